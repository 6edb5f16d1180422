"""The measurands whose budgets a fit writes, and the uncertainty of the distance errors that it predicts."""

from __future__ import annotations

from dataclasses import replace

from bayescal.assess.budget.budget import Budget, budget
from bayescal.assess.budget.inputs import Basis
from bayescal.assess.budget.measurand import Measurand, certified_distances, distance, distances, volume
from bayescal.assess.budget.readings import readings
from bayescal.predict.forecast import CENTRES, READINGS, DistanceErrors, Forecast

SINGLE = 3
"""Certified distances, those with the largest errors, that have a budget of their own."""


def certified(basis: Basis) -> Measurand | None:
    """Error of any one of the certified distances; None without any."""
    pairs = certified_distances(basis)
    if len(pairs) == 1:
        return distance(basis, pairs[0])
    name = f"error of a distance between {CENTRES} ({len(pairs)} distances)"
    return distances(basis, pairs, name) if pairs else None


MEASURED = {CENTRES: certified, READINGS: readings}
"""Measurand of distances that validation rows measure, by the type of their ends; else that of the volume."""


def headline(basis: Basis) -> Measurand:
    """The distances that a fit reports first: measured ones where there are any, else those of the volume."""
    return next((m for of in MEASURED.values() if (m := of(basis)) is not None), None) or volume(basis)


def with_budgets(expected: Forecast, basis: Basis) -> Forecast:
    """Predicted distance errors with u and k of their budgets: the only ones that are stated of them."""

    def stated(d: DistanceErrors) -> DistanceErrors:
        measurand = MEASURED.get(d.over, volume)(basis)
        assert measurand is not None, "distances that are predicted have a budget"
        b = budget(basis, measurand)
        return replace(d, u=b.u, k=b.k)

    checked = tuple(stated(d) for d in expected.checked)
    return replace(expected, checked=checked, workspace=stated(expected.workspace))


def of_distances(basis: Basis) -> dict[tuple[str, str], Budget]:
    """The budget of the error of each certified distance, by its ends."""
    return {pair: budget(basis, distance(basis, pair)) for pair in certified_distances(basis)}


def usual(basis: Basis) -> tuple[Budget, ...]:
    """Budgets of the measured distances, of the probed volume, and of the largest certified errors."""
    each = [budget(basis, m) for of in (*MEASURED.values(), volume) if (m := of(basis)) is not None]
    each += sorted(of_distances(basis).values(), key=lambda b: -abs(b.measurand.value or 0.0))[:SINGLE]
    return tuple({b.measurand.name: b for b in each}.values())
