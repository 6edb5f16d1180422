"""What a plan shows: amplitudes at the stated detectability, pairs at plausible amplitudes, interventions."""

import numpy as np
import pytest
from gap_pools import MODEL, nominal, pool

from bayescal.gap.result import Pair, Suspect
from bayescal.gap.settings import DESIGN
from bayescal.model.block import parts_of
from bayescal.planning.contrasts import contrasts
from bayescal.planning.projection import Projection
from bayescal.planning.separate import NO_LEVER, SEPARATED, confusable, detectable, with_levers

RNG = np.random.default_rng(0)
CHOSEN = np.arange(0, 150, 2)


def test_the_smallest_amplitude_has_the_stated_detectability() -> None:
    c = contrasts(pool(), nominal())
    plan = Projection(c.columns, CHOSEN)
    random = [Projection(c.columns, np.arange(k)) for k in (60, 75, 90)]
    found = {(d.effect, str(d.site)): d for d in detectable(c.vocabulary, plan, random)}
    backlash = found["backlash", "joint 3"]
    ball = found["ball-radius", "probe"]
    assert ball.smallest > 20.0 * ball.plausible  # planes alone hardly show it
    for amplitude, p in ((backlash.smallest, plan), (backlash.smallest_random, random[1])):
        suspect = Suspect("backlash at joint 3", {"backlash J3": amplitude})
        one = contrasts(pool(), nominal(), [Pair((suspect,))])
        at = {id(plan): CHOSEN, id(random[1]): np.arange(75)}[id(p)]
        assert one.strengths(Projection(one.columns, at))[0] == pytest.approx(DESIGN.named, rel=1e-6)


def test_confusable_effects_are_those_of_the_vocabulary_at_their_weakest_site() -> None:
    c = contrasts(pool(), nominal())
    plan, bare = (Projection(c.columns, k) for k in (CHOSEN, CHOSEN[:60]))
    found = confusable(c.vocabulary, plan, [bare])
    of_harmonics = [x for _, x in found if {p.split(" at ")[0] for p in x.pair} == {
        "eccentricity", "second-harmonic"
    }]  # fmt: skip
    assert len(of_harmonics) == 1
    pairs = [
        Pair((Suspect(f"{own} at joint {joint}"),), rival)
        for own, other in (("eccentricity", "second-harmonic"), ("second-harmonic", "eccentricity"))
        for joint in range(1, 7)
        for rival in ((), (Suspect(other),))
    ]
    every = contrasts(pool(), nominal(), pairs)
    own = [k for k, item in enumerate(every.items) if len(item.truth) == 2]  # the sites, not the whole effect
    alone, beside = every.strengths(Projection(every.columns, CHOSEN))[own].reshape(-1, 2).T
    assert of_harmonics[0].after == pytest.approx(min(beside[alone >= DESIGN.named]), rel=1e-6)
    assert all(x.before < x.after for _, x in found)


def test_a_payload_is_the_intervention_for_compliance_beside_bending() -> None:
    without = ("compliance at joint 3",)
    parts = parts_of(without, MODEL)
    unloaded = np.flatnonzero(pool().session.measurements.payload == 0)
    bent = Suspect("bending at link 3", {"bending J3 bearing": 4e-5})
    pair = Pair((bent,), (Suspect("compliance at joint 3"),))
    c = contrasts(pool(), nominal(without), [pair], parts)
    plan = Projection(c.columns, unloaded)
    ((weakest, found),) = confusable(c.vocabulary, plan, [Projection(c.columns)], [pair])
    assert found.before < found.after < SEPARATED
    (judged,) = with_levers(pool(), MODEL, unloaded, [(weakest, found)], RNG, parts)
    assert "payload" in judged.intervention


def test_effects_that_no_intervention_separates() -> None:
    c = contrasts(pool(), nominal(), [Pair((Suspect("ball-radius"),))])
    ball = Pair((Suspect("ball-radius"),), ())
    found = confusable(c.vocabulary, Projection(c.columns, CHOSEN), [Projection(c.columns)], [ball])
    assert with_levers(pool(), MODEL, CHOSEN, found, RNG)[0].intervention == NO_LEVER
