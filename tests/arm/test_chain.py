"""The readable chain against finite differences and its own conventions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_pinocchio import robots

from bayescal.arm.chain import chain_of, frames, link_angles, points, wrenches
from bayescal.arm.transforms import AXES, rigid, rotation, rpy_matrix, rpy_of

ANGLES = st.floats(-3.14, 3.14)


@given(st.tuples(ANGLES, st.floats(-1.57, 1.57), ANGLES))
def test_rpy_round_trip(rpy):
    np.testing.assert_allclose(rpy_of(rpy_matrix(rpy)), rpy, atol=1e-9)


@given(st.tuples(ANGLES, st.sampled_from((-np.pi / 2, np.pi / 2)), ANGLES))
def test_rpy_at_gimbal_lock(rpy):
    matrix = rpy_matrix(rpy)
    np.testing.assert_allclose(rpy_matrix(rpy_of(matrix)), matrix, atol=1e-12)


def test_rpy_is_about_fixed_axes():
    """Roll first, about F0's x; then pitch about F0's y; then yaw about F0's z."""
    turned = rpy_matrix(np.radians([90, 0, 90])) @ [0, 1, 0]  # y to z by the roll, where it stays
    np.testing.assert_allclose(turned, [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(rpy_matrix(np.radians([0, 90, 0])) @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(
        rigid(rotation(2, np.pi / 2), [1, 2, 3]) @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-15
    )


def test_readings_to_link_angles(lrmate):
    """The pendant's J3 is taken against the floor: J2 alone turns link 3 back."""
    at = link_angles(lrmate, np.radians([[10.0, 20, 30, 40, 50, 60], [0, 20, -20, 0, 0, 0]]))
    np.testing.assert_allclose(
        np.degrees(at), [[10, -70, -50, -40, -50, -60], [0, -70, 0, 0, 0, 0]], atol=1e-12
    )


def by_hand(chain, q, tool, delta):
    """One point by 4 x 4 matrices, in the order that the chain's docstring gives."""

    def displaced(x):
        out = np.eye(4)
        for k, name in enumerate(AXES):
            axis = "xyz".index(name[1])
            out = out @ (
                rigid(rotation(axis, x[k])) if name[0] == "r" else rigid(None, x[k] * np.eye(3)[axis])
            )
        return out

    pose = chain.base @ displaced(delta[0]) @ chain.link[0]
    for i in range(1, chain.n + 1):
        pose = (
            pose @ rigid(rotation(2, q[i - 1]), [0, 0, chain.d[i - 1]]) @ displaced(delta[i]) @ chain.link[i]
        )
    return (pose @ rigid(None, tool) @ displaced(delta[-1]))[:3, 3]


@given(robots(), st.integers(0, 2**32 - 1))
def test_displaced_points(robot, seed):
    rng = np.random.default_rng(seed)
    chain = chain_of(robot)
    q, tool = rng.uniform(-3, 3, (3, robot.n)), rng.uniform(-0.2, 0.2, (3, 3))
    delta = rng.uniform(-0.1, 0.1, (2, 3, robot.n + 2, 6))
    found = points(chain, q, tool, delta)
    assert found.shape == (2, 3, 3)
    for walker in range(2):
        for k in range(3):
            np.testing.assert_allclose(
                found[walker, k], by_hand(chain, q[k], tool[k], delta[walker, k]), atol=1e-13
            )


@given(robots(), st.integers(0, 2**32 - 1))
def test_wrenches_are_slopes(robot, seed):
    """All 6 (n + 2) displacements, away from zero."""
    rng = np.random.default_rng(seed)
    chain, n, h = chain_of(robot), robot.n, 1e-5
    q, tool, u = rng.uniform(-3, 3, (2, n)), rng.uniform(-0.2, 0.2, (2, 3)), rng.standard_normal((2, 3))
    delta = rng.uniform(-0.1, 0.1, (2, n + 2, 6))
    step = h * np.eye(6 * (n + 2)).reshape(-1, 1, n + 2, 6)
    slope = (points(chain, q, tool, delta + step) - points(chain, q, tool, delta - step)) / (2 * h)
    found = wrenches(chain, q, tool, delta, u).reshape(2, -1)
    np.testing.assert_allclose(found, np.sum(slope * u, axis=-1).T, atol=2e-9)


@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_displacements_are_dh_errors(lrmate, convention):
    """A wrong theta, d, alpha or a in the table moves the ball as its displacement does, exactly."""
    robot = replace(lrmate, convention=convention)
    rng = np.random.default_rng(0)
    q, tool = rng.uniform(-3, 3, (5, 6)), np.array([0.06, 0.01, 0.12])
    theta, d, alpha, a = 0.05 * rng.standard_normal((4, 6))
    wrong = replace(robot, d=robot.d + d, alpha=robot.alpha + alpha, a=robot.a + a)
    delta = np.zeros((5, 8, 6))
    at = slice(0, 6) if convention == "mdh" else slice(1, 7)
    delta[:, 1:7, 0], delta[:, 1:7, 1], delta[:, at, 2], delta[:, at, 3] = theta, d, alpha, a
    found = points(chain_of(robot), q, tool, delta)
    np.testing.assert_allclose(found, points(chain_of(wrong), q + theta, tool), atol=1e-14)


@given(robots(), st.integers(0, 2**32 - 1))
def test_displaced_frames_carry_the_ball(robot, seed):
    """Of displacements that differ from row to row; the tool's may only slide its ball."""
    rng = np.random.default_rng(seed)
    q, tool = rng.uniform(-3, 3, (4, robot.n)), rng.uniform(-0.2, 0.2, (4, 3))
    delta = 0.1 * rng.standard_normal((4, robot.n + 2, 6))
    delta[:, -1, ::2] = 0.0
    chain = chain_of(robot)
    pose = frames(chain, q, delta)
    ball = (pose[:, -1, :3, :3] @ tool[..., None])[..., 0] + pose[:, -1, :3, 3]
    np.testing.assert_allclose(ball, points(chain, q, tool, delta), atol=1e-12)
    np.testing.assert_allclose(frames(chain, q, 0 * delta), frames(chain, q), atol=1e-14)
