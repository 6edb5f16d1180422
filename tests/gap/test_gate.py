"""The gate of the validation data: which refits it withholds."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_errors import NOISE, held

from bayescal.gap.search.gate import worse
from bayescal.predict.crossvalidation import LEFT_OUT

COUNT = 400
RESIDUAL = NOISE * np.random.default_rng(0).choice([-1.3, -1.0, -0.6, 0.6, 1.0, 1.3], COUNT)
DISTANCES = 2 * NOISE * np.array([1.0, -1.0, 0.9, -1.1, 1.1, -0.9])


@pytest.mark.parametrize(("factor", "withheld"), [(1.05, False), (1.3, True)])
def test_contacts_that_grow_are_not_excused_by_a_larger_uncertainty(factor, withheld):
    """A refit that only expects more is more probable; it is withheld where contacts are 1.3 times as far."""
    before, after = held(2 * RESIDUAL, sd=NOISE), held(2 * factor * RESIDUAL, sd=2.2 * NOISE)
    assert ("validation RMS" in worse(before, after)) == withheld


@pytest.mark.parametrize(("factor", "withheld"), [(1.05, True), (0.95, False)])
def test_contacts_that_become_improbable_count_where_they_grow(factor, withheld):
    """A refit that is too sure of itself is withheld, but not where it leaves less of the contacts."""
    before, after = held(2 * RESIDUAL, sd=2 * NOISE), held(2 * factor * RESIDUAL, sd=NOISE)
    assert bool(worse(before, after)) == withheld
    # of a single block no standard error is known: the loss then counts as it is
    one = np.zeros(COUNT, int)
    assert bool(worse(replace(before, block=one), replace(after, block=one))) == withheld


@pytest.mark.parametrize(
    ("contacts", "factor", "withheld"), [(1, 4.0, False), (COUNT, 1.006, False), (COUNT, 1.02, True)]
)
def test_a_loss_by_chance_withholds_nothing(contacts, factor, withheld):
    """One contact four times as far off is no significant loss, 0.6 % of all contacts is a small one."""
    before = held(RESIDUAL)
    after = replace(before, residual=RESIDUAL * np.where(np.arange(COUNT) < contacts, factor, 1.0))
    assert bool(worse(before, after)) == withheld


@pytest.mark.parametrize(
    ("factor", "expected", "withheld"),
    [(1.3, 2.0, False), (2.0, 2.0, True), (2.0, 5.0, False), (2.0, 0.5, True)],
)
@pytest.mark.parametrize("how", [LEFT_OUT, ""])
def test_distances_that_double_withhold_a_refit(factor, expected, withheld, how):
    """Twice as large as they were and as was expected; however the contacts were judged."""
    before = held(RESIDUAL, distances=DISTANCES, distance_sd=expected * NOISE)
    after = held(RESIDUAL, distances=factor * DISTANCES, distance_sd=expected * NOISE)
    before, after = (replace(h, how=how or h.how) for h in (before, after))
    assert ("distance RMS" in worse(before, after)) == withheld


def test_fitted_contacts_do_not_judge_a_refit():
    """Left out one by one they are calibration rows, which the search has judged."""
    before, after = held(RESIDUAL), held(3 * RESIDUAL)
    assert worse(before, after)
    assert not worse(replace(before, how=LEFT_OUT), replace(after, how=LEFT_OUT))
