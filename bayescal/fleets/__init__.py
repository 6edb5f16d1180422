"""The distribution of an arm's parameters over a fleet, by empirical Bayes.

The parameters t of an arm, in units of their stated priors, are t_k ~ N(m_k, s_k^2 / w_k), with a weight w_k
of each arm and parameter, w_k ~ Gamma(NU / 2, NU / 2): Student's t, so that an arm unlike the others does not
widen the distribution (Lange, Little and Taylor 1989, JASA 84, 881). A priori m_k ~ N(0, COMMON), and log s_k
is normal with the standard deviation SPREAD and a mean square of s_k of 1 - COMMON: a further arm has the
stated prior if the fleet tells nothing, and nearly so if it has few arms. m and s are the most probable ones,
by the EM algorithm over the likelihoods of the arms with their full covariance (`likelihood`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq, minimize_scalar

NU = 4.0
"""Degrees of freedom of the distribution over arms (usual for robust estimates)."""
COMMON = 0.5
"""Share of the stated variance that the arms of a model have in common, a priori (assumed)."""
SPREAD = float(np.log(2.0))
"""Standard deviation of the logarithm of a scale, a priori: a factor of two is usual (assumed)."""
ROUNDS, STEP = 1000, 1e-3
"""Largest number of rounds of EM, and the change, in stated standard deviations, at which they end."""
WIDEST = 10.0
"""Largest factor by which arms that are left out widen a prior."""
FEWEST = 3
"""Arms from which a distribution is learnt: each is compared with that of two others or more."""


def _consistency() -> float:
    """Scale of Student's t with `NU` that is most probable for standard normal values."""
    x = np.linspace(-12.0, 12.0, 4801)
    p = np.exp(-(x**2) / 2.0) / np.sqrt(2 * np.pi) * (x[1] - x[0])
    return float(brentq(lambda s: np.sum(p * (NU + 1) * x**2 / (NU * s**2 + x**2)) - 1.0, 0.1, 2.0))


NORMAL = 1.0 / _consistency()
"""Standard deviation of normal values in units of the fitted scale."""
CENTRE = 0.5 * float(np.log(1.0 - COMMON)) - SPREAD**2 - float(np.log(NORMAL))
"""Mean of log s a priori."""
MOST_GROUPS = 24
"""Groups of arms that are left out together in a fleet of more."""


@dataclass(frozen=True)
class Arms:
    """Information (A, K, K) and score (A, K) of each of A arms, in units of the stated priors."""

    information: np.ndarray
    score: np.ndarray

    @property
    def count(self) -> int:
        """Number of arms."""
        return len(self.score)

    def without(self, some: Sequence[int]) -> Arms:
        """The other arms."""
        return Arms(np.delete(self.information, some, axis=0), np.delete(self.score, some, axis=0))


@dataclass(frozen=True)
class Learnt:
    """The distribution of K parameters over a fleet, in units of the stated priors."""

    mean: np.ndarray  # (K,) m
    u_mean: np.ndarray  # (K,) its standard uncertainty
    scale: np.ndarray  # (K,) standard deviation of usual arms, s for normal values
    dof: np.ndarray  # (K,) number of arms that the scale is worth
    spread: np.ndarray  # (K,) root mean square deviation of all arms, with those that differ
    factor: float = 1.0  # by which arms that were left out widen the prior

    @property
    def usual(self) -> np.ndarray:
        """Standard deviation (K,) of a further usual arm, with the uncertainty of the mean."""
        return np.hypot(self.scale, self.u_mean)

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation (K,) of the prior of a further arm."""
        wide = self.scale * np.exp(1.0 / (2.0 * self.dof + SPREAD**-2))  # the root of the mean square
        return self.factor * np.hypot(np.maximum(wide, self.spread), self.u_mean)


def posterior(
    information: np.ndarray, score: np.ndarray, mean: np.ndarray, precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (..., K) and covariance (..., K, K) of arms with priors of this mean and precision (..., K)."""
    total = information + np.einsum("...k,kl->...kl", precision, np.eye(len(mean)))
    covariance = np.linalg.inv(total)
    return np.einsum("...kl,...l->...k", covariance, score + precision * mean), covariance


