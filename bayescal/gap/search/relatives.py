"""Relatives of a named effect: what it predicts, times a function of any other quantity of the session.

A cause that is not in the list of known effects may act at the site of a name and along its coordinate, and
so explain much of the data under that name: friction that grows with the load looks like backlash. There are
two kinds of relatives. A *modulated* relative is the prediction of the name and, in addition, this prediction
times smooth functions of another quantity: the data show that the name is not all. A *replaced* relative is
the prediction times a positive function, without the name: in proportion to a load, at one end of a range, in
one direction. The name is only as sure as the data exclude these.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.arm import chain as reference
from bayescal.effects import Circumstances
from bayescal.effects.location import Driver
from bayescal.gap.linear.evidence import SCALE_PRIOR, Bank, log_sum, weigh_sets
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.search.beam import Hypothesis, Member
from bayescal.gap.search.cells import signs
from bayescal.gap.search.makers import smooth
from bayescal.gap.settings import RELATIVES
from bayescal.statistics import rms


@dataclass(frozen=True)
class Argument:
    """A quantity of the session, with functions of it."""

    driver: Driver
    functions: np.ndarray  # (N, k) smooth ones, which modulate a prediction
    factors: np.ndarray  # (N, m) positive ones, in proportion to which an error may be


@dataclass(frozen=True)
class Related:
    """A member of a hypothesis replaced by an error at its site that also varies with another quantity."""

    member: Member
    driver: Driver  # the quantity that explains most
    gain: float  # nats over the hypothesis, averaged over all quantities, with the prior odds


def arguments(c: Circumstances) -> tuple[Argument, ...]:
    """All quantities of a session on which an error may depend, those that vary over its fitted rows."""
    return tuple(
        Argument(driver, np.column_stack(values), np.column_stack([np.empty((len(c.q), 0)), *factors]))
        for driver, values, factors in _functions(c)
        if values
    )


def _functions(c: Circumstances) -> Iterator[tuple[Driver, list[np.ndarray], list[np.ndarray]]]:
    fitted, waves = c.fitted, RELATIVES.waves
    for j in range(1, c.robot.n + 1):
        angle = c.readings[:, j - 1]
        yield Driver("angle", j), smooth(angle, fitted, waves), _ends(angle, fitted)
        if c.torques is not None and np.ptp(c.torques[fitted, j - 1]) > 1e-3:
            load = c.torques[:, j - 1] / rms(c.torques[fitted, j - 1])
            yield Driver("torque", j), smooth(load, fitted, waves), [np.abs(load), *_ends(load, fitted)]
        if c.velocity is not None and np.any(c.velocity[fitted, j - 1]):
            speed, way = np.abs(c.velocity[:, j - 1]), signs(c.velocity[:, j - 1])
            yield Driver("direction", j), [way], [(1.0 + way) / 2, (1.0 - way) / 2]
            yield Driver("joint speed", j), smooth(speed, fitted, 2), [speed / rms(speed[fitted])]
    clock = np.arange(len(c.q), dtype=float) if c.time is None else c.time
    yield Driver("time"), smooth(clock, fitted, waves), _ends(clock, fitted)
    if c.temperature is not None:
        yield Driver("temperature"), smooth(c.temperature, fitted, 2), _ends(c.temperature, fitted)
    place = reference.points(c.chain, c.q, c.tool_centres[c.tool])
    ends = [f for x in place.T for f in _ends(x, fitted)]
    yield Driver("workspace"), [f for x in place.T for f in smooth(x, fitted, 1)], ends
    if np.any(c.touching):
        normal = list(np.where(c.touching[:, None], c.approach, 0.0).T)
        yield Driver("contact direction"), normal, [f for x in normal for f in _ends(x, fitted)]


def _ends(x: np.ndarray, fitted: np.ndarray) -> list[np.ndarray]:
    """Straight lines from 0 at one end of the range of a coordinate x (N,) to 1 at the other, both ways."""
    low, high = float(np.min(x[fitted])), float(np.max(x[fitted]))
    if not high > low:
        return []
    u = np.clip((x - low) / (high - low), 0.0, 1.0)
    return [u, 1.0 - u]


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
    amplitudes = dict(zip(state.columns.tolist(), state.amplitudes, strict=True))
    row = p.rows[p.contact]
    functions = RELATIVES.share * np.column_stack([a.functions for a in given])[row]
    factors = np.column_stack([np.ones(len(given[0].functions)), *(a.factors for a in given)])[row]
    forgiven = RELATIVES.forgiven * max(h.log_evidence - null, 0.0)
    for member in members:
        rest = without(member)
        if h.log_evidence - rest.log_evidence < RELATIVES.least:
            continue
        own = member.variant.columns
        predicted = p.pool[: p.count, own] @ np.array([amplitudes[k] for k in own.tolist()])
        if not np.any(predicted):  # of a certificate
            continue
        modulated = _nats(state, predicted[:, None] * functions, [a.functions.shape[1] for a in given])
        modulated += np.log(RELATIVES.modulated / len(given)) - forgiven
        bare = fit_state(p, rest.state.columns, rest.state.scales, state.weight, robust=False)
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
    own = np.array([a.driver.joint in joints for a in given])
    if not own.any() or own.all():
        return np.full(len(given), -np.log(len(given)))
    return np.log(np.where(own, 0.5 / np.sum(own), 0.5 / np.sum(~own)))
