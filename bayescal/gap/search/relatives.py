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

from bayescal.effects.location import Driver
from bayescal.gap.linear.evidence import SCALE_PRIOR, Bank, log_sum, weigh_sets
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.search.beam import Hypothesis, Member
from bayescal.gap.search.quantities import Argument
from bayescal.gap.settings import RELATIVES


@dataclass(frozen=True)
class Related:
    """A member of a hypothesis replaced by an error at its site that also varies with another quantity."""

    member: Member
    driver: Driver  # the quantity that explains most
    gain: float  # nats over the hypothesis, averaged over all quantities, with the prior odds


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
