from dataclasses import replace

import numpy as np
import pytest
from simulated import robot_file

from bayescal.arm.transforms import rigid
from bayescal.probing.approach import layout
from bayescal.probing.reach import Arm, cone, inverse
from bayescal.robots import load_robot

TOOL = np.array([0.06, 0.0, 0.12])


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "standard", "seven", "four"])
def test_inverse_reaches_what_it_says_within_the_limits(name, tmp_path):
    robot, _ = load_robot(name if name.startswith("fanuc") else robot_file(tmp_path, name))
    arm, rng = Arm(robot, TOOL), np.random.default_rng(1)
    pose = arm.frames(arm.anywhere(300, rng))
    centres, axes = arm.ball(pose), pose[:, -1, :3, 2]
    readings, found = inverse(arm, arm.anywhere(300, rng), centres, axes)
    assert found.mean() > 0.2
    there = arm.frames(readings[found])
    assert np.abs(arm.ball(there) - centres[found]).max() < 1e-7
    if robot.n >= 5:
        assert np.sum(there[:, -1, :3, 2] * axes[found], axis=1).min() > 1 - 1e-9
    sign = np.sign(np.diag(robot.link_from_reading))
    limited = readings @ robot.link_from_reading.T * sign  # of the FANUC's third joint, J2 + J3
    assert np.all(limited > robot.limits[:, 0])
    assert np.all(limited < robot.limits[:, 1])


def test_arms_of_equal_content_are_equal():
    """Whatever they are called by: one number of another arm makes it another one."""
    robot, _ = load_robot("fanuc-lrmate200ic")
    arm, same = Arm(robot, TOOL), Arm(load_robot("fanuc-lrmate200ic")[0], TOOL.copy())
    assert arm == same
    assert hash(arm) == hash(same)
    for other in (
        Arm(replace(robot, limits=robot.limits * 0.9), TOOL),
        Arm(replace(robot, base=rigid(None, np.array([0.0, 0.0, 1.0]))), TOOL),
        Arm(robot, TOOL + 1e-9),
    ):
        assert arm != other


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "standard", "seven"])
def test_jacobian_is_the_slope_of_place_and_turn(name, tmp_path):
    robot, _ = load_robot(name if name.startswith("fanuc") else robot_file(tmp_path, name))
    arm = Arm(robot, TOOL)
    angles = arm.angles_of(arm.anywhere(5, np.random.default_rng(2)))
    j = arm.jacobian(arm.frames(arm.readings_of(angles)))
    for k in range(robot.n):
        step = np.zeros(robot.n)
        step[k] = 1e-6
        up, down = (arm.frames(arm.readings_of(angles + s * step)) for s in (1, -1))
        assert np.allclose((arm.ball(up) - arm.ball(down)) / 2e-6, j[:, :3, k], atol=1e-8)
        turn = (up - down)[:, -1, :3, 2] / 2e-6
        axis = arm.frames(arm.readings_of(angles))[:, -1, :3, 2]
        assert np.allclose(turn, np.cross(j[:, 3:, k], axis), atol=1e-8)


def test_cone_is_filled():
    axis = np.tile([0.0, 0.6, 0.8], (4000, 1))
    angle = np.arccos(np.sum(axis * cone(axis, 1.0, np.random.default_rng(0)), axis=1))
    assert angle.max() < 1.0
    assert np.mean(angle < 0.5) == pytest.approx((1 - np.cos(0.5)) / (1 - np.cos(1.0)), abs=0.03)


def test_layout_has_its_length_and_no_two_spheres_touch():
    for count in range(2, 9):
        centres = layout(count, 0.3)
        away = np.linalg.norm(centres[:, None] - centres, axis=2)[np.triu_indices(count, 1)]
        assert len(centres) == count
        assert away.max() == pytest.approx(0.3)
        assert away.min() > 0.0508
