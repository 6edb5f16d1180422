"""Locations of the named effects, as shares of the excess variance of the baseline."""

from __future__ import annotations

import numpy as np

from bayescal.gap.examine import Examined
from bayescal.gap.linear.state import State
from bayescal.gap.outcome.where import places, places_named
from bayescal.gap.result import Place
from bayescal.gap.search.beam import COMPLIANCE, Member


def where(first: Examined, last: Examined, promoted: bool, noise: float) -> tuple[Place, ...]:
    """Locations of compliance where that was missing, then all others; shares of the same excess."""
    out: tuple[Place, ...] = ()
    null = first.search.hypotheses[frozenset()].state
    chosen, size = last.decision.hypothesis, last.fitted.model.size
    excess = _excess(null, chosen.state, noise)
    if promoted:
        every = max(first.candidates.variants[COMPLIANCE], key=lambda v: len(v.columns))
        own = first.search.hypothesis([Member(every, 1.0, 0.0)])
        pool, absorbs = first.candidates.pool, first.fitted.model.size
        out = places_named(own, pool, first.circumstances, excess, absorbs)
    return (*out, *places(chosen, last.pool, last.candidates.pool, last.circumstances, excess, size))


def _excess(null: State, chosen: State, noise: float) -> float:
    """Excess variance of the lengths of a contact under the baseline, m2.

    Over the noise or, where that is less certain, over the residual variance of the chosen hypothesis.
    """
    p = null.problem
    keep = chosen.weight[: p.lengths] > 0
    square, left = (float(np.mean((s.residual[: p.lengths] * p.sigma)[keep] ** 2)) for s in (null, chosen))
    own = noise**2 * (1.0 - null.effective_dof / max(float(np.sum(chosen.weight[: p.count] > 0)), 1.0))
    return max(square - min(own, left), 0.0)
