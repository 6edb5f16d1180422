"""Prismatic joints anywhere in a chain: kernel, wrenches and slopes against the reference and differences."""

import numpy as np
import pytest

from bayescal.arm.chain import Robot, chain_of, frames, link_angles, points, wrenches
from bayescal.arm.inverse import nearest, solutions, without_solution
from bayescal.arm.motion import Motion, NominalArm, Term
from bayescal.arm.transforms import AXES, rigid, rotation

STEP = 1e-6
KINDS = ["PRRRRRR", "RRPR", "PP", "RPRPRP"]


def robot_of(kinds, convention="mdh", seed=0):
    """A random arm with joints of some kinds, P or R; each reading also moves the next joint a little."""
    rng, n = np.random.default_rng(seed), len(kinds)
    slides = np.array([kind == "P" for kind in kinds])
    coupling = np.diag(rng.choice([-1.0, 1.0], n)) + np.diag(rng.uniform(-0.2, 0.2, n - 1), -1)
    return Robot(
        name=kinds, convention=convention, joint_names=tuple(f"J{k}" for k in range(n)),
        alpha=rng.uniform(-2, 2, n), a=rng.uniform(-0.4, 0.4, n), d=rng.uniform(-0.4, 0.4, n),
        offset=rng.uniform(-3, 3, n), beta=rng.uniform(-0.1, 0.1, n),
        limits=np.where(slides[:, None], [-0.5, 2.0], [-3.0, 3.0]), link_from_reading=coupling,
        base=rigid(rotation(0, 0.3), [0.1, 0.2, 0.3]), prismatic=slides,
    )  # fmt: skip


def by_rows(robot, readings):
    """The flange (4, 4) by products of rows, as the robot file states them."""
    q = robot.link_from_reading @ readings
    out = robot.base
    for k in range(robot.n):
        theta, d = robot.offset[k], robot.d[k]
        theta, d = (theta, d + q[k]) if robot.slides[k] else (theta + q[k], d)
        joint = rigid(rotation(2, theta), [0, 0, d])
        shift, hayati = rigid(None, [robot.a[k], 0, 0]), rigid(rotation(1, robot.beta[k]))
        twist = rigid(rotation(0, robot.alpha[k]))
        mdh = robot.convention == "mdh"
        out = out @ (twist @ shift @ hayati @ joint if mdh else joint @ shift @ twist @ hayati)
    return out


@pytest.mark.parametrize("convention", ["mdh", "dh"])
@pytest.mark.parametrize("kinds", KINDS)
def test_the_chain_is_the_product_of_the_rows(kinds, convention):
    robot = robot_of(kinds, convention)
    readings = np.random.default_rng(1).uniform(-1, 1, (5, robot.n))
    found = frames(chain_of(robot), link_angles(robot, readings))[:, -1]
    np.testing.assert_allclose(found, [by_rows(robot, r) for r in readings], atol=1e-13)


@pytest.mark.parametrize("convention", ["mdh", "dh"])
@pytest.mark.parametrize("kinds", KINDS)
def test_kernel_wrenches_and_differences_agree(kinds, convention):
    robot, rng = robot_of(kinds, convention), np.random.default_rng(2)
    chain, n, count = chain_of(robot), robot.n, 150  # more than a block of the kernel
    q = link_angles(robot, rng.uniform(-1, 1, (count, n)))
    tool, u = 0.1 * rng.normal(size=(count, 3)), rng.normal(size=(3, count))
    size = 6 * (n + 2)
    terms = [(6 * f + a, Term(f, AXES[a])) for f in range(n + 2) for a in range(6)]
    driven = (Term(frame, axis, rng.normal(size=count)) for frame, axis in ((1, "tz"), (n, "rx")))
    terms += enumerate(driven, start=size)
    motion = Motion(chain, q, tool, terms, size + 2)
    values = 0.01 * rng.normal(size=size + 2)
    delta, p = motion.displacements(values), motion.points(values)
    np.testing.assert_allclose(p.T, points(chain, q, tool, delta), atol=1e-13)
    columns = motion.columns(values, p, u)
    reference = wrenches(chain, q, tool, delta, u.T).reshape(count, -1).T
    np.testing.assert_allclose(columns[:size], reference, atol=1e-12)
    step = STEP * np.eye(size + 2)
    slopes = (motion.points(values + step) - motion.points(values - step)) / (2 * STEP)
    np.testing.assert_allclose(columns, np.sum(slopes * u, axis=1), atol=1e-8)
    some = np.arange(0, count, 7)
    np.testing.assert_allclose(motion.at_rows(some).points(values), p[:, some], atol=1e-14)
    delta[:, -1] = 0.0  # a turn of the tool about itself moves no point of the flange
    turned, moved = motion.turns(values), frames(chain, q, delta)[:, -1, :3, :3]
    np.testing.assert_allclose(np.moveaxis(turned, -1, 0), moved, atol=1e-13)


@pytest.mark.parametrize("kinds", KINDS)
def test_slopes_of_the_nominal_arm(kinds):
    robot = robot_of(kinds)
    arm = NominalArm(robot, np.array([0.05, 0.02, 0.1]))
    angles = np.random.default_rng(3).uniform(-1, 1, (4, robot.n))
    found = arm.jacobian(arm.frames(arm.readings_of(angles)))

    def at(shift):
        pose = arm.frames(arm.readings_of(angles + shift))
        return arm.ball(pose), pose[:, -1, :3, :3]

    for k, step in enumerate(STEP * np.eye(robot.n)):
        (p, a), (q, b) = at(step), at(-step)
        np.testing.assert_allclose(found[:, :3, k], (p - q) / (2 * STEP), atol=1e-8)
        skew = (a - b) @ np.swapaxes(a + b, 1, 2) / (4 * STEP)
        turn = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
        np.testing.assert_allclose(found[:, 3:, k], turn, atol=1e-8)


def test_inverse_kinematics_keeps_a_carriage_on_its_rail():
    arm = NominalArm(robot_of("PRRRRRR", seed=4), np.zeros(3))
    angles = np.array([[0.5, 0.3, -0.6, 0.4, 0.8, 0.7, -0.2], [1.5, 1.0, 0.5, 0.9, -1.0, 1, 1]])
    readings = arm.readings_of(angles)
    poses = arm.tool_poses(arm.frames(readings))
    for k, found in enumerate(solutions(arm, poses, readings[:, None])):
        assert np.all((found[:, 0] >= -0.5) & (found[:, 0] <= 2.0))
        best = nearest(arm, found, readings[[k]])
        np.testing.assert_allclose(best, readings[k], atol=1e-6)  # not shifted by whole turns
    far = poses[0].copy()
    far[:3, 3] += 20.0
    assert without_solution(arm, far, np.empty((0, 7))).startswith("out of reach by")
    beyond = np.array([[4.0, 0.3, -0.6, 0.4, 0.8, 0.7, -0.2]])
    assert nearest(arm, beyond, readings) is None
    assert "J0 at 4000.0 mm, limits -500 to 2000" in without_solution(arm, poses[0], beyond)
