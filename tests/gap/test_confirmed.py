"""Which named effects the validation data admit, and which are withheld."""

import numpy as np
import pytest

from bayescal.gap.search.gate import confirmed, gain
from bayescal.predict.crossvalidation import VALIDATED
from bayescal.predict.distances import CentreDistances
from bayescal.predict.errors import ValidationErrors

NOISE, COUNT = 5e-6, 60
SCATTER = np.random.default_rng(4).standard_normal(COUNT)


def errors(excess: float, distance: float = 0.0, correlated: float = 0.0) -> ValidationErrors:
    """Validation rows with an error beside the noise, and two distances that are off by `distance`."""
    residual = NOISE * SCATTER + excess * np.where(np.arange(COUNT) % 2, 1.0, -1.0)
    by_parameters = np.array([[NOISE, correlated], [NOISE, -correlated]])
    distances = CentreDistances(
        (("a", "b"), ("c", "d")), np.array([distance, -distance]), by_parameters,
        NOISE * np.eye(2), np.zeros(2), np.tile([1.0, 0, 0], (2, 1)),
    )  # fmt: skip
    label = np.full(COUNT, "contact")
    return ValidationErrors(
        VALIDATED, "contact", residual, np.full(COUNT, NOISE), np.zeros((COUNT, 1)), np.arange(COUNT),
        np.full(COUNT, "planes"), label, np.full(COUNT, "face"), np.arange(COUNT), distances,
    )  # fmt: skip


def judged(spoils: dict[str, float], helps: dict[str, float], base: float = 20e-6):
    """Refits of sets of names, each of which takes an error away or adds one; and how often one was asked."""
    asked = []

    def refit(members):
        asked.append(members)
        size = base - sum(helps.get(m, 0.0) for m in members) + sum(spoils.get(m, 0.0) for m in members)
        return "+".join(members), errors(size)

    return refit, asked


def test_effects_that_help_are_kept():
    refit, _ = judged({}, {"play": 8e-6, "scale": 7e-6})
    found = confirmed(("play", "scale"), refit, errors(20e-6))
    assert (found.members, found.fitted, found.withheld) == (("play", "scale"), "play+scale", ())


@pytest.mark.parametrize("order", [("drift", "play", "scale"), ("play", "scale", "drift")])
def test_the_effect_that_spoils_the_validation_is_withheld_whatever_its_size(order):
    """The last of the effects is the smallest: it must not be withheld for what another one does."""
    refit, _ = judged({"drift": 60e-6}, {"play": 8e-6, "scale": 7e-6})
    found = confirmed(order, refit, errors(20e-6))
    assert found.members == tuple(m for m in order if m != "drift")
    assert [m for m, _ in found.withheld] == ["drift"]
    assert found.withheld[0][1] == pytest.approx(-gain(errors(20e-6), found.errors, refit(order)[1]))
    assert found.fitted == "play+scale"


def test_a_name_that_costs_beside_another_that_helps_is_withheld():
    """Together they help. Alone, each removal is tried, and one of them is worth more without the other."""
    refit, _ = judged({"drift": 8e-6}, {"play": 18e-6})
    assert gain(errors(20e-6), errors(20e-6), refit(("play", "drift"))[1]) > 3
    found = confirmed(("play", "drift"), refit, errors(20e-6))
    assert found.members == ("play",)


def test_two_that_spoil_are_both_withheld():
    refit, _ = judged({"drift": 60e-6, "bending": 50e-6}, {"play": 8e-6})
    found = confirmed(("bending", "play", "drift"), refit, errors(20e-6))
    assert found.members == ("play",)
    assert {m for m, _ in found.withheld} == {"drift", "bending"}


def test_of_two_that_spoil_only_together_one_goes():
    """Either does what both do, so that no removal alone helps; less than both is needed all the same."""

    def refit(members):
        return "+".join(members), errors(40e-6 if members else 0.0)

    found = confirmed(("bending", "coupling"), refit, errors(0.0))
    assert found.members == ()
    assert len(found.withheld) == 2


def test_without_any_effect_the_baseline_stands():
    refit, _ = judged({"drift": 60e-6}, {})
    found = confirmed(("drift",), refit, errors(20e-6))
    assert (found.members, found.fitted) == ((), "")


def test_a_certain_effect_keeps_its_name_and_loses_its_claim():
    """The others are tested as if it were not there, and the refit contains it."""
    refit, _ = judged({"drift": 60e-6, "bending": 50e-6}, {"play": 8e-6})
    found = confirmed(("drift", "bending", "play"), refit, errors(20e-6), lambda m: m == "drift")
    assert (found.members, found.fitted) == (("drift", "play"), "drift+play")
    assert ([m for m, _ in found.withheld], [m for m, _ in found.unclaimed]) == (["bending"], ["drift"])
    assert found.unclaimed[0][1] > 3


def test_gain_of_distances_heeds_their_correlation():
    """An error that two distances share by the arm's uncertainty is likely along it, and unlikely across."""
    near, far = (gain(errors(0.0), errors(0.0), errors(0.0, 20e-6, c)) for c in (20e-6, 0.0))
    assert near > far + 2
