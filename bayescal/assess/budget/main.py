"""The measurands whose budgets a fit writes."""

from __future__ import annotations

from bayescal.assess.budget.budget import Budget, budget
from bayescal.assess.budget.inputs import Basis
from bayescal.assess.budget.measurand import Measurand, certified_distances, distance, distances, volume
from bayescal.assess.budget.readings import readings

SINGLE = 3
"""Certified distances, those with the largest errors, that have a budget of their own."""


def headline(basis: Basis) -> Measurand:
    """The distances that a fit reports first: measured ones where there are any, else those of the volume."""
    pairs = certified_distances(basis)
    if pairs:
        name = f"error of a distance between sphere centres ({len(pairs)} distances)"
        return distances(basis, pairs, name) if len(pairs) > 1 else distance(basis, pairs[0])
    return readings(basis) or volume(basis)


def usual(basis: Basis) -> tuple[Budget, ...]:
    """Budgets of the headline distance, of the probed volume, and of the largest certified errors."""
    first = headline(basis)
    each = [first, volume(basis)]
    pairs = certified_distances(basis)
    if len(pairs) > 1:
        single = [distance(basis, pair) for pair in pairs]
        each += sorted(single, key=lambda m: -abs(m.value or 0.0))[:SINGLE]
    named = {m.name: m for m in each}
    return tuple(budget(basis, m) for m in named.values())
