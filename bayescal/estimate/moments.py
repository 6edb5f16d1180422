"""Variance of each family of a discrepancy, from residual correlation between different poses.

With H the columns of the functions after the fit (whitened, projected) and g_pk = H_pk' e_p the score of
function k at pose p, the expectation of (sum_p g_pk)^2 - nu sum_p g_pk^2 depends on the discrepancy alone:
the noise of different poses is independent. The variances are those that reproduce these moments best (least
squares, none negative). Rows of one pose share errors, so that only products of different poses count.

Scatter of an estimate over poses: the rows of one pose are not independent.

What measurements tell without the prior of their fit, and which parameters differ from a prior.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.statistics import chi2_sf

CHANCE = 0.1
"""Chance that any family has a variance in a session without a discrepancy (convention)."""
LIKELY = 0.16
"""The same of each family where the residuals are larger than the noise, so that there is a discrepancy
(assumed)."""
AT_ONCE = 1024
"""Residuals whose columns are held in memory three times."""
UNSEEN = 2.0
"""Factor from variances that residuals show to those stated: the fit absorbs a part of the smooth functions
(tuned on halves of six sessions of real arms)."""


def variances(
    h: np.ndarray, e: np.ndarray, pose: np.ndarray, family: np.ndarray, dof: float, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Variances (F,) that the residuals show of F families, and the chance of each under noise, (F,).

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
        return out, np.ones(count)
    nu, products, score = len(e) / dof, np.zeros((h.shape[1],) * 2), np.zeros(h.shape[1])
    for index in of_equal_size(pose):
        pose_scores = np.sum(h[index] * e[index][..., None], axis=1)  # of each pose
        products += nu * pose_scores.T @ pose_scores
        score += np.sum(pose_scores, axis=0)
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
    return out, p


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
    for index in of_equal_size(pose):
        if index.shape[1] == 1:  # all poses in one product
            square = h[index[:, 0]] ** 2
            out += square.T @ square
            continue
        for rows in index:
            out += (h[rows].T @ h[rows]) ** 2
    return out


def of_equal_size(pose: np.ndarray, at_once: int = AT_ONCE) -> Iterator[np.ndarray]:
    """Residuals (poses, k) of all poses of k residuals, for every k; about `at_once` at a time."""
    order, size = np.argsort(pose, kind="stable"), np.bincount(pose)
    first = np.cumsum(size) - size
    for k in np.unique(size):
        begin, step = first[size == k][:, None], max(at_once // max(k, 1), 1)
        for start in range(0, len(begin), step):
            yield order[begin[start : start + step] + np.arange(k)]


SMALLEST = 1e-6
"""Share of a pose's residual below which the fit leaves none."""
DEVIATIONS = 2.0
"""Standard deviations by which a scatter must be less even than chance makes it (convention)."""
LEAST = 1e-9
"""Smallest variance of a direction, in unknowns of unit variance, of which the residuals say anything."""


def scatter_factor(
    c: np.ndarray, j: np.ndarray, e: np.ndarray, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of an estimate by independent errors of its poses.

    The estimator CR2 (Bell and McCaffrey 2002), sum of Delta Delta' with
    Delta_p = C J_p' (1 - J_p C J_p')^(-1/2) e_p: without bias where all rows are independent. With few poses
    for the parameters it is too uncertain: in proportion to the parameters per pose it is shrunk towards
    C J' J C times a factor; entirely where it deviates from that no more than by chance (`by_chance`).

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
    for index in of_equal_size(pose):
        changes = by[index]  # (poses, k, D)
        redundancy = np.eye(index.shape[1]) - changes @ np.swapaxes(j[index], 1, 2)
        values, vectors = np.linalg.eigh(0.5 * (redundancy + np.swapaxes(redundancy, 1, 2)))
        # a pose that alone determines a direction has no residual there: nothing to divide
        inverse = np.where(values > SMALLEST, np.maximum(values, SMALLEST) ** -0.5, 1.0)
        rotated = np.swapaxes(vectors, 1, 2) @ e[index][..., None]
        which = pose[index[:, 0]]
        delta[which] = np.sum(changes * (vectors @ (inverse[..., None] * rotated)), axis=1)
        first[which] = index[:, 0]
    share = 1.0 if by_chance(delta, by) else min(float(np.sum(by * j)) / count, 1.0)
    factor = max(float(np.sum(delta**2)) / float(np.sum(by**2)), 1.0)
    columns = np.concatenate([np.sqrt(1.0 - share) * delta, np.sqrt(share * factor) * by])
    return columns.T, np.concatenate([first, np.arange(len(by))])


