"""The chain and its statics against Pinocchio, on tables of both conventions."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayescal.arm.chain import Robot, chain_of, displaced, frames, link_angles, points
from bayescal.arm.statics import Stance, gravity_loads
from bayescal.arm.transforms import AXES

LOAD, AT = 1.3, np.array([0.02, -0.03, 0.06])


def screw(axis: str, angle: float, slide: float) -> pin.SE3:
    """A turn about and a slide along one axis, in Pinocchio's own words."""
    return pin.SE3(pin.utils.rotate(axis, angle), slide * np.eye(3)["xyz".index(axis)])


def pinocchio_of(robot: Robot) -> tuple[pin.Model, pin.SE3]:
    """The same table as a Pinocchio model, links as point masses, and the flange behind its last joint."""
    model = pin.Model()
    parent, placed = 0, pin.SE3(robot.base)
    for i in range(robot.n):
        hayati = pin.SE3(pin.utils.rotate("y", robot.beta[i]), np.zeros(3))
        row = screw("x", robot.alpha[i], robot.a[i]) * hayati
        height = pin.SE3(np.eye(3), np.array([0, 0, robot.d[i]]))
        before, behind = (row, height) if robot.convention == "mdh" else (pin.SE3.Identity(), height * row)
        parent = model.addJoint(parent, pin.JointModelRZ(), placed * before, f"j{i}")
        if robot.masses is not None:
            own = pin.Inertia(robot.masses[i], robot.centres_of_mass[i], np.zeros((3, 3)))
            model.appendBodyToJoint(parent, own, behind)
        placed = behind
    if robot.masses is not None:
        model.appendBodyToJoint(parent, pin.Inertia(LOAD, AT, np.zeros((3, 3))), placed)
    return model, placed


@st.composite
def robots(draw, least: int = 1) -> Robot:
    """Arms of 1 to 7 joints in either convention, with masses, a base anywhere and coupled readings."""
    n = draw(st.integers(least, 7))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    base = pin.SE3(pin.rpy.rpyToMatrix(rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3))
    return Robot(
        name="any",
        convention=draw(st.sampled_from(("mdh", "dh"))),
        joint_names=tuple(f"J{i + 1}" for i in range(n)),
        alpha=draw(st.sampled_from((rng.uniform(-3, 3, n), rng.choice([0, np.pi / 2, -np.pi / 2], n)))),
        a=rng.uniform(-0.5, 0.5, n),
        d=rng.uniform(-0.5, 0.5, n),
        offset=rng.uniform(-3, 3, n),
        beta=draw(st.sampled_from((0.0, 0.1))) * rng.standard_normal(n),
        limits=np.tile([-3.0, 3.0], (n, 1)),
        link_from_reading=np.eye(n) + np.tril(rng.uniform(-1, 1, (n, n)), -1),
        base=base.homogeneous,
        masses=rng.uniform(0, 10, n),
        centres_of_mass=rng.uniform(-0.2, 0.2, (n, 3)),
    )


def check_kinematics(robot: Robot, readings: np.ndarray, tool: np.ndarray) -> None:
    model, flange = pinocchio_of(robot)
    data = model.createData()
    q = link_angles(robot, readings)
    chain = chain_of(robot)
    found, ball = frames(chain, q), points(chain, q, tool)
    for k, reading in enumerate(readings):
        pin.forwardKinematics(model, data, robot.link_from_reading @ reading + robot.offset)
        pose = data.oMi[robot.n] * flange
        np.testing.assert_allclose(found[k, -1], pose.homogeneous, atol=2e-13)
        np.testing.assert_allclose(ball[k], pose.act(tool), atol=2e-13)
        for i in range(robot.n):  # ours stand behind the joint's Tz, Pinocchio's before it
            ours = data.oMi[i + 1] * pin.SE3(np.eye(3), np.array([0, 0, robot.d[i]]))
            np.testing.assert_allclose(found[k, i + 1], ours.homogeneous, atol=2e-13)
        np.testing.assert_allclose(found[k, 0], robot.base, atol=0)


