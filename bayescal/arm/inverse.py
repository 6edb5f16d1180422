"""Inverse kinematics by damped least squares: one search for every task, limits, and all solutions of a pose.

A task says how far the arm still is from its goal, and the slopes of that error by the angles of the joints
(`NominalArm.angles_of`). The search knows nothing else. The same code therefore serves a nominal arm, a
fitted one (with the nominal slopes, which differ by parts in a thousand) and a contact on a surface. The
damping of the step is proportional to the squared error (Sugihara 2011, doi:10.1109/TRO.2011.2148230), so
that it vanishes at a solution.

All solutions of the inverse kinematics of a pose, and the nearest of them to given readings.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import cross, length

PASSES = 25
STEP = 0.4  # rad a pass; m of a prismatic joint
LEVER = 0.3  # m: lever arm that weights direction errors against position errors
PLACE, DIRECTION = 1e-8, 1e-6  # m, rad: tolerances of a solution
Admits = Callable[[np.ndarray], bool]
"""Whether readings (n,), rad, may be taken."""
Task = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""task(angles (M, n), which (M,)) -> what is missing to the goal (M, k), rad, and its slopes (M, k, n) by the
angles as the arm moves towards it, with lengths divided by `LEVER`; which are solved (M,). `which` are the
numbers of the searches under way, of those that were started."""


