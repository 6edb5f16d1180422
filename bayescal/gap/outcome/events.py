"""Sizes of unmodelled errors of a simple form: row and size of a sudden change, size of a rocking base.

A generic cell tries a change at few rows, between which its row is therefore searched again.

Validation errors of a model with sudden changes, whose rows are uncertain.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayescal.effects import EFFECTS, Circumstances, Parameter, parameters_of
from bayescal.effects.location import BASE, Driver, Site
from bayescal.effects.selection import Selection
from bayescal.estimate import Estimate
from bayescal.gap.linear.evidence import SCALE_PRIOR, Bank, log_sum, weigh_sets
from bayescal.gap.linear.problem import Problem
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.result import Amplitude, Event
from bayescal.gap.search.beam import Hypothesis
from bayescal.gap.search.candidates import Variant
from bayescal.gap.search.cells import sets_of
from bayescal.gap.search.unknown import CellFit, Pool, with_columns, with_set
from bayescal.gap.settings import CELLS, OUTCOME
from bayescal.model import with_parameters
from bayescal.predict.crossvalidation import LEFT_OUT, VALIDATED, validation_errors
from bayescal.predict.errors import ValidationErrors, with_rows_of, without_rows
from bayescal.statistics import chi2_sf

EVENT, ROCKING = Driver("event"), Driver("base moment", form="sign")
UNKNOWN = "unknown"
TAIL = 0.025
"""Probability on either side of a 95 % interval (convention)."""
EQUAL = 1e-6
"""Of the largest displacement: up to it two changes displace alike (rounding)."""
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
    parameters = cell_parameters(pool, f, c)
    if cell.driver == EVENT:
        event, with_it = _event(without, with_it, pool, f, c.may_change)
        return event, _amplitudes(cell.site, cell.driver, parameters, _axes(parameters), with_it)
    if cell.driver == ROCKING and cell.site == BASE:
        what = [f"half-angle {_about(p, c)}" for p in parameters]
        return None, _amplitudes(cell.site, cell.driver, parameters, what, with_it)
    return None, ()


def cell_parameters(pool: Pool, f: CellFit, c: Circumstances) -> tuple[Parameter, ...]:
    """Parameters of the best set of a cell."""
    return sets_of(pool.cells[f.cell], f.cell, c)[f.best - int(np.flatnonzero(pool.owner == f.cell)[0])]


def _event(
    without: State, with_it: State, pool: Pool, f: CellFit, possible: np.ndarray
) -> tuple[Event, State]:
    """The most probable row of a change, of `possible` ones, with its 95 % interval, and the fit with it."""
    p, best = without.problem, pool.columns[:, pool.sets[f.best]]
    # the same displacement from an earlier row on, where the cell has one
    earlier = [pool.columns[:, pool.sets[k]] for k in np.flatnonzero(pool.owner == f.cell)]
    same = [
        x for x in earlier if x.shape == best.shape and np.array_equal(_from(_since(p, best), x, p), best)
    ]
    event, shifted = _searched(without, with_it.weight, best, same, possible)
    return event, with_columns(without, shifted, f.scale, with_it.weight)


def _from(row: int, columns: np.ndarray, p: Problem) -> np.ndarray:
    """Columns (R, k) from a row of the session on, and 0 before and in constraints."""
    of_session = np.append(p.rows[p.contact], np.full(len(p.residual) - p.count, -1))
    return np.where((of_session >= row)[:, None], columns, 0.0)


def _since(p: Problem, columns: np.ndarray) -> int:
    """First row of the session that columns (R, k) displace."""
    return int(np.min(p.rows[p.contact][np.any(columns[: p.count] != 0.0, axis=1)]))


def _searched(
    without: State, weight: np.ndarray, best: np.ndarray, same: Sequence[np.ndarray], possible: np.ndarray
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
    possible : np.ndarray of bool, shape (N,)
        Rows of the session before which there may be a change.
    """
    p, size = without.problem, best.shape[1]
    longest = max(same, key=lambda x: np.count_nonzero(np.any(x != 0.0, axis=1)))
    fitted = np.unique(p.rows)
    middle, reach = int(np.searchsorted(fitted, _since(p, best))), 2 * len(fitted) // CELLS.moments + 1
    near = fitted[max(middle - reach, 1) : middle + reach + 1]
    near = near[possible[near]]
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