def moments_of(robot: Robot, q: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    count = len(q)
    load, at = np.full(count, LOAD), np.tile(AT, (count, 1))
    return gravity_loads(robot, chain_of(robot), q, gravity, load, at).moments


def check_statics(robot: Robot, q: np.ndarray, gravity: np.ndarray) -> None:
    """Torques by Pinocchio's gravity, all three components by the forces that its joints bear at rest."""
    model, _ = pinocchio_of(robot)
    model.gravity.linear = gravity
    data = model.createData()
    ours = moments_of(robot, q, gravity)
    still = np.zeros(robot.n)
    for k, angles in enumerate(q):
        held = pin.computeGeneralizedGravity(model, data, angles)
        np.testing.assert_allclose(ours[k, 1:, 2], -held, atol=1e-11)  # the weight pulls, the motor holds
        pin.rnea(model, data, angles, still, still)
        for i in range(robot.n):
            force = data.f[i + 1]
            about = force.angular - np.cross([0, 0, robot.d[i]], force.linear)
            np.testing.assert_allclose(ours[k, i + 1], -about, atol=1e-11)


@settings(max_examples=40)
@given(robots(), st.integers(0, 2**32 - 1))
def test_random_arms(robot, seed):
    rng = np.random.default_rng(seed)
    check_kinematics(robot, rng.uniform(-3, 3, (3, robot.n)), rng.uniform(-0.2, 0.2, 3))
    check_statics(robot, rng.uniform(-3, 3, (3, robot.n)), np.array([1.0, -2.0, -9.0]))


def misbuilt(robot: Robot, rng: np.random.Generator) -> tuple[Robot, np.ndarray]:
    """A robot whose rows and base are a little wrong, and the same as displacements of its frames."""
    delta = 0.05 * rng.standard_normal((robot.n + 2, 6))
    delta[1:-1, 4:] = 0.0  # no row has room for a turn about y behind its twist
    delta[-1] = 0.0
    mdh = robot.convention == "mdh"
    if mdh:  # behind the last joint there is no row
        delta[-2, 2:] = 0.0
    rows = slice(1, None) if mdh else slice(None)
    turns = delta[1 : robot.n, 2:] if mdh else delta[1:-1, 2:]
    alpha, a = robot.alpha.copy(), robot.a.copy()
    alpha[rows] += turns[:, 0]
    a[rows] += turns[:, 1]
    parts = [screw(axis, *delta[0, 2 * k : 2 * k + 2]) for k, axis in enumerate("zxy")]
    base = pin.SE3(robot.base) * parts[0] * parts[1] * parts[2]
    offset, d = robot.offset + delta[1:-1, 0], robot.d + delta[1:-1, 1]
    return replace(robot, alpha=alpha, a=a, offset=offset, d=d, base=base.homogeneous), delta


@settings(max_examples=40)
@given(robots(), st.integers(0, 2**32 - 1))
def test_displaced_arms_are_misbuilt_ones(robot, seed):
    """Frames, and the moments of the weights on them, where the arm stands beside its drawing."""
    rng = np.random.default_rng(seed)
    wrong, delta = misbuilt(robot, rng)
    q, gravity = rng.uniform(-3, 3, (3, robot.n)), np.array([1.0, -2.0, -9.0])
    there, turned = np.tile(delta, (3, 1, 1)), q + delta[1:-1, 0]
    chain, other = chain_of(robot), chain_of(wrong)
    np.testing.assert_allclose(frames(chain, q, there), frames(other, turned), atol=1e-12)
    load, at = np.full(3, LOAD), np.tile(AT, (3, 1))
    found = gravity_loads(robot, chain, q, gravity, load, at, Stance(there, 0.0 * there)).moments
    expected = moments_of(wrong, turned, gravity)
    # that of the base stays about the base as drawn: the moment of the same weights about another place
    weight = (np.sum(robot.masses) + LOAD) * gravity
    about = expected[:, 0] @ wrong.base[:3, :3].T + np.cross(wrong.base[:3, 3] - robot.base[:3, 3], weight)
    expected[:, 0] = about @ robot.base[:3, :3]
    own = [0, 2]  # the y axis of a frame stands behind its turn about x
    np.testing.assert_allclose(found[..., own], expected[..., own], atol=1e-10)
    check_statics(wrong, turned, gravity)
    drawn = gravity_loads(robot, chain, q, gravity, load, at, Stance(0.0 * there, 0.0 * there)).moments
    np.testing.assert_allclose(drawn, moments_of(robot, q, gravity), atol=1e-12)


@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_loads_are_the_slopes_of_potential_energy_by_every_displacement(lrmate, convention):
    """Of an arm that stands beside its drawing: turns and slides of all frames, each along its own axis."""
    robot = replace(lrmate, convention=convention)
    rng = np.random.default_rng(4)
    built, yields = 0.02 * rng.standard_normal((2, 1, 8, 6))
    built[:, 0] = 0.0
    yields[:, [0, 7]] = 0.0
    if convention == "mdh":  # a turn of the next row turns the hinges about y, but not the link's own mass
        built[..., 2:] = 0.0
    q, gravity, h = rng.uniform(-3, 3, (1, 6)), np.array([0.5, 1.0, -9.7]), 1e-5
    chain, load = chain_of(robot), np.array([LOAD])
    found = gravity_loads(robot, chain, q, gravity, load, AT[None], Stance(built + yields, yields))

    def energy(frame: int, axis: int, by: float) -> float:
        more = np.zeros_like(yields)
        more[:, frame, axis] = by
        pose, out = frames(chain, q, built + yields + more), 0.0
        bodies = [(LOAD, pose[0, 7] @ np.append(AT, 1.0))]
        for i, (mass, centre) in enumerate(zip(robot.masses, robot.centres_of_mass, strict=True), start=1):
            if convention == "dh":
                centre = (chain.link[i] @ np.append(centre, 1.0))[:3]
            moves = (yields + more)[0, i] if convention == "mdh" else (built + yields + more)[0, i]
            own = np.append(displaced(centre, np.where(np.arange(6) < 2, 0.0, moves)), 1.0)
            bodies.append((mass, pose[0, i] @ own))
        for mass, where in bodies:
            out -= mass * gravity @ where[:3]
        return out

    for frame in range(7):
        for k, axis in enumerate("xyz"):
            for kind, loads in (("r", found.moments), ("t", found.weights)):
                at = AXES.index(f"{kind}{axis}")
                slope = (energy(frame, at, h) - energy(frame, at, -h)) / (2 * h)
                assert loads[0, frame, k] == pytest.approx(-slope, abs=1e-7), (frame, kind, axis)


def test_lrmate_against_the_published_table():
    """Typed in from the published table, not read from the built-in file."""
    rows = [(0, 0, 0), (-90, 75, 0), (0, 300, 0), (-90, 75, 320), (90, 0, 0), (-90, 0, 80)]
    from bayescal.robots import load_robot

    robot, _ = load_robot("fanuc-lrmate200ic")
    assert robot.masses.sum() == pytest.approx(21.25)
    for degrees in np.random.default_rng(2).uniform(-180, 180, (100, 6)):
        j1, j2, j3, j4, j5, j6 = degrees
        pose = pin.SE3.Identity()
        for (alpha, a, d), theta in zip(rows, (j1, j2 - 90, -(j3 + j2), -j4, -j5, -j6), strict=True):
            pose = pose * screw("x", np.radians(alpha), a / 1e3) * screw("z", np.radians(theta), d / 1e3)
        ours = frames(chain_of(robot), link_angles(robot, np.radians(degrees)[None]))[0, -1]
        np.testing.assert_allclose(ours, pose.homogeneous, atol=1e-14)
