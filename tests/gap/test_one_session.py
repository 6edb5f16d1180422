"""Effects of one session of several: a base that yields on one floor and not on the other."""

import numpy as np
import pytest

from bayescal.dataset.join import joined
from bayescal.effects import parameters_of
from bayescal.effects.location import BASE, Site
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.gap.diagnose import diagnose
from bayescal.gap.search.candidates import candidates
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate

USUAL = ("geometry", "compliance")
LITTLE = {"contacts": 120, "later": 30, "repeats": 4, "spheres": 1, "placements": 1, "arm_seed": 1}


@pytest.fixture(scope="module")
def two():
    """Two sessions of one arm; only the base of the second yields."""
    first = simulate(Options(name="A", seed=1, effects=USUAL, **LITTLE)).dataset
    second = simulate(Options(name="B", seed=2, effects=(*USUAL, "base-compliance"), **LITTLE)).dataset
    return joined([first, second], own_noise=False)


@pytest.fixture(scope="module")
def c(two):
    scene = Scene(two)
    return scene.circumstances(scene.rows("calibrate"))


def test_sites_of_a_session():
    site = BASE.of("cube, floor 2")
    assert (str(site), site.text) == ("base of cube-floor-2", "the base of cube-floor-2")
    assert Site.read(str(site)) == site
    assert site.anywhere == BASE == Site.read("base")
    assert str(Site.read("A:cube.+x")) == "A:cube.+x"


def test_parameters_act_in_their_session(c):
    usual = parameters_of(("base-compliance",), c)
    second = parameters_of(("base-compliance@session at base of B",), c)
    rows = c.sessions[1].rows
    assert [p.name for p in second if p.effect == "base-compliance"] == [
        f"B:{p.name}" for p in usual if p.effect == "base-compliance"
    ]
    for p, q in zip(second, usual, strict=False):
        for s, t in zip(p.terms, q.terms, strict=True):
            if p.effect == "base-compliance":
                np.testing.assert_array_equal(s.driver, np.where(rows, t.driver, 0.0))


def test_a_single_session_has_no_such_form(two):
    scene = Scene(two.sessions[0])
    alone = scene.circumstances(scene.rows("calibrate"))
    with pytest.raises(BayescalError, match="base-compliance@session has no parameters here"):
        parameters_of(("base-compliance@session",), alone)
    assert {v.setting for v in candidates(alone, USUAL).variants["base-compliance"]} == {None, "turned"}


def test_variants_pay_for_their_freedom(c):
    found = candidates(c, USUAL).variants["base-compliance"]
    own = [v for v in found if v.setting == "session"]
    assert [str(v.site) for v in own] == ["", "base of A", "base of B"]
    assert np.sum(np.exp([v.log_prior for v in found])) == pytest.approx(1.0)
    assert max(v.log_prior for v in own) < max(v.log_prior for v in found if v.setting is None)


def test_the_base_of_the_second_session_is_named(two):
    gap = diagnose(two)
    assert gap.verdict.kind == "named"
    (name,) = gap.verdict.named
    assert name.effect == "base-compliance"
    assert list(map(str, name.sites)) == ["base of B"]
    fitted = calibrated(Scene(two), (*USUAL, "base-compliance@session at base of B"))
    assert fitted.weights.scale["contact"] < 1.3
