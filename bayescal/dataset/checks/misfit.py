"""How far rows are off at nominal geometry: what the checks of a dataset judge by."""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.dataset.contacts import Contacts, residual, scatter
from bayescal.dataset.types import Dataset, Target

OFF = 0.05
"""m: a contact this far from where the others of its target put the surface is impossible."""

FEWEST = 4
"""Instrument rows from which a rigid fit can judge any of them."""


def nominal(dataset: Dataset, readings: np.ndarray) -> np.ndarray:
    """Nominal ball centres in F0, (N, 3) m, at readings (N, n), rad."""
    tool = np.array([t.centre for t in dataset.tools])[dataset.measurements.tool]
    return points(chain_of(dataset.robot), link_angles(dataset.robot, readings), tool)


def contacts(dataset: Dataset, target: Target, p: np.ndarray, at: np.ndarray) -> Contacts:
    """The rows `at` of one target, with ball centres p (N, 3), m, of all rows."""
    rows = dataset.measurements
    radius = np.array([t.ball_radius or 0.0 for t in dataset.tools])[rows.tool[at]]
    length = np.full(len(at), target.values.get("length", np.nan))
    if rows.length is not None:
        length = np.where(np.isfinite(rows.length[at]), rows.length[at], length)
    return Contacts(target, p[at], radius, length)


def seen(dataset: Dataset, p: np.ndarray, at: np.ndarray) -> np.ndarray:
    """How far an instrument's rows `at` are off after the best rigid fit, m; 0 where too few to tell."""
    xyz = dataset.measurements.xyz
    return np.zeros(len(at)) if len(at) < FEWEST or xyz is None else scatter(p[at], xyz[at], OFF)


def away(dataset: Dataset, readings: np.ndarray) -> np.ndarray:
    """How far every row is off its target as it is drawn, (N,) m."""
    p, out = nominal(dataset, readings), np.zeros(len(readings))
    for index, target in enumerate(dataset.targets):
        at = np.flatnonzero(dataset.measurements.target == index)
        if target.kind == "instrument":
            out[at] = seen(dataset, p, at)
        elif len(at):
            out[at] = np.linalg.norm(residual(contacts(dataset, target, p, at))[0], axis=1)
    return out
