"""Whether the way to a contact and back is free: the straight path of the ball along the outward normal."""

from __future__ import annotations

import numpy as np

from bayescal.arm.inverse import LEVER
from bayescal.arm.nominal import NominalArm
from bayescal.collision.check import Clearance

RETRACT = 0.02
"""m: how far the ball is retracted; touch probes are backed off by 2 to 25 mm before the next approach."""

STOPS = 4  # points that are checked on the path
FIRM = 30.0
"""Weight of the path against the orientation of the tool: near a singularity the orientation gives way."""

DAMPING = 0.2
"""Of rotations: those that need joint motions 1 / DAMPING times as large are made by half. With 0.02, a step
near a singularity of the wrist moved the ball by up to 9 mm off its path."""


def path_free(
    clearance: Clearance,
    readings: np.ndarray,
    normals: np.ndarray,
    touched: np.ndarray | None = None,
    length: float = RETRACT,
    stops: int = STOPS,
) -> np.ndarray:
    """Check the retract from contacts, which is also their approach.

    Parameters
    ----------
    clearance : Clearance
    readings : np.ndarray, shape (M, n)
        Of the contacts, rad.
    normals : np.ndarray, shape (M, 3)
        Outward unit normals of the surface, in F0.
    touched : np.ndarray of int, shape (M,), optional
        As for `Clearance.collides`.
    length : float
        Of the path, m.
    stops : int
        Number of points that are checked, at equal distances; the contact itself is not one of them.

    Returns
    -------
    np.ndarray of int, shape (M,)
        0 if free, otherwise an index into `clearance.reasons`; -1 if the path leaves the joint limits.
    """
    out = np.zeros(len(readings), int)
    at = np.array(readings, float)
    arm = clearance.arm
    for _ in range(stops):
        at = retracted(arm, at, length / stops * normals)
        angles = arm.angles_of(at)
        within = np.all((angles >= arm.robot.limits[:, 0]) & (angles <= arm.robot.limits[:, 1]), axis=1)
        out[(out == 0) & ~within] = -1
        left = np.flatnonzero(out == 0)
        if not len(left):
            break
        out[left] = clearance.collides(at[left], None if touched is None else touched[left])
    return out


def retracted(arm: NominalArm, readings: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Readings (M, n), rad, with the ball moved by small `shifts` (M, 3), m, and the tool's orientation kept.

    One damped Jacobian step. Arms with fewer than six joints, and poses near a singularity, keep the path and
    turn the tool a little.
    """
    j = arm.jacobian(arm.frames(readings))
    weight = FIRM / LEVER
    j[:, :3] *= weight
    goal = np.concatenate([weight * shifts, np.zeros_like(shifts)], axis=1)
    square = np.swapaxes(j, 1, 2) @ j + DAMPING**2 * np.eye(arm.robot.n)
    step = np.linalg.solve(square, (np.swapaxes(j, 1, 2) @ goal[..., None]))[..., 0]
    return readings + arm.readings_of(step)
