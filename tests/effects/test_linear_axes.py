"""What effects do to a prismatic joint: units and axes, curves along its travel, beams and their equation."""

from dataclasses import replace

import numpy as np
import pytest
from rails import moving_session
from scipy.integrate import solve_bvp
from sessions import circumstances, with_columns

from bayescal.arm.chain import chain_of, link_angles, points
from bayescal.dataset import Target
from bayescal.effects import EFFECTS
from bayescal.effects.common import ORDERS
from bayescal.effects.gravity import cantilever, supported
from bayescal.model import Scene, build, standing

CURVES = {"straightness": ("m", {"tx", "ty"}), "angular-motion": ("rad", {"rx", "ry", "rz"})}
CURVES |= {"positioning": ("m", {"tz"})}


@pytest.fixture(scope="module")
def c():
    return circumstances(moving_session())


def of_rail(c, effect):
    return [p for p in EFFECTS[effect].parameters(c) if p.site.number == 1]


@pytest.mark.parametrize(("effect", "unit"), [
    ("backlash", "m"), ("encoder-scale", "1"), ("unsettled", "s"), ("thermal-drift", "m"),
])  # fmt: skip
def test_a_rail_is_displaced_along_its_axis(c, effect, unit):
    (p,) = of_rail(c, effect)
    assert p.unit == unit
    assert {(t.frame, t.axis) for t in p.terms} == {(1, "tz")}


def test_the_scale_of_a_rail_is_relative(c):
    (p,) = of_rail(c, "encoder-scale")
    np.testing.assert_array_equal(p.terms[0].driver, c.readings[:, 0])
    assert str(p.driver) == "position 1"


@pytest.mark.parametrize("effect", ["eccentricity", "second-harmonic", "coupling"])
def test_what_only_turns_has_no_parameter_at_a_rail(c, effect):
    parameters = EFFECTS[effect].parameters(c)
    assert parameters
    assert all(t.frame > 1 and t.axis == "rz" for p in parameters for t in p.terms)


def test_a_pinion_has_waves_per_metre(c):
    """53 motor turns per metre: the error repeats after 1 / 53 m."""
    waves = of_rail(c, "gear-mesh")
    readings = c.readings.copy()
    readings[:, 0] += 1 / 53
    moved = of_rail(replace(c, readings=readings, q=c.q + np.eye(7)[0] / 53), "gear-mesh")
    for p, again in zip(waves, moved, strict=True):
        assert p.unit == "m"
        np.testing.assert_allclose(p.terms[0].driver, again.terms[0].driver, atol=1e-10)
    assert str(waves[0].driver) == "position 1, 53 times per metre"


def test_a_horizontal_rail_carries_no_weight_along_its_axis(c):
    assert not of_rail(c, "compliance")


def test_a_lifting_column_carries_its_weight(c):
    """Gravity along the rail: its compliance is driven by the weight of carriage, arm, tool and payload."""
    dataset = moving_session()
    upright = circumstances(replace(dataset, gravity=np.array([0.0, -9.81, 0.0])))
    (p,) = of_rail(upright, "compliance")
    mass = dataset.robot.masses.sum() + dataset.tools[0].mass + dataset.measurements.payload
    assert p.unit == "m/N"
    assert [(t.frame, t.axis) for t in p.terms] == [(1, "tz")]
    np.testing.assert_allclose(p.terms[0].driver, -9.81 * mass, rtol=1e-9)
    # A column of 0.2 um/N sinks by 0.2 um for each newton that it carries
    robot = replace(dataset.robot, compliance=np.array([2e-7, *[0.0] * 6]))
    upright = replace(dataset, robot=robot, gravity=np.array([0.0, -9.81, 0.0]))
    mass = robot.masses.sum() + dataset.tools[0].mass + dataset.measurements.payload
    sunk = Scene(upright).q[:, 0] - dataset.measurements.readings[:, 0]
    np.testing.assert_allclose(sunk, -2e-7 * 9.81 * mass, rtol=1e-9)


@pytest.mark.parametrize("effect", CURVES)
def test_curves_have_no_straight_line_and_a_root_mean_square_of_1(c, effect):
    unit, axes = CURVES[effect]
    travel = np.linspace(0.0, 3.0, 4001)  # the limits of the rail
    grid = replace(c, q=np.column_stack([travel, *[np.zeros(4001)] * 6]))
    parameters = EFFECTS[effect].parameters(grid)
    assert {t.axis for p in parameters for t in p.terms} == axes
    assert {p.unit for p in parameters} == {unit}
    for axis in axes:
        curves = np.array([p.terms[0].driver for p in parameters if p.terms[0].axis == axis])
        product = np.trapezoid(curves[:, None] * curves, travel, axis=-1) / 3.0
        np.testing.assert_allclose(product, np.eye(len(curves)), atol=1e-3)
        lowest = [np.ones(4001), travel - 1.5][: 2 if unit == "m" else 1]
        np.testing.assert_allclose(np.trapezoid(curves[:, None] * lowest, travel, axis=-1), 0.0, atol=1e-3)
        assert len(curves) == ORDERS - (1 if unit == "m" else 0)


