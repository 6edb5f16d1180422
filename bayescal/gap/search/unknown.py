"""Unmodelled effects: evidence of generic cells in addition to a hypothesis, each with its own outliers.

A cause that is not in the list of known effects may act at the site of a name and along its coordinate, and
so explain much of the data under that name: friction that grows with the load looks like backlash. There are
two kinds of such relatives. A *modulated* relative is the prediction of the name and, in addition, this
prediction times smooth functions of another quantity: the data show that the name is not all. A *replaced*
relative is the prediction times a positive function, without the name: in proportion to a load, at one end of
a range, in one direction. The name is only as sure as the data exclude these.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.effects import Parameter
from bayescal.effects.location import Driver
from bayescal.gap.linear.evidence import (
    SCALE_PRIOR,
    SCALES,
    Bank,
    log_sum,
    weigh_clusters,
    weigh_sets,
    weighed_sets,
)
from bayescal.gap.linear.problem import Driven, Problem, Slopes
from bayescal.gap.linear.state import State, fit_state, limited
from bayescal.gap.search.beam import Hypothesis, Member, unseen_share
from bayescal.gap.search.makers import Argument, Cell
from bayescal.gap.settings import RELATIVES, UNKNOWN

MOST_ROWS = 3000
"""Rows up to which the sets of cells are kept: their drivers take as much memory as the columns."""


@dataclass(frozen=True, kw_only=True)
class Pool(Bank):
    """Cells and their columns (R, K): `sets` are indices of columns, `owner` is the cell of each set."""

    cells: tuple[Cell, ...]
    owner: np.ndarray

    @cached_property
    def by_number(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """By the number m of their sets: cells (B,), and the sets (B, m) of each."""
        number = np.bincount(self.owner, minlength=len(self.cells))
        first = np.cumsum(number) - number
        of = ((np.flatnonzero(number == m), m) for m in np.unique(number))
        return [(cells, first[cells][:, None] + np.arange(m)) for cells, m in of]

    @cached_property
    def clustered(self) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Of each cell that is drawn anew in clusters of rows: its set, column (R,), and clusters (N,)."""
        first = np.searchsorted(self.owner, np.arange(len(self.cells))).tolist()
        return [
            (k, self.columns[:, self.sets[k]][:, 0], cell.clusters)
            for k, cell in zip(first, self.cells, strict=True)
            if cell.clusters is not None
        ]

    @cached_property
    def log_prior(self) -> np.ndarray:
        """Log prior of every cell as an unmodelled effect, (cells,): -inf for a form of a known effect."""
        kinds = np.array([cell.site.kind for cell in self.cells])
        of_known_effect = np.array([cell.of_known_effect for cell in self.cells])
        weight = np.array([cell.weight for cell in self.cells])
        for kind in np.unique(kinds):
            of_kind = kinds == kind
            weight[of_kind] *= UNKNOWN.sites.get(str(kind), UNKNOWN.faces) / np.sum(weight[of_kind])
        weight[of_known_effect] = 0.0
        with np.errstate(divide="ignore"):
            return np.log(weight / np.sum(weight))


def filled(make: Callable[[], Iterable[Cell]], slopes: Slopes, poses: np.ndarray, p: Problem) -> Pool:
    """Pool of cells, whose columns are those of `Driven`.

    Of a large session none has its sets any more when the next one is made.

    Parameters
    ----------
    make : callable
        Makes the cells, one after another.
    slopes, poses
        See `Driven`.
    p : Problem
        The problem, of R rows.
    """
    cells, sizes = list[Cell](), list[list[int]]()

    def parameters() -> Iterator[Parameter]:
        for cell in make():
            yield from itertools.chain.from_iterable(cell.sets)
            sizes.append(list(map(len, cell.sets)))
            cells.append(cell if len(p.residual) <= MOST_ROWS else replace(cell, sets=()))

    columns = Driven(slopes, poses, parameters())
    ends = np.cumsum(list(itertools.chain.from_iterable(sizes)), dtype=int)[:-1]
    sets = tuple(np.split(np.arange(columns.shape[1]), ends))
    owner = np.repeat(np.arange(len(cells)), list(map(len, sizes)))
    return Pool(columns, sets, p.count, p.worth, p.jacobian, cells=tuple(cells), owner=owner)


@dataclass(frozen=True)
class CellFit:
    """The gain of a cell over a hypothesis: nats averaged over its sets and scales; best set and scale."""

    cell: int
    gain: float
    best: int  # index of the set in the pool
    scale: float
    rival: bool = True  # False for a form of a known effect
    unseen: float = 0.0  # share of the evidence, of sizes that these data would not show


