"""Names of effects in a model: what a text selects, and what is refused."""

import numpy as np
import pytest

from bayescal.effects import parameters_of
from bayescal.effects.deflection import compliances
from bayescal.effects.location import joint, link
from bayescal.effects.selection import Selection, shortest
from bayescal.effects.vocabulary import same_terms
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.exporting.robot import calibrated_robot
from bayescal.model import check_asked
from bayescal.model.scene import Scene


@pytest.fixture(scope="module")
def c(cube):
    scene = Scene(cube(seed=1).dataset)
    return scene.circumstances(scene.rows("calibrate"))


@pytest.mark.parametrize(
    "asked",
    [
        Selection("backlash"),
        Selection("step", "212"),
        Selection("backlash", "reading", (joint(3),), factor=4.0),
        Selection("bending", None, (link(2), joint(4)), factor=0.125),
        Selection(
            "gear-mesh",
            "50",
            (joint(3),),
            ("angle 3 100 times a turn", "angle 3 200 times a turn"),
            factor=0.1 + 0.2,
        ),
        Selection("compliance", together=True, factor=1.0),
    ],
)
def test_a_name_reads_as_it_is_written(asked):
    assert Selection.read(str(asked)) == asked
    assert "," not in str(asked)


def test_sites_drivers_and_priors(c):
    whole = {p.name: p for p in parameters_of(("backlash",), c) if p.effect == "backlash"}
    (one,) = (p for p in parameters_of(("backlash  at joint 3 x4",), c) if p.effect == "backlash")
    usual = whole[one.name]
    assert (one.site, one.sd, one.mean) == (joint(3), 4 * usual.sd, 0.0)
    assert same_terms(one.terms, usual.terms)
    both = parameters_of(("backlash at joint 3 and joint 4",), c)
    assert [p.site for p in both if p.effect == "backlash"] == [joint(3), joint(4)]
    of_angle = [p for p in parameters_of(("coupling at joint 5 by angle 4",), c) if p.effect == "coupling"]
    assert [(str(p.site), str(p.driver)) for p in of_angle] == [("joint 5", "angle 4")]
    own = [p for p in parameters_of(("compliance at joint 2",), c) if p.effect == "compliance"]
    assert own[0].mean > 0  # the usual prior
    (wide,) = (p for p in parameters_of(("compliance at joint 2 x1",), c) if p.effect == "compliance")
    assert (wide.sd, wide.mean) == (own[0].sd, own[0].nominal)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("backlash at joint 9", "no parameters at `joint 9`; its sites are: joint 1, joint 2"),
        ("backlash at", "no effect is called `backlash at`"),
        (
            "coupling at joint 5 by angle 1",
            "no parameters by `angle 1` there; its drivers there are: angle 3, ang",
        ),
        ("backlash in proportion", "no parameters in proportion there; say backlash"),
        ("backlash at joint 3 x0", "'0' is not a number above 0"),
        ("backlash x-2", "'-2' is not a number above 0"),
        ("back lash", "no effect is called `back lash`"),
    ],
)
def test_names_that_cannot_be(name, words, c):
    with pytest.raises(BayescalError) as caught:
        parameters_of((name,), c)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_effect_is_named_once():
    with pytest.raises(BayescalError, match=r"named twice.*'backlash at joint 2 and joint 3'"):
        check_asked(("backlash at joint 2", "backlash at joint 3"), 1.0)


@pytest.mark.parametrize("value", [0.125, 8.0, 1.0, 1234.5625, 1 / 3, 212.0])
def test_numbers_are_not_rounded(value):
    assert float(shortest(value)) == value


def test_compliance_in_proportion_is_the_same_stiffness_everywhere(cube):
    """Statics and robot.yaml have the compliances that the common factor stands for."""
    found = calibrated(Scene(cube(seed=1).dataset), ("geometry", "compliance in proportion"))
    model = found.model
    k = next(k for k, p in enumerate(model.parameters) if p.effect == "compliance")
    factor = model.deviations(found.z[: len(model.parameters)])[k]
    usual = {p.site.number: p.centre for p in model.parameters[k].stands_for}
    assert factor > 0.2
    robot = calibrated_robot(found.model, found.arm)
    assert {j: robot.compliance[j - 1] for j in usual} == pytest.approx(
        {j: factor * v for j, v in usual.items()}
    )
    known = compliances(model.parameters, model.deviations(found.z[: len(model.parameters)]))
    np.testing.assert_allclose(list(known.values()), [factor * v for v in usual.values()])
