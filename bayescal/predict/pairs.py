"""Distances between points of the workspace: pairs, lengths, and their slopes by the arm."""

from __future__ import annotations

import numpy as np

from bayescal.arm.motion import Motion
from bayescal.model import Model

SHORTEST = 0.2
"""Shortest distance, relative to the longest: shorter distances give little information on the arm."""


def evenly(count: int, most: int) -> np.ndarray:
    """At most `most` indices, evenly among `count`."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def far_pairs(at: np.ndarray) -> np.ndarray:
    """Pairs (K, 2) of points (3, N) with a distance that is long enough."""
    pairs = np.stack(np.triu_indices(at.shape[1], 1), axis=1)
    apart = lengths(at, pairs)
    return pairs[apart > SHORTEST * np.max(apart, initial=0.0)]


def lengths(at: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Distances (..., K) between points (..., 3, N)."""
    return np.linalg.norm(at[..., pairs[:, 0]] - at[..., pairs[:, 1]], axis=-2)


def slopes(model: Model, motion: Motion, values: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Slopes (K, P), m, of the distances of pairs (K, 2) of TCP positions by z of the arm.

    Parameters
    ----------
    model : Model
    motion : Motion
        Of N rows, under this model's parameters.
    values : np.ndarray, shape (P,)
        Deviations of the arm's parameters, SI.
    pairs : np.ndarray, shape (K, 2)
        Of the rows.
    """
    at = motion.points(values)
    first, second = pairs.T
    along = (at[:, first] - at[:, second]) / lengths(at, pairs)
    axes = [np.repeat(axis[:, None], at.shape[1], axis=1) for axis in np.eye(3)]
    by_point = np.stack([motion.columns(values, at, axis) for axis in axes])  # (3, P, N)
    by = np.einsum("ak,apk->kp", along, by_point[..., first] - by_point[..., second])
    return np.asarray(by * model.sd)
