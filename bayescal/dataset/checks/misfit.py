"""Errors of rows at nominal geometry, the basis of the checks of a dataset."""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.dataset import target_kinds
from bayescal.dataset.contacts import Contacts, residual, scatter
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Dataset

OFF = 0.05
"""m: a contact this far from where the others of its target put the surface is impossible."""

FEWEST = 4
"""Instrument rows from which a rigid fit can judge any of them."""


def nominal(dataset: Dataset, readings: np.ndarray) -> np.ndarray:
    """Nominal ball centres in F0, (N, 3) m, at readings (N, n), rad."""
    tool = np.array([t.centre for t in dataset.tools])[dataset.measurements.tool]
    return points(chain_of(dataset.robot), link_angles(dataset.robot, readings), tool)


def contacts(dataset: Dataset, target: int, p: np.ndarray, at: np.ndarray) -> Contacts:
    """The rows `at` of one target, with ball centres p (N, 3), m, of all rows."""
    seen = target_kinds.seen(dataset, target, at, p[at].mean(axis=0))
    return Contacts(dataset.targets[target], p[at], seen)


def seen(dataset: Dataset, p: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Errors of an instrument's rows `at` after the best rigid fit, m; 0 where there are too few rows."""
    xyz = dataset.measurements.xyz
    return np.zeros(len(at)) if len(at) < FEWEST or xyz is None else scatter(p[at], xyz[at], OFF)


def away(dataset: Dataset, readings: np.ndarray) -> np.ndarray:
    """Distance of every row from its target at nominal geometry, (N,) m."""
    p, out = nominal(dataset, readings), np.zeros(len(readings))
    for index, target in enumerate(dataset.targets):
        at = np.flatnonzero(dataset.measurements.target == index)
        if not KINDS[target.kind].placed:
            out[at] = seen(dataset, p, at)
        elif len(at):
            out[at] = np.linalg.norm(residual(contacts(dataset, index, p, at))[0], axis=1)
    return out
