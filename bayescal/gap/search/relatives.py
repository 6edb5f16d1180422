"""Relatives of a named effect: what it predicts, times a function of any other quantity of the session.

A cause that is not in the list of known effects may act at the site of a name and along its coordinate, and
so explain much of the data under that name: friction that grows with the load looks like backlash. What it
depends on besides shows as a modulation of the error that the name predicts. The form of a true name is known
to 10 or 20 %, whose square is forgiven.
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
from bayescal.gap.search.beam import Hypothesis, Member
from bayescal.gap.search.cells import signs
from bayescal.gap.search.makers import smooth
from bayescal.gap.settings import RELATIVES


@dataclass(frozen=True)
class Argument:
    """A quantity of the session, and smooth functions (N, k) of it."""

    driver: Driver
    functions: np.ndarray


@dataclass(frozen=True)
class Related:
    """A member of a hypothesis replaced by an error at its site that also varies with another quantity."""

    member: Member
    driver: Driver  # the quantity that explains most
    gain: float  # nats over the hypothesis, averaged over all quantities, without what is forgiven


def arguments(c: Circumstances) -> tuple[Argument, ...]:
    """All quantities of a session on which an error may depend, those that vary over its fitted rows."""
    listed = [(driver, values) for driver, values in _functions(c) if values]
    return tuple(Argument(driver, np.column_stack(values)) for driver, values in listed)


def _functions(c: Circumstances) -> Iterator[tuple[Driver, list[np.ndarray]]]:
    for j in range(1, c.robot.n + 1):
        yield Driver("angle", j), smooth(c.readings[:, j - 1], c.fitted, RELATIVES.waves)
        if c.torques is not None and np.ptp(c.torques[c.fitted, j - 1]) > 1e-3:
            yield Driver("torque", j), smooth(c.torques[:, j - 1], c.fitted, RELATIVES.waves)
        if c.velocity is not None and np.any(c.velocity[c.fitted, j - 1]):
            speed = c.velocity[:, j - 1]
            yield Driver("direction", j), [signs(speed)]
            yield Driver("joint speed", j), smooth(np.abs(speed), c.fitted, 2)
    clock = np.arange(len(c.q), dtype=float) if c.time is None else c.time
    yield Driver("time"), smooth(clock, c.fitted, RELATIVES.waves)
    if c.temperature is not None:
        yield Driver("temperature"), smooth(c.temperature, c.fitted, 2)
    place = reference.points(c.chain, c.q, c.tool_centres[c.tool])
    yield Driver("workspace"), [w for axis in place.T for w in smooth(axis, c.fitted, 1)]
    if np.any(c.touching):
        yield Driver("contact direction"), list(np.where(c.touching[:, None], c.approach, 0.0).T)


def relatives(
    h: Hypothesis, null: float, given: Sequence[Argument], lost: Callable[[Member], float]
) -> Iterator[Related]:
    """The relatives of every effect of a hypothesis.

    Parameters
    ----------
    h : Hypothesis
    null : float
        Log evidence of noise only.
    given : sequence of Argument
        Quantities of the session.
    lost : callable
        Log evidence, nats, that the hypothesis loses without a member.
    """
    state, p = h.state, h.state.problem
    amplitudes = dict(zip(state.columns.tolist(), state.amplitudes, strict=True))
    row = p.rows[p.contact]
    ends = np.cumsum([0, *(a.functions.shape[1] for a in given)])
    sets = tuple(np.arange(low, high) for low, high in itertools.pairwise(ends))
    functions = RELATIVES.share * np.column_stack([a.functions for a in given])[row]
    forgiven = RELATIVES.forgiven * max(h.log_evidence - null, 0.0)
    for member in h.members:
        if lost(member) < RELATIVES.least:
            continue
        own = member.variant.columns
        predicted = p.pool[: p.count, own] @ np.array([amplitudes[k] for k in own.tolist()])
        columns = np.zeros((len(p.residual), functions.shape[1]), order="F")
        columns[: p.count] = predicted[:, None] * functions
        nats = log_sum(weigh_sets(state, Bank(columns, sets, p.count, p.worth)) + SCALE_PRIOR, axis=1)
        gain = float(log_sum(nats)) - float(np.log(len(nats))) - forgiven
        yield Related(member, given[int(np.argmax(nats))].driver, gain)