def learn(arms: Arms, start: Learnt | None = None) -> Learnt:
    """Mean and scale of each parameter over arms.

    Parameters
    ----------
    arms : Arms
    start : Learnt, optional
        Where the search begins: the distribution of nearly the same arms.
    """
    count = arms.score.shape[1]
    mean, scale = (np.zeros(count), np.ones(count)) if start is None else (start.mean, start.scale / NORMAL)
    weight = np.ones_like(arms.score)
    for _ in range(ROUNDS):
        each, covariance = posterior(arms.information, arms.score, mean, weight / scale**2)
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        before = mean, scale
        mean = np.sum(weight * each, axis=0) / (np.sum(weight, axis=0) + scale**2 / COMMON)
        square = (each - mean) ** 2 + variance
        scale = _scale(np.sum(weight * square, axis=0), arms.count)
        weight = (NU + 1.0) / (NU + square / scale**2)
        if max(np.max(np.abs(mean - before[0])), np.max(np.abs(np.log(scale / before[1])))) < STEP:
            break
    information = _information(covariance, weight / scale**2)
    u = np.sqrt(np.diag(np.linalg.inv(np.eye(count) / COMMON + np.sum(information, axis=0))))
    share = np.diagonal(information, axis1=1, axis2=2) * scale**2 / weight
    spread = np.sqrt(np.sum(square, axis=0) / (arms.count - 1))
    return Learnt(mean, u, NORMAL * scale, np.sum(share**2, axis=0), spread)


def _scale(square: np.ndarray, count: int) -> np.ndarray:
    """Most probable scales (K,) for sums of squares (K,) of so many arms, with the hyperprior."""
    log = np.zeros_like(square)
    for _ in range(100):
        pull = square * np.exp(-2.0 * log)
        step = (count - pull + (log - CENTRE) / SPREAD**2) / (2.0 * pull + SPREAD**-2)
        log -= np.clip(step, -1.0, 1.0)
        if np.max(np.abs(step)) < 1e-9:
            break
    return np.exp(log)


def _information(covariance: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Information (..., K, K) of the data on the mean of the prior: (L^-1 + T)^-1."""
    across = precision[..., :, None] * covariance * precision[..., None, :]
    return np.einsum("...k,kl->...kl", precision, np.eye(precision.shape[-1])) - across


def log_score(information: np.ndarray, score: np.ndarray, mean: np.ndarray, sd: np.ndarray) -> float:
    """Log density, nats, of the data of an arm under a normal prior, less a constant of the arm."""
    precision = 1.0 / sd**2
    posterior_mean, covariance = posterior(information, score, mean, precision)
    volume = np.linalg.slogdet(covariance * precision)[1]
    return float(0.5 * (volume + posterior_mean @ (score + precision * mean) - np.sum(precision * mean**2)))


def left_out(arms: Arms, every: Learnt) -> tuple[list[Learnt], np.ndarray]:
    """Arms left out in turn, of a large fleet in `MOST_GROUPS` groups.

    Parameters
    ----------
    arms : Arms
    every : Learnt
        Distribution of all of them.

    Returns
    -------
    list of Learnt
        The distribution of the others, for each arm.
    np.ndarray, shape (A,)
        Log density, nats, of each arm under the distribution of the others, less that under the stated prior.
    """
    groups = np.array_split(np.arange(arms.count), min(arms.count, MOST_GROUPS))
    others = [of for group in groups for of in [learn(arms.without(group.tolist()), every)] * len(group)]
    stated = np.zeros(arms.score.shape[1])
    gains = [
        log_score(i, s, of.mean, of.sd) - log_score(i, s, stated, stated + 1.0)
        for i, s, of in zip(arms.information, arms.score, others, strict=True)
    ]
    return others, np.array(gains)


def widened(arms: Arms, others: Sequence[Learnt], every: Learnt, usual: np.ndarray) -> Learnt:
    """The distribution of all arms, with the factor by which arms that are left out widen it.

    It is one factor of all parameters, by the arms that are `usual` (A,): where an arm differs, the spread is
    larger already.
    """
    data = [(arms.information[k], arms.score[k], others[k]) for k in np.flatnonzero(usual).tolist()]

    def loss(factor: float) -> float:
        return -sum(log_score(i, s, of.mean, factor * of.sd) for i, s, of in data)

    best = minimize_scalar(lambda x: loss(float(np.exp(x))), bounds=(0.0, np.log(WIDEST)), method="bounded")
    return replace(every, factor=float(np.exp(best.x)) if best.fun < loss(1.0) else 1.0)