def by_chance(delta: np.ndarray, by: np.ndarray) -> bool:
    """Whether a scatter deviates from a multiple of by' by no more than by chance.

    With x_p the changes by each pose, whitened by by' by, and S the sum of x_p x_p', the square deviation of
    S from a multiple of the identity is compared with its expectation where that is true, the sum of the
    square errors of the terms (Ledoit and Wolf 2004, J. Multivariate Analysis 88, 365). The ratio varies as
    a mean of as many squares as S has free elements.

    Parameters
    ----------
    delta : np.ndarray, shape (P, D)
        Change of the estimate by each pose.
    by : np.ndarray, shape (R, D)
        Changes by independent errors of all residuals, without correlation within poses.
    """
    x = delta @ whitening(by.T @ by)[0].T
    s, size = x.T @ x, x.shape[1]
    error = float(np.sum(np.sum(x**2, axis=1) ** 2) - np.sum(s**2) / len(x))
    deviation = float(np.sum(s**2) - np.trace(s) ** 2 / max(size, 1))
    spread = np.sqrt(2.0 / max(size * (size + 1) / 2 - 1, 1))
    return deviation <= error * (1.0 + DEVIATIONS * spread)


def whitening(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Map W (K, D) with W C W' = 1 of the K directions in which C (D, D) is not zero, and its inverse.

    The inverse is (D, K). Unknowns have very different variances: C is scaled to a unit diagonal first.
    """
    sd = np.sqrt(np.diag(covariance))
    scale = np.where(sd > 0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > LEAST
    root = np.sqrt(values[kept])
    return (vectors[:, kept] / root).T / scale, scale[:, None] * vectors[:, kept] * root


def complement(by: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Columns X (D, R) for which `covariance` + X X' is nowhere less than by' by, one for each residual.

    No combination of unknowns then has a smaller variance than independent residuals give it. The columns are
    zero where it has none.

    Parameters
    ----------
    by : np.ndarray, shape (R, D)
    covariance : np.ndarray, shape (D, D)
    """
    white, inverse = whitening(by.T @ by)
    values, vectors = np.linalg.eigh(white @ covariance @ white.T)
    missing = np.sqrt(np.maximum(1.0 - values, 0.0))
    return (inverse @ (vectors * missing)) @ (by @ white.T @ vectors).T


ROUNDING = 1e-12
"""Variance of an error, in prior variances, that is added: rounding of a direction that the prior decides."""
LEAST_TOLD = 1e-6
"""Information, in units of the stated prior, below which the data tell nothing of a parameter."""


def likelihood(z: np.ndarray, solved: np.ndarray, stated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information (P, P) and score (P,) of an estimate z (P,) with covariances `solved` C and `stated` V.

    Both are in units of the prior that a fit used. The estimate is z = W t + e of the true t, with W = 1 - C
    and cov(e) = N = V - C C. So

        information  L = W N^-1 W,    score  h = W N^-1 z:    log p(z | t) = h't - t'L t / 2 + constant

    for any prior of t.
    """
    eye = np.eye(len(z))
    weight = eye - solved
    pull = np.linalg.solve(stated - solved @ solved + ROUNDING * eye, weight).T
    return pull @ weight, pull @ z


@dataclass(frozen=True)
class Shift:
    """A parameter of an arm that differs, in units of its stated prior."""

    index: int
    value: float  # of the deviation, if no other parameter differs
    u: float  # with the spread of usual arms
    ratio: float  # value / u


def shifts(
    information: np.ndarray, score: np.ndarray, mean: np.ndarray, covariance: np.ndarray, most: int
) -> list[Shift]:
    """Parameters by which data differ from a normal prior, the clearest first, each beside those before.

    With M = (L^-1 + T)^-1 the information of the data on the mean of the prior, T its covariance, and g the
    score, a shift of parameter k alone is g_k / M_kk with the variance 1 / M_kk. The next is sought with the
    first one free.

    Parameters
    ----------
    information, score : np.ndarray, shapes (K, K) and (K,)
    mean, covariance : np.ndarray, shapes (K,) and (K, K)
        Of the prior.
    most : int
        Number of parameters.
    """
    precision = np.linalg.inv(covariance)
    out: list[Shift] = []
    free: list[int] = []
    posterior = np.linalg.solve(information + precision, score + precision @ mean)
    mean_information = precision - precision @ np.linalg.solve(information + precision, precision)
    pull = precision @ (posterior - mean)
    for _ in range(min(most, len(mean))):
        reduced, gradient = mean_information, pull
        if free:
            by = np.linalg.solve(mean_information[np.ix_(free, free)], mean_information[free]).T
            reduced, gradient = mean_information - by @ mean_information[free], pull - by @ pull[free]
        size = np.maximum(np.diag(reduced), LEAST_TOLD)
        ratio = gradient / np.sqrt(size)
        ratio[free] = 0.0
        k = int(np.argmax(np.abs(ratio)))
        out.append(Shift(k, float(gradient[k] / size[k]), float(size[k] ** -0.5), float(ratio[k])))
        free.append(k)
    return out
