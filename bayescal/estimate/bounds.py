"""The bound of positive parameters: a compliance below zero within its uncertainty is that of a rigid part.

The prior of a compliance is normal (the model stays linear), so an estimate may be negative. Let v, S be the
estimates and the covariance of all positive parameters. The most probable values that are not negative are

    argmin over v' >= 0 of (v' - v)' S^-1 (v' - v),

a non-negative least-squares problem (Lawson, Hanson 1974). The parameters that are zero there are fitted
again at zero, and all others with them.

Their uncertainty is not removed: the covariance is that of the model with them as unknowns. For a single
parameter whose estimate is v <= 0, E[v'^2 | v' >= 0] <= u^2: the uncertainty stated about zero is not too
small.

A value that is significantly negative contradicts the model, and is left as it is: below -2 u of a single
positive parameter; several share its probability (Bonferroni): below -2.6 u of five. So are all, where only
together they are that improbable (chi-square of the bound).

Joint readings as variables of the graph: every contact has its own reading errors.

The usual estimate adds the noise of the readings to the variance of a contact through the Jacobian.
Here each contact has n additional unknowns, its reading errors, and a separate factor. The two agree if
the model is linear within the noise of a reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import nnls
from scipy.special import ndtr, ndtri

from bayescal.arm.motion import Motion, Term
from bayescal.effects import UNITS, Parameter
from bayescal.effects.location import micrometres
from bayescal.errors import BayescalError
from bayescal.estimate import linearise
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.estimate import Estimate, at_solution, estimate, smallest_noise
from bayescal.estimate.solver import add_constraints, with_variables
from bayescal.model import ARM, Block, Model
from bayescal.model.equilibrium import moved, standing_model, tool_points
from bayescal.model.model import with_parameters
from bayescal.statistics import chi2_sf, rms

if TYPE_CHECKING:
    from factors.graph import Graph

CHANCE = float(ndtr(-2.0))
"""Probability that a rigid part has an estimate below -2 u."""
TIGHT = 1e-6
"""Prior standard deviation of a parameter that is fitted at its bound, as a share of its own."""
FITS = 8
"""Most fits with gravity moments at the pose of the fit before, and with further parameters at zero."""
AT_REST = 1e-2
"""Displacement of the TCP by such a fit, in units of the smallest noise, at which they end."""
PAIRS = 400
"""Pairs of poses whose distance is compared."""


@dataclass(frozen=True)
class Negative:
    """A physically positive parameter with a negative value, SI."""

    parameter: str
    value: float
    u: float
    unit: str  # a key of UNITS
    limit: float = 2.0  # u below zero from which on it is significant

    @property
    def significant(self) -> bool:
        """Whether the value is not that of a rigid part with its uncertainty."""
        return self.value < -self.limit * self.u

    @property
    def figures(self) -> str:
        """Value and u in the unit of files."""
        unit, factor = UNITS[self.unit]
        value, u = float(f"{factor * self.value:.3g}"), float(f"{factor * self.u:.2g}")
        return f"{value:.9g} {unit.replace('urad', 'µrad')} (u {u:.9g})"


@dataclass(frozen=True)
class Rigid:
    """Parameters that a fit has at zero, and what that changes over the poses of the session, m."""

    parameters: tuple[Negative, ...] = ()  # with their values without the bound
    distance_rms: float = 0.0
    distance_max: float = 0.0

    @property
    def words(self) -> str:
        """In a sentence; "" where no parameter is at its bound."""
        if not self.parameters:
            return ""
        each = ", ".join(f"{n.parameter} {n.figures}" for n in self.parameters)
        size, most = micrometres(self.distance_rms), micrometres(self.distance_max)
        return (
            f"set to rigid, because not distinguishable from 0: {each}; fitted again, distances over the "
            f"poses of the session change by {size} RMS, {most} at most"
        )


UNCHANGED = Rigid()
"""Of a fit whose positive parameters are not negative."""


def negative(parameters: Sequence[Parameter], deviations: np.ndarray, sd: np.ndarray) -> tuple[Negative, ...]:
    """Physically positive parameters below zero, by deviations (P,) from nominal and their u (P,), SI."""
    limit = float(-ndtri(CHANCE / max(sum(p.positive for p in parameters), 1)))
    return tuple(
        Negative(p.name, float(p.nominal + d), float(u), p.unit, limit)
        for p, d, u in zip(parameters, deviations, sd, strict=True)
        if p.positive and p.nominal + d < -TIGHT * p.sd
    )


def bounded(fitted: Estimate) -> tuple[Estimate, Rigid]:
    """The estimate with positive parameters that are not negative, and what was changed.

    The estimate is unchanged if none is negative, or if one contradicts the bound together with others.
    """
    model, count = fitted.model, len(fitted.model.parameters)
    if not negative(model.parameters, fitted.arm, np.ones(count)):
        return fitted, UNCHANGED
    covariance = stated(fitted).limited[:count, :count]
    u = np.sqrt(np.diag(covariance)) * model.sd
    below = negative(model.parameters, fitted.arm, u)
    kept = {n.parameter for n in below if n.significant}
    within = [n.parameter for n in below if not n.significant]
    together = chi2_sf(square(fitted, covariance, within), len(within)) if len(within) > 1 else 1.0
    free = [k for k, p in enumerate(model.parameters) if p.positive and p.name not in kept]
    at_zero = _at_zero(fitted, free) if together >= CHANCE else ()
    out = fitted
    for _ in range(len(free)):
        if not at_zero:
            return fitted, UNCHANGED
        out = _fitted(fitted, at_zero)
        more = {n.parameter for n in negative(model.parameters, out.arm, np.ones(count))} - kept
        if not more:
            break
        at_zero = tuple(dict.fromkeys((*at_zero, *more)))
    held = tuple(
        Negative(p.name, float(p.nominal + d), float(sd), p.unit)
        for p, d, sd in zip(model.parameters, fitted.arm, u, strict=True)
        if p.name in at_zero
    )
    return out, Rigid(held, *_changed(fitted, out))


def square(fitted: Estimate, covariance: np.ndarray, names: Sequence[str]) -> float:
    """Chi-square of parameters against zero, by a covariance of z."""
    index, p = [fitted.model.names.index(name) for name in names], fitted.model.parameters
    off = np.array([fitted.z[k] + p[k].centre / p[k].sd for k in index])
    return float(off @ np.linalg.solve(covariance[np.ix_(index, index)], off)) if index else 0.0


def _at_zero(fitted: Estimate, free: Sequence[int]) -> tuple[str, ...]:
    """Parameters, of those at `free`, that are zero at the most probable values that are not negative."""
    if not free:  # of an empty matrix, nnls aborts the process
        return ()
    p = fitted.model.parameters
    zero = np.array([-p[k].centre / p[k].sd for k in free])  # z of a part that is rigid
    above = fitted.z[list(free)] - zero
    covariance = fitted.covariance[np.ix_(free, free)]
    factor = np.linalg.cholesky(np.linalg.inv(covariance)).T
    best, _ = nnls(factor, factor @ above)
    return tuple(p[free[int(k)]].name for k in np.flatnonzero(best <= 0))


def _fitted(fitted: Estimate, names: Sequence[str]) -> Estimate:
    """The fit again, of the same rows, with some parameters at zero; they stay unknowns of its model."""
    model, noise = fitted.model, smallest_noise(fitted)
    here = np.array([p.name in names for p in model.parameters])
    zero = np.array([-p.centre / p.sd for p in model.parameters])
    z = fitted.z.copy()
    z[: len(here)][here] = zero[here]
    for _ in range(FITS):
        before = model.deviations(z[model.slices[ARM]])
        model = standing_model(model, before)
        tight = tuple(
            replace(p, sd=TIGHT * p.sd, mean=0.0) if h else p
            for p, h in zip(model.parameters, here, strict=True)
        )
        start = z.copy()
        start[: len(here)][here] = 0.0
        bound = with_parameters(model.scene, model.effects, tight)
        held = estimate(bound, start=start, left_out=fitted.rejected)
        z = held.z.copy()
        z[: len(here)][here] = zero[here]
        after = model.deviations(z[model.slices[ARM]])
        if moved(tool_points(model, before), tool_points(model, after)) < AT_REST * noise:
            break
    return replace(at_solution(model, z, fitted.rejected), held=tuple(names))


def _changed(before: Estimate, after: Estimate) -> tuple[float, float]:
    """RMS and largest change, m, of distances between TCP positions of the fitted measurements."""
    rows = np.unique(np.concatenate([b.rows for b in before.model.states]))
    one, other = np.random.default_rng(0).integers(0, len(rows), (2, PAIRS))
    length = []
    for e in (before, after):
        points = tool_points(e.model, e.arm)[:, rows]
        length.append(np.linalg.norm(points[:, one] - points[:, other], axis=0))
    change = np.abs(length[1] - length[0])
    return rms(change), float(np.max(change))


def with_latent_readings(fitted: Estimate) -> Estimate:
    """Solve again with latent readings, from an estimate and with its noise scale and row weights.

    Raises
    ------
    BayescalError
        If the session states no noise of the readings.
    """
    from factors.graph import Graph

    model = fitted.model
    joint, _ = model.scene.dataset.reading_noise
    if joint <= 0:
        what = "noise.joint_deg and noise.slide_mm are 0: the readings have no errors to estimate"
        remedy = "state noise.joint_deg in dataset.yaml, or omit the option"
        raise BayescalError(what, "--latent-joints", remedy)
    graph, n = Graph(), model.scene.chain.n
    start = with_variables(graph, model, fitted.z)
    variables = list(start)
    for block in model.blocks:
        scale = fitted.weights.scale[block.group]
        for k in np.flatnonzero(fitted.weights.row[block.name]):
            name = f"readings {block.rows[k]}"
            if name not in start:  # point and orientation of the same row share its readings
                graph.variable(name, n)
                start[name] = np.zeros(n)
            _add_contact(graph, model, block, int(k), name, scale, joint * scale)
    add_constraints(graph, model, variables)
    solution, iterations = graph.solve(start)
    z = np.concatenate([solution[name] for name in variables])
    linear, iterations = linearise(model, z, fitted.weights), fitted.iterations + iterations
    return replace(fitted, z=z, covariance=graph.covariance(variables), linear=linear, iterations=iterations)


def _add_contact(
    graph: Graph, model: Model, block: Block, k: int, name: str, scale: float, joint: float
) -> None:
    """Add one contact; its residual is a function of arm, target and the contact's n reading errors."""
    size, n = len(model.parameters), model.scene.chain.n
    robot, share = model.scene.dataset.robot, model.scene.dataset.reading_noise[1]
    coupling = robot.link_from_reading * share
    row = block.rows[[k]]
    terms = [(p, _at(term, k)) for p, term in block.motion.terms]
    terms += [
        (size + r, Term(j + 1, robot.axes[j], float(coupling[j, r])))
        for j in range(n)
        for r in range(n)
        if coupling[j, r]
    ]
    motion = Motion(model.scene.chain, model.scene.q[row], model.scene.tools[row], terms, size + n)
    contact = replace(model.part(block, row), motion=motion)
    sigma = scale * float(block.sigma[k])

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        arm = parts[0] if size else np.zeros(0)
        target = parts[-2] if block.size else np.zeros(0)
        values = np.concatenate([model.deviations(arm), parts[-1] * joint])
        r, by_values, by_target = contact.linearise(values, target)
        gradients = [by_values[:, :size] * model.sd / sigma] if size else []
        gradients += [by_target / sigma] if block.size else []
        return r / sigma, [*gradients, by_values[:, size:] * (joint / sigma)]

    names = ([ARM] if size else []) + ([block.target] if block.size else []) + [name]
    graph.factor(names, contact.kind.rows, function)


def _at(term: Term, k: int) -> Term:
    return replace(term, driver=float(np.asarray(term.driver)[k])) if np.ndim(term.driver) else term
