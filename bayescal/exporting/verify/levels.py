"""Differences between a simulator and the fitted arm, by model level."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.exporting.fitted import NOMINAL, FittedArm
from bayescal.exporting.mjcf.new_file import mjcf
from bayescal.exporting.verify.limits import TOGETHER_RMS, limit
from bayescal.exporting.verify.replay import Machine, modelled, replayed
from bayescal.exporting.verify.simulator import Simulator

POSES = 100


@dataclass(frozen=True)
class Level:
    """One model level: differences of C tool points, m, and the limit of the largest."""

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
    arm: FittedArm, text: str, state: int, where: str, notify: Callable[[float], None] = lambda share: None
) -> tuple[Level, ...]:
    """Compare every model level of an arm with a simulator.

    The last level is the written file; the others are files written in the same way.

    Parameters
    ----------
    arm : FittedArm
    text : str
        Of the written file.
    state : int
        Row of the session whose state the file has.
    where : str
        Name of the file, for messages.
    notify : callable
        Called with the completed fraction.
    """
    rows, out = chosen(arm), []
    for k, name in enumerate(arm.levels):
        notify(k / len(arm.levels))
        own = arm if name == arm.levels[-1] else arm.level(name)
        file = text if own is arm else mjcf(own, state)
        simulator = Simulator(file, arm.dataset.robot.joint_names, where)
        reached, points = replayed(simulator, Machine.of(own, state), own, rows)
        off = np.linalg.norm(points - modelled(own, rows, reached, state), axis=1)
        out.append(Level(name, off, limit(arm.effects[:k] if name != NOMINAL else ())))
    return tuple(out)
