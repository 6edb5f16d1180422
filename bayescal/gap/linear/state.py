"""A hypothesis fitted to a linear problem: its noise scale, its outliers, its evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.estimate import STATED_WORTH
from bayescal.estimate.outliers import Judged, limit, scale, student_weights
from bayescal.estimate.solver import factored, halved, solved
from bayescal.gap.linear.problem import Problem
from bayescal.gap.settings import LINEAR


@dataclass(frozen=True)
class State:
    """A hypothesis fitted to a problem: the model and scaled columns of the pool, with its own outliers."""

    problem: Problem
    columns: np.ndarray  # (k,) of the pool
    scales: np.ndarray  # (k,) prior scale of each
    weight: np.ndarray  # (R,) 0 for rows left out, else what they are worth; constraints 1
    kappa: float  # noise scale
    residual: np.ndarray  # (R,) at the optimum
    step: np.ndarray  # (D + k,) from the linearisation
    covariance: np.ndarray  # (D + k, D + k)
    effective_dof: float  # degrees of freedom that the fit takes up
    log_evidence: float
    robust: bool  # whether outliers were searched for

    @property
    def design(self) -> np.ndarray:
        """Columns (R, D + k) of the model and of the hypothesis: not stored, a search has many states."""
        return design(self.problem, self.columns, self.scales)

    @property
    def gross(self) -> int:
        """Number of excluded contacts."""
        return len(np.unique(self.problem.contact[self.weight[: self.problem.count] == 0]))

    @property
    def dof(self) -> float:
        """Degrees of freedom of the noise, including its prior."""
        return float(np.sum(self.weight[: self.problem.count])) - self.effective_dof + STATED_WORTH

    @property
    def amplitudes(self) -> np.ndarray:
        """Fitted amplitudes of the columns, (k,), in units of their prior standard deviations."""
        return self.step[len(self.problem.z) :] * self.scales


def design(p: Problem, columns: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Columns (R, D + k) of the model and of k columns of the pool, these times their scales."""
    return np.column_stack([p.jacobian, p.pool[:, columns] * scales])


