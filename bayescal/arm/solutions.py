"""All solutions of the inverse kinematics of a pose, and the nearest of them to given readings."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

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


def nearest(
    arm: NominalArm,
    found: np.ndarray,
    references: np.ndarray,
    admits: Callable[[np.ndarray], bool] | None = None,
) -> np.ndarray | None:
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
    admits : callable, optional
        Whether readings (n,), rad, may be taken; then all whole turns within the limits are tried.
    """
    least, most = _turns(arm, found)
    good = np.all(least <= most, axis=1)
    own, least, most = (part[good, None] for part in (found, least, most))
    if admits is not None:
        turned = [
            angles[0] + TURN * np.array(turns)
            for angles, low, high in zip(own, least, most, strict=True)
            for turns in product(*(np.arange(a, b + 1) for a, b in zip(low[0], high[0], strict=True)))
        ]
        taken = [angles for angles in turned if admits(arm.readings_of(angles[None])[0])]
        own = np.array(taken).reshape(-1, 1, arm.robot.n)
        least = most = np.zeros(own.shape)
    if not len(own):
        return None
    goal = arm.angles_of(references)[None]
    candidates = own + TURN * np.clip(np.round((goal - own) / TURN), least, most)
    away = np.linalg.norm(candidates - goal, axis=2)
    return arm.readings_of(candidates[np.unravel_index(np.argmin(away), away.shape)][None])[0]


def _turns(arm: NominalArm, found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest number of whole turns (S, n) that leave angles (S, n) within the limits."""
    low, high = arm.robot.limits.T
    return np.ceil((low - TOUCHES - found) / TURN), np.floor((high + TOUCHES - found) / TURN)


def without_solution(arm: NominalArm, pose: np.ndarray, found: np.ndarray) -> str:
    """Why none of the solutions `found` (S, n) of a pose (4, 4) can be taken: limits, or what is missing.

    Of the solution that exceeds the limits least, all joints beyond them are listed.
    """
    low, high = arm.robot.limits.T
    if len(found):
        own = found + TURN * np.round(((low + high) / 2 - found) / TURN)
        excess = np.maximum(np.maximum(low - own, own - high), 0.0).max(axis=1)
        return beyond_limits(arm, own[np.argmin(excess)])
    starts = np.random.default_rng(0).uniform(-np.pi, np.pi, (STARTS, arm.robot.n))
    anywhere = np.full(arm.robot.n, np.inf)
    goal = np.tile(pose[:3, 3], (STARTS, 1))
    angles, there = descend(to_points(arm, goal), starts, -anywhere, anywhere)
    if np.any(there):
        return "the point is within reach, but not with this orientation"
    short = np.linalg.norm(arm.ball(arm.frames(arm.readings_of(angles))) - goal, axis=1).min()
    return f"out of reach by {1e3 * short:.0f} mm"


def beyond_limits(arm: NominalArm, angles: np.ndarray) -> str:
    """The joints whose angles (n,), rad, are beyond their limits, as text; "" if none is."""
    low, high = arm.robot.limits.T
    bad = np.flatnonzero((angles < low - TOUCHES) | (angles > high + TOUCHES))
    each = [
        f"{arm.robot.joint_names[k]} at {a:.1f} deg, limits {b:.0f} to {c:.0f}"
        for k, a, b, c in zip(bad, *np.degrees([angles[bad], low[bad], high[bad]]), strict=True)
    ]
    return f"beyond the joint limits ({'; '.join(each)})" if each else ""
