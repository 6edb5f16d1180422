"""Alignments of vectors and points: what they promise where the answer is known, and where there is none."""

import numpy as np
import pytest

from analysis.world import reach
from bayescal.arm.inverse import (
    descend,
    nearest,
    poses_apart,
    solutions,
    to_axes,
    to_frames,
    to_points,
    to_poses,
    without_solution,
)
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import alignment, cross, length, rigid, rigid_alignment, rotation, rpy_matrix
from bayescal.robots import load_robot

TURN = rpy_matrix(np.array([0.4, -1.1, 2.5]))
PLACED = rigid(TURN, np.array([0.3, -2.0, 1.5]))
POINTS = np.random.default_rng(0).normal(size=(7, 3))


def moved(points: np.ndarray) -> np.ndarray:
    return points @ TURN.T + PLACED[:3, 3]


def test_exact_points_give_their_transform():
    np.testing.assert_allclose(rigid_alignment(moved(POINTS), POINTS), PLACED, atol=1e-14)
    np.testing.assert_allclose(alignment(POINTS @ TURN.T, POINTS), TURN, atol=1e-14)


def test_points_of_a_plane_are_not_reflected():
    flat = POINTS * [1, 1, 0]
    np.testing.assert_allclose(rigid_alignment(moved(flat), flat), PLACED, atol=1e-14)
    assert np.linalg.det(rigid_alignment(-POINTS, POINTS)[:3, :3]) == pytest.approx(1.0)


def test_weights_are_those_of_repeated_points():
    to = moved(POINTS) + 0.1 * np.random.default_rng(1).normal(size=(7, 3))
    count = np.array([1, 3, 1, 2, 1, 5, 1])
    repeated = rigid_alignment(np.repeat(to, count, axis=0), np.repeat(POINTS, count, axis=0))
    np.testing.assert_allclose(rigid_alignment(to, POINTS, count.astype(float)), repeated, atol=1e-13)
    assert np.abs(rigid_alignment(to, POINTS) - repeated).max() > 1e-3


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("own", [POINTS[:1], POINTS[:2], np.ones((4, 3)), np.outer([0.0, 1, 2], [1, 2, 3])])
def test_undetermined_alignments_still_bring_the_points_together(own):
    """One point, coincident points, points of a line: any of the best transforms, and no warning."""
    np.testing.assert_allclose(own @ (t := rigid_alignment(moved(own), own))[:3, :3].T + t[:3, 3], moved(own))


@pytest.mark.parametrize("shape", [(3,), (7, 3), (50, 9, 3)])
def test_lengths_and_cross_products_are_those_of_numpy(shape):
    v = np.random.default_rng(0).normal(size=(2, *shape))
    for a, b in (v, np.asfortranarray(v), 1e-9 * v):
        np.testing.assert_array_equal(length(a), np.linalg.norm(a, axis=-1))
        np.testing.assert_array_equal(cross(a, b), np.cross(a, b))


# --- Inverse kinematics against closed forms that share no code with it.

TOOL = np.array([0.06, 0.0, 0.12])


def arm_of(name: str) -> NominalArm:
    robot, _ = load_robot(name)
    return NominalArm(robot, TOOL, rpy_matrix(np.array([0.3, -0.5, 1.0])))


def random_readings(arm: NominalArm, count: int, seed: int = 0, share: float = 0.9) -> np.ndarray:
    low, high = share * np.clip(arm.robot.limits, -np.pi, np.pi).T
    return arm.readings_of(np.random.default_rng(seed).uniform(low, high, (count, arm.robot.n)))


