"""Locations of the gap: sites and drivers, with their size and probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.distributions import f_sf
from bayescal.effects import Circumstances, Driver, Parameter, Site
from bayescal.effects.location import ARM, face
from bayescal.estimate import STATED_WORTH
from bayescal.gap.linear.evidence import project
from bayescal.gap.linear.problem import without_nuisance
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.outcome.sudden import sizes
from bayescal.gap.result import Curve, Place
from bayescal.gap.search.beam import Hypothesis
from bayescal.gap.search.cells import sets_of
from bayescal.gap.search.unknown import CellFit, Pool, gains, with_set
from bayescal.gap.settings import OUTCOME


def places(
    hypothesis: Hypothesis,
    pool: Pool,
    named: Sequence[Parameter],
    c: Circumstances,
    excess: float,
    size: int,
) -> tuple[Place, ...]:
    """Locations of named effects, then significant further ones, then the largest of the others.

    Parameters
    ----------
    hypothesis : Hypothesis
        The named effects, fitted.
    pool : Pool
        Generic cells.
    named : sequence of Parameter
        The pool of named candidates.
    excess : float
        Excess variance of a contact under the baseline, m2.
    size : int
        Number of parameters of the model: the size of a location is what these do not absorb; the errors of
        masses are not counted.
    """
    out = list(places_named(hypothesis, named, c, excess, size))
    state, tests = hypothesis.state, len(pool.sets)
    seen = {(p.site, p.driver) for p in out}
    most = max(OUTCOME.places, len(out) + OUTCOME.places_left)  # further locations are always listed
    while len(out) < most:
        ranked = sorted(gains(state, pool), key=lambda f: -f.gain)
        ranked = [f for f in ranked if (pool.cells[f.cell].site, pool.cells[f.cell].driver) not in seen]
        if not ranked:
            break
        place, wider = _of_cell(state, pool, ranked[0], c, excess, size, tests)
        out.append(place)
        seen.add((place.site, place.driver))
        if place.family_p_value > OUTCOME.significant:
            for other in ranked[1 : 1 + most - len(out)]:
                out.append(_of_cell(state, pool, other, c, excess, size, tests)[0])
            break
        state = wider
    return tuple(out)


def f_test(state: State, columns: np.ndarray) -> float:
    """p-value of columns (R, k) under the hypothesis that their amplitude is zero."""
    projected = project(state, columns)
    information = projected.information(np.arange(columns.shape[1]))
    values, vectors = np.linalg.eigh(information)
    real = values > 1e-9 * max(float(values[-1]), 1e-300)
    size = int(np.sum(real))
    if not size:
        return 1.0
    gain = float(np.sum((vectors[:, real].T @ projected.score) ** 2 / values[real]))
    count = state.problem.count
    square = float(np.sum(state.weight[:count] * state.residual[:count] ** 2)) + STATED_WORTH
    chi2 = square / state.kappa**2
    dof = max(state.dof - size, 1.0)
    return float(f_sf(gain / size / (max(chi2 - gain, 1e-9) / dof), size, dof))


def visible(state: State, contribution: np.ndarray) -> np.ndarray:
    """Part of a whitened contribution (R,) that the state does not absorb, of lengths (L,), m."""
    return unabsorbed(state, contribution)[: state.problem.lengths] * state.problem.sigma


def unabsorbed(state: State, contribution: np.ndarray) -> np.ndarray:
    """Part of a whitened contribution (R,) not absorbed by the state, of lengths and orientations (C,)."""
    count = state.problem.count
    whiten = np.sqrt(state.weight)
    whiten[:count] /= state.kappa
    design = state.design * whiten[:, None]
    weighted = contribution * whiten
    left = contribution - state.design @ (state.covariance @ (design.T @ weighted))
    return left[:count]


def _place(
    site: Site, driver: Driver, parameters: Sequence[Parameter], columns: np.ndarray, amplitude: np.ndarray,
    without: State, with_it: State, c: Circumstances, excess: float, size: int, tests: int, gain: float,
    name: str,
) -> Place:  # fmt: skip
    p = without.problem
    contribution = columns @ amplitude
    bare = fit_state(without_nuisance(p, size), (), (), without.weight, robust=False)
    left = visible(bare, contribution)
    kept = without.weight[: p.lengths] > 0
    rms = float(np.sqrt(np.mean(left[kept] ** 2))) if np.any(kept) else 0.0
    p_value = f_test(without, columns)
    share = float(np.clip(rms**2 / excess, 0.0, 1.0)) if excess > 0 else 0.0
    curve = _curve(site, driver, parameters, columns, contribution, with_it, c)
    return Place(site, driver, rms, share, p_value, min(1.0, p_value * tests), gain, name, curve)


def _of_cell(
    state: State, pool: Pool, f: CellFit, c: Circumstances, excess: float, size: int, tests: int
) -> tuple[Place, State]:
    cell = pool.cells[f.cell]
    if cell.clusters is not None:
        return _of_random_cell(state, pool, f, c, excess, tests), state
    start = state.weight if not state.gross else None
    wider = with_set(state, pool, f.best, f.scale, start)
    if wider.gross < state.gross:  # contacts that it explains are no outliers
        state = fit_state(state.problem, state.columns, state.scales, wider.weight, robust=False)
    own = pool.sets[f.best]
    amplitude = wider.amplitudes[len(state.columns) :]
    first = int(np.flatnonzero(pool.owner == f.cell)[0])
    parameters = sets_of(cell, f.cell, c)[f.best - first]
    place = _place(
        cell.site, cell.driver, parameters, pool.columns[:, own], amplitude, state, wider, c, excess, size,
        tests, f.gain, "",
    )  # fmt: skip
    if place.family_p_value > OUTCOME.significant:
        return place, wider
    event, amplitudes = sizes(state, wider, pool, f, c)
    return replace(place, event=event, amplitudes=amplitudes), wider


def _of_random_cell(
    state: State, pool: Pool, f: CellFit, c: Circumstances, excess: float, tests: int
) -> Place:
    """The location of a random error: its standard deviation at the contacts, and no smooth curve.

    Its p-value is the inverse of its Bayes factor: without the error, a factor of k or more occurs with a
    probability of at most 1/k (Markov's inequality).
    """
    cell, p = pool.cells[f.cell], state.problem
    column = pool.columns[:, pool.sets[f.best]]
    kept = state.weight[: p.lengths] > 0
    size = column[: p.lengths, 0] * p.sigma * f.scale
    rms = float(np.sqrt(np.mean(size[kept] ** 2))) if np.any(kept) else 0.0
    share = float(np.clip(rms**2 / excess, 0.0, 1.0)) if excess > 0 else 0.0
    p_value = float(np.exp(-max(f.gain, 0.0)))
    curve = _curve(cell.site, cell.driver, (), column, np.zeros(len(column)), state, c)
    return Place(cell.site, cell.driver, rms, share, p_value, min(1.0, p_value * tests), f.gain, "", curve)


def places_named(
    hypothesis: Hypothesis, named: Sequence[Parameter], c: Circumstances, excess: float, size: int
) -> tuple[Place, ...]:
    """The largest locations of every effect of a hypothesis; see `places`."""
    state, p = hypothesis.state, hypothesis.state.problem
    amplitudes = dict(zip(state.columns.tolist(), state.amplitudes, strict=True))
    out: list[Place] = []
    for member in hypothesis.members:
        groups: dict[tuple[Site, Driver], list[int]] = {}
        for k in member.variant.columns.tolist():
            groups.setdefault((named[k].site, named[k].driver), []).append(k)
        drivers = {driver for _, driver in groups}
        if len(groups) > 1 and len(drivers) == 1:  # a common cause at all joints is listed before its parts
            groups = {(ARM, drivers.pop()): member.variant.columns.tolist()} | groups
        mine = []
        for (site, driver), own in groups.items():
            rest = ~np.isin(state.columns, own)
            without = fit_state(p, state.columns[rest], state.scales[rest], state.weight, robust=False)
            parts, columns = [named[k] for k in own], p.pool[:, own]
            amplitude, gain = (
                np.array([amplitudes[k] for k in own]),
                state.log_evidence - without.log_evidence,
            )
            mine.append(
                _place(
                    site, driver, parts, columns, amplitude, without, state, c, excess, size,
                    len(groups), gain, member.effect,
                )
            )  # fmt: skip
        out += sorted(mine, key=lambda place: (place.site != ARM, -place.rms))[: OUTCOME.places_named]
    return tuple(out)


def _curve(
    site: Site, driver: Driver, parameters: Sequence[Parameter], columns: np.ndarray,
    contribution: np.ndarray, state: State, c: Circumstances,
) -> Curve:  # fmt: skip
    p = state.problem
    along = driver.coordinate(site, c)
    rows = p.rows[p.contact[: p.lengths]]
    fitted = contribution[: p.lengths] * p.sigma
    residual = state.residual[: p.lengths] * p.sigma + fitted
    on = next((f.rows for f in c.faces if face(f.name) == site), np.ones(len(c.q)))
    keep = (state.weight[: p.lengths] > 0) & (on[rows] > 0)  # of a face, the contacts on it
    lever, unit = None, ""
    frames = {(t.frame, t.axis) for q in parameters for t in q.terms}
    one = len(frames) == 1 or all(axis == "rz" for _, axis in frames)
    if frames and one and all(frame >= 0 for frame, _ in frames):
        drivers = np.array([np.broadcast_to(q.terms[0].driver, len(c.q))[rows] for q in parameters]).T
        best = np.argmax(np.abs(drivers), axis=1)
        at = np.arange(len(rows))
        size = drivers[at, best]
        scaled = columns[: p.lengths][at, best] * p.sigma / np.array([q.sd for q in parameters])[best]
        lever = np.where(size != 0, scaled / np.where(size != 0, size, 1.0), 0.0)[keep]
        unit = "rad" if next(iter(frames))[1][0] == "r" else "m"
    return Curve(along.label, along.values[rows][keep], residual[keep], fitted[keep], rows[keep], lever, unit)
