"""Unmodelled errors of a simple form: row and size of a sudden change, size of a rocking of the base.

A generic cell tries a change at few rows. Its row is therefore searched again among the rows between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.distributions import chi2_sf
from bayescal.effects import Circumstances, Parameter
from bayescal.effects.location import BASE, Driver, Site
from bayescal.gap.linear.evidence import SCALE_PRIOR, Bank, log_sum, weigh_sets
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.result import Amplitude, Event
from bayescal.gap.search.cells import sets_of
from bayescal.gap.search.unknown import CellFit, Pool
from bayescal.gap.settings import CELLS, OUTCOME

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
    own = pool.sets[f.best]
    parameters = sets_of(cell, f.cell, c)[f.best - int(np.flatnonzero(pool.owner == f.cell)[0])]
    if cell.driver == EVENT:
        event, with_it = _event(without, with_it, pool, f, len(own))
        return event, _amplitudes(cell.site, cell.driver, parameters, _axes(parameters), with_it)
    if cell.driver == ROCKING and cell.site == BASE:
        what = [f"half-angle {_about(p, c)}" for p in parameters]
        return None, _amplitudes(cell.site, cell.driver, parameters, what, with_it)
    return None, ()


def _event(without: State, with_it: State, pool: Pool, f: CellFit, size: int) -> tuple[Event, State]:
    """The most probable row of a change, with its 95 % interval, and the fit with a change there."""
    p = without.problem
    row = np.append(p.rows[p.contact], np.full(len(p.residual) - p.count, -1))  # of the session
    best = pool.columns[:, pool.sets[f.best]]
    since = int(np.min(row[np.any(best != 0.0, axis=1)]))

    def starting(at: int, columns: np.ndarray) -> np.ndarray:
        return np.where((row >= at)[:, None], columns, 0.0)

    # the same displacement from an earlier row on, where the cell has one
    earlier = [pool.columns[:, pool.sets[k]] for k in np.flatnonzero(pool.owner == f.cell)]
    same = [x for x in earlier if x.shape == best.shape and np.array_equal(starting(since, x), best)]
    longest = max(same, key=lambda x: np.count_nonzero(np.any(x != 0.0, axis=1)))
    fitted = np.unique(p.rows)
    middle, reach = int(np.searchsorted(fitted, since)), 2 * len(fitted) // CELLS.moments + 1
    near = fitted[max(middle - reach, 1) : middle + reach + 1]
    near = near[[np.any(starting(at, longest)) for at in near]]
    columns = np.column_stack([starting(at, longest) for at in near])
    sets = tuple(np.arange(size) + size * k for k in range(len(near)))
    bare = fit_state(p, without.columns, without.scales, with_it.weight, robust=False)
    nats = log_sum(weigh_sets(bare, Bank(columns, sets, p.count, p.worth)) + SCALE_PRIOR, axis=1)
    share = np.cumsum(np.exp(nats - log_sum(nats)))
    low, high = (int(np.searchsorted(share, q)) for q in (TAIL, 1.0 - TAIL))
    most = int(np.argmax(nats > np.max(nats) - SAME))
    wide = replace(p, pool=np.column_stack([p.pool, columns[:, sets[most]]]))
    state = fit_state(
        wide,
        np.append(without.columns, np.arange(size) + p.pool.shape[1]),
        np.append(without.scales, with_it.scales[-size:]),
        with_it.weight,
        without.robust,
    )
    first, last = near[low], near[min(high, len(near) - 1)]
    return Event(int(near[most]), (int(first), int(last))), state


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
