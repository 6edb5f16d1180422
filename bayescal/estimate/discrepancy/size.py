"""Variance of each family of a discrepancy, from residual correlation between different poses.

With H the columns of the functions after the fit (whitened, projected) and g_pk = H_pk' e_p the score of
function k at pose p, the expectation of (sum_p g_pk)^2 - nu sum_p g_pk^2 depends on the discrepancy alone:
the noise of different poses is independent. The variances are those that reproduce these moments best (least
squares, none negative). Rows of one pose share errors, so that only products of different poses count.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayescal.distributions import chi2_sf

CHANCE = 0.1
"""Chance that any family has a variance in a session without a discrepancy (convention)."""
LIKELY = 0.16
"""The same of each family where the residuals are larger than the noise, so that there is a discrepancy
(assumed)."""
AT_ONCE = 1024
"""Poses whose columns are held in memory three times."""
UNSEEN = 2.0
"""Factor from variances that residuals show to those stated: the fit absorbs a part of the smooth functions
(tuned on halves of six sessions of real arms)."""


def variances(
    h: np.ndarray, e: np.ndarray, pose: np.ndarray, family: np.ndarray, dof: float, level: float
) -> np.ndarray:
    """Variances (F,) that the residuals show of F families.

    Parameters
    ----------
    h : np.ndarray, shape (R, K)
        Whitened columns of the functions, projected by the fit.
    e : np.ndarray, shape (R,)
        Whitened residuals.
    pose : np.ndarray of int, shape (R,)
        Pose of each residual.
    family : np.ndarray of int, shape (K,)
        Family of each function, from 0 to F - 1.
    dof : float
        Degrees of freedom of the residuals.
    level : float
        Chance of a family's moment under noise below which it has a variance.
    """
    count = int(family.max()) + 1 if len(family) else 0
    out = np.zeros(count)
    if not count or dof <= 0:
        return out
    nu, products, score = len(e) / dof, np.zeros((h.shape[1],) * 2), np.zeros(h.shape[1])
    for at in of_equal_size(pose):
        own = np.sum(h[at] * e[at][..., None], axis=1)  # of each pose
        products += nu * own.T @ own
        score += np.sum(own, axis=0)
    expected = (h.T @ h) ** 2 - within_poses(h, pose)
    member = (family == np.arange(count)[:, None]).astype(float)  # (F, K)
    total, noise = member @ score**2, member @ np.diag(products)
    # under noise a weighted sum of chi-squares (Satterthwaite 1946), with the spread of the scores over poses
    square = np.maximum(np.diag(member @ products**2 @ member.T), np.finfo(float).tiny)
    p = chi2_sf(total * noise / square, noise**2 / square)
    q, kept = total - noise, np.flatnonzero(p < level)
    if len(kept):
        from scipy.optimize import nnls  # slow to import, and many sessions have no discrepancy

        # argmin over lambda >= 0 of lambda' T lambda - 2 q' lambda
        values, vectors = np.linalg.eigh((member @ expected @ member.T)[np.ix_(kept, kept)])
        root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
        out[kept] = nnls(root[:, None] * vectors.T, (vectors.T @ q[kept]) / root)[0]
    return out


def degrees_of_freedom(h: np.ndarray) -> float:
    """Effective degrees of freedom of a family's variance, from its columns `h` (R, K) after the fit.

    The variance is estimated from the squared scores H' e of K functions. With amplitudes of this variance
    the scores have the covariance (H'H)^2, and their sum of squares these degrees of freedom (Satterthwaite).
    """
    square = np.linalg.matrix_power(h.T @ h, 2)
    return float(np.trace(square) ** 2 / max(np.sum(square**2), np.finfo(float).tiny))


def within_poses(h: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Sum over the poses of (H_pk' H_pl)^2, (K, K)."""
    out = np.zeros((h.shape[1], h.shape[1]))
    for at in of_equal_size(pose):
        own = h[at]  # (poses, rows, K)
        for i in range(at.shape[1]):
            both = (own[:, i : i + 1] * own).reshape(-1, h.shape[1])
            out += both.T @ both
    return out


def of_equal_size(pose: np.ndarray) -> Iterator[np.ndarray]:
    """Residuals (poses, k) of all poses of k residuals, for every k that occurs; at most `AT_ONCE` poses."""
    order, size = np.argsort(pose, kind="stable"), np.bincount(pose)
    first = np.cumsum(size) - size
    for k in np.unique(size):
        begin = first[size == k][:, None]
        for start in range(0, len(begin), AT_ONCE):
            yield order[begin[start : start + AT_ONCE] + np.arange(k)]