def gains(state: State, pool: Pool) -> list[CellFit]:
    """Gain of every cell over a state, of leading ones also with the contacts that it excludes.

    A local defect looks like a few outliers.
    """
    cells = cell_fits(state, pool)
    if state.gross:
        linear = [f for f in approximate_fits(limited(state), pool) if pool.cells[f.cell].clusters is None]
        for rank in sorted(linear, key=lambda f: -f.gain)[: UNKNOWN.tried]:
            anew = refitted(state, pool, rank)
            if anew.gain > cells[rank.cell].gain:
                cells[rank.cell] = anew
    return cells


def cell_fits(state: State, pool: Pool) -> list[CellFit]:
    """Gain of every cell over a state; large gains are computed by a fit of the best set of the cell."""
    out = approximate_fits(state, pool)
    fitted: set[int] = set()
    exact = [f.cell for f in out if pool.cells[f.cell].clusters is None]
    while exact:
        top = out[max(exact, key=lambda k: out[k].gain)]
        if top.gain < UNKNOWN.large or top.cell in fitted:
            break
        out[top.cell] = refitted(state, pool, top, state.weight)
        fitted.add(top.cell)
    return out


def refitted(state: State, pool: Pool, f: CellFit, start: np.ndarray | None = None) -> CellFit:
    """A cell with its gain by fits of its best set, scale by scale."""
    wide = _with_columns(state, pool.columns[:, pool.sets[f.best]])
    best = _fitted(wide, state, f.scale, start)  # its outliers are those of the other scales at first
    others = (best if s == f.scale else _fitted(wide, state, s, best.weight) for s in SCALES)
    nats = np.array([fit.log_evidence for fit in others]) + SCALE_PRIOR
    gain = float(log_sum(nats) - state.log_evidence - np.log(np.sum(pool.owner == f.cell)))
    unseen = unseen_share(f.unseen, f.gain, gain)
    return replace(f, gain=gain, scale=float(SCALES[int(np.argmax(nats))]), unseen=unseen)


def approximate_fits(state: State, pool: Pool) -> list[CellFit]:
    """Gain of every cell over a state, without fits."""
    (bayes, small), p = weighed_sets(state, pool), state.problem
    for index, column, clusters in pool.clustered:
        bayes[index], small[index] = weigh_clusters(state, column, clusters[p.rows[p.contact]])
    bayes, small = bayes + SCALE_PRIOR, small + SCALE_PRIOR
    gain, best = np.empty(len(pool.cells)), np.empty((2, len(pool.cells)), int)  # set and scale
    unseen = np.empty(len(pool.cells))
    for cells, sets in pool.by_number:
        table = bayes[sets].reshape(len(cells), -1)  # (B, sets x scales)
        gain[cells] = log_sum(table, axis=1) - np.log(sets.shape[1])
        unseen[cells] = np.sum(
            np.exp(small[sets].reshape(table.shape) - log_sum(table, axis=1)[:, None]), axis=1
        )
        position, best[1, cells] = np.divmod(np.argmax(table, axis=1), len(SCALES))
        best[0, cells] = np.take_along_axis(sets, position[:, None], axis=1)[:, 0]
    return [
        CellFit(i, g, index, float(SCALES[k]), unseen=u)
        for i, (g, u, (index, k)) in enumerate(
            zip(gain.tolist(), unseen.tolist(), best.T.tolist(), strict=True)
        )
    ]


def with_set(state: State, pool: Pool, index: int, scale: float, start: np.ndarray | None = None) -> State:
    """A state with a set of columns of a pool added; its problem has no other columns than those it uses."""
    return with_columns(state, pool.columns[:, pool.sets[index]], scale, start)


def with_columns(state: State, columns: np.ndarray, scale: float, start: np.ndarray | None = None) -> State:
    """A state with further columns (R, k) at one scale; its problem has no other columns than it uses."""
    return _fitted(_with_columns(state, columns), state, scale, start)


def _with_columns(state: State, columns: np.ndarray) -> Problem:
    """The problem of a state with its own columns and further ones (R, k), and no others."""
    p = state.problem
    return replace(p, pool=np.column_stack([p.pool[:, state.columns], columns]))


def _fitted(wide: Problem, state: State, scale: float, start: np.ndarray | None) -> State:
    """A state fitted again with the further columns of `wide`, all at one scale."""
    further = wide.pool.shape[1] - len(state.columns)
    scales = np.concatenate([state.scales, np.full(further, scale)])
    return fit_state(wide, np.arange(len(scales)), scales, start, state.robust)


