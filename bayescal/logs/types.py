"""A joint log as frozen arrays, in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.logs.mechanism import Mechanism

CALIBRATE, VALIDATE = "calibrate", "validate"
SERVO = "servo"
"""Kind of torques that are errors of position servos, times their stiffness."""
TORQUE, TRACKING, LINK = "torque", "tracking", "link"
"""Kinds of residuals: torque, N m; command less position beyond what the torque explains, rad; position
behind the gear less position of the motor, rad. A joint has a channel of each kind that a log has."""


ONE_VALUE, MOVING = 0.5, 0.1
"""Fraction of the rows of a moving joint with one and the same torque: its signal has too few digits, or is
dead; and a joint moves where it is faster than this fraction of its 95th percentile (conventions)."""
LOST_STEPS, LOST = 3.0, 0.05
"""Steps, and s, without rows, over which nothing is interpolated: half a period of 10 Hz (assumed)."""
FEWEST_ROWS = 20
"""Rows of a motion: fewer have no derivatives."""
SHORTEST = 1.0
"""s of a part of a motion that is of use: its ends are lost to filters (assumed)."""


@dataclass(frozen=True)
class Motion:
    """One motion of a log: N rows of n joints. A column that was not measured is None."""

    name: str
    role: str  # calibrate or validate
    kind: str  # of motion, as the file says
    same_as: str  # the motion that it repeats; its own name if none
    time: np.ndarray  # (N,) s
    position: np.ndarray  # (N, n) rad
    velocity: np.ndarray | None  # (N, n) rad/s
    command: np.ndarray | None  # (N, n) rad
    torque: np.ndarray | None  # (N, n) N m, at the joint
    link: np.ndarray | None  # (N, n) rad, of second encoders behind the gears
    temperature: np.ndarray | None  # (N,) degC
    payload: np.ndarray  # (N,) kg
    line: int  # of its first row

    @property
    def loaded(self) -> bool:
        """Whether it carries a payload."""
        return bool(np.any(self.payload > 0.0))

    @property
    def divided(self) -> tuple[Motion, ...]:
        """Its parts between rows that are missing, without those that are too short; itself if none are."""
        steps = np.diff(self.time)
        lost = np.flatnonzero(steps > max(LOST_STEPS * float(np.median(steps)), LOST)) + 1
        if not len(lost):
            return (self,)
        parts = [slice(a, b) for a, b in pairwise((0, *lost.tolist(), len(self.time)))]
        parts = [p for p in parts if self.time[p.stop - 1] - self.time[p.start] >= SHORTEST]
        parts = [p for p in parts if p.stop - p.start >= FEWEST_ROWS]
        columns = {f.name for f in fields(self)} - {"name", "role", "kind", "same_as", "line"}
        out = []
        for k, rows in enumerate(parts, 1):
            values: dict[str, Any] = {
                c: None if (x := getattr(self, c)) is None else x[rows] for c in columns
            }
            name = f"{self.name} ({k})"
            out.append(replace(self, name=name, same_as=name, line=self.line + rows.start, **values))
        return tuple(out)


@dataclass(frozen=True)
class Controller:
    """What is known of the controller: gains (n,) in SI, None where not stated."""

    kind: str  # torque or position
    stiffness: np.ndarray | None  # (n,) N m/rad
    damping: np.ndarray | None  # (n,) N m s/rad
    stated: bool = True  # False where the stiffness follows from the log
    ahead: np.ndarray | None = None  # (n,) N m s/rad, of the commanded speed; None where torques do not tell
    complete: bool = True  # False where measured torques have a further part, such as feed-forward


@dataclass(frozen=True)
class Log:
    """Motions of one arm, with its nominal mechanism and what is known of the measurement."""

    name: str
    mechanism: Mechanism
    motions: tuple[Motion, ...]
    gravity: np.ndarray  # (3,) m/s2
    controller: Controller
    torque_kind: str  # motor, current, sensor or servo; "" without torques
    signed: bool  # whether the torque has a sign
    u_constant: float  # relative standard uncertainty of the torque constants
    alignment: float  # s, of torque against position, and its standard uncertainty
    u_alignment: float
    link_side: bool  # whether positions are of the link side of the gears
    notes: tuple[str, ...]  # what was assumed
    digest: str  # SHA-256 of the files
    files: tuple[Path, ...] = ()  # that were read
    noise: np.ndarray | None = None  # (n,) N m, stated standard deviations of the torques

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.mechanism.n

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of residuals of this log."""
        control = self.controller
        servo = control.kind == "position" and control.stiffness is not None and control.complete
        servo = servo and self.torque_kind != SERVO
        tracked = servo and all(m.command is not None for m in self.motions)
        linked = not self.link_side and all(m.link is not None for m in self.motions)
        return (TORQUE, *([TRACKING] if tracked else []), *([LINK] if linked else []))

    def of_role(self, role: str) -> tuple[Motion, ...]:
        """The motions of a role."""
        return tuple(m for m in self.motions if m.role == role)

    @property
    def divided(self) -> Log:
        """The log with motions divided where rows are missing."""
        parts = {m.name: m.divided for m in self.motions}
        if all(len(p) == 1 and p[0].name == name for name, p in parts.items()):
            return self
        kept = tuple(p for m in self.motions for p in parts[m.name])
        missing = [name for name, p in parts.items() if [m.name for m in p] != [name]]
        said = f"rows are missing in motion {', '.join(missing)}: it is divided there, not interpolated"
        return replace(self, motions=kept, notes=(*self.notes, said))

    @property
    def coarse(self) -> Mapping[str, float]:
        """Joints with one and the same torque in most rows in which they move, and the fraction of these.

        What such a torque tells of masses, centres of mass and friction would be wrong: it is left out.
        """
        parts = [m for m in self.motions if m.torque is not None and len(m.time) > 1]
        if not parts or self.torque_kind == SERVO:
            return {}
        torque = np.concatenate([m.torque for m in parts if m.torque is not None])
        speed = np.abs(np.concatenate([np.gradient(m.position, m.time, axis=0) for m in parts]))
        out = {}
        for name, t, v in zip(self.mechanism.joint_names, torque.T, speed.T, strict=True):
            moves = v > max(MOVING * float(np.quantile(v, 0.95)), np.finfo(float).tiny)
            share = np.unique(t[moves], return_counts=True)[1].max() / moves.sum() if moves.any() else 0.0
            if share > ONE_VALUE:
                out[name] = float(share)
        return out

    @property
    def limits(self) -> tuple[str, ...]:
        """What limits all results of this log, as text: assumptions, and torques that tell nothing."""
        coarse = self.coarse
        if not coarse:
            return self.notes
        each = ", ".join(f"{name} {100 * share:.0f} %" for name, share in coarse.items())
        what = f"one and the same torque in most rows in which the joint moves: {each}: it would tell wrong "
        return (*self.notes, what + "masses and friction, and is left out; log it with more digits")
