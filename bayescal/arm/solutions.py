"""All solutions of the inverse kinematics of a pose, and the nearest of them to given readings."""

from __future__ import annotations

import numpy as np

from bayescal.arm.inverse import descend, to_points, to_poses
from bayescal.arm.nominal import NominalArm

STARTS = 60
"""Random starts a pose: of 60 poses each of three arms they find 948 of 949 solutions, 40 starts 945."""
CHUNK = 100  # poses that are solved at once: memory
SAME = 1e-4  # rad: solutions closer than this in every joint, up to whole turns, are one
TURN = 2 * np.pi
TOUCHES = 1e-9  # rad: a joint at its limit is within it


def solutions(arm: NominalArm, poses: np.ndarray, starts: np.ndarray | None = None) -> list[np.ndarray]:
    """All solutions of each pose of the tool's frame, up to whole turns of the joints and without limits.

    The limits are left out of the search because it ends at them short of solutions beside them; `nearest`
    applies them.

    Parameters
    ----------
    arm : NominalArm
    poses : np.ndarray, shape (M, 4, 4)
        In F0.
    starts : np.ndarray, shape (M, K, n), optional
        Readings from which a search starts too, rad: of an arm with more than six joints, whose solutions are
        a continuum, those near them are found.

    Returns
    -------
    list of np.ndarray, shape (S, n)
        Angles of the joints (`NominalArm.angles_of`), rad, from -pi to pi; S = 0 where there is none.
    """
    n = arm.robot.n
    begin = np.random.default_rng(0).uniform(-np.pi, np.pi, (STARTS, n))
    anywhere = np.full(n, np.inf)
    out: list[np.ndarray] = []
    for first in range(0, len(poses), CHUNK):
        goals = poses[first : first + CHUNK]
        each = np.broadcast_to(begin, (len(goals), STARTS, n))
        if starts is not None:
            given = starts[first : first + CHUNK]
            each = np.concatenate([arm.angles_of(given.reshape(-1, n)).reshape(given.shape), each], axis=1)
        count = each.shape[1]
        task = to_poses(arm, np.repeat(goals, count, axis=0))
        angles, found = descend(task, each.reshape(-1, n), -anywhere, anywhere)
        by_pose = zip(angles.reshape(each.shape), found.reshape(-1, count), strict=True)
        out += [_distinct(_within_a_turn(own[good])) for own, good in by_pose]
    return out


def _distinct(angles: np.ndarray) -> np.ndarray:
    """Those of solutions (S, n) that differ by more than whole turns."""
    kept = np.empty((0, angles.shape[1]))
    for own in angles:
        if np.all(np.abs(_within_a_turn(kept - own)).max(axis=1, initial=0.0) > SAME):
            kept = np.vstack([kept, own])
    return kept


def _within_a_turn(angle: np.ndarray) -> np.ndarray:
    return angle - TURN * np.round(angle / TURN)


def nearest(arm: NominalArm, found: np.ndarray, references: np.ndarray) -> np.ndarray | None:
    """The readings (n,), rad, of the solution nearest to any of some readings, within the joint limits.

    Nearest by the Euclidean distance of the joint angles; every joint is turned by whole turns towards the
    reference, as far as its limits allow. None where no solution is within them.

    Parameters
    ----------
    arm : NominalArm
    found : np.ndarray, shape (S, n)
        Angles of `solutions`, rad.
    references : np.ndarray, shape (K, n)
        Readings, rad.
    """
    low, high = arm.robot.limits.T
    least, most = np.ceil((low - TOUCHES - found) / TURN), np.floor((high + TOUCHES - found) / TURN)
    good = np.all(least <= most, axis=1)
    if not np.any(good):
        return None
    own, least, most = (part[good, None] for part in (found, least, most))
    goal = arm.angles_of(references)[None]
    candidates = own + TURN * np.clip(np.round((goal - own) / TURN), least, most)
    away = np.linalg.norm(candidates - goal, axis=2)
    return arm.readings_of(candidates[np.unravel_index(np.argmin(away), away.shape)][None])[0]


def without_solution(arm: NominalArm, pose: np.ndarray, found: np.ndarray) -> str:
    """Why none of the solutions `found` (S, n) of a pose (4, 4) can be taken: limits, or what is missing.

    Of the solution that exceeds the limits least, all joints beyond them are listed.
    """
    low, high = arm.robot.limits.T
    if len(found):
        middle = (low + high) / 2
        own = found + TURN * np.round((middle - found) / TURN)
        excess = np.maximum(np.maximum(low - own, own - high), 0.0)
        best = int(np.argmin(excess.max(axis=1)))
        beyond = [
            f"{name} at {angle:.1f} deg, limits {least:.0f} to {most:.0f}"
            for name, angle, least, most in zip(
                arm.robot.joint_names, *np.degrees([own[best], low, high]), strict=True
            )
            if not least - np.degrees(TOUCHES) <= angle <= most + np.degrees(TOUCHES)
        ]
        return f"beyond the joint limits ({'; '.join(beyond)})"
    starts = np.random.default_rng(0).uniform(-np.pi, np.pi, (STARTS, arm.robot.n))
    anywhere = np.full(arm.robot.n, np.inf)
    goal = np.tile(pose[:3, 3], (STARTS, 1))
    angles, there = descend(to_points(arm, goal), starts, -anywhere, anywhere)
    if np.any(there):
        return "the point is within reach, but not with this orientation"
    short = np.linalg.norm(arm.ball(arm.frames(arm.readings_of(angles))) - goal, axis=1).min()
    return f"out of reach by {1e3 * short:.0f} mm"
