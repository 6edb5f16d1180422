"""Errors of points are lengths everywhere; figures are in the order of time and show what is significant."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.effects.location import BASE, PROBE, TOOL, Driver, joint
from bayescal.gap.result import VALIDATION_POINTS
from bayescal.reporting.gap.arm import drawn_curves
from bayescal.reporting.gap.lengths import length
from bayescal.reporting.gap.phrases import headline


def test_the_length_of_points_is_that_of_their_vectors():
    errors = np.random.default_rng(0).standard_normal((3, 40))
    rms = float(np.sqrt(np.mean(errors**2)))
    lengths = np.linalg.norm(errors, axis=0)
    assert length(VALIDATION_POINTS, rms) == pytest.approx(np.sqrt(np.mean(lengths**2)))
    assert length("planes", rms) == length("distances", rms) == rms


def test_only_significant_curves_and_an_event_once():
    def at(site, kind, p, points=5):
        curve = SimpleNamespace(x=np.zeros(points))
        return SimpleNamespace(site=site, driver=Driver(kind), family_p_value=p, curve=curve)

    first, again, angle = at(BASE, "event", 0.0), at(TOOL, "event", 0.0), at(joint(2), "angle", 1e-4)
    chance, none = at(PROBE, "event", 0.5), at(joint(3), "angle", 0.0, points=0)
    assert drawn_curves([chance, first, again, none, angle]) == [first, angle]
    assert drawn_curves([chance]) == []


@pytest.mark.parametrize(
    ("rms", "unknown", "words"),
    [
        (5e-6, 0.2, "explains these data"),
        (9e-6, 0.2, "validation points are larger"),
        (5e-6, 0.7, "noise only is possible (probability 0.25)"),
    ],
)
def test_the_headline_is_that_of_the_table(rms, unknown, words):
    measured = SimpleNamespace(
        what=VALIDATION_POINTS, rms=rms, predicted_rms=5e-6, predicted_interval95=(3e-6, 7e-6)
    )
    gap = SimpleNamespace(
        verdict=SimpleNamespace(kind="null", probability={"null": 0.25, "unknown": unknown}),
        where=(),
        magnitude=SimpleNamespace(noise=5e-6, measured=(measured,)),
    )
    assert words in headline(gap)[0]
