"""Poses of a session replayed in a simulator: its differences from the fitted arm, by model level."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.effects import MODELS
from bayescal.effects.selection import plain
from bayescal.exporting.mjcf.elastic import Content
from bayescal.exporting.mjcf.format import mjcf
from bayescal.exporting.mjcf.mechanism import Load, loads, names, poses
from bayescal.exporting.mjcf.readings import Joints, Law, bare, error, law_of, posture
from bayescal.fitted.arm import NOMINAL, FittedArm
from bayescal.verifying.simulator import Simulator

NOMINAL_WITHIN = 1e-9
"""Maximum difference of the TCP positions, m, of the nominal arm."""
TOGETHER, TOGETHER_RMS = 3e-6, 1e-6
"""Maximum and RMS difference, m, of any model."""


def limit(effects: Sequence[str]) -> float:
    """Maximum difference of a model with these effects, m."""
    within = [MODELS[plain(name)].simulated_within for name in effects] or [NOMINAL_WITHIN]
    return min(sum(within), TOGETHER)


APPROACH = 3.0
"""Motion of every gear before a pose, in half-widths of the largest lost motion: it passes twice that."""
MOVED = 0.999
"""Place in the lost motion beyond which a gear has moved through it."""


@dataclass(frozen=True)
class Place:
    """Where the arm of a file is: its joints, and the world of the file in F0, (4, 4), m.

    In a user's file (`of_user`) the joints have the user's actuators, and the bodies the user's names. With a
    `script` the file has no errors of the readings; they are in its commands.
    """

    joints: Joints
    world: np.ndarray
    of_user: bool = False
    script: bool = False
    renamed: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @classmethod
    def of(cls, arm: FittedArm, sidecar: Mapping[str, Any]) -> Place:
        """The place in a file with a sidecar; in a new file without one."""
        script = sidecar.get("readings") == "script"
        if "root_in_f0" not in sidecar:
            return cls(Joints.of(arm.dataset.robot.joint_names), np.eye(4), script=script)
        joints = Joints(tuple(sidecar["joints"].values()), np.array(sidecar["signs"]))
        return cls(joints, np.array(sidecar["root_in_f0"]), True, script, sidecar.get("renamed", {}))


@dataclass(frozen=True)
class Machine:
    """What brings an arm in a simulator to a pose: the law of its readings, its tools, places of bodies."""

    law: Law
    loads: tuple[Load, ...]
    place: Place
    poses: Mapping[str, np.ndarray]

    @classmethod
    def of(cls, arm: FittedArm, row: int, place: Place | None = None) -> Machine:
        """The machine of an arm in the state of a row."""
        content = Content(arm, row)
        law = law_of(content)
        places = dict(zip(names(len(law.lost)), poses(content, law), strict=True))
        return cls(law, loads(content), place or Place.of(arm, {}), places)

    def simulator(self, text: str, folder: Path, where: str) -> Simulator:
        """The simulator of a file of this machine."""
        place = self.place
        return Simulator(
            text, folder, place.joints, self.law.nominal, not place.of_user, where, place.renamed
        )

    def sense(self, velocity: np.ndarray | None, count: int) -> np.ndarray:
        """Places (C, n) of gears in their lost motion after a velocity (C, n); the middle without one."""
        return np.zeros((count, len(self.law.lost))) if velocity is None else self.law.sense(velocity)

    def starts(self, readings: np.ndarray, sense: np.ndarray) -> np.ndarray:
        """Readings (C, n), rad, from which the poses are approached: gears that moved, move."""
        if not self.law.lost.any():
            return readings
        moved = APPROACH * np.max(self.law.lost) * np.where(np.abs(sense) > MOVED, np.sign(sense), 0.0)
        return readings - np.linalg.solve(self.law.geared @ self.law.nominal, moved.T).T

    def postures(self, starts: np.ndarray, sense: np.ndarray) -> list[dict[str, float]]:
        """Positions of all joints at the starts (C, n); gears that rest are at their places."""
        names = self.place.joints.names
        lags = self.law.lag(np.where(np.abs(sense) > MOVED, 0.0, sense))
        out = [dict(posture(self.law, self.place.joints, start)) for start in starts]
        for positions, lag in zip(out, lags, strict=True):
            for j in np.flatnonzero(lag).tolist():
                positions[error(names[j])] += float(lag[j])
        return out

    def commands(self, readings: np.ndarray, sense: np.ndarray) -> np.ndarray:
        """Commands (C, n) of a script, rad, for readings."""
        links = self.law.turned(readings) + self.law.lag(sense)
        return np.linalg.solve(self.law.nominal, links.T).T


def replayed(
    simulator: Simulator, machine: Machine, arm: FittedArm, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Readings reached (C, n), rad, and TCP positions (C, 3), m, in rows of the session.

    Each pose is approached in the direction in which the arm moved, with the tool and the payload of the row.
    """
    m = arm.dataset.measurements
    payload = np.zeros(len(m.ids)) if m.payload is None else m.payload
    velocity = m.velocity
    reached, points = np.empty((len(rows), m.readings.shape[1])), np.empty((len(rows), 3))
    carried = np.column_stack([m.tool[rows], payload[rows]])
    for tool, extra in np.unique(carried, axis=0):
        mine = np.flatnonzero((carried == (tool, extra)).all(axis=1))
        load = machine.loads[int(tool)]
        simulator.carry(load, float(extra))
        readings = m.readings[rows[mine]]
        sense = machine.sense(None if velocity is None else velocity[rows[mine]], len(mine))
        if machine.place.script:
            goals = machine.commands(readings, sense)
            starts, light = goals, bare(machine.law)
            postures = [dict(posture(light, machine.place.joints, goal)) for goal in goals]
        else:
            goals, starts = readings, machine.starts(readings, sense)
            postures = machine.postures(starts, sense)
        stood = simulator.stand(postures, starts, goals, load.name)
        reached[mine], points[mine] = stood.readings - goals + readings, stood.points
    world = machine.place.world
    return reached, points @ world[:3, :3].T + world[:3, 3]