def _changes(pool: Pool, of: np.ndarray, p: Problem) -> Iterator[np.ndarray]:
    """Columns (R, k) like those of a sudden change, from the rows on from which cells have one.

    A cell's displacements are combined to those of the change: turns of the base to those of an instrument.
    """
    since, count = _since(p, of), p.count
    for columns, owner in zip(pool.sets, pool.owner, strict=True):
        if pool.cells[owner].driver == EVENT and len(columns) == of.shape[1]:
            cell = pool.columns[:, columns]
            here = _from(since, cell, p)[:count]
            combined = np.linalg.lstsq(here, of[:count], rcond=None)[0]
            if np.allclose(here @ combined, of[:count], rtol=0.0, atol=EQUAL * np.max(np.abs(of))):
                yield cell @ combined


def named_events(
    h: Hypothesis,
    pool: Pool,
    parameters: Sequence[Parameter],
    c: Circumstances,
    unmodelled: CellFit | None = None,
) -> Mapping[str, tuple[Event, ...]]:
    """Rows of the sudden changes that a hypothesis names, with 95 % intervals, by effect, in its own order.

    Only of effects all of whose displacements cells have too: of the base, of a tool, of the only
    instrument. Changes of one site are as far `apart` as the effect's settings are.

    Parameters
    ----------
    h : Hypothesis
    pool : Pool
        Of the cells.
    parameters : sequence of Parameter
        Of the candidates, by which the hypothesis counts its columns.
    c : Circumstances
    unmodelled : CellFit or None
        Of the unmodelled effect beside the names, which is then in the model too.
    """
    p, out = h.state.problem, dict[str, tuple[Event, ...]]()
    for m in h.members:
        if not all(driver == EVENT for _, driver in m.variant.places) or not m.variant.places:
            continue
        sites = list(m.variant.sites) or [m.variant.places[0][0]]
        of_columns = [parameters[k].site for k in m.variant.columns]
        sizes = [of_columns.count(site) // sites.count(site) for site in sites]
        parts = np.split(m.variant.columns, np.cumsum(sizes)[:-1])
        for part in parts:
            columns = p.pool[:, part]
            same = list(_changes(pool, columns, p))
            if not same:
                out.pop(m.effect, None)
                break
            before = out.get(m.effect, ())
            possible = _apart(m.variant, before, c)
            without = h.state.without(part)
            if unmodelled:
                without = with_set(without, pool, unmodelled.best, unmodelled.scale, h.state.weight)
            event, _ = _searched(without, h.state.weight, columns, same, possible)
            out[m.effect] = (*before, _with_fitted(event, m.variant, len(before)))
    return out


def _with_fitted(event: Event, v: Variant, number: int) -> Event:
    """The event, whose interval holds the row of the variant too: what is stated of errors is of its fit."""
    each = v.setting if isinstance(v.setting, tuple) else ((None, v.setting),)
    _, first = each[number] if number < len(each) else (None, None)
    if not isinstance(first, float):
        return event
    low, high = event.interval95
    return replace(event, interval95=(min(low, int(first) - 1), max(high, int(first) - 1)))


def uncertain(events: Mapping[str, Sequence[Event]], fitted: np.ndarray) -> tuple[int, ...]:
    """Rows of the session that may be before a sudden change or after it; `fitted` are the fitted ones."""
    return tuple(row for of in events.values() for e in of for row in _between(e, fitted))


def _between(event: Event, fitted: np.ndarray) -> range:
    """Rows that may be before a change or after it: from the last fitted row before its interval on."""
    low, high = event.interval95
    return range(int(np.max(fitted[fitted < low], initial=-1)) + 1, high)


def errors_with(
    fitted: Estimate, events: Mapping[str, Sequence[Event]], without: str = LEFT_OUT, strict: bool = True
) -> ValidationErrors:
    """Validation errors of a model with sudden changes.

    Validation rows within the interval of a change count with the row of the change, between the same fitted
    rows, that makes them most probable. Where rows that were fitted are left out in turn, rows within an
    interval do not count: the fit has used them to find the change.

    Parameters
    ----------
    fitted : Estimate
    events : mapping of str to sequence of Event
        By effect; those are of a change in the model whose interval holds its row.
    without, strict
        As for `validation_errors`.
    """

    def errors(of: Estimate) -> ValidationErrors:
        return validation_errors(of, strict=strict, without=without)

    held, rows = errors(fitted), fitted.model.scene.rows("calibrate")
    if held.how != VALIDATED:
        return without_rows(held, uncertain(events, rows))
    for name in fitted.model.effects:
        selection = Selection.read(name)
        of = events.get(selection.effect, ())
        begins = selection.setting.split("/") if of and selection.setting else []
        for (k, begin), event in itertools.product(enumerate(begins), of):
            low, high = event.interval95
            if not low < float(begin) <= high + 1:  # settings count rows from 1
                continue
            between = _between(event, rows)
            use = np.isin(held.joint.rows, between)
            if not use.any():
                continue
            ends = (_changing(fitted, name, k, row) for row in (between[0], between.stop))
            changed, unchanged = map(errors, ends)
            cost = np.cumsum(np.append(0.0, (unchanged.joint.chi2 - changed.joint.chi2)[use]))
            first = [*held.joint.rows[use], between.stop][int(np.argmin(cost))]
            held = with_rows_of(held, unchanged, range(between[0], first))
            held = with_rows_of(held, changed, range(first, between.stop))
    return held


def _changing(fitted: Estimate, name: str, number: int, row: int) -> Estimate:
    """The estimate with a change of one of its effects from another row on, its parameters as fitted."""
    model, selection = fitted.model, Selection.read(name)
    setting = (selection.setting or "").split("/")
    setting[number] = str(row + 1)
    other = str(replace(selection, setting="/".join(setting)))
    effects = tuple(other if effect == name else effect for effect in model.effects)
    c = model.scene.circumstances(model.scene.rows("calibrate"))
    displaced = iter([p.terms for p in parameters_of((other,), c) if p.effect == selection.effect])
    parameters = tuple(
        replace(p, terms=next(displaced)) if p.effect == selection.effect else p for p in model.parameters
    )
    return replace(fitted, model=with_parameters(model.scene, effects, parameters))


def _apart(v: Variant, before: Sequence[Event], c: Circumstances) -> np.ndarray:
    """Rows (N,) of the session before which the next change of a variant may be: bool.

    The rows of those `before` it have been searched; of those after it the settings are known.
    """
    scan, possible = EFFECTS[v.effect].scan, c.may_change
    if scan is None or not isinstance(v.setting, tuple):
        return possible
    (site, _), *after = v.setting[len(before) :]
    others = [(of, event.row + 1.0) for event, (of, _) in zip(before, v.setting, strict=False)] + after
    near = [k for k in np.flatnonzero(possible) if not all(scan.apart(c, (site, k + 1.0), o) for o in others)]
    possible = possible.copy()
    possible[near] = False
    return possible


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
    kinds = ["rotation" if p.unit == "rad" else "shift" for p in parameters]
    if len(parameters) == 1:
        return kinds
    return [f"{kind} {p.terms[0].axis[-1]}" for kind, p in zip(kinds, parameters, strict=True)]  # "tx", "rz"


def _about(p: Parameter, c: Circumstances) -> str:
    """The horizontal axis of a rotation of the base, as text: its azimuth in F0."""
    row = int(np.argmax(np.abs(p.terms[0].driver)))
    parts = np.zeros(3)
    for term in p.terms:
        parts["xyz".index(term.axis[1])] = np.asarray(term.driver)[row]
    x, y, _ = c.chain.base[:3, :3] @ parts
    azimuth = round(float(np.degrees(np.arctan2(y, x)))) % 180
    return f"about the horizontal axis at {azimuth} deg from x"
