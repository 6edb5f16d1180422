"""The verdict: from weighed hypotheses to what is named, and what stays credible."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.effects import confusable
from bayescal.effects.location import Driver, joint
from bayescal.gap.search.beam import Hypothesis, Member
from bayescal.gap.search.candidates import Variant
from bayescal.gap.search.makers import Cell
from bayescal.gap.search.unknown import CellFit
from bayescal.gap.search.verdict import (
    Weighed,
    contradicted,
    credible_set,
    given_away,
    probabilities,
    softened,
    verdict_of,
)

ALIKE = ("hardening", "hysteresis")


def weighed(*names, probability=0.0, score=0.0, cell=False):
    """A set of effects without a fit, perhaps with an unmodelled effect."""
    members = tuple(Member(Variant(n, None, (), np.zeros(0, int), 0.0), 1.0, 0.0) for n in names)
    found = CellFit(0, 1.0, 0, 1.0) if cell else None
    return Weighed(Hypothesis(members, None, 0.0, 0.0), found, 0.0, score, probability)


@pytest.mark.parametrize(
    ("sets", "kind", "names"),
    [
        ([(("lobing",), 0.7), ((), 0.3)], "null", ()),
        ([(("lobing",), 0.85), ((), 0.15)], "null", ()),
        ([(("lobing",), 0.92), ((), 0.08)], "named", ("lobing",)),
        ([(("lobing",), 0.7), (("lobing", "unknown"), 0.3)], "named+unexplained", ("lobing",)),
        ([(("lobing",), 0.8), (("lobing", "unknown"), 0.2)], "named", ("lobing",)),
        ([(("lobing",), 0.4), (("step",), 0.35), (("latency",), 0.25)], "ambiguous", ()),
        # beside a doubtful effect only a nearly certain one is named
        ([(("lobing", "step"), 0.45), (("lobing",), 0.55)], "ambiguous", ("lobing",)),
        ([(("lobing", "step"), 0.45), (("lobing",), 0.3), (("latency",), 0.25)], "ambiguous", ()),
        # a further effect counts, whichever it is
        ([(("lobing",), 0.55), (("lobing", "step"), 0.45)], "named+unexplained", ("lobing",)),
        ([(("lobing",), 0.7), (("lobing", "step"), 0.2), (("latency",), 0.1)], "named", ("lobing",)),
        ([(("lobing",), 0.7), (("lobing", "step"), 0.16), (("lobing", "unknown"), 0.14)],
         "named+unexplained", ("lobing",)),
        ([(("unknown",), 0.6), (("lobing",), 0.4)], "unknown", ()),
        ([(("unknown",), 0.4), (("lobing",), 0.35), (("step",), 0.25)], "ambiguous", ()),
        ([(("lobing", "unknown"), 0.6), (("unknown",), 0.4)], "named+unexplained", ("lobing",)),
        ([(("lobing", "unknown"), 0.45), (("unknown",), 0.55)], "named+unexplained", ()),
    ],
)  # fmt: skip
def test_a_verdict_names_what_is_more_likely_than_not(sets, kind, names):
    found = [
        weighed(*(n for n in own if n != "unknown"), probability=p, cell="unknown" in own) for own, p in sets
    ]
    effects = {n for own, _ in sets for n in own}
    assert verdict_of(found, probabilities(found, sorted(effects))) == (kind, names)


def test_the_credible_set_holds_nine_tenths_and_what_is_confusable_close_behind():
    first, second, third = (("lobing", 0.7), ("step", 0.22), ("latency", 0.08))
    found = [weighed(n, probability=p, score=-10.0 * k) for k, (n, p) in enumerate((first, second, third))]
    assert credible_set(found) == ("lobing", "step")
    assert confusable(*ALIKE)
    for behind, kept in ((3.0, True), (6.0, False)):
        pair = [weighed(ALIKE[0], probability=0.95), weighed(ALIKE[1], probability=0.04, score=-behind)]
        assert (ALIKE[1] in credible_set(pair)) == kept


def test_noise_only_is_a_member_of_the_credible_set_like_any_other():
    """It is listed where its probability is needed for nine tenths, and alone where nothing else is."""
    some = [("lobing",), 0.6], [(), 0.35], [("step",), 0.05]
    assert credible_set([weighed(*own, probability=p, score=p) for own, p in some]) == ("lobing", "null")
    assert credible_set([weighed(probability=0.95), weighed("step", probability=0.05)]) == ("null",)
    sure = [weighed("lobing", probability=0.95), weighed(probability=0.05)]
    assert credible_set(sure) == ("lobing",)


def test_a_best_set_without_any_effect_is_null():
    """Also where very many sets, each less probable, leave it less than a tenth."""
    rest = [weighed(f"effect {k}", probability=0.05) for k in range(18)]
    found = [weighed(probability=0.08), *rest]
    names = [w.effects[0] for w in rest]
    assert verdict_of(found, probabilities(found, names)) == ("null", ())


def test_structure_at_the_site_of_a_name_contradicts_it():
    """Of the best set alone, and from the nats on that right names never leave."""
    best, other = weighed("lobing", probability=0.9), weighed("step", probability=0.1)
    for sets, nats, found in ((best, 6.0, True), (best, 4.0, False), (other, 6.0, False)):
        assert contradicted([best, other, replace(sets, at_names=nats)]) == found


def test_only_confusable_effects_come_closer():
    """Of ten nats by which the leader fits better, six count against a confusable effect."""
    sets = [weighed(ALIKE[0], score=5.0), weighed(ALIKE[1], score=-5.0), weighed("lobing", score=-5.0)]
    leader, alike, other = (w.score for w in softened(sets))
    assert (leader, other) == (5.0, -5.0)
    assert leader - alike == pytest.approx(6.0)


@pytest.mark.parametrize(("behind", "expected"), [(0.0, 0.15), (4.0, 0.15), (5.0, 0.04), (50.0, 0.04)])
def test_an_effect_of_an_improbable_hypothesis_is_no_rival_of_a_cell(behind, expected):
    """A cell gives away nats to an effect at its place, but not to one of odds below 1 to 100."""
    place = (joint(3), Driver("torque", 3))
    there = Variant("hardening", None, (joint(3),), np.zeros(0, int), 0.0, (place,))
    elsewhere = Variant(
        "eccentricity", None, (joint(3),), np.zeros(0, int), 0.0, ((joint(3), Driver("angle", 3)),)
    )
    ranked = [
        Hypothesis((Member(variant, 1.0, 0.0),), None, 60.0 - less, 0.0)
        for variant, less in ((elsewhere, 0.0), (there, behind))
    ]
    assert given_away(Cell(*place, ()), ranked) == expected