def fit_state(
    p: Problem,
    columns: np.ndarray | Sequence[int],
    scales: np.ndarray | Sequence[float],
    start: np.ndarray | None = None,
    robust: bool = True,
) -> State:
    """Fit a hypothesis. Each has its own outliers: rows that support it are no outliers of it.

    Parameters
    ----------
    columns, scales : np.ndarray, shape (k,)
        Columns of the pool in the hypothesis, and factors on their prior standard deviations.
    start : np.ndarray, shape (R,), optional
        Row weights of another fit, whose rows of weight 0 are left out initially.
    robust : bool
        Search for outliers.
    """
    columns, scales = np.asarray(columns, int), np.asarray(scales, float)
    x = design(p, columns, scales)
    pull = np.concatenate([p.z, np.zeros(len(columns))])
    count = p.count
    base = p.base
    weight = base.copy() if start is None else np.where(start > 0, base, 0.0)
    fixed = np.eye(x.shape[1]) + x[count:].T @ x[count:]
    push = x[count:].T @ p.residual[count:] + pull
    size = np.bincount(p.contact)

    gram, score = np.zeros_like(fixed), np.zeros(len(pull))
    of = np.zeros(count)  # the row weights of these two

    def solve(w: np.ndarray, kappa: float):
        nonlocal gram, score, of
        changed = np.flatnonzero(w[:count] != of)
        if 4 * len(changed) < count:  # only a few rows changed: update instead of a full evaluation
            some = x[changed]
            weighted = some * (w[changed] - of[changed])[:, None]
            gram, score = gram + weighted.T @ some, score + weighted.T @ p.residual[changed]
        else:
            root = np.sqrt(w[:count])
            half = x[:count] * root[:, None]
            gram, score = half.T @ half, half.T @ (root * p.residual[:count])
        of = w[:count].copy()
        info = gram / kappa**2
        factor = factored(info + fixed)
        step = -solved(factor, score / kappa**2 + push)
        return step, p.residual + x @ step, info, factor

    # rows that are worth less than 1 have a larger covariance in proportion
    unit = (np.sqrt(base)[:, None] * x)[:count].T

    def judged(r: np.ndarray, kappa: float, factor: np.ndarray) -> Judged:
        slopes = halved(factor, unit).T / kappa
        parts = []
        for at in p.by_size:
            own = slopes[at]
            parts.append((r[at], np.einsum("cid,cjd->cij", own, own), (weight / base)[at[:, 0]]))
        return Judged.of(parts)

    kappa = 1.0
    if robust and start is None:
        for k in range(LINEAR.rounds):  # Student t, with a scale from the median of the chi-squares
            step, r, info, factor = solve(weight, kappa)
            square = np.bincount(p.contact, r[:count] ** 2)
            taken = float(np.trace(solved(factor, info)))
            before, kappa = kappa, scale(square, size, taken)
            weight[:count] = base[:count] * student_weights(square, size, kappa)[p.contact]
            if k > 2 and abs(np.log(kappa / before)) < 3e-3:
                break
    for _ in range(LINEAR.rounds):
        step, r, info, factor = solve(weight, kappa)
        chi2 = float(np.sum(weight[:count] * r[:count] ** 2))
        kept = float(np.sum(weight[:count]))
        old = weight.copy()
        if robust:
            found = judged(r, kappa, factor)
            effective_dof = float(found.weight @ found.taken)
            for at, own in zip(p.by_size, np.split(~found.outliers(), p.ends), strict=True):
                used = own if p.sharing is None else own | p.sharing[p.contact[at[:, 0]]]
                weight[at] = used[:, None] * base[at]
        else:
            effective_dof = float(np.trace(solved(factor, info)))
        dof = max(kept - effective_dof, 0.0) + STATED_WORTH
        before, kappa = kappa, float(np.sqrt((chi2 + STATED_WORTH) / dof))
        if abs(np.log(kappa / before)) < 1e-4 and np.array_equal(old, weight):
            break
    step, r, info, factor = solve(weight, kappa)
    chi2 = float(np.sum(weight[:count] * r[:count] ** 2))
    kept = float(np.sum(weight[:count]))
    covariance = solved(factor, np.eye(len(pull)))
    effective_dof = float(np.sum(covariance * info))
    z = pull + step
    lost = np.unique(p.contact[weight[:count] == 0])
    log_evidence = (
        -(kept + STATED_WORTH) * np.log(kappa)
        - 0.5 * (chi2 + STATED_WORTH) / kappa**2
        - 0.5 * (r[count:] @ r[count:] + z @ z)
        - float(np.sum(np.log(np.diag(factor))))
        + float(np.sum(p.gross[lost]))
        - 0.5 * np.log(2.0 * (kept - effective_dof + STATED_WORTH))
    )
    return State(p, columns, scales, weight, kappa, r, step, covariance, effective_dof, log_evidence, robust)


def again(state: State, p: Problem) -> State:
    """A state of another form of its problem, with the same row weights."""
    return fit_state(p, state.columns, state.scales, state.weight, robust=False)


def limited(state: State) -> State:
    """The hypothesis fitted to all contacts, with residuals no larger than the limit of rejection.

    Excluded contacts count, and none more than the others: what several of them share shows, beside an
    outlier of any size.
    """
    p = state.problem
    own = state.residual[: p.count]
    square = np.bincount(p.contact, own**2)
    most = limit(np.bincount(p.contact)) * state.kappa**2
    residual = p.residual.copy()
    residual[: p.count] -= own * (1.0 - np.sqrt(most / np.maximum(square, most)))[p.contact]
    return fit_state(replace(p, residual=residual), state.columns, state.scales, robust=False)
