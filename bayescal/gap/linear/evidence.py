"""Evidence of columns that are added to a fitted hypothesis, averaged over prior scales and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln

from bayescal.estimate import STATED_WORTH
from bayescal.gap.linear.noise_integral import integrated
from bayescal.gap.linear.state import State
from bayescal.gap.settings import LINEAR

SCALES = np.array(LINEAR.scales)
"""Factors on the prior standard deviations over which evidence is averaged."""
SCALE_PRIOR = -0.5 * (np.log(SCALES) / np.log(LINEAR.scale_spread)) ** 2
SCALE_PRIOR = SCALE_PRIOR - np.log(np.sum(np.exp(SCALE_PRIOR)))
"""Log weights of the factors."""
NODES, _WEIGHTS = np.polynomial.hermite.hermgauss(LINEAR.noise_nodes)
LOG_WEIGHTS = np.log(_WEIGHTS)
"""Of the quadrature over the noise."""
MOST_VALUES = 100_000
"""Values of columns of which products are computed at once: copies that stay in the processor's cache."""


def log_sum(x: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Logarithm of the sum of exponentials; SciPy's takes far longer for small arrays."""
    most = np.max(x, axis=axis, keepdims=True)
    total = np.log(np.sum(np.exp(x - most), axis=axis))
    return total + (np.squeeze(most, axis=axis) if axis is not None else most.item())


@dataclass(frozen=True)
class Projected:
    """A pool of columns (R, K), projected off the parameters of a state.

    `across` (D, K) are products of the parameters' columns and these, `weighted` (R, K) whitened columns.
    """

    state: State
    pool: np.ndarray  # (R, K)
    weighted: np.ndarray  # (R, K)
    across: np.ndarray  # (D, K)
    solved: np.ndarray  # (D, K) covariance times across
    score: np.ndarray  # (K,)

    def information(self, columns: np.ndarray) -> np.ndarray:
        """G (k, k) = X'MX of some columns."""
        x = self.weighted[:, columns]
        return x.T @ x - self.across[:, columns].T @ self.solved[:, columns]


def project(state: State, pool: np.ndarray) -> Projected:
    """Project a pool of columns, at the state's weights and noise."""
    count = state.problem.count
    whiten = np.sqrt(state.weight)
    whiten[:count] /= state.kappa
    weighted = pool * whiten[:, None]
    design = state.design * whiten[:, None]
    across = design.T @ weighted
    # at the optimum the gradient of the state's parameters is zero: the projected score is X'r
    score = -(weighted.T @ (state.residual * whiten))
    return Projected(state, pool, weighted, across, state.covariance @ across, score)


@dataclass(frozen=True)
class Bank:
    """Columns (R, K) and sets of them whose evidence is often evaluated, with their constant products.

    `jacobian` (R, D) is that of the states over which they are evaluated, if all have the same.
    """

    columns: np.ndarray
    sets: tuple[np.ndarray, ...]
    count: int  # rows that are contacts
    worth: np.ndarray | None = None  # (C,) see `Problem`
    jacobian: np.ndarray | None = None

    @cached_property
    def weighted(self) -> np.ndarray:
        """Columns of the contacts (C, K), each row by the root of what it is worth."""
        own = self.columns[: self.count]
        return own if self.worth is None else own * np.sqrt(self.worth)[:, None]

    @cached_property
    def by_jacobian(self) -> tuple[np.ndarray, np.ndarray]:
        """Products (D, K) with the Jacobian, over contacts, by what each is worth, and constraints."""
        assert self.jacobian is not None
        own, count = self.jacobian[: self.count], self.count
        own = own if self.worth is None else own * self.worth[:, None]
        return own.T @ self.columns[:count], self.jacobian[count:].T @ self.columns[count:]

    def across(self, state: State, weight: np.ndarray) -> np.ndarray:
        """Products (D + k, K) with the design of a state, by its row weights (R,) over the noise."""
        p = state.problem
        if p.jacobian is not self.jacobian:
            return (state.design * weight[:, None]).T @ self.columns
        contacts, constraints = self.by_jacobian
        left = np.flatnonzero(state.weight[: self.count] == 0)
        gone = (p.jacobian[left] * p.base[left, None]).T @ self.columns[left]
        further = p.pool[:, state.columns] * (weight[:, None] * state.scales)
        own = (contacts - gone) / state.kappa**2 + constraints
        return np.concatenate([own, further.T @ self.columns])

    @cached_property
    def groups(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """By size k: sets (B,), columns (B, k), X'X over contacts and constraints (B, k, k)."""
        by_size: dict[int, list[int]] = {}
        for i, own in enumerate(self.sets):
            by_size.setdefault(len(own), []).append(i)
        out = []
        for members in by_size.values():
            at = np.array([self.sets[i] for i in members], int).reshape(len(members), -1)
            contacts, constraints = (
                _products(part, at) for part in (self.weighted, self.columns[self.count :])
            )
            out.append((np.array(members), at, contacts, constraints))
        return out


def _products(columns: np.ndarray, at: np.ndarray) -> np.ndarray:
    """X'X (B, k, k) of B sets `at` (B, k) of columns (R, K)."""
    out = np.empty((*at.shape, at.shape[1]))
    step = max(MOST_VALUES // max(at.shape[1] * len(columns), 1), 1)
    for first in range(0, len(at), step):
        x = columns.T[at[first : first + step]]
        np.matmul(x, np.swapaxes(x, 1, 2), out=out[first : first + step])
    return out


def weigh_sets(state: State, bank: Bank) -> np.ndarray:
    """Log Bayes factors (len(sets), scales) of adding sets of columns to a state, by prior scale."""
    count = bank.count
    weight = state.weight.copy()
    weight[:count] /= state.kappa**2
    across = bank.across(state, weight)
    solved = state.covariance @ across
    score = -(bank.columns.T @ (state.residual * weight))
    left = np.flatnonzero(state.weight[:count] == 0)
    out = np.empty((len(bank.sets), len(SCALES)))
    for members, at, contacts, constraints in bank.groups:
        gone = bank.weighted[left[:, None, None], at]  # (rows left out, B, k)
        information = (contacts - np.einsum("rbi,rbj->bij", gone, gone)) / state.kappa**2 + constraints
        a, s = across.T[at], solved.T[at]
        out[members] = _factors(state, information - a @ np.swapaxes(s, 1, 2), score[at])
    return out


def weigh_clusters(state: State, column: np.ndarray, clusters: np.ndarray) -> np.ndarray:
    """Log Bayes factors (scales,) of a random error that is drawn anew in each cluster of rows.

    The columns of the clusters do not overlap, so that their information is diagonal. What the parameters of
    the state absorb is neglected: little of each of many clusters, and the result is too small by it.

    Parameters
    ----------
    state : State
    column : np.ndarray, shape (R,)
        Whitened motion of the rows by an error of one prior standard deviation.
    clusters : np.ndarray, shape (C,)
        Cluster of each row of a contact.
    """
    count = state.problem.count
    weight, own = state.weight[:count] / state.kappa**2, column[:count]
    information = np.bincount(clusters, weight * own**2)
    score = np.bincount(clusters, weight * own * state.residual[:count])
    return _factors_along(state, information[None], score[None] ** 2)[0]


def log_bayes(p: Projected, sets: Sequence[np.ndarray]) -> np.ndarray:
    """Log Bayes factors (len(sets), scales) of adding sets of a projected pool's columns, by prior scale."""
    return weigh_sets(p.state, Bank(p.pool, tuple(sets), p.state.problem.count, p.state.problem.worth))


def _factors(state: State, information: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Log Bayes factors (B, scales) from information (B, k, k) and scores (B, k), integrated over noise."""
    if not score.shape[1]:
        return np.zeros((len(score), len(SCALES)))
    values, vectors = np.linalg.eigh(information)
    return _factors_along(state, values, np.einsum("bij,bi->bj", vectors, score) ** 2)


def _factors_along(state: State, values: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Log Bayes factors (B, scales) from eigenvalues of information (B, k) and squared scores along them."""
    count, dof, worth = state.problem.count, state.dof, STATED_WORTH / state.kappa**2
    chi2 = float(np.sum(state.weight[:count] * state.residual[:count] ** 2)) / state.kappa**2 + worth
    with_it = integrated(np.maximum(values, 0.0), along, SCALES**2, dof, chi2, worth, NODES, LOG_WEIGHTS)
    return with_it - (gammaln(dof / 2) - dof / 2 * np.log(chi2 / 2))
