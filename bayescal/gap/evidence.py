"""Evidence of what columns add to a fitted hypothesis, averaged over prior scales and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.estimate import STATED_WORTH
from bayescal.gap.problem import State

SCALES = 2.0 ** np.arange(-3, 4)
"""Factors on the prior standard deviations over which evidence is averaged."""
SPREAD = np.log(3.0)
"""How far the prior standard deviations are thought to be off: a factor of 3, one sigma."""
SCALE_PRIOR = -0.5 * (np.log(SCALES) / SPREAD) ** 2
SCALE_PRIOR = SCALE_PRIOR - np.log(np.sum(np.exp(SCALE_PRIOR)))
"""Log weights of the factors."""
NOISE = np.exp(np.linspace(-1.6, 0.25, 40))
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
    return Projected(state, weighted, across, state.covariance @ across, score)


def log_bayes(p: Projected, sets: Sequence[np.ndarray]) -> np.ndarray:
    """Log Bayes factors (len(sets), scales) of adding sets of columns, by prior scale."""
    out = np.empty((len(sets), len(SCALES)))
    by_size: dict[int, list[int]] = {}
    for i, columns in enumerate(sets):
        by_size.setdefault(len(columns), []).append(i)
    count = p.state.problem.count
    chi2 = float(np.sum(p.state.weight[:count] * p.state.residual[:count] ** 2)) / p.state.kappa**2
    chi2 += STATED_WORTH / p.state.kappa**2
    base = -p.state.dof * np.log(NOISE) - 0.5 * chi2 / NOISE**2
    null = log_sum(base)
    for size, members in by_size.items():
        if size == 0:
            out[members] = 0.0
            continue
        at = np.array([sets[i] for i in members])  # (B, k)
        x = p.weighted.T[at]  # (B, k, R)
        a, s = p.across.T[at], p.solved.T[at]
        information = x @ np.swapaxes(x, 1, 2) - a @ np.swapaxes(s, 1, 2)
        values, vectors = np.linalg.eigh(information)
        values = np.maximum(values, 0.0)
        along = np.einsum("bij,bi->bj", vectors, p.score[at]) ** 2
        by = (SCALES**2)[:, None, None] / NOISE[:, None] ** 2  # (S, U, 1)
        with_it = 1.0 + by * values[:, None, None, :]  # (B, S, U, k)
        gain = along[:, None, None, :] * (by / NOISE[:, None] ** 2) / with_it - np.log(with_it)
        out[members] = log_sum(base + 0.5 * gain.sum(axis=-1), axis=-1) - null
    return out