def modelled(arm: FittedArm, rows: np.ndarray, reached: np.ndarray, state: int) -> np.ndarray:
    """TCPs (C, 3), m, of the fitted arm at readings reached (C, n) in rows, in the state of a row."""
    m = arm.dataset.measurements
    out = np.empty((len(rows), 3))
    names = [t.name for t in arm.dataset.tools]
    for tool in np.unique(m.tool[rows]):
        mine = np.flatnonzero(m.tool[rows] == tool)
        payload = 0.0 if m.payload is None else m.payload[rows[mine]]
        direction = None if m.velocity is None else m.velocity[rows[mine]]
        poses = arm.at(
            reached[mine], tool=names[int(tool)], payload_kg=payload, direction=direction, row=state
        )
        out[mine] = poses.points
    return out


POSES = 100


@dataclass(frozen=True)
class Level:
    """One model level: differences of C TCP positions, m, and the limit of the largest."""

    name: str
    differences: np.ndarray  # (C,)
    limit: float

    @property
    def rms(self) -> float:
        """RMS difference, m."""
        return float(np.sqrt(np.mean(self.differences**2)))

    @property
    def maximum(self) -> float:
        """Largest difference, m."""
        return float(np.max(self.differences))

    @property
    def passed(self) -> bool:
        """Whether the differences are within the limits."""
        return self.maximum <= self.limit and self.rms <= TOGETHER_RMS


@dataclass(frozen=True)
class File:
    """A file of an arm: its text, the folder of its meshes, its name, and where the arm is in it."""

    text: str
    folder: Path
    name: str
    place: Place

    @classmethod
    def new(cls, arm: FittedArm, state: int, script: bool = False) -> File:
        """A new file of an arm in the state of a row."""
        place = replace(Place.of(arm, {}), script=script)
        return cls(mjcf(arm, state, script), Path(), "new file", place)


def chosen(arm: FittedArm) -> np.ndarray:
    """Rows of the session whose poses are compared: evenly spread, without outliers."""
    ids = np.array(arm.dataset.measurements.ids)
    rows = np.flatnonzero(~np.isin(ids, arm.rejected))
    return rows[np.unique(np.linspace(0, len(rows) - 1, POSES).round().astype(int))]


def levels(
    arm: FittedArm, file: File, state: int, notify: Callable[[float], None] = lambda share: None
) -> tuple[Level, ...]:
    """Compare every model level of an arm with a simulator.

    The last level is the written file; the others are files written in the same way.

    Parameters
    ----------
    arm : FittedArm
    file : File
        The written one.
    state : int
        Row of the session whose state the file has.
    notify : callable
        Called with the completed fraction.
    """
    rows, out = chosen(arm), []
    for k, name in enumerate(arm.levels):
        notify(k / len(arm.levels))
        arm_of_level = arm if name == arm.levels[-1] else arm.level(name)
        used = file if arm_of_level is arm else File.new(arm_of_level, state, file.place.script)
        machine = Machine.of(arm_of_level, state, used.place)
        simulator = machine.simulator(used.text, used.folder, used.name)
        reached, points = replayed(simulator, machine, arm_of_level, rows)
        off = np.linalg.norm(points - modelled(arm_of_level, rows, reached, state), axis=1)
        out.append(Level(name, off, limit(arm.effects[:k] if name != NOMINAL else ())))
    return tuple(out)
