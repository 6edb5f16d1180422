"""Locations of the gap: sites and drivers, with their size and probability.

Of unmodelled errors of a simple form also the row and size of a sudden change, or the size of a rocking of
the base. A generic cell tries a change at few rows, between which its row is therefore searched again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.effects import Circumstances, Parameter
from bayescal.effects.location import ARM, BASE, Driver, Site, face
from bayescal.estimate import STATED_WORTH
from bayescal.gap.linear.evidence import SCALE_PRIOR, Bank, log_sum, project, weigh_sets
from bayescal.gap.linear.problem import Problem, without_nuisance
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.result import Amplitude, Curve, Event, Place
from bayescal.gap.search.beam import Hypothesis
from bayescal.gap.search.cells import sets_of
from bayescal.gap.search.unknown import CellFit, Pool, gains, with_set
from bayescal.gap.settings import CELLS, OUTCOME
from bayescal.statistics import chi2_sf, f_sf, rms

EVENT, ROCKING = Driver("event"), Driver("base moment", form="sign")
UNKNOWN = "unknown"
TAIL = 0.025
"""Probability on either side of a 95 % interval (convention)."""
SAME = 1e-6
"""Nats, up to which rows are equally probable: a contact that is left out does not distinguish its row from
the next. The first of them is told."""


def sizes(
    without: State, with_it: State, pool: Pool, f: CellFit, c: Circumstances
) -> tuple[Event | None, tuple[Amplitude, ...]]:
    """Row of a sudden change, and by what it moves its site; by what a base rocks; else (None, ()).

    Parameters
    ----------
    without, with_it : State
        Fits without the best set of a cell, and with it in the last columns.
    pool : Pool
    f : CellFit
        Of the cell.
    c : Circumstances
    """
    cell = pool.cells[f.cell]
    parameters = _parameters(pool, f, c)
    if cell.driver == EVENT:
        event, with_it = _event(without, with_it, pool, f, len(pool.sets[f.best]))
        return event, _amplitudes(cell.site, cell.driver, parameters, _axes(parameters), with_it)
    if cell.driver == ROCKING and cell.site == BASE:
        what = [f"half-angle {_about(p, c)}" for p in parameters]
        return None, _amplitudes(cell.site, cell.driver, parameters, what, with_it)
    return None, ()


def _parameters(pool: Pool, f: CellFit, c: Circumstances) -> tuple[Parameter, ...]:
    """Parameters of the best set of a cell."""
    return sets_of(pool.cells[f.cell], f.cell, c)[f.best - int(np.flatnonzero(pool.owner == f.cell)[0])]


def _event(without: State, with_it: State, pool: Pool, f: CellFit, size: int) -> tuple[Event, State]:
    """The most probable row of a change, with its 95 % interval, and the fit with a change there."""
    p, best = without.problem, pool.columns[:, pool.sets[f.best]]
    # the same displacement from an earlier row on, where the cell has one
    earlier = [pool.columns[:, pool.sets[k]] for k in np.flatnonzero(pool.owner == f.cell)]
    same = [
        x for x in earlier if x.shape == best.shape and np.array_equal(_from(_since(p, best), x, p), best)
    ]
    event, shifted = _searched(without, with_it.weight, best, same)
    wide = replace(p, pool=np.column_stack([p.pool, shifted]))
    state = fit_state(
        wide,
        np.append(without.columns, np.arange(size) + p.pool.shape[1]),
        np.append(without.scales, with_it.scales[-size:]),
        with_it.weight,
        without.robust,
    )
    return event, state


def _from(row: int, columns: np.ndarray, p: Problem) -> np.ndarray:
    """Columns (R, k) from a row of the session on, and 0 before and in constraints."""
    of_session = np.append(p.rows[p.contact], np.full(len(p.residual) - p.count, -1))
    return np.where((of_session >= row)[:, None], columns, 0.0)


def _since(p: Problem, columns: np.ndarray) -> int:
    """First row of the session that columns (R, k) displace."""
    return int(np.min(p.rows[p.contact][np.any(columns[: p.count] != 0.0, axis=1)]))


def _searched(
    without: State, weight: np.ndarray, best: np.ndarray, same: Sequence[np.ndarray]
) -> tuple[Event, np.ndarray]:
    """The most probable row of a change near that of its columns, its interval, and the columns from there.

    Parameters
    ----------
    without : State
        Without the change.
    weight : np.ndarray, shape (R,)
        Row weights of the fit with it.
    best : np.ndarray, shape (R, k)
        Columns of the change.
    same : sequence of np.ndarray, shape (R, k)
        Of the same displacement, from other rows on.
    """
    p, size = without.problem, best.shape[1]
    longest = max(same, key=lambda x: np.count_nonzero(np.any(x != 0.0, axis=1)))
    fitted = np.unique(p.rows)
    middle, reach = int(np.searchsorted(fitted, _since(p, best))), 2 * len(fitted) // CELLS.moments + 1
    near = fitted[max(middle - reach, 1) : middle + reach + 1]
    near = near[[np.any(_from(row, longest, p)) for row in near]]
    columns = np.column_stack([_from(row, longest, p) for row in near])
    sets = tuple(np.arange(size) + size * k for k in range(len(near)))
    bare = fit_state(p, without.columns, without.scales, weight, robust=False)
    nats = log_sum(weigh_sets(bare, Bank(columns, sets, p.count, p.worth)) + SCALE_PRIOR, axis=1)
    share = np.cumsum(np.exp(nats - log_sum(nats)))
    low, high = (int(np.searchsorted(share, q)) for q in (TAIL, 1.0 - TAIL))
    most = int(np.argmax(nats > np.max(nats) - SAME))
    interval = int(near[low]), int(near[min(high, len(near) - 1)])
    return Event(int(near[most]), interval), columns[:, sets[most]]


def _changes(pool: Pool, site: Site, size: int) -> Iterator[np.ndarray]:
    """Columns (R, size) of all sudden changes of a site that cells have."""
    for columns, owner in zip(pool.sets, pool.owner, strict=True):
        cell = pool.cells[owner]
        if (cell.site, cell.driver, len(columns)) == (site.anywhere, EVENT, size):
            yield pool.columns[:, columns]


def named_events(
    h: Hypothesis, pool: Pool, parameters: Sequence[Parameter]
) -> Mapping[str, tuple[Event, ...]]:
    """Rows of the sudden changes that a hypothesis names, with 95 % intervals, by effect, in its own order.

    Only of effects all of whose displacements cells have too: of the base, or of a tool.

    Parameters
    ----------
    h : Hypothesis
    pool : Pool
        Of the cells.
    parameters : sequence of Parameter
        Of the candidates, by which the hypothesis counts its columns.
    """
    p, out = h.state.problem, dict[str, tuple[Event, ...]]()
    for m in h.members:
        if not all(driver == EVENT for _, driver in m.variant.places) or not m.variant.places:
            continue
        sites = list(m.variant.sites) or [m.variant.places[0][0]]
        of_columns = [parameters[k].site for k in m.variant.columns]
        sizes = [of_columns.count(site) // sites.count(site) for site in sites]
        parts = np.split(m.variant.columns, np.cumsum(sizes)[:-1])
        for own, site in zip(parts, sites, strict=True):
            columns = p.pool[:, own]
            since, moved = _since(p, columns), np.any(columns[: p.count] != 0.0, axis=1)
            same = [
                x
                for x in _changes(pool, site, len(own))
                if np.array_equal(np.any(_from(since, x, p)[: p.count] != 0.0, axis=1), moved)
            ]
            if not same:
                out.pop(m.effect, None)
                break
            rest = ~np.isin(h.state.columns, own)
            without = fit_state(p, h.state.columns[rest], h.state.scales[rest], h.state.weight, robust=False)
            event, _ = _searched(without, h.state.weight, columns, same)
            out[m.effect] = (*out.get(m.effect, ()), event)
    return out


def _amplitudes(
    site: Site, driver: Driver, parameters: Sequence[Parameter], what: Sequence[str], state: State
) -> tuple[Amplitude, ...]:
    """The amplitudes of the last columns of a state, in SI."""
    size = len(parameters)
    sd = np.array([p.sd for p in parameters])
    scale = sd * state.scales[-size:]
    values = state.amplitudes[-size:] * sd
    u = scale * np.sqrt(np.diag(state.covariance)[-size:])
    clear = chi2_sf((values / u) ** 2, 1.0) * size < OUTCOME.significant
    return tuple(
        Amplitude(UNKNOWN, site, driver, (), name, float(v), float(s), p.unit, None, bool(yes))
        for p, name, v, s, yes in zip(parameters, what, values, u, clear, strict=True)
    )


def _axes(parameters: Sequence[Parameter]) -> list[str]:
    """What each parameter of a sudden change moves, as text: ``shift x``, or ``shift`` alone."""
    out = []
    for p in parameters:
        kind, axis = "rotation" if p.unit == "rad" else "shift", p.terms[0].axis  # "tx", "rz", "normal"
        out.append(f"{kind} {axis[-1]}" if len(parameters) > 1 else kind)
    return out


def _about(p: Parameter, c: Circumstances) -> str:
    """The horizontal axis of a rotation of the base, as text: its azimuth in F0."""
    at = int(np.argmax(np.abs(p.terms[0].driver)))
    parts = np.zeros(3)
    for term in p.terms:
        parts["xyz".index(term.axis[1])] = np.asarray(term.driver)[at]
    x, y, _ = c.chain.base[:3, :3] @ parts
    azimuth = round(float(np.degrees(np.arctan2(y, x)))) % 180
    return f"about the horizontal axis at {azimuth} deg from x"


@dataclass(frozen=True)
class Scale:
    """What the size of a location is relative to.

    `excess` is the excess variance of a contact under the baseline, m2. Its size is what the first `size`
    parameters do not absorb, those of the model; the errors of masses are not counted.
    """

    circumstances: Circumstances
    excess: float
    size: int

    def share(self, size: float) -> float:
        """Share of the excess variance of an RMS, m."""
        return float(np.clip(size**2 / self.excess, 0.0, 1.0)) if self.excess > 0 else 0.0


@dataclass(frozen=True)
class Contribution:
    """What is located: columns (R, k) of parameters (none of a random error) and their amplitudes (k,)."""

    site: Site
    driver: Driver
    parameters: Sequence[Parameter]
    columns: np.ndarray
    amplitude: np.ndarray
    gain: float  # nats
    name: str = ""  # of a named effect

    @property
    def motion(self) -> np.ndarray:
        """Change (R,) of the whitened residuals; that of a random error is not known."""
        return self.columns @ self.amplitude if self.parameters else np.zeros(len(self.columns))


def places(hypothesis: Hypothesis, pool: Pool, named: Sequence[Parameter], scale: Scale) -> tuple[Place, ...]:
    """Locations of named effects, then significant further ones, then the largest of the others.

    Parameters
    ----------
    hypothesis : Hypothesis
        The named effects, fitted.
    pool : Pool
        Generic cells.
    named : sequence of Parameter
        The pool of named candidates.
    scale : Scale
    """
    out = list(places_named(hypothesis, named, scale))
    state = hypothesis.state
    seen = {(p.site, p.driver) for p in out}
    most = max(OUTCOME.places, len(out) + OUTCOME.places_left)  # further locations are always listed
    while len(out) < most:
        ranked = sorted(gains(state, pool), key=lambda f: -f.gain)
        ranked = [f for f in ranked if (pool.cells[f.cell].site, pool.cells[f.cell].driver) not in seen]
        if not ranked:
            break
        place, wider = _of_cell(state, pool, ranked[0], scale)
        out.append(place)
        seen.add((place.site, place.driver))
        if place.family_p_value > OUTCOME.significant:
            out += [_of_cell(state, pool, f, scale)[0] for f in ranked[1 : 1 + most - len(out)]]
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


def _place(of: Contribution, without: State, with_it: State, tests: int, scale: Scale) -> Place:
    """The location of a contribution, by the fits without and with it; one of so many `tests`."""
    p = without.problem
    bare = fit_state(without_nuisance(p, scale.size), (), (), without.weight, robust=False)
    left = visible(bare, of.motion)
    kept = without.weight[: p.lengths] > 0
    size = rms(left[kept]) if np.any(kept) else 0.0
    p_value = f_test(without, of.columns)
    curve = _curve(of, with_it, scale.circumstances)
    family = min(1.0, p_value * tests)
    return Place(of.site, of.driver, size, scale.share(size), p_value, family, of.gain, of.name, curve)


def _of_cell(state: State, pool: Pool, f: CellFit, scale: Scale) -> tuple[Place, State]:
    """The location of a generic cell, and the state with it."""
    cell = pool.cells[f.cell]
    if cell.clusters is not None:
        return _of_random_cell(state, pool, f, scale), state
    start = state.weight if not state.gross else None
    wider = with_set(state, pool, f.best, f.scale, start)
    if wider.gross < state.gross:  # contacts that it explains are no outliers
        state = fit_state(state.problem, state.columns, state.scales, wider.weight, robust=False)
    amplitude = wider.amplitudes[len(state.columns) :]
    parameters = _parameters(pool, f, scale.circumstances)
    columns = pool.columns[:, pool.sets[f.best]]
    of = Contribution(cell.site, cell.driver, parameters, columns, amplitude, f.gain)
    place = _place(of, state, wider, len(pool.sets), scale)
    if place.family_p_value > OUTCOME.significant:
        return place, wider
    event, amplitudes = sizes(state, wider, pool, f, scale.circumstances)
    return replace(place, event=event, amplitudes=amplitudes), wider


def _of_random_cell(state: State, pool: Pool, f: CellFit, scale: Scale) -> Place:
    """The location of a random error: its standard deviation at the contacts, and no smooth curve.

    Its p-value is the inverse of its Bayes factor: without the error, a factor of k or more occurs with a
    probability of at most 1/k (Markov's inequality).
    """
    cell, p = pool.cells[f.cell], state.problem
    column = pool.columns[:, pool.sets[f.best]]
    kept = state.weight[: p.lengths] > 0
    sd = column[: p.lengths, 0] * p.sigma * f.scale
    size = rms(sd[kept]) if np.any(kept) else 0.0
    p_value = float(np.exp(-max(f.gain, 0.0)))
    of = Contribution(cell.site, cell.driver, (), column, np.zeros(0), f.gain)
    curve, family = _curve(of, state, scale.circumstances), min(1.0, p_value * len(pool.sets))
    return Place(cell.site, cell.driver, size, scale.share(size), p_value, family, f.gain, "", curve)


def places_named(hypothesis: Hypothesis, named: Sequence[Parameter], scale: Scale) -> tuple[Place, ...]:
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
            others = ~np.isin(state.columns, own)
            without = fit_state(p, state.columns[others], state.scales[others], state.weight, robust=False)
            parameters, columns = [named[k] for k in own], p.pool[:, own]
            amplitude = np.array([amplitudes[k] for k in own])
            gain = state.log_evidence - without.log_evidence
            of = Contribution(site, driver, parameters, columns, amplitude, gain, member.effect)
            mine.append(_place(of, without, state, len(groups), scale))
        out += sorted(mine, key=lambda place: (place.site != ARM, -place.rms))[: OUTCOME.places_named]
    return tuple(out)


def _curve(of: Contribution, state: State, c: Circumstances) -> Curve:
    """Residuals and the contribution, at the fitted contacts, along the coordinate of the driver."""
    p = state.problem
    along = of.driver.coordinate(of.site, c)
    rows = p.rows[p.contact[: p.lengths]]
    fitted = of.motion[: p.lengths] * p.sigma
    residual = state.residual[: p.lengths] * p.sigma + fitted
    on = next((f.rows for f in c.faces if face(f.name) == of.site), np.ones(len(c.q)))
    keep = (state.weight[: p.lengths] > 0) & (on[rows] > 0)  # of a face, the contacts on it
    lever, unit = None, ""
    frames = {(t.frame, t.axis) for q in of.parameters for t in q.terms}
    one = len(frames) == 1 or all(axis == "rz" for _, axis in frames)
    if frames and one and all(frame >= 0 for frame, _ in frames):
        drivers = np.array([np.broadcast_to(q.terms[0].driver, len(c.q))[rows] for q in of.parameters]).T
        best = np.argmax(np.abs(drivers), axis=1)
        index = np.arange(len(rows))
        size, sd = drivers[index, best], np.array([q.sd for q in of.parameters])
        scaled = of.columns[: p.lengths][index, best] * p.sigma / sd[best]
        lever = np.where(size != 0, scaled / np.where(size != 0, size, 1.0), 0.0)[keep]
        unit = "rad" if next(iter(frames))[1][0] == "r" else "m"
    return Curve(along.label, along.values[rows][keep], residual[keep], fitted[keep], rows[keep], lever, unit)
