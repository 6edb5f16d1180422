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

SAME_NOISE = 0.02
"""Relative difference of noise scales up to which the same measurements are outliers (cost)."""


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

    def amplitudes_of(self, columns: np.ndarray) -> np.ndarray:
        """Fitted amplitudes (k,) of some of the columns, by their numbers in the pool."""
        fitted = dict(zip(self.columns.tolist(), self.amplitudes, strict=True))
        return np.array([fitted[k] for k in columns.tolist()])

    def predicted(self, columns: np.ndarray) -> np.ndarray:
        """What some of the columns change, (R,): the columns times their fitted amplitudes."""
        return self.problem.pool[:, columns] @ self.amplitudes_of(columns)

    def without(self, columns: np.ndarray) -> State:
        """The fit without some of the columns, with the same row weights."""
        others = ~np.isin(self.columns, columns)
        return fit_state(self.problem, self.columns[others], self.scales[others], self.weight, robust=False)


def design(p: Problem, columns: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Columns (R, D + k) of the model and of k columns of the pool, these times their scales."""
    return np.column_stack([p.jacobian, p.pool[:, columns] * scales])


class _Normal:
    """Normal equations of a hypothesis at row weights and a noise scale.

    Gauss-Newton steps are exact: the problem is linear. The products over contacts are kept, because from one
    fit to the next the weights of only a few rows change.
    """

    def __init__(self, p: Problem, columns: np.ndarray, scales: np.ndarray) -> None:
        self.problem, self.x = p, design(p, columns, scales)
        of_contacts, of_constraints = self.x[: p.count], self.x[p.count :]
        self.contacts = of_contacts
        self.pull = np.concatenate([p.z, np.zeros(len(columns))])
        self.fixed = np.eye(self.x.shape[1]) + of_constraints.T @ of_constraints
        self.root = np.tril(factored(self.fixed))
        self.push = of_constraints.T @ p.residual[p.count :] + self.pull
        self.gram, self.score = np.zeros_like(self.fixed), np.zeros(len(self.pull))
        self.weight = np.zeros(p.count)  # the row weights of these two
        # rows that are worth less than 1 have a larger covariance in proportion
        self.unit = (np.sqrt(p.base)[:, None] * self.x)[: p.count].T

    def solve(self, weight: np.ndarray, kappa: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Step (D + k,), residuals (R,) there, and Cholesky factor of the information."""
        p = self.problem
        weight = weight[: p.count]
        changed = np.flatnonzero(weight != self.weight)
        if 4 * len(changed) < p.count:  # only a few rows changed: update instead of a full evaluation
            some = self.contacts[changed]
            weighted = some * (weight[changed] - self.weight[changed])[:, None]
            self.gram = self.gram + weighted.T @ some
            self.score = self.score + weighted.T @ p.residual[changed]
        else:
            root = np.sqrt(weight)
            half = self.contacts * root[:, None]
            self.gram, self.score = half.T @ half, half.T @ (root * p.residual[: p.count])
        self.weight = weight.copy()
        factor = factored(self.gram / kappa**2 + self.fixed)
        step = -solved(factor, self.score / kappa**2 + self.push)
        return step, p.residual + self.x @ step, factor

    def taken(self, factor: np.ndarray) -> float:
        """Degrees of freedom that contacts take up: the trace of the covariance times their information."""
        return len(self.root) - float(np.sum(halved(factor, self.root) ** 2))

    def judged(self, r: np.ndarray, weight: np.ndarray, kappa: float, factor: np.ndarray) -> Judged:
        """All contacts with their leverage in the fit."""
        slopes, share = halved(kappa * factor, self.unit).T, weight / self.problem.base
        parts = []
        for rows in self.problem.by_size:
            by_contact = slopes[rows]
            parts.append((r[rows], np.einsum("cid,cjd->cij", by_contact, by_contact), share[rows[:, 0]]))
        return Judged.of(parts)


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
    normal, count, base = _Normal(p, columns, scales), p.count, p.base
    ends = np.cumsum(list(map(len, p.by_size)))[:-1]  # of the contacts of each size except the last
    weight, kappa = base.copy() if start is None else np.where(start > 0, base, 0.0), 1.0
    if robust and start is None:
        weight, kappa = _student(normal, weight)
    judged_at = 0.0  # the noise scale at which outliers were judged with these row weights
    for _ in range(LINEAR.rounds):
        _, r, factor = normal.solve(weight, kappa)
        chi2, kept = float(np.sum(weight[:count] * r[:count] ** 2)), float(np.sum(weight[:count]))
        effective_dof = normal.taken(factor)
        dof = max(kept - effective_dof, 0.0) + STATED_WORTH
        before, kappa = kappa, float(np.sqrt((chi2 + STATED_WORTH) / dof))
        change = abs(np.log(kappa / before))
        # leverages take most of the time: at about the right noise scale, and then where it has moved
        if robust and change < SAME_NOISE and abs(kappa - judged_at) > SAME_NOISE * kappa:
            old, judged_at = weight.copy(), kappa
            judged = normal.judged(r, weight, before, factor)
            for rows, good in zip(p.by_size, np.split(~judged.outliers(), ends), strict=True):
                used = good if p.sharing is None else good | p.sharing[p.contact[rows[:, 0]]]
                weight[rows] = used[:, None] * base[rows]
            if not np.array_equal(old, weight):
                judged_at = 0.0
                continue
        if change < 1e-4:
            break
    step, r, factor = normal.solve(weight, kappa)
    chi2, kept = float(np.sum(weight[:count] * r[:count] ** 2)), float(np.sum(weight[:count]))
    covariance = solved(factor, np.eye(len(step)))
    effective_dof = normal.taken(factor)
    z = normal.pull + step
    lost = np.unique(p.contact[weight[:count] == 0])
    log_evidence = (
        -(kept + STATED_WORTH) * np.log(kappa)
        - 0.5 * (chi2 + STATED_WORTH) / kappa**2
        - 0.5 * (r[count:] @ r[count:] + z @ z)
        - float(np.sum(np.log(np.diag(factor))))
        + p.excluded(lost)
        - 0.5 * np.log(2.0 * (kept - effective_dof + STATED_WORTH))
    )
    return State(p, columns, scales, weight, kappa, r, step, covariance, effective_dof, log_evidence, robust)


def _student(normal: _Normal, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Row weights (R,) of a fit with Student t noise, and its scale, by the median of the chi-squares."""
    p, kappa, weight = normal.problem, 1.0, weight.copy()
    size = np.bincount(p.contact)
    for k in range(LINEAR.rounds):
        _, r, factor = normal.solve(weight, kappa)
        square = np.bincount(p.contact, r[: p.count] ** 2)
        before, kappa = kappa, scale(square, size, normal.taken(factor))
        weight[: p.count] = p.base[: p.count] * student_weights(square, size, kappa)[p.contact]
        if k > 2 and abs(np.log(kappa / before)) < 1e-2:
            break
    return weight, kappa


def again(state: State, p: Problem) -> State:
    """A state of another form of its problem, with the same row weights."""
    return fit_state(p, state.columns, state.scales, state.weight, robust=False)


def limited(state: State) -> State:
    """The hypothesis fitted to all contacts, with residuals no larger than the limit of rejection.

    Excluded contacts count, and none more than the others: what several of them share shows, beside an
    outlier of any size.
    """
    p = state.problem
    of_contacts = state.residual[: p.count]
    square = np.bincount(p.contact, of_contacts**2)
    most = limit(np.bincount(p.contact)) * state.kappa**2
    residual = p.residual.copy()
    residual[: p.count] -= of_contacts * (1.0 - np.sqrt(most / np.maximum(square, most)))[p.contact]
    return fit_state(replace(p, residual=residual), state.columns, state.scales, robust=False)
