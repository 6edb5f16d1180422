"""Coupled axes: an error of an encoder or a gear on the side of the links, or on that of the readings."""

from dataclasses import replace

import numpy as np
import pytest
from gap_problems import BASELINE, Bench

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects import Parameter, location, named, parameters_of
from bayescal.gap.search.candidates import candidates
from bayescal.gap.search.cells import cells
from bayescal.gap.search.refit import model_name
from bayescal.gap.settings import SEARCH
from bayescal.model.scene import Scene


@pytest.fixture(scope="module")
def bench(cube):
    return Bench.of(cube(seed=3, count=120).dataset)


def terms_of(c, effect, joint, side):
    """Turns of a FANUC's second or third joint, written down without the effect: its own link, or both."""
    values = c.velocity if effect == "backlash" else c.readings
    shown = values[:, joint - 1]
    passing = shown if (joint, side) != (3, "link") else values[:, 1] + values[:, 2]
    if effect == "backlash":
        passing = np.sign(passing)
    sense = {2: 1.0, 3: -1.0}[joint]
    terms = [Term(joint, "rz", sense * passing)]
    if (joint, side) == (2, "reading"):
        terms.append(Term(3, "rz", -passing))
    return tuple(terms)


@pytest.mark.parametrize("effect", ["backlash", "encoder-scale"])
@pytest.mark.parametrize(("joint", "side"), [(2, "link"), (2, "reading"), (3, "link"), (3, "reading")])
def test_the_side_of_a_coupled_axis_is_found(bench, effect, joint, side):
    """The name, the joint and the side; and what `--model` takes is that very form."""
    c = bench.circumstances
    truth = Parameter("truth", "rad", terms_of(c, effect, joint, side), 1e-4)
    column = bench.slopes.columns([truth])
    decision, _ = bench.decided(bench.made_up(1, bench.visible(column, 800.0, 1)))
    (member,) = decision.members
    assert (member.effect, member.variant.site) == (effect, f"joint {joint}")
    usual = named(model_name(member, bench.known))[1] or "link"
    assert usual == side
    own = [
        p
        for p in parameters_of((model_name(member, bench.known),), c)
        if p.site == location.joint(joint) and p.effect != "tool"
    ]
    columns = bench.slopes.columns(own)
    np.testing.assert_allclose(
        columns, member.scale * bench.problem.pool[:, member.variant.columns], atol=1e-12
    )


def elevated(c, name):
    """A wide elevation off the middle of a face."""
    face = next(f for f in c.faces if f.name == name)
    far = np.sum(((face.place - [0.3, -0.1]) / [0.5, 0.7]) ** 2, axis=1)
    height = np.exp(-far / 2) * face.rows
    return Parameter("truth", "m", (Term(CONTACT, "normal", -height),), 1e-5)


def test_an_elevation_of_a_face_is_no_wrong_certificate(bench):
    """It changes the mean height and the slopes of the face, which contradicts the certified ones."""
    c = bench.circumstances
    name = c.faces[1].name
    column = bench.slopes.columns([elevated(c, name)])
    decision, _ = bench.decided(bench.made_up(1, bench.visible(column, 150.0, 1)))
    found = [(m.effect, m.variant.site, m.variant.setting) for m in decision.members]
    assert (decision.kind, found) == ("named", [("plane-form", name, "raised")])
    assert decision.probability["artefact"] < 0.05


def test_a_form_that_contradicts_a_certificate_has_a_fifth_of_the_prior_of_a_form(bench):
    share = {}
    for v in bench.known.variants["plane-form"]:
        share[v.setting] = share.get(v.setting, 0.0) + np.exp(v.log_prior)
    assert share["raised"] == pytest.approx(0.2 * SEARCH.other_forms)
    assert sum(share.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("joint", [4, 5])
def test_gravity_holds_a_joint_on_one_flank(bench, joint):
    """Neither motion alone nor torque alone decides: backlash, where it was hardening of both joints."""
    c = bench.circumstances
    torque = c.torques[:, joint - 1]
    friction = 0.3 * np.quantile(np.abs(torque[c.fitted]), 0.9)
    way = np.sign(c.velocity @ c.robot.link_from_reading[joint - 1])
    flank = np.sign(friction * way - torque)
    assert 0.1 < np.mean(flank != way) < 0.9
    truth = Parameter("truth", "rad", (Term(joint, "rz", flank),), 1e-4)
    decision, _ = bench.decided(bench.made_up(1, bench.visible(bench.slopes.columns([truth]), 200.0, 1)))
    (member,) = decision.members
    found = (decision.kind, member.effect, member.variant.site, member.variant.setting)
    assert found == ("named", "backlash", f"joint {joint}", "held-30")
    assert model_name(member, bench.known).startswith(f"backlash@held-30 at joint {joint}")


def test_other_forms_share_a_part_of_the_prior(bench):
    """At all joints, and at each joint where the axes are coupled; none where no axes are."""
    for effect, forms in (("backlash", 3), ("encoder-scale", 1)):
        variants = bench.known.variants[effect]
        assert sum(np.exp(v.log_prior) for v in variants) == pytest.approx(1.0)
        other = [v for v in variants if v.setting == "reading"]
        assert [v.site for v in other] == ["", "joint 2", "joint 3"]
        assert sum(np.exp(v.log_prior) for v in other) == pytest.approx(SEARCH.other_forms / forms)
        assert not [v for v in variants if v.setting == "link"]


def test_uncoupled_axes_have_one_form(bench, cube):
    dataset = cube(seed=3, count=120).dataset
    robot = replace(dataset.robot, link_from_reading=np.diag([1.0, 1, -1, -1, -1, -1]))
    scene = Scene(replace(dataset, robot=robot))
    c = scene.circumstances(scene.rows("calibrate"))
    known = candidates(c, BASELINE)
    for effect in ("backlash", "encoder-scale"):
        held = {"held-30", "held-60"} if effect == "backlash" else set()
        assert {v.setting for v in known.variants[effect]} == {None} | held
        assert sum(np.exp(v.log_prior) for v in known.variants[effect]) == pytest.approx(1.0)
    assert all(
        len(cell.sets) == 1 for cell in cells(c) if str(cell.driver) in ("angle 2", "approach 2", "angle 3")
    )


def test_a_torque_turns_its_own_link(bench):
    """In the cells too, while an angle may turn what the reading moves."""
    of = {(str(cell.site), str(cell.driver)): cell for cell in cells(bench.circumstances)}

    def frames(driver):
        return [{t.frame for p in own for t in p.terms} for own in of["joint 2", driver].sets]

    assert frames("torque 2") == [{2}]
    assert set(map(tuple, frames("past torque 2"))) == {(2,)}
    assert frames("angle 4") == frames("approach 2") == [{2}, {2, 3}]
