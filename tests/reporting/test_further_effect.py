"""The further effect of a verdict `named+unexplained`: one of the vocabulary, or one outside it."""

import pytest

from bayescal.reporting.shared.origin import possible


@pytest.mark.parametrize(
    ("unknown", "names"),
    [(0.03, ("hardening", "hysteresis")), (0.4, ("hardening", "hysteresis")), (0.5, ())],
)
def test_the_further_effect_is_stated_by_name_where_names_are_more_probable(unknown, names):
    probability = {"latency": 0.99, "hardening": 0.33, "hysteresis": 0.13, "null": 0.0, "unknown": unknown}
    credible = ("latency", "hardening", "hysteresis", "unknown", "null")
    assert possible(probability, credible, ("latency",)) == names


def test_improbable_effects_are_not_proposed_for_inspection():
    probability = {"latency": 0.99, "hardening": 0.33, "hysteresis": 0.04, "unknown": 0.03}
    assert possible(probability, ("latency", "hardening", "hysteresis"), ("latency",)) == ("hardening",)
