"""The linear problem of a diagnosis: residuals, columns of the model, columns of the candidates.

Everything is linear at one estimate: linear and refitted chi-squares agree to 0.15 %. Contacts are whitened
by their stated noise. `State` then computes noise scale, outliers and evidence of any hypothesis with small
matrices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from bayescal.arm.motion import CERTIFICATE, CONTACT, TURN, Term
from bayescal.arm.transforms import AXES
from bayescal.effects import Parameter
from bayescal.estimate import STATED_WORTH, Estimate, linearise
from bayescal.estimate.outliers import Judged, limit, scale, student_weights
from bayescal.gap.settings import LINEAR
from bayescal.model import ARM, with_parameters
from bayescal.model.length_blocks import length_blocks, main_group

TURNS = ("rx", "ry", "rz")


@dataclass(frozen=True)
class Problem:
    """Residuals (R,), Jacobian (R, D) and pool of candidate columns (R, K), contacts first, then constraints.

    Contacts are whitened by their stated noise, columns scaled by their prior standard deviations. `z` (D,)
    is where the problem was linearised; the prior mean is 0. `contact` (C,) numbers the contact of each of
    the first C rows; the three rows of a point are used or excluded together. The first L of these rows are
    lengths, the others orientations, each with its own contact number. Columns and evidence use both;
    results in metres are of lengths only.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    pool: np.ndarray
    z: np.ndarray
    contact: np.ndarray
    rows: np.ndarray  # (contacts,) row of the session of each contact
    sigma: np.ndarray  # (L,) m, stated noise of each of the first L rows

    @property
    def count(self) -> int:
        """Number C of residuals of contacts."""
        return len(self.contact)

    @property
    def lengths(self) -> int:
        """Number L of residuals that are lengths."""
        return len(self.sigma)

    @cached_property
    def by_size(self) -> list[np.ndarray]:
        """Residuals (C, k) of the contacts of k rows, for every k."""
        order, size = np.argsort(self.contact, kind="stable"), np.bincount(self.contact)
        first = np.cumsum(size) - size
        return [order[first[size == k][:, None] + np.arange(k)] for k in np.unique(size)]

    @property
    def ends(self) -> np.ndarray:
        """End of the contacts of each size except the last, in the order of `by_size`."""
        return np.cumsum([len(at) for at in self.by_size])[:-1]

    @cached_property
    def gross(self) -> np.ndarray:
        """Log density (contacts,) of an outlier: that of a good contact at the limit of rejection."""
        return -0.5 * limit(np.bincount(self.contact))


def problem(fitted: Estimate, extra: Sequence[Parameter], nuisance: Sequence[Parameter] = ()) -> Problem:
    """Linearise a fitted model with further parameters, all at zero, as a pool of candidates.

    `nuisance` parameters are added to those of the model in the Jacobian: every hypothesis may use them.
    """
    slopes = Slopes.of(fitted, [p for p in (*nuisance, *extra) if of_certificate(p)])
    return slopes.problem(fitted.z, extra, nuisance)


