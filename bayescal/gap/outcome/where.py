"""Locations of the gap: sites and drivers, with their size and probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.effects import CERTIFICATE, Circumstances, Parameter
from bayescal.effects.location import ARM, TOOL, Driver, Site, face
from bayescal.estimate import STATED_WORTH
from bayescal.gap.linear.evidence import project
from bayescal.gap.linear.problem import Slopes, without_nuisance
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.outcome.events import EVENT, cell_parameters, sizes
from bayescal.gap.result import MOVES, Curve, Place
from bayescal.gap.search.beam import Hypothesis, Member
from bayescal.gap.search.cells import hanging
from bayescal.gap.search.makers import movers
from bayescal.gap.search.unknown import CellFit, Pool, gains, with_columns, with_set
from bayescal.gap.settings import OUTCOME, SEARCH
from bayescal.statistics import f_sf, grouped, rms

SUDDEN = 0.8
"""Share of the nats of a location from which on a shift of its site is stated too (assumed): a shift explains
0.75 of a straight drift."""


@dataclass(frozen=True)
class Scale:
    """What the size of a location is relative to, and the slopes by which other sites would move.

    `excess` is the excess variance of a contact under the baseline, m2. Its size is what the first `size`
    parameters do not absorb, those of the model; the errors of masses are not counted.
    """

    circumstances: Circumstances
    excess: float
    size: int
    slopes: Slopes

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
        place, wider = _of_cell(state, pool, ranked[0], scale, _sudden(ranked, pool))
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
    return state.problem.metres(unabsorbed(state, contribution))


def unabsorbed(state: State, contribution: np.ndarray) -> np.ndarray:
    """Part of a whitened contribution (R,) not absorbed by the state, of lengths and orientations (C,)."""
    absorbed = state.design @ project(state, contribution[:, None]).solved[:, 0]
    return (contribution - absorbed)[: state.problem.count]


GRAVITY = frozenset({"torque", "bending moment"})
"""Kinds of drivers by which a tool on its mount also yields."""
MOVED_BY = {TOOL.kind: MOVES | GRAVITY | {"direction"}}
"""Kinds of drivers by which a site may move, by its kind; of others those of `MOVES`."""
FUNCTIONS = 3
"""Functions of the rows up to which an error is compared with those of other sites (cost)."""


def neighbours(
    of: Contribution, without: State, with_it: State, c: Circumstances, slopes: Slopes
) -> tuple[Site, ...]:
    """Sites at which a free error by the same functions of the rows would look the same.

    It leaves less of what is located than the noise hides, and than a share.

    Parameters
    ----------
    of : Contribution
    without, with_it : State
        The fits without and with it.
    c : Circumstances
    slopes : Slopes
        Of the problem of both.
    """
    functions, kind = _functions(of, c), of.driver.kind
    bare = replace(without, robust=False)
    least = min(SEARCH.detectable, (1.0 - SUDDEN) * _remainder(bare, of, with_it))
    if not 0 < functions.shape[1] <= FUNCTIONS:
        return ()

    def alike(parameters: Sequence[Parameter]) -> bool:
        wide = with_columns(bare, slopes.columns(parameters), OUTCOME.free, with_it.weight)
        return _remainder(wide, of, with_it) < least

    out = []
    for site, ways in movers(c).items():
        if site != of.site and kind in MOVED_BY.get(site.kind, MOVES):
            sets = [[q for f in functions.T for q in move(f)] for move in ways]
            if site == TOOL and kind in GRAVITY:
                sets += [list(some) for cell in hanging(c) for some in cell.sets]
            out += [site] if any(map(alike, sets)) else []
    return tuple(out)


def _functions(of: Contribution, c: Circumstances) -> np.ndarray:
    """Functions (N, k) of the rows by which a contribution displaces axes of frames, none a sum of others.

    An error of a certificate displaces none.
    """
    moved: dict[tuple[int, str], np.ndarray] = {}
    for q, amplitude in zip(of.parameters, of.amplitude, strict=False):  # of a random error there are none
        for t in (t for t in q.terms if t.frame != CERTIFICATE):
            by = amplitude * q.sd * np.broadcast_to(t.driver, len(c.q))
            moved[t.frame, t.axis] = moved.get((t.frame, t.axis), 0.0) + by
    each = [f / size for f in moved.values() if (size := float(np.max(np.abs(f)))) > 0]
    if not each:
        return np.zeros((len(c.q), 0))
    vectors, sizes, _ = np.linalg.svd(np.column_stack(each), full_matrices=False)
    some = vectors[:, sizes > 1e-6 * sizes[0]]
    return np.asarray(some / np.max(np.abs(some), axis=0))


def _remainder(state: State, of: Contribution, final: State) -> float:
    """Detectability lambda of what a state leaves of a contribution, by the weights of a final state."""
    weight = final.weight[: state.problem.count]
    return float(np.sum(weight * unabsorbed(state, of.motion) ** 2)) / final.kappa**2


def beside(
    member: Member, h: Hypothesis, named: Sequence[Parameter], c: Circumstances, slopes: Slopes
) -> tuple[Site, ...]:
    """The `neighbours` of a named effect, if it is of one site; `named` is the pool of candidates."""
    places, index = dict.fromkeys(member.variant.places), member.variant.columns
    if len({(site, driver.kind) for site, driver in places}) != 1:
        return ()
    site, driver = next(iter(places))
    parameters, columns = [named[k] for k in index], h.state.problem.pool[:, index]
    of = Contribution(site, driver, parameters, columns, h.state.amplitudes_of(index), 0.0)
    return neighbours(of, h.state.without(index), h.state, c, slopes)


def _place(of: Contribution, without: State, with_it: State, tests: int, scale: Scale) -> Place:
    """The location of a contribution, by the fits without and with it; one of so many `tests`."""
    p = without.problem
    bare = fit_state(without_nuisance(p, scale.size), (), (), without.weight, robust=False)
    residual = visible(bare, of.motion)
    kept = without.weight[: p.lengths] > 0
    size = rms(residual[kept], of_none=0.0)
    p_value = f_test(without, of.columns)
    curve = _curve(of, with_it, scale.circumstances)
    family = min(1.0, p_value * tests)
    place = Place(of.site, of.driver, size, scale.share(size), p_value, family, of.gain, of.name, curve)
    if family > OUTCOME.significant:
        return place
    return replace(place, neighbours=neighbours(of, without, with_it, scale.circumstances, scale.slopes))


def _sudden(ranked: Sequence[CellFit], pool: Pool) -> CellFit | None:
    """A sudden change of the site of the first of some cells that explains nearly as much as it."""
    first, site = ranked[0], pool.cells[ranked[0].cell].site
    alike = (f for f in ranked[1:] if pool.cells[f.cell].driver == EVENT and pool.cells[f.cell].site == site)
    return next((f for f in alike if f.gain >= SUDDEN * first.gain), None)


def _of_cell(
    state: State, pool: Pool, f: CellFit, scale: Scale, sudden: CellFit | None = None
) -> tuple[Place, State]:
    """The location of a generic cell, and the state with it; a `sudden` change explains most of it."""
    cell = pool.cells[f.cell]
    if cell.clusters is not None:
        return _of_random_cell(state, pool, f, scale), state
    start = state.weight if not state.gross else None
    wider = with_set(state, pool, f.best, f.scale, start)
    if wider.gross < state.gross:  # contacts that it explains are no outliers
        state = fit_state(state.problem, state.columns, state.scales, wider.weight, robust=False)
    amplitude = wider.amplitudes[len(state.columns) :]
    parameters = cell_parameters(pool, f, scale.circumstances)
    columns = pool.columns[:, pool.sets[f.best]]
    of = Contribution(cell.site, cell.driver, parameters, columns, amplitude, f.gain)
    place = _place(of, state, wider, len(pool.sets), scale)
    if place.family_p_value > OUTCOME.significant:
        return place, wider
    event, amplitudes = sizes(state, wider, pool, f, scale.circumstances)
    if sudden and not amplitudes:
        shifted = with_set(state, pool, sudden.best, sudden.scale, start)
        event, amplitudes = sizes(state, shifted, pool, sudden, scale.circumstances)
    return replace(place, event=event, amplitudes=amplitudes), wider


def _of_random_cell(state: State, pool: Pool, f: CellFit, scale: Scale) -> Place:
    """The location of a random error: its standard deviation at the contacts, and no smooth curve.

    Its p-value is the inverse of its Bayes factor: without the error, a factor of k or more occurs with a
    probability of at most 1/k (Markov's inequality).
    """
    cell, p = pool.cells[f.cell], state.problem
    column = pool.columns[:, pool.sets[f.best]]
    kept = state.weight[: p.lengths] > 0
    sd = p.metres(column[:, 0]) * f.scale
    size = rms(sd[kept], of_none=0.0)
    p_value = float(np.exp(-max(f.gain, 0.0)))
    of = Contribution(cell.site, cell.driver, (), column, np.zeros(0), f.gain)
    curve, family = _curve(of, state, scale.circumstances), min(1.0, p_value * len(pool.sets))
    return Place(cell.site, cell.driver, size, scale.share(size), p_value, family, f.gain, "", curve)


def places_named(hypothesis: Hypothesis, named: Sequence[Parameter], scale: Scale) -> tuple[Place, ...]:
    """The largest locations of every effect of a hypothesis; see `places`."""
    state, p = hypothesis.state, hypothesis.state.problem
    out: list[Place] = []
    for member in hypothesis.members:
        columns_of = member.variant.columns.tolist()
        groups = grouped(((named[k].site, named[k].driver), k) for k in columns_of)
        drivers = {driver for _, driver in groups}
        if len(groups) > 1 and len(drivers) == 1:  # a common cause at all joints is listed before its parts
            groups = {(ARM, drivers.pop()): columns_of} | {g: k for g, k in groups.items() if g[0] != ARM}
        mine = []
        for (site, driver), index in groups.items():
            without, parameters = state.without(np.array(index)), [named[k] for k in index]
            columns, amplitude = p.pool[:, index], state.amplitudes_of(np.array(index))
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
    fitted = p.metres(of.motion)
    residual = p.metres(state.residual) + fitted
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
        scaled = p.metres(of.columns)[index, best] / sd[best]
        lever = np.where(size != 0, scaled / np.where(size != 0, size, 1.0), 0.0)[keep]
        unit = "rad" if next(iter(frames))[1][0] == "r" else "m"
    return Curve(along.label, along.values[rows][keep], residual[keep], fitted[keep], rows[keep], lever, unit)
