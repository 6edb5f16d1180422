"""Signals of a joint log at equal steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from bayescal.logs import Motion

STEP = 4e-3
"""s, of signals that are compared: far below the periods of motions."""
SMOOTH = 0.1
"""s, over which speeds are averaged."""


def speeds(time: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Velocities (N, n), rad/s, from positions (N, n) and stamps (N,), over `SMOOTH`: stamps may scatter."""
    wide = max(round(float(SMOOTH / np.median(np.diff(time)))), 1)
    turned, took = np.gradient(position, axis=0), np.gradient(time)[:, None]
    both = [np.asarray(uniform_filter1d(x, wide, axis=0, mode="nearest")) for x in (turned, took)]
    return both[0] / both[1]


@dataclass(frozen=True)
class Uniform:
    """A motion at equal steps, its median one: arrays (N, n), None where not measured."""

    step: float
    position: np.ndarray
    velocity: np.ndarray
    measured: np.ndarray | None
    torque: np.ndarray | None
    command: np.ndarray | None


def uniform(motion: Motion) -> Uniform:
    """A motion at equal steps; `velocity` is that of the positions where none is measured.

    Of a faster log, means of as many rows as make `STEP`: the same for all signals, so that delays are kept.
    """
    raw = float(np.median(np.diff(motion.time)))
    grid = np.arange(motion.time[0], motion.time[-1] + raw / 2, raw)
    every = max(round(STEP / raw), 1)

    def at(values: np.ndarray | None) -> np.ndarray | None:
        if values is None:
            return None
        even = np.column_stack([np.interp(grid, motion.time, column) for column in values.T])
        return even if every == 1 else np.asarray(uniform_filter1d(even, every, axis=0)[::every])

    position = at(motion.position)
    assert position is not None
    step, measured = raw * every, at(motion.velocity)
    velocity = np.gradient(position, step, axis=0) if measured is None else measured
    return Uniform(step, position, velocity, measured, at(motion.torque), at(motion.command))