def descend(
    task: Task,
    starts: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    passes: int = PASSES,
    free: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the joints at which a task is solved, searched from one start each.

    Parameters
    ----------
    task : Task
    starts : np.ndarray, shape (M, n)
        Initial angles, rad; positions of prismatic joints, m.
    low, high : np.ndarray, shape (n,)
        Limits of the angles, rad.
    passes : int
        Maximum number of steps.
    free : np.ndarray of bool, shape (n,), optional
        Joints that move; all if not given.

    Returns
    -------
    angles : np.ndarray, shape (M, n)
        rad, within the limits.
    converged : np.ndarray, shape (M,)
        Which of them are solutions.
    """
    n = starts.shape[1]
    angles = np.clip(starts, low, high)
    converged = np.zeros(len(starts), bool)
    live = np.arange(len(starts))
    for _ in range(passes):
        error, slopes, solved = task(angles[live], live)
        converged[live[solved]] = True
        keep = ~solved
        live, error, slopes = live[keep], error[keep], slopes[keep]
        if not len(live):
            break
        if free is not None:
            slopes = slopes * free
        damping = 1e-3 * np.sum(error**2, axis=1) + 1e-10
        square = np.swapaxes(slopes, 1, 2) @ slopes + damping[:, None, None] * np.eye(n)
        step = np.linalg.solve(square, np.einsum("mij,mi->mj", slopes, error)[..., None])[..., 0]
        step *= np.minimum(1.0, STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
        angles[live] = np.clip(angles[live] + step, low, high)
    return angles, converged


def to_points(arm: NominalArm, points: np.ndarray) -> Task:
    """The task of bringing the TCP of a nominal arm to `points` (M, 3), m; the orientation is free."""

    def task(angles: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pose = arm.frames(arm.readings_of(angles))
        away = points[which] - arm.ball(pose)
        return away / LEVER, arm.jacobian(pose)[:, :3] / LEVER, length(away) < PLACE

    return task


def to_axes(arm: NominalArm, points: np.ndarray, axes: np.ndarray) -> Task:
    """The task of `to_points` with the z axis of the tool's frame along `axes` (M, 3); its roll is free."""

    def task(angles: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pose = arm.frames(arm.readings_of(angles))
        away = points[which] - arm.ball(pose)
        axis = arm.tool_axis(pose)
        turn = _turn(axis, axes[which])
        j = arm.jacobian(pose)
        j[:, 3:] -= axis[:, :, None] * np.einsum("mi,mij->mj", axis, j[:, 3:])[:, None]
        j[:, :3] /= LEVER
        return np.concatenate([away / LEVER, turn], axis=1), j, _there(away, turn)

    return task


def to_poses(
    arm: NominalArm, poses: np.ndarray, reached: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
) -> Task:
    """The task of bringing the tool's frame to `poses` (M, 4, 4) in F0.

    `reached(readings (K, n), which (K,))`, (K, 4, 4), says where the tool is; of another arm than the nominal
    one the slopes are those of the nominal arm. An arm with fewer than six joints cannot correct all six
    components: with `reached`, only its point is brought there, by the smallest motion of the joints.
    """
    rows = 6 if reached is None or arm.robot.n >= 6 else 3

    def task(angles: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        readings = arm.readings_of(angles)
        pose = arm.frames(readings)
        here = arm.tool_poses(pose) if reached is None else reached(readings, which)
        away, turn = poses_apart(here, poses[which])
        j = arm.jacobian(pose)
        j[:, :3] /= LEVER
        solved = _there(away, turn if rows == 6 else np.zeros_like(turn))
        return np.concatenate([away / LEVER, turn], axis=1)[:, :rows], j[:, :rows], solved

    return task


def to_frames(arm: NominalArm, goals: np.ndarray) -> Task:
    """The task of poses `goals` (M, 4, 4), as far as the arm has joints: pose, axis of the tool, or point."""
    if arm.robot.n >= 6:
        return to_poses(arm, goals)
    points = goals[:, :3, 3]
    return to_axes(arm, points, goals[:, :3, 2]) if arm.robot.n == 5 else to_points(arm, points)


def poses_apart(here: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shifts, m, and rotation vectors, rad, (M, 3) in F0 that bring poses `here` (M, 4, 4) to `there`."""
    from scipy.spatial.transform import Rotation  # slow to import, and many sessions need none

    across = there[:, :3, :3] @ np.swapaxes(here[:, :3, :3], 1, 2)
    return there[:, :3, 3] - here[:, :3, 3], Rotation.from_matrix(across).as_rotvec()


def _there(away: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return (length(away) < PLACE) & (length(turn) < DIRECTION)


def _turn(actual: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Rotation vectors (M, 3), rad, from unit vectors `actual` to `wanted`."""
    across = cross(actual, wanted)
    sine = length(across)
    angle = np.arctan2(sine, np.sum(actual * wanted, axis=1))
    return across * (angle / np.maximum(sine, 1e-12))[:, None]


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
    (begin, low, high), turns = _anywhere(arm), ~arm.robot.slides
    out: list[np.ndarray] = []
    for first in range(0, len(poses), CHUNK):
        goals = poses[first : first + CHUNK]
        each = np.broadcast_to(begin, (len(goals), STARTS, n))
        if starts is not None:
            given = starts[first : first + CHUNK]
            each = np.concatenate([arm.angles_of(given.reshape(-1, n)).reshape(given.shape), each], axis=1)
        count = each.shape[1]
        task = to_poses(arm, np.repeat(goals, count, axis=0))
        angles, converged = descend(task, each.reshape(-1, n), low, high)
        by_pose = zip(angles.reshape(each.shape), converged.reshape(-1, count), strict=True)
        out += [_distinct(_within_a_turn(of_pose[good], turns), turns) for of_pose, good in by_pose]
    return out


def _anywhere(arm: NominalArm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random angles (STARTS, n), and the ends between which a search moves, (n,): limits of what slides."""
    slides, (low, high) = arm.robot.slides, arm.robot.limits.T
    begin = np.random.default_rng(0).uniform(-np.pi, np.pi, (STARTS, arm.robot.n))
    begin = np.where(slides, low + (high - low) * (begin / TURN + 0.5), begin)
    return begin, np.where(slides, low, -np.inf), np.where(slides, high, np.inf)


def _distinct(angles: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Those of solutions (S, n) that differ by more than whole turns."""
    kept = np.empty((0, angles.shape[1]))
    for solution in angles:
        if np.all(np.abs(_within_a_turn(kept - solution, turns)).max(axis=1, initial=0.0) > SAME):
            kept = np.vstack([kept, solution])
    return kept


def _within_a_turn(angle: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Angles (..., n) from -pi to pi, of the joints that turn (n,)."""
    return angle - np.where(turns, TURN, 0.0) * np.round(angle / TURN)


def nearest(
    arm: NominalArm, solved: np.ndarray, references: np.ndarray, admits: Admits | None = None
) -> np.ndarray | None:
    """The readings (n,), SI, of the solution nearest to any of some readings, within the joint limits.

    Nearest by the Euclidean distance of the joint angles; every joint is turned by whole turns towards the
    reference, as far as its limits allow. None where no solution is within them.

    Parameters
    ----------
    arm : NominalArm
    solved : np.ndarray, shape (S, n)
        Angles of `solutions`, rad.
    references : np.ndarray, shape (K, n)
        Readings, rad.
    admits : callable, optional
        Whether readings (n,), rad, may be taken; then all whole turns within the limits are tried.
    """
    least, most = _turns(arm, solved)
    turn = np.where(arm.robot.slides, 0.0, TURN)
    good = np.all(least <= most, axis=1)
    valid, least, most = (part[good, None] for part in (solved, least, most))
    if admits is not None:
        turned = [
            angles[0] + turn * np.array(turns)
            for angles, low, high in zip(valid, least, most, strict=True)
            for turns in product(*(np.arange(a, b + 1) for a, b in zip(low[0], high[0], strict=True)))
        ]
        taken = [angles for angles in turned if admits(arm.readings_of(angles[None])[0])]
        valid = np.array(taken).reshape(-1, 1, arm.robot.n)
        least = most = np.zeros(valid.shape)
    if not len(valid):
        return None
    goal = arm.angles_of(references)[None]
    candidates = valid + turn * np.clip(np.round((goal - valid) / TURN), least, most)
    away = np.linalg.norm(candidates - goal, axis=2)
    return arm.readings_of(candidates[np.unravel_index(np.argmin(away), away.shape)][None])[0]


def _turns(arm: NominalArm, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest number of whole turns (S, n) that leave angles (S, n) within the limits."""
    low, high = arm.robot.limits.T
    least, most = np.ceil((low - TOUCHES - angles) / TURN), np.floor((high + TOUCHES - angles) / TURN)
    within = (angles >= low - TOUCHES) & (angles <= high + TOUCHES)
    slides = arm.robot.slides  # no turns: least > most where it is beyond its limits
    return np.where(slides, np.where(within, 0.0, 1.0), least), np.where(slides, 0.0, most)


def without_solution(arm: NominalArm, pose: np.ndarray, solved: np.ndarray) -> str:
    """Why none of the solutions `solved` (S, n) of a pose (4, 4) can be taken: limits, or what is missing.

    Of the solution that exceeds the limits least, all joints beyond them are listed.
    """
    low, high = arm.robot.limits.T
    if len(solved):
        turn = np.where(arm.robot.slides, 0.0, TURN)
        centred = solved + turn * np.round(((low + high) / 2 - solved) / TURN)
        excess = np.maximum(np.maximum(low - centred, centred - high), 0.0).max(axis=1)
        return beyond_limits(arm, centred[np.argmin(excess)])
    starts, least, most = _anywhere(arm)
    goal = np.tile(pose[:3, 3], (STARTS, 1))
    angles, there = descend(to_points(arm, goal), starts, least, most)
    if np.any(there):
        return "the point is within reach, but not with this orientation"
    short = np.linalg.norm(arm.ball(arm.frames(arm.readings_of(angles))) - goal, axis=1).min()
    return f"out of reach by {1e3 * short:.0f} mm"


def beyond_limits(arm: NominalArm, angles: np.ndarray) -> str:
    """The joints whose angles (n,), rad, are beyond their limits, as text; "" if none is."""
    low, high = arm.robot.limits.T
    bad = np.flatnonzero((angles < low - TOUCHES) | (angles > high + TOUCHES))
    each = [
        f"{arm.robot.joint_names[k]} at {a:.1f} {arm.robot.units[k]}, limits {b:.0f} to {c:.0f}"
        for k, a, b, c in zip(bad, *arm.robot.shown(np.array([angles, low, high]))[:, bad], strict=True)
    ]
    return f"beyond the joint limits ({'; '.join(each)})" if each else ""
