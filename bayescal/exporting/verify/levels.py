"""Differences between a simulator and the fitted arm, by model level."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayescal.exporting.fitted import NOMINAL, FittedArm
from bayescal.exporting.mjcf.new_file import mjcf
from bayescal.exporting.verify.limits import TOGETHER_RMS, limit
from bayescal.exporting.verify.replay import Machine, Place, modelled, replayed

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
        own = arm if name == arm.levels[-1] else arm.level(name)
        used = file if own is arm else File.new(own, state, file.place.script)
        machine = Machine.of(own, state, used.place)
        simulator = machine.simulator(used.text, used.folder, used.name)
        reached, points = replayed(simulator, machine, own, rows)
        off = np.linalg.norm(points - modelled(own, rows, reached, state), axis=1)
        out.append(Level(name, off, limit(arm.effects[:k] if name != NOMINAL else ())))
    return tuple(out)