@dataclass(frozen=True)
class Slopes:
    """Derivatives of every whitened residual by a unit displacement of every axis of every frame.

    The column of any parameter is such a derivative times a driver, so that the chain is evaluated only once.
    """

    residual: np.ndarray  # (R,)
    jacobian: np.ndarray  # (R, D) of the model's own parameters
    axes: np.ndarray  # (C, 6 (n + 2) + 3): of every frame, then of rotations of the tool about its point
    certified_values: Mapping[str, np.ndarray]  # columns (R,) of parameters of certificates, by name
    contact: np.ndarray  # (C,)
    rows: np.ndarray  # (contacts,)
    sigma: np.ndarray  # (L,) m

    @classmethod
    def of(cls, fitted: Estimate, certified_values: Sequence[Parameter] = ()) -> Slopes:
        """Linearise at an estimate, with full weight of every contact."""
        model = fitted.model
        frames = model.scene.chain.n + 2
        sites = [*((f, axis) for f in range(frames) for axis in AXES), *((TURN, axis) for axis in TURNS)]
        units = [Parameter("", "1", (Term(*site),), 1.0) for site in sites]
        wide = with_parameters(model.scene, model.effects, (*model.parameters, *units, *certified_values))
        own, last = len(model.parameters), len(wide.parameters)
        shift = wide.shift[own:] / wide.sd[own:]
        z = np.concatenate([fitted.z[model.slices[ARM]], -shift, fitted.z[own:]])
        scale = fitted.weights.scale
        main = scale[main_group(model)]
        weights = replace(
            fitted.weights,
            row={b.name: np.ones(len(b.rows)) for b in model.blocks},
            scale={g: s / main for g, s in scale.items()},
        )
        linear = linearise(wide, z, weights)
        contact, rows, first = [], [], 0
        for b in model.blocks:
            contact.append(np.tile(first + np.arange(len(b.rows)), b.kind.rows))
            rows.append(b.rows)
            first += len(b.rows)
        count = sum(map(len, contact))
        return cls(
            linear.residual,
            linear.jacobian[:, np.r_[0:own, last : wide.size]],
            np.asfortranarray(linear.jacobian[:count, own : own + len(units)]),
            {p.name: linear.jacobian[:, own + len(units) + k] for k, p in enumerate(certified_values)},
            np.concatenate(contact),
            np.concatenate(rows),
            np.concatenate([weights.sigma[b.name] * weights.scale[b.group] for b in length_blocks(model)]),
        )

    def problem(self, z: np.ndarray, extra: Sequence[Parameter], nuisance: Sequence[Parameter]) -> Problem:
        """The problem with a pool of candidates; see `problem`."""
        return Problem(
            self.residual,
            np.column_stack([self.jacobian, self.columns(nuisance)]),
            self.columns(extra),
            np.concatenate([z, np.zeros(len(nuisance))]),
            self.contact,
            self.rows,
            self.sigma,
        )

    def columns(self, parameters: Sequence[Parameter]) -> np.ndarray:
        """Columns (R, K) of parameters, each times its prior standard deviation."""
        out = np.zeros((len(self.residual), len(parameters)), order="F")
        count, of_lengths, at = len(self.contact), len(self.sigma), self.rows[self.contact]
        for k, p in enumerate(parameters):
            column = out[:count, k]
            for term in p.terms:
                driver = np.asarray(term.driver, float)
                if term.frame == CERTIFICATE:
                    out[:, k] += self.certified_values[p.name] / p.sd
                    break
                driver = driver if driver.ndim == 0 else driver[at]
                if term.frame == CONTACT:
                    column[:of_lengths] += (driver if driver.ndim == 0 else driver[:of_lengths]) / self.sigma
                elif term.frame == TURN:
                    column += self.axes[:, TURNS.index(term.axis) - len(TURNS)] * driver
                else:
                    column += self.axes[:, 6 * term.frame + AXES.index(term.axis)] * driver
            out[:, k] *= p.sd
        return out


def of_certificate(p: Parameter) -> bool:
    """Whether a parameter is one of a certificate."""
    return any(term.frame == CERTIFICATE for term in p.terms)


def without_nuisance(p: Problem, size: int) -> Problem:
    """The same problem with the first `size` columns of its Jacobian: the model's own parameters."""
    return replace(p, jacobian=p.jacobian[:, :size], z=p.z[:size])