def unknown(hypothesis: Hypothesis, pool: Pool, null: float) -> tuple[float, float, list[CellFit]]:
    """Log evidence of an unmodelled effect over a hypothesis, averaged over cells, and that of each cell.

    Between them the share of this evidence that is of sizes that the data would not show.

    A cell with the site and driver of a named effect fits its form better. It contradicts the name by its
    nats beyond a share of those of all names, relative to the log evidence `null` of noise only.
    """
    state = hypothesis.state
    cells = gains(state, pool)
    forgiven = UNKNOWN.forgiven * max(hypothesis.log_evidence - null, 0.0)
    weight, same = pool.log_prior, same_place(hypothesis, pool)
    cells = [
        replace(f, gain=float(f.gain - forgiven * at_name), rival=bool(w > -np.inf))
        for f, at_name, w in zip(cells, same, weight, strict=True)
    ]
    if not np.any(weight > -np.inf):
        return -np.inf, 0.0, cells
    nats = np.array([f.gain for f in cells]) + weight
    gain = float(log_sum(nats))
    return gain, float(np.exp(nats - gain) @ [f.unseen for f in cells]), cells


def same_place(hypothesis: Hypothesis, pool: Pool) -> np.ndarray:
    """Cells (cells,) with the site and driver of a named effect."""
    mine = {place for m in hypothesis.members for place in m.variant.places}
    there = {(site.anywhere, driver.course) for site, driver in mine}
    return np.array([(cell.site, cell.driver) in there for cell in pool.cells])


@dataclass(frozen=True)
class Related:
    """A member of a hypothesis replaced by an error at its site that also varies with another quantity.

    Or by one that has its form, of a cause that is not known.
    """

    member: Member
    driver: Driver  # the quantity that explains most
    gain: float  # nats over the hypothesis, averaged over all quantities, with the prior odds
    alike: bool = False  # it has the form of the member


def relatives(
    h: Hypothesis,
    members: Sequence[Member],
    null: float,
    given: Sequence[Argument],
    without: Callable[[Member], Hypothesis],
) -> Iterator[Related]:
    """The relatives of some members of a hypothesis.

    Parameters
    ----------
    h : Hypothesis
    members : sequence of Member
    null : float
        Log evidence of noise only.
    given : sequence of Argument
        Quantities of the session.
    without : callable
        The hypothesis without a member.
    """
    state, p = h.state, h.state.problem
    row = p.rows[p.contact]
    functions = RELATIVES.share * np.column_stack([a.functions for a in given])[row]
    factors = np.column_stack([np.ones(len(given[0].functions)), *(a.factors for a in given)])[row]
    forgiven = RELATIVES.forgiven * max(h.log_evidence - null, 0.0)
    for member in members:
        reduced = without(member)
        if h.log_evidence - reduced.log_evidence < RELATIVES.least:
            continue
        predicted = state.predicted(member.variant.columns)[: p.count]
        if not np.any(predicted):  # of a certificate
            continue
        modulated = _nats(state, predicted[:, None] * functions, [a.functions.shape[1] for a in given])
        modulated += np.log(RELATIVES.modulated / len(given)) - forgiven
        bare = fit_state(p, reduced.state.columns, reduced.state.scales, state.weight, robust=False)
        name, *each = _nats(bare, predicted[:, None] * factors, [1] * factors.shape[1])
        replaced = _means(np.array(each) - name, [a.factors.shape[1] for a in given])
        replaced += np.log(RELATIVES.replaced) + _weights(member, given)
        both = np.logaddexp(modulated, replaced)
        yield Related(member, given[int(np.argmax(both))].driver, float(log_sum(both)))


def _nats(state: State, columns: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Log evidence of consecutive sets of columns (C, K) over a state, averaged over scales."""
    p = state.problem
    wide = np.zeros((len(p.residual), columns.shape[1]), order="F")
    wide[: p.count] = columns
    ends = np.cumsum([0, *sizes])
    sets = tuple(np.arange(low, high) for low, high in itertools.pairwise(ends))
    return np.asarray(log_sum(weigh_sets(state, Bank(wide, sets, p.count, p.worth)) + SCALE_PRIOR, axis=1))


def _means(nats: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Logarithms of the mean evidence of consecutive groups; -inf for a group of none."""
    parts = np.split(nats, np.cumsum(sizes)[:-1])
    return np.array([float(log_sum(x)) - np.log(len(x)) if len(x) else -np.inf for x in parts])


def _weights(member: Member, given: Sequence[Argument]) -> np.ndarray:
    """Log prior of each quantity: half for those of the joints of an effect, half for all others."""
    joints = {site.number for site, _ in member.variant.places if site.number}
    of_joints = np.array([a.driver.joint in joints for a in given])
    if not of_joints.any() or of_joints.all():
        return np.full(len(given), -np.log(len(given)))
    return np.log(np.where(of_joints, 0.5 / np.sum(of_joints), 0.5 / np.sum(~of_joints)))
