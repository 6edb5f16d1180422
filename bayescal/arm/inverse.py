"""Inverse kinematics by damped least squares: one search for every task, limits, and all solutions of a pose.

A task says how far the arm still is from its goal, and the slopes of that error by the angles of the joints
(`NominalArm.angles_of`). The search knows nothing else. The same code therefore serves a nominal arm, a
fitted one (with the nominal slopes, which differ by parts in a thousand) and a contact on a surface. The
damping of the step is proportional to the squared error (Sugihara 2011, doi:10.1109/TRO.2011.2148230), so
that it vanishes at a solution.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.arm.nominal import NominalArm
from bayescal.arm.transforms import cross, length

PASSES = 25
STEP = 0.4  # rad a pass
LEVER = 0.3  # m: lever arm that weights direction errors against position errors
PLACE, DIRECTION = 1e-8, 1e-6  # m, rad: tolerances of a solution
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
        Initial angles, rad.
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
    found : np.ndarray, shape (M,)
        Which of them are solutions.
    """
    n = starts.shape[1]
    angles = np.clip(starts, low, high)
    found = np.zeros(len(starts), bool)
    live = np.arange(len(starts))
    for _ in range(passes):
        error, slopes, solved = task(angles[live], live)
        found[live[solved]] = True
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
    return angles, found


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
        own = arm.tool_axis(pose)
        turn = _turn(own, axes[which])
        j = arm.jacobian(pose)
        j[:, 3:] -= own[:, :, None] * np.einsum("mi,mij->mj", own, j[:, 3:])[:, None]
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


def _turn(own: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Rotation vectors (M, 3), rad, from unit vectors `own` to `wanted`."""
    across = cross(own, wanted)
    sine = length(across)
    angle = np.arctan2(sine, np.sum(own * wanted, axis=1))
    return across * (angle / np.maximum(sine, 1e-12))[:, None]