@dataclass(frozen=True)
class State:
    """A hypothesis fitted to a problem: the model and scaled columns of the pool, with its own outliers."""

    problem: Problem
    columns: np.ndarray  # (k,) of the pool
    scales: np.ndarray  # (k,) prior scale of each
    weight: np.ndarray  # (R,) 0 for rows left out; constraints 1
    kappa: float  # noise scale
    residual: np.ndarray  # (R,) at the optimum
    step: np.ndarray  # (D + k,) from the linearisation
    design: np.ndarray  # (R, D + k)
    covariance: np.ndarray  # (D + k, D + k)
    effective_dof: float  # degrees of freedom that the fit takes up
    log_evidence: float
    robust: bool  # whether outliers were searched for

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
        Initial row weights; full weights if not given.
    robust : bool
        Search for outliers.
    """
    columns, scales = np.asarray(columns, int), np.asarray(scales, float)
    design = np.column_stack([p.jacobian, p.pool[:, columns] * scales])
    pull = np.concatenate([p.z, np.zeros(len(columns))])
    count = p.count
    weight = np.ones(len(p.residual)) if start is None else start.copy()
    fixed = np.eye(design.shape[1]) + design[count:].T @ design[count:]
    push = design[count:].T @ p.residual[count:] + pull
    size = np.bincount(p.contact)

    gram, score = np.zeros_like(fixed), np.zeros(len(pull))
    of = np.zeros(count)  # the row weights of these two

    def solve(w: np.ndarray, kappa: float):
        nonlocal gram, score, of
        changed = np.flatnonzero(w[:count] != of)
        if 4 * len(changed) < count:  # only a few rows changed: update instead of a full evaluation
            some = design[changed]
            weighted = some * (w[changed] - of[changed])[:, None]
            gram, score = gram + weighted.T @ some, score + weighted.T @ p.residual[changed]
        else:
            root = np.sqrt(w[:count])
            half = design[:count] * root[:, None]
            gram, score = half.T @ half, half.T @ (root * p.residual[:count])
        of = w[:count].copy()
        info = gram / kappa**2
        factor = cho_factor(info + fixed, lower=True)
        step = -cho_solve(factor, score / kappa**2 + push)
        return step, p.residual + design @ step, info, factor

    def judged(r: np.ndarray, kappa: float, factor) -> Judged:
        slopes = solve_triangular(factor[0], design[:count].T, lower=True).T / kappa
        return Judged.of(
            [(r[at], slopes[at] @ np.swapaxes(slopes[at], 1, 2), weight[at[:, 0]]) for at in p.by_size]
        )

    kappa = 1.0
    if robust and start is None:
        for k in range(LINEAR.rounds):  # Student t, with a scale from the median of the chi-squares
            step, r, info, factor = solve(weight, kappa)
            square = np.bincount(p.contact, r[:count] ** 2)
            taken = float(np.trace(cho_solve(factor, info)))
            before, kappa = kappa, scale(square, size, taken)
            weight[:count] = student_weights(square, size, kappa)[p.contact]
            if k > 2 and abs(np.log(kappa / before)) < 3e-3:
                break
    for _ in range(LINEAR.rounds):
        step, r, info, factor = solve(weight, kappa)
        effective_dof = float(np.trace(cho_solve(factor, info)))
        chi2 = float(np.sum(weight[:count] * r[:count] ** 2))
        kept = float(np.sum(weight[:count]))
        dof = max(kept - effective_dof, 0.0) + STATED_WORTH
        old = weight.copy()
        if robust:
            good = np.split(~judged(r, kappa, factor).outliers(), p.ends)
            for at, own in zip(p.by_size, good, strict=True):
                weight[at] = own[:, None]
        before, kappa = kappa, float(np.sqrt((chi2 + STATED_WORTH) / dof))
        if abs(np.log(kappa / before)) < 1e-4 and np.array_equal(old, weight):
            break
    step, r, info, factor = solve(weight, kappa)
    chi2 = float(np.sum(weight[:count] * r[:count] ** 2))
    kept = float(np.sum(weight[:count]))
    effective_dof = float(np.trace(cho_solve(factor, info)))
    z = pull + step
    lost = np.unique(p.contact[weight[:count] == 0])
    log_evidence = (
        -(kept + STATED_WORTH) * np.log(kappa)
        - 0.5 * (chi2 + STATED_WORTH) / kappa**2
        - 0.5 * (r[count:] @ r[count:] + z @ z)
        - float(np.sum(np.log(np.diag(factor[0]))))
        + float(np.sum(p.gross[lost]))
        - 0.5 * np.log(2.0 * (kept - effective_dof + STATED_WORTH))
    )
    covariance = cho_solve(factor, np.eye(len(z)))
    return State(
        p, columns, scales, weight, kappa, r, step, design, covariance, effective_dof, log_evidence, robust
    )


def again(state: State, p: Problem) -> State:
    """A state of another form of its problem, with the same row weights."""
    return fit_state(p, state.columns, state.scales, state.weight, robust=False)