def bent(length, at, clamped, moment, force):
    """Turn and deflection at a place of a beam of E I = 1, by its differential equation in two parts."""

    def slope(s, y):  # deflection, turn, moment and shear of the part before the load, and of that behind it
        return (
            np.vstack(
                [y[1], y[2], -y[3], 0 * y[3], *(k * y[i] for i, k in ((5, 1), (6, 1), (7, -1))), 0 * y[7]]
            )
            * (np.array([at] * 4 + [length - at] * 4)[:, None])
        )

    def ends(a, b):
        begin = [a[0], a[1]] if clamped else [a[0], a[2]]
        end = [b[6], b[7]] if clamped else [b[4], b[6]]
        return np.array([*begin, *end, b[0] - a[4], b[1] - a[5], b[2] - a[6] - moment, b[3] - a[7] - force])

    found = solve_bvp(slope, ends, np.linspace(0, 1, 11), np.zeros((8, 11)), tol=1e-10)
    assert found.success
    return found.y[1, -1], found.y[0, -1]


@pytest.mark.parametrize(("beam", "clamped"), [(cantilever, True), (supported, False)])
@pytest.mark.parametrize("at", [0.4, 1.1])
def test_beams_satisfy_their_differential_equation(beam, clamped, at):
    length = 1.5
    turn, both, shift = beam(np.array(at), np.array(length - at))
    np.testing.assert_allclose(bent(length, at, clamped, 1.0, 0.0), [turn, both], rtol=1e-6)
    np.testing.assert_allclose(bent(length, at, clamped, 0.0, 1.0), [both, shift], rtol=1e-6)


def test_a_column_bends_under_an_arm_that_reaches_out(c):
    """Where the arm hangs on one side, the end of a column turns and moves to that side."""
    upright = circumstances(replace(moving_session(), gravity=np.array([0.0, -9.81, 0.0])))
    moments = upright.loads.moments[:, 1]
    lengths = upright.q[:, 0]
    for p in EFFECTS["axis-bending"].parameters(upright):
        turned, moved = p.terms
        about = {"rx": 0, "ry": 1}[turned.axis]
        np.testing.assert_allclose(turned.driver, lengths * moments[:, about], atol=1e-9)  # no weight across
        # the top of a column moves by omega x z: about y to +x, about x to -y
        sign = {"tx": 1.0, "ty": -1.0}[moved.axis]
        np.testing.assert_allclose(moved.driver, sign * 0.5 * lengths**2 * moments[:, about], atol=1e-9)


def test_the_speed_of_a_contact_is_that_of_the_ball(c):
    """Of a carriage as of the joints: by differences of the ball's place along the inward normal."""
    normal = np.array([0.6, 0.64, 0.48])
    dataset = replace(moving_session(), targets=(Target("face", "plane", {"normal": normal, "offset": 0.3}),))
    scene, m = Scene(dataset), dataset.measurements
    moved = (with_columns(dataset, readings=m.readings + dt * m.velocity) for dt in (1e-5, -1e-5))
    later, before = map(Scene, moved)
    speed = (before.points - later.points) @ normal / 2e-5
    np.testing.assert_allclose(scene.circumstances().speed, speed, atol=1e-8)


def test_the_stance_has_the_deflection_of_a_carriage_that_the_robot_file_states():
    """An arm hung from a vertical rail that yields: its statics are those of the place where it stands."""
    dataset = moving_session()
    robot = replace(dataset.robot, compliance=np.array([1e-4, 0, 2e-5, 1e-5, 0, 0, 0]))
    along = chain_of(robot).link[0, :3, 2]
    scene = Scene(replace(dataset, robot=robot, gravity=9.81 * (robot.base[:3, :3] @ along)))
    model = build(scene, ("geometry",))
    stance = standing(model, np.zeros(len(model.parameters))).stance
    rigid = link_angles(robot, dataset.measurements.readings)
    assert np.max(abs(scene.q - rigid)[:, 0]) > 1e-3
    there = points(scene.chain, rigid, scene.tools, stance.delta)
    np.testing.assert_allclose(there, scene.points, atol=1e-12)
