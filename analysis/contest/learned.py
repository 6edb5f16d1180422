"""Entries that learn what a calibrated model leaves: a Gaussian process, and gradient boosting.

Both learn from residuals of the `calibrate` rows by the sines and cosines of the joint readings. Points give
displacements along three axes; contacts give one along the normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.contest import session as sessions
from analysis.contest.ours import Answer, Given, points_of_estimate
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.model.scene import Scene

LENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Of the kernel: distances of features of unit scale."""
RATIOS = np.geomspace(1e-3, 1e3, 25)
"""Variance of the process over that of the noise."""
Predict = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Of features and residuals that train, and features of all rows: residuals of all rows."""


@dataclass(frozen=True)
class Left:
    """What a calibrated model leaves: features (N, F) and normals (N, 3) of all rows, residuals of some."""

    points: np.ndarray  # (N, 3) mm, of the calibrated model
    features: np.ndarray
    normals: np.ndarray  # nan where the row is of a point
    rows: np.ndarray  # (C,) of `residual`
    residual: np.ndarray  # (C, 3) mm of points in F0, or (C, 1) along the normals


def left(given: Given) -> Left:
    """Residuals of the calibration by bayescal: geometry and compliance.

    Raises
    ------
    BayescalError
        If a session calibrates with both points and contacts.
    """
    points = points_of_estimate(calibrated(Scene(given.fitted), given.usual))
    session = sessions.read(given.folder)
    targets = sessions.located(session, points)
    rows, parts = [], []
    for own, r in sessions.residuals_of(session, points, targets, "calibrate"):
        state = targets[str(session.target[own[0]])]
        rows.append(own)
        parts.append(r @ state["rotation"].T if "rotation" in state else r)
    if len({part.shape[1] for part in parts}) > 1:
        raise BayescalError("points and contacts together")
    q = given.whole.measurements.readings
    features = np.column_stack([np.sin(q), np.cos(q)])
    normals = sessions.normals(session, points, targets)
    return Left(points, features, normals, np.concatenate(rows), np.concatenate(parts))


def gaussian_process(given: Given) -> Answer:
    """Kernel and noise by the largest marginal likelihood on a grid; the same for all axes.

    A contact sees the displacement along its normal: the covariance of two contacts is the kernel times the
    cosine between their normals.
    """
    x = left(given)
    rows, y = x.rows, x.residual
    single = y.shape[1] == 1

    def kernel(a: np.ndarray, b: np.ndarray, length: float) -> np.ndarray:
        square = np.sum((x.features[a][:, None] - x.features[b][None]) ** 2, axis=-1)
        out = np.exp(-0.5 * square / length**2)
        return np.asarray(out * np.nan_to_num(x.normals[a] @ x.normals[b].T) if single else out)

    best, chosen = -np.inf, (LENGTHS[0], RATIOS[0], 1.0, np.zeros(0), np.zeros((0, 0)))
    for length in LENGTHS:
        size, vectors = np.linalg.eigh(kernel(rows, rows, length))
        turned = vectors.T @ y
        for ratio in RATIOS:
            scale = 1.0 + ratio * np.maximum(size, 0.0)
            noise = float(np.mean(np.sum(turned**2 / scale[:, None], axis=0) / len(y)))
            value = -0.5 * y.shape[1] * (len(y) * np.log(noise) + np.sum(np.log(scale)))
            if value > best:
                best, chosen = value, (length, ratio, noise, scale, vectors)
    length, ratio, noise, scale, vectors = chosen
    every = np.arange(len(x.points))
    solved = vectors @ ((vectors.T @ y) / scale[:, None])
    across = ratio * kernel(every, rows, length)
    inside = np.sum((across @ vectors) ** 2 / scale, axis=1)
    u = np.sqrt(noise * (1.0 + ratio - inside))
    moved = across @ solved
    shift = np.nan_to_num(moved * x.normals) if single else moved
    return Answer(x.points - shift, u if not single or np.isfinite(x.normals).all() else None)


def boosted(given: Given, predict: Predict) -> Answer:
    """Gradient boosting by scikit-learn with its defaults."""
    x = left(given)
    single = x.residual.shape[1] == 1
    features = np.column_stack([x.features, np.nan_to_num(x.normals)]) if single else x.features
    moved = predict(features[x.rows], x.residual, features)
    return Answer(x.points - (np.nan_to_num(moved * x.normals) if single else moved))
