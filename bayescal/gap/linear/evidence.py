"""Evidence of what columns add to a fitted hypothesis, averaged over prior scales and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.estimate import STATED_WORTH
from bayescal.gap.linear.problem import State
from bayescal.gap.settings import LINEAR

SCALES = np.array(LINEAR.scales)
"""Factors on the prior standard deviations over which evidence is averaged."""
SCALE_PRIOR = -0.5 * (np.log(SCALES) / np.log(LINEAR.scale_spread)) ** 2
SCALE_PRIOR = SCALE_PRIOR - np.log(np.sum(np.exp(SCALE_PRIOR)))
"""Log weights of the factors."""
NOISE = np.exp(np.linspace(LINEAR.noise_lowest, LINEAR.noise_highest, LINEAR.noise_nodes))
"""Noise scales over the state's own, on which it is integrated."""


def log_sum(x: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Logarithm of the sum of exponentials; SciPy's takes far longer for small arrays."""
    most = np.max(x, axis=axis, keepdims=True)
    total = np.log(np.sum(np.exp(x - most), axis=axis))
    return total + (np.squeeze(most, axis=axis) if axis is not None else most.item())


@dataclass(frozen=True)
class Projected:
    """What a pool of columns (R, K) has left of it once a state has absorbed what it can.

    `across` (D, K) ties the columns to the state's parameters, `weighted` (R, K) are whitened columns.
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
    # at the optimum the state's parameters pull with their prior alone: what is left of the score is X'r
    score = -(weighted.T @ (state.residual * whiten))
    return Projected(state, pool, weighted, across, state.covariance @ across, score)


@dataclass(frozen=True)
class Bank:
    """Columns (R, K) and sets of them that are weighed again and again, with what no state changes."""

    columns: np.ndarray
    sets: tuple[np.ndarray, ...]
    count: int  # rows that are contacts

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
                np.stack([x.T @ x for x in (part[:, own] for own in at)])
                for part in (self.columns[: self.count], self.columns[self.count :])
            )
            out.append((np.array(members), at, contacts, constraints))
        return out


def weigh_sets(state: State, bank: Bank) -> np.ndarray:
    """Log Bayes factors (len(sets), scales) of adding sets of columns to a state, by prior scale."""
    count = bank.count
    weight = state.weight.copy()
    weight[:count] /= state.kappa**2
    across = (state.design * weight[:, None]).T @ bank.columns
    solved = state.covariance @ across
    score = -(bank.columns.T @ (state.residual * weight))
    left = np.flatnonzero(state.weight[:count] == 0)
    out = np.empty((len(bank.sets), len(SCALES)))
    for members, at, contacts, constraints in bank.groups:
        gone = bank.columns[left[:, None, None], at]  # (rows left out, B, k)
        information = (contacts - np.einsum("rbi,rbj->bij", gone, gone)) / state.kappa**2 + constraints
        a, s = across.T[at], solved.T[at]
        out[members] = _factors(state, information - a @ np.swapaxes(s, 1, 2), score[at])
    return out


def log_bayes(p: Projected, sets: Sequence[np.ndarray]) -> np.ndarray:
    """Log Bayes factors (len(sets), scales) of adding sets of a projected pool's columns, by prior scale."""
    return weigh_sets(p.state, Bank(p.pool, tuple(sets), p.state.problem.count))


def _factors(state: State, information: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Log Bayes factors (B, scales) from information (B, k, k) and scores (B, k), integrated over noise."""
    count = state.problem.count
    chi2 = float(np.sum(state.weight[:count] * state.residual[:count] ** 2)) + STATED_WORTH
    base = -state.dof * np.log(NOISE) - 0.5 * chi2 / (state.kappa * NOISE) ** 2
    if not score.shape[1]:
        return np.zeros((len(score), len(SCALES)))
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 0.0)
    along = np.einsum("bij,bi->bj", vectors, score) ** 2
    by = (SCALES**2)[:, None, None] / NOISE[:, None] ** 2  # (S, U, 1)
    with_it = 1.0 + by * values[:, None, None, :]  # (B, S, U, k)
    gain = along[:, None, None, :] * (by / NOISE[:, None] ** 2) / with_it - np.log(with_it)
    return log_sum(base + 0.5 * gain.sum(axis=-1), axis=-1) - log_sum(base)
