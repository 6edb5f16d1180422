"""Poses of a session replayed in a simulator: its differences from the fitted arm, by model level."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.effects import MODELS
from bayescal.effects.selection import plain
from bayescal.exporting.mjcf.elastic import Content
from bayescal.exporting.mjcf.format import holds
from bayescal.exporting.mjcf.mechanism import Load, loads, places
from bayescal.exporting.mjcf.readings import Law, bare, error, law_of, posture
from bayescal.fitted.arm import NOMINAL, FittedArm
from bayescal.verifying.simulator import File, Simulator

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
class Machine:
    """An arm in its file in MuJoCo, in the state of a row: the law of its readings and its tools."""

    arm: FittedArm
    file: File
    simulator: Simulator
    law: Law
    loads: tuple[Load, ...]

    @classmethod
    def of(cls, arm: FittedArm, row: int, file: File) -> Machine:
        """The machine of an arm in a file that has the state of a row."""
        content = Content(arm, row)
        law = law_of(content)
        return cls(arm, file, Simulator(file, law.nominal), law, loads(content))

    def at(self, row: int) -> Machine:
        """The machine in the state of another row, to which the bodies of a new file are brought."""
        content = Content(self.arm, row)
        law = law_of(content)
        self.simulator.take(places(content, bare(law) if self.file.script else law))
        return replace(self, law=law, loads=loads(content))

    def replayed(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Readings reached (C, n), rad, and TCP positions (C, 3), m, in rows of the session.

        Each pose is approached in the direction in which the arm moved, with tool and payload of the row.
        """
        m, law, joints = self.arm.dataset.measurements, self.law, self.file.joints
        payload = np.zeros(len(m.ids)) if m.payload is None else m.payload
        reached, points = np.empty((len(rows), m.readings.shape[1])), np.empty((len(rows), 3))
        carried = np.column_stack([m.tool[rows], payload[rows]])
        for tool, extra in np.unique(carried, axis=0):
            mine = np.flatnonzero((carried == (tool, extra)).all(axis=1))
            load = self.loads[int(tool)]
            self.simulator.carry(load, float(extra))
            readings = m.readings[rows[mine]]
            # places of gears in their lost motion; the middle where no velocity is recorded
            sense = np.zeros(readings.shape) if m.velocity is None else law.sense(m.velocity[rows[mine]])
            if self.file.script:
                links = law.turned(readings) + law.lag(sense)
                starts = goals = np.linalg.solve(law.nominal, links.T).T
                postures = [dict(posture(bare(law), joints, goal)) for goal in goals]
            else:
                goals, starts = readings, self.starts(readings, sense)
                postures = self.postures(starts, sense)
            stood, points[mine] = self.simulator.stand(postures, starts, goals, load.name)
            reached[mine] = stood - goals + readings
        world = self.file.world
        return reached, points @ world[:3, :3].T + world[:3, 3]

    def starts(self, readings: np.ndarray, sense: np.ndarray) -> np.ndarray:
        """Readings (C, n), rad, from which the poses are approached: gears that moved, move."""
        if not self.law.lost.any():
            return readings
        moved = APPROACH * np.max(self.law.lost) * np.where(np.abs(sense) > MOVED, np.sign(sense), 0.0)
        return readings - np.linalg.solve(self.law.geared @ self.law.nominal, moved.T).T

    def postures(self, starts: np.ndarray, sense: np.ndarray) -> list[dict[str, float]]:
        """Positions of all joints at the starts (C, n); gears that rest are at their places."""
        names = self.file.joints.names
        lags = self.law.lag(np.where(np.abs(sense) > MOVED, 0.0, sense))
        out = [dict(posture(self.law, self.file.joints, start)) for start in starts]
        for positions, lag in zip(out, lags, strict=True):
            for j in np.flatnonzero(lag).tolist():
                positions[error(names[j])] += float(lag[j])
        return out


def modelled(arm: FittedArm, rows: np.ndarray, reached: np.ndarray, state: int) -> np.ndarray:
    """TCPs (C, 3), m, of the fitted arm at readings reached (C, n) in rows, in the state of a row."""
    m = arm.dataset.measurements
    out = np.empty((len(rows), 3))
    for tool in np.unique(m.tool[rows]):
        mine, name = np.flatnonzero(m.tool[rows] == tool), arm.dataset.tools[int(tool)].name
        payload = 0.0 if m.payload is None else m.payload[rows[mine]]
        direction = None if m.velocity is None else m.velocity[rows[mine]]
        poses = arm.at(reached[mine], tool=name, payload_kg=payload, direction=direction, row=state)
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


def chosen(arm: FittedArm) -> np.ndarray:
    """Rows of the session whose poses are compared: evenly spread, without outliers."""
    ids = np.array(arm.dataset.measurements.ids)
    rows = np.flatnonzero(~np.isin(ids, arm.rejected))
    return rows[np.unique(np.linspace(0, len(rows) - 1, POSES).round().astype(int))]


def levels(
    arm: FittedArm, file: File, state: int, notify: Callable[[float], None] = lambda share: None
) -> tuple[Level, ...]:
    """Compare every model level of an arm, as far as MJCF holds it, with a simulator.

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
        used = file if arm_of_level is arm else File.new(arm_of_level, state, file.script)
        reached, points = Machine.of(arm_of_level, state, used).replayed(rows)
        off = np.linalg.norm(points - modelled(_held(arm_of_level), rows, reached, state), axis=1)
        out.append(Level(name, off, limit(arm.effects[:k] if name != NOMINAL else ())))
    return tuple(out)


def _held(arm: FittedArm) -> FittedArm:
    """The arm without the parameters that no MJCF file holds."""
    held = [holds(arm, k) for k in range(len(arm.values))]
    return arm if all(held) else replace(arm, values=np.where(held, arm.values, 0.0))
