"""Errors of points are lengths everywhere; figures are in the order of time and show what is significant."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.gap.result import VALIDATION_POINTS, Verdict
from bayescal.reporting.figures.where import drawn_curves
from bayescal.reporting.gap.contacts import length
from bayescal.reporting.gap.phrases import headline


def test_the_length_of_points_is_that_of_their_vectors():
    errors = np.random.default_rng(0).standard_normal((3, 40))
    rms = float(np.sqrt(np.mean(errors**2)))
    lengths = np.linalg.norm(errors, axis=0)
    assert length(VALIDATION_POINTS, rms) == pytest.approx(np.sqrt(np.mean(lengths**2)))
    assert length("planes", rms) == length("distances", rms) == rms


def test_only_significant_curves_and_an_event_once():
    def drawn(*cells):
        curves = [
            {"site": site, "driver": driver, "x": [0.0] * points, "event": driver == "moment"}
            for site, driver, _, points in cells
        ]
        where = [{"site": s, "driver": d, "family_p_value": p} for s, d, p, _ in cells]
        return [c["site"] for c in drawn_curves({"curves": curves, "where": where})]

    first, again, angle = (
        ("base", "moment", 0.0, 5),
        ("tool", "moment", 0.0, 5),
        ("joint 2", "angle", 1e-4, 5),
    )
    chance, none = ("probe", "moment", 0.5, 5), ("joint 3", "angle", 0.0, 0)
    assert drawn(chance, first, again, none, angle) == ["base", "joint 2"]
    assert drawn(chance) == []


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
        verdict=Verdict("null", (), {"null": 0.25, "unknown": unknown}, (), (), (), {}, ()),
        where=(),
        undetermined=(),
        arm=None,
        magnitude=SimpleNamespace(noise=5e-6, measured=(measured,)),
    )
    assert words in headline(gap)[0]
