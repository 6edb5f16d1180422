"""What measurements tell without the prior of their fit, and which parameters differ from a prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