def ur_in_closed_form(robot, flange: np.ndarray) -> list[np.ndarray]:
    """Up to eight solutions of a UR arm from its modified DH table: joints 2 to 4 move in a plane."""
    d1, d4, d5, d6 = robot.d[[0, 3, 4, 5]]
    a2, a3 = robot.a[[2, 3]]
    x, y, _ = flange[:3, 3] - d6 * flange[:3, 2]
    aside, out = np.arcsin(d4 / np.hypot(x, y)), []
    for t1 in (np.arctan2(y, x) + aside, np.arctan2(y, x) + np.pi - aside):
        plane = np.array([np.sin(t1), -np.cos(t1), 0.0]) @ flange[:3, :3]  # (s5 c6, -s5 s6, c5)
        for t5 in np.arccos(np.clip(plane[2], -1, 1)) * np.array([1, -1]):
            t6 = np.arctan2(-plane[1] * np.sin(t5), plane[0] * np.sin(t5))
            wrist = rigid(rotation(0, np.pi / 2) @ rotation(2, t5)) @ rigid(None, np.array([0, 0, d5]))
            last = rigid(rotation(0, -np.pi / 2) @ rotation(2, t6))
            wrist = wrist @ last @ rigid(None, np.array([0, 0, d6]))
            root = rigid(rotation(2, t1) @ rotation(0, np.pi / 2), np.array([0, 0, d1]))
            four = np.linalg.inv(root) @ flange @ np.linalg.inv(wrist)
            px, py = four[:2, 3]
            bend = (px**2 + py**2 - a2**2 - a3**2) / (2 * a2 * a3)
            for t3 in np.arccos(bend) * np.array([1, -1]) if abs(bend) < 1 else ():
                t2 = np.arctan2(py, px) - np.arctan2(a3 * np.sin(t3), a2 + a3 * np.cos(t3))
                t4 = np.arctan2(four[1, 0], four[0, 0]) - t2 - t3
                out.append(np.array([t1, t2, t3, t4, t5, t6]))
    return out


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether angles are equal up to whole turns."""
    return np.abs(np.angle(np.exp(1j * (a - b)))).max() < 1e-4


def test_all_solutions_of_a_ur5e():
    arm = arm_of("universal-robots-ur5e")
    pose = arm.frames(random_readings(arm, 30))
    for own, flange in zip(solutions(arm, arm.tool_poses(pose)), pose[:, -1], strict=True):
        expected = ur_in_closed_form(arm.robot, flange)
        assert len(own) == len(expected)
        assert all(any(same(a, b) for b in own) for a in expected)


def test_solutions_of_an_arm_with_coupled_axes():
    """Elbow up before the arm, both wrists, by the closed form of the independent simulator."""
    arm = NominalArm(load_robot("fanuc-lrmate200ic")[0], reach.nominal().tool)
    rng, count = np.random.default_rng(1), 60
    place = rng.uniform([0.3, -0.3, -0.1], [0.55, 0.3, 0.4], (count, 3))
    turn = rpy_matrix(rng.uniform([2.0, -0.7, -3.0], [4.0, 0.7, 3.0], (count, 3)))
    expected = reach.readings(place, turn, rng.random(count) < 0.5)
    good = reach.within(expected)
    assert good.sum() > 15
    poses = np.array([rigid(r, p) for r, p in zip(turn[good], place[good], strict=True)])
    for own, closed in zip(solutions(arm, poses), expected[good], strict=True):
        assert np.abs(nearest(arm, own, closed[None] + 0.3) - closed).max() < 1e-5


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "abb-irb120", "kuka-iiwa7"])
def test_solutions_reach_their_pose_within_the_limits(name):
    arm = arm_of(name)
    readings = random_readings(arm, 12)
    poses = arm.tool_poses(arm.frames(readings))
    found = solutions(arm, poses, readings[:, None])
    for own, pose, own_readings in zip(found, poses, readings, strict=True):
        assert np.abs(nearest(arm, own, own_readings[None]) - own_readings).max() < 1e-5
        here = arm.tool_poses(arm.frames(arm.readings_of(own)))
        away, turn = poses_apart(here, np.broadcast_to(pose, here.shape))
        assert np.abs(away).max() < 1e-8
        assert np.abs(turn).max() < 1e-6


def test_whole_turns_go_towards_the_reference_within_the_limits():
    arm = arm_of("fanuc-lrmate200ic")  # joint 6: two turns; joint 4: 190 deg each way
    angles = np.radians([[10, 20, 30, -175, 40, 100]])
    for goal, expected in ((-175, 100), (-175, 100)), ((185, -260), (185, -260)), ((300, 500), (185, 100)):
        reference = np.radians([[10, 20, 30, goal[0], 40, goal[1]]])
        chosen = arm.angles_of(nearest(arm, angles, arm.readings_of(reference))[None])
        assert np.degrees(chosen[0, [3, 5]]) == pytest.approx(expected)


def test_why_there_is_no_solution():
    arm = arm_of("fanuc-lrmate200ic")
    far = rigid(None, np.array([2.0, 0.0, 0.3]))
    reason = without_solution(arm, far, solutions(arm, far[None])[0])
    assert reason.startswith("out of reach by 1")
    near = rigid(rpy_matrix(np.array([0.0, -np.pi / 2, 0.0])), np.array([0.8, 0.0, 0.2]))  # flange outwards
    assert "not with this orientation" in without_solution(arm, near, solutions(arm, near[None])[0])
    beyond = arm.readings_of(np.radians([[10.0, 150, 30, 20, 40, 50]]))  # joint 2: 140 deg at most
    pose = arm.tool_poses(arm.frames(beyond))
    own = solutions(arm, pose)[0]
    only = own[[k for k in range(len(own)) if same(own[k], arm.angles_of(beyond)[0])]]
    assert nearest(arm, only, beyond) is None
    reason = "beyond the joint limits (J2 at 150.0 deg, limits -60 to 140)"
    assert without_solution(arm, pose[0], only) == reason


def test_joints_that_are_not_free_stay():
    arm = arm_of("fanuc-lrmate200ic")
    starts = arm.angles_of(random_readings(arm, 50))
    goals = np.random.default_rng(2).uniform([0.3, -0.2, 0.0], [0.5, 0.2, 0.3], (50, 3))
    anywhere = np.full(6, np.inf)
    angles, found = descend(to_points(arm, goals), starts, -anywhere, anywhere, free=np.arange(6) < 3)
    assert found.mean() > 0.5
    assert np.array_equal(angles[:, 3:], starts[:, 3:])
    ball = arm.ball(arm.frames(arm.readings_of(angles[found])))
    assert np.abs(ball - goals[found]).max() < 1e-8


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "kuka-iiwa7"])
def test_what_is_found_has_the_orientation_too(name):
    """Searches that begin at the right point with another orientation do not end there."""
    arm = arm_of(name)
    goals = arm.tool_poses(arm.frames(random_readings(arm, 80, share=0.6)))
    points, axes = goals[:, :3, 3], goals[:, :3, 2]
    low, high = arm.robot.limits.T
    begin, there = descend(to_points(arm, points), arm.angles_of(random_readings(arm, 80, 1)), low, high)
    assert there.mean() > 0.5
    fitted = to_poses(arm, goals, lambda readings, which: arm.tool_poses(arm.frames(readings)))
    by_task = {"pose": to_poses(arm, goals), "fitted": fitted, "frame": to_frames(arm, goals)}
    by_task["axis"] = to_axes(arm, points, axes)
    for task, own in by_task.items():
        angles, found = descend(own, begin, low, high, passes=60)
        assert (found & there).sum() > 15, task
        reached = arm.tool_poses(arm.frames(arm.readings_of(angles[found])))
        away, turn = poses_apart(reached, goals[found])
        assert np.abs(away).max() < 1.1e-8
        across = np.cross(reached[:, :3, 2], axes[found])
        assert np.abs(across if task == "axis" else turn).max() < 1.1e-6
        assert (np.abs(turn).max() > 0.1) == (task == "axis")  # its roll is free


def test_another_arm_is_reached_with_the_slopes_of_the_nominal_one():
    """An arm whose table is wrong and whose joints wave: to rounding, in a few passes."""
    arm = arm_of("universal-robots-ur5e")
    other = NominalArm(load_robot("universal-robots-ur5")[0], TOOL, arm.tool_axes)

    def reached(readings: np.ndarray, which: np.ndarray) -> np.ndarray:
        return other.tool_poses(other.frames(readings + 1e-4 * np.sin(200 * readings)))

    readings = random_readings(arm, 20)
    goals = reached(readings, np.arange(20))
    anywhere = np.full(6, np.inf)
    angles, found = descend(to_poses(arm, goals, reached), readings + 0.01, -anywhere, anywhere, passes=60)
    assert found.mean() > 0.9
    away, turn = poses_apart(reached(angles[found], np.arange(found.sum())), goals[found])
    assert np.abs(away).max() < 1e-8
    assert np.abs(turn).max() < 1e-6
