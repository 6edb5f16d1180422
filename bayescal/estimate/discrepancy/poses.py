"""Scatter of an estimate over poses: the rows of one pose are not independent."""

from __future__ import annotations

import numpy as np

from bayescal.estimate.discrepancy.size import of_equal_size

SMALLEST = 1e-6
"""Share of a pose's residual below which the fit leaves none."""


def scatter_factor(
    c: np.ndarray, j: np.ndarray, e: np.ndarray, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of an estimate by independent errors of its poses.

    The estimator CR2 (Bell and McCaffrey 2002), sum of Delta Delta' with
    Delta_p = C J_p' (1 - J_p C J_p')^(-1/2) e_p: without bias where all rows are independent. With few poses
    for the parameters it is too uncertain: in proportion to the parameters per pose it is shrunk towards
    C J' J C times a factor.

    Parameters
    ----------
    c : np.ndarray, shape (D, D)
        Covariance of the solver.
    j : np.ndarray, shape (R, D)
        Whitened Jacobian.
    e : np.ndarray, shape (R,)
        Whitened residuals.
    pose : np.ndarray of int, shape (R,)
        Pose of each residual.

    Returns
    -------
    by : np.ndarray, shape (D, M)
        One column for each pose, then one for each residual; by by' is the covariance.
    of : np.ndarray of int, shape (M,)
        A residual of the pose that each column belongs to.
    """
    by = j @ c
    count = int(pose.max()) + 1 if len(pose) else 0
    if count < 2:
        return by.T, np.arange(len(by))
    delta, first = np.zeros((count, len(c))), np.zeros(count, int)
    for at in of_equal_size(pose):
        own = by[at]  # (poses, k, D)
        left = np.eye(at.shape[1]) - own @ np.swapaxes(j[at], 1, 2)
        values, vectors = np.linalg.eigh(0.5 * (left + np.swapaxes(left, 1, 2)))
        # a pose that alone determines a direction has no residual there: nothing to divide
        inverse = np.where(values > SMALLEST, np.maximum(values, SMALLEST) ** -0.5, 1.0)
        rotated = np.swapaxes(vectors, 1, 2) @ e[at][..., None]
        which = pose[at[:, 0]]
        delta[which] = np.sum(own * (vectors @ (inverse[..., None] * rotated)), axis=1)
        first[which] = at[:, 0]
    share = min(float(np.sum(by * j)) / count, 1.0)
    factor = max(float(np.sum(delta**2)) / float(np.sum(by**2)), 1.0)
    columns = np.concatenate([np.sqrt(1.0 - share) * delta, np.sqrt(share * factor) * by])
    return columns.T, np.concatenate([first, np.arange(len(by))])
