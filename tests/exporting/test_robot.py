"""The calibrated robot as DH rows moves exactly as the displaced chain does."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal import effects
from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.effects import Effect, Parameter, Site, Term
from bayescal.estimate import estimate
from bayescal.exporting.robot import calibrated_robot
from bayescal.model import ARM, build
from bayescal.model.scene import Scene


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_rows_move_as_the_model(cube, convention, tied):
    session = cube(seed=1, count=60).dataset
    if convention == "dh":  # any rows will do: the same numbers read the other way
        session = replace(session, robot=replace(session.robot, convention="dh"))
    if tied:
        targets = tuple(replace(t, u=1e-3, u_angle=1e-3) for t in session.targets)
        tools = tuple(replace(t, u=1e-3) for t in session.tools)
        session = replace(session, targets=targets, tools=tools)
    scene = Scene(session)
    model = build(scene, ("geometry",))
    found = estimate(build(Scene(cube(seed=1, count=60).dataset), ("geometry",)))
    rng = np.random.default_rng(0)
    fake = replace(found, model=model, z=2.0 * rng.standard_normal(model.size))
    robot = calibrated_robot(fake.model, fake.arm)
    values = model.deviations(fake.z[model.slices[ARM]])
    tool = scene.tools[0].copy()
    for value, p in zip(values, model.parameters, strict=True):
        if p.effect == "tool":
            tool["xyz".index(p.name[-1])] += value
    rows = np.arange(len(scene.q))
    expected = model.motion(rows).points_reference(values).T
    q = link_angles(robot, session.measurements.readings)
    np.testing.assert_allclose(points(chain_of(robot), q, tool), expected, atol=1e-12)


def test_compliance_goes_along(cube):
    found = estimate(build(Scene(cube(seed=1, count=120).dataset), ("geometry", "compliance")))
    robot = calibrated_robot(found.model, found.arm)
    named = {p.name: v for p, v in zip(found.model.parameters, found.model.physical(found.z), strict=False)}
    assert robot.compliance is not None
    assert robot.compliance[1] == pytest.approx(named["compliance J2"], rel=1e-12)
    assert robot.name.endswith("-calibrated")


@pytest.mark.parametrize("effect", ["encoder-scale", "encoder-scale@link", "encoder-scale@reading", "joint"])
@pytest.mark.parametrize("coupling", ["display", "mechanical"])
def test_scales_go_along(cube, effect, coupling):
    """On whichever side of the coupled axes the encoders sit."""
    session = cube(seed=1, count=60).dataset
    session = replace(session, robot=replace(session.robot, coupling=coupling))
    scene = Scene(session)
    model = build(scene, (effect,))
    rng = np.random.default_rng(0)
    for j in range(1, 7):  # one at a time: scales of two joints multiply, which the model does not know
        z = np.zeros(model.size)
        own = [k for k, p in enumerate(model.parameters) if p.name == f"encoder-scale J{j}"]
        z[own] = 3.0 * rng.standard_normal()
        robot = calibrated_robot(model, model.deviations(z[model.slices[ARM]]))
        expected = (
            model.motion(np.arange(len(scene.q))).points_reference(model.deviations(z[model.slices[ARM]])).T
        )
        q = link_angles(robot, session.measurements.readings)
        np.testing.assert_allclose(points(chain_of(robot), q, scene.tools), expected, atol=1e-12)
        assert np.max(np.abs(expected - scene.points)) > 1e-6
        assert robot.coupling == coupling


def test_a_registered_effect_of_a_similar_name_is_no_scale(cube):
    """Its parameter displaces the base; the ratios of the encoders stay nominal."""
    shift = Parameter("encoder-scale-drift x", "m", (Term(0, "tx"),), 1e-3, site=Site("joint", 1))
    effects.register(Effect("encoder-scale-drift", "the base shifts", lambda c: [shift]))
    try:
        scene = Scene(cube(seed=1, count=60).dataset)
        model = build(scene, ("encoder-scale-drift",))
        z = np.zeros(model.size)
        z[0] = 2.0
        robot = calibrated_robot(model, model.deviations(z[model.slices[ARM]]))
    finally:
        effects.unregister("encoder-scale-drift")
    np.testing.assert_array_equal(robot.link_from_reading, scene.dataset.robot.link_from_reading)
    np.testing.assert_allclose(robot.base[:3, 3], scene.dataset.robot.base[:3, 3] + [2e-3, 0, 0], atol=1e-12)
