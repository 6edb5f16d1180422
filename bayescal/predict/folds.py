"""Blocked cross-validation: fitted measurements are left out in blocks of poses and time, in closed form."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayescal.dataset import Measurements
from bayescal.estimate.clusters import poses

FOLDS = 10
"""Number of blocks of rows that are left out in turn (convention)."""
ROUNDING = 1e-9
"""Smallest share of the information on a direction that the other blocks must have."""


def folds(m: Measurements, rows: np.ndarray) -> np.ndarray:
    """Block (R,) of each of some rows, from 0, by time within each target; rows of one pose are together.

    The rows of a target are in the order of time, and a block is a stretch of them. A session that probes one
    face after the other so never loses a whole face, whose location the other rows do not determine.

    Parameters
    ----------
    m : Measurements
    rows : np.ndarray of int, shape (R,)
        Rows of the session, in any order; several residuals may have the same row.
    """
    own, inverse = np.unique(rows, return_inverse=True)
    block = np.empty(len(own), int)
    for target in np.unique(m.target[own]):
        mine = np.flatnonzero(m.target[own] == target)
        block[mine] = np.arange(len(mine)) * FOLDS // len(mine)
    pose = poses(m, own)
    _, first = np.unique(pose, return_index=True)
    return block[first][pose][inverse]


def without_fold(
    residual: np.ndarray, by: np.ndarray, weight: np.ndarray, fold: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Predict the rows of each block by a fit to the others, exact for a linear model.

    Parameters
    ----------
    residual : np.ndarray, shape (R,)
        Whitened residuals at the optimum.
    by : np.ndarray, shape (R, D)
        Whitened slopes by posterior standard normals: J F with covariance F F'.
    weight : np.ndarray, shape (R,)
        0 for rows that were not fitted, else 1.
    fold : np.ndarray of int, shape (R,)

    Yields
    ------
    rows : np.ndarray of int, shape (K,)
        Residuals of a block.
    residual : np.ndarray, shape (K,)
        Whitened, by the fit to the other blocks.
    by : np.ndarray, shape (K, D)
        Whitened slopes by posterior standard normals of that fit.

    Notes
    -----
    With B of the block's rows, the others have the information 1 - B'WB in these coordinates, and the optimum
    moves by its inverse times B'W r.
    """
    for one in np.unique(fold):
        mine = np.flatnonzero(fold == one)
        b, used = by[mine], weight[mine]
        values, vectors = np.linalg.eigh(np.eye(by.shape[1]) - (b.T * used) @ b)
        own = (b @ vectors) / np.sqrt(np.maximum(values, ROUNDING))
        yield mine, residual[mine] + own @ (own.T @ (used * residual[mine])), own
