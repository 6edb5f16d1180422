"""Touching: the readings at which the true arm's ball meets the true surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayescal.dataset import Dataset, Target
from bayescal.effects import parameters_of
from bayescal.errors import BayescalError
from bayescal.model import Model
from bayescal.scene import Scene

CLOSED = 1e-12  # m
PASSES = 30


@dataclass(frozen=True)
class World:
    """What is true of a session: its effects, the arm's deviations from its drawing, the targets.

    `deviations` gives those of a model's parameters, (P,), SI.
    """

    effects: tuple[str, ...]
    deviations: Callable[[Model], np.ndarray]
    targets: tuple[Target, ...]

    def model(self, dataset: Dataset) -> Model:
        """The true arm at a session's readings, its drivers included, before the true targets."""
        scene = Scene(dataset)
        parameters = parameters_of(self.effects, scene.circumstances(scene.rows("calibrate")))
        return Model(Scene(replace(dataset, targets=self.targets)), self.effects, parameters, (), ())

    def residuals(self, dataset: Dataset) -> np.ndarray:
        """How far off the true surface, along its normal, each row's ball truly is, (N,), m."""
        model = self.model(dataset)
        values = self.deviations(model)
        rows = dataset.measurements.target
        out = np.empty(len(rows))
        for target in np.unique(rows):
            at = np.flatnonzero(rows == target)
            block = model.block(int(target), at)
            out[at] = block.residual(values, np.zeros(block.size))[0]
        return out


def touch(world: World, dataset: Dataset, shift: np.ndarray) -> Dataset:
    """The session with every contact closed: each row goes on at its joint velocities until it touches.

    Torques and whatever else drives an effect are those at the readings found.

    Parameters
    ----------
    world : World
        What is true.
    dataset : Dataset
        Its readings are where the nominal arm touches the nominal targets; with velocities.
    shift : np.ndarray, shape (N,)
        How far outside of the true surface each contact triggers, m: noise and gross errors.

    Returns
    -------
    Dataset
        With the readings at which the contacts hold, to 1e-12 m.

    Raises
    ------
    BayescalError
        If some contact cannot be closed: errors as large as that miss the target.
    """
    start, velocity = dataset.measurements.readings, dataset.measurements.velocity
    assert velocity is not None

    def after(seconds: np.ndarray) -> tuple[Dataset, np.ndarray]:
        readings = start + seconds[:, None] * velocity
        moved = replace(dataset, measurements=replace(dataset.measurements, readings=readings))
        return moved, world.residuals(moved) - shift

    seconds = np.zeros(len(start))
    moved, off = after(seconds)
    slope = (after(seconds + 1e-3)[1] - off) / 1e-3  # m/s: how fast the ball closes in
    for _ in range(PASSES):
        if np.all(np.abs(off) < CLOSED):
            return moved
        step = np.clip(-off / slope, -1.0, 1.0)
        seconds = seconds + step
        before = off
        moved, off = after(seconds)
        far = np.abs(step) > 1e-7  # nearer, the difference is rounding
        slope = np.where(far, (off - before) / np.where(far, step, 1.0), slope)
        if not np.all(np.isfinite(slope) & (slope != 0)):
            break
    row = int(np.argmax(np.where(np.isfinite(off), np.abs(off), np.inf)))
    name = dataset.targets[dataset.measurements.target[row]].name
    what = f"the arm with its errors never touches {name}"
    raise BayescalError(what, dataset.name, "give a smaller --error-scale, or another --seed")
