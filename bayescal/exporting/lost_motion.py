"""What a pose does not state: from which side each joint came to it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.exporting.fitted import FittedArm, Poses


def lost_motion(
    arm: FittedArm,
    at: Callable[[np.ndarray, np.ndarray, np.ndarray], Poses],
    readings: np.ndarray,
    velocity: np.ndarray,
    poses: Poses,
) -> np.ndarray:
    """Displacements (C, n, 3), m, of TCP positions by the lost motion of each joint of unknown direction.

    The joint rests on either side of its lost motion: one standard deviation from the middle.

    Parameters
    ----------
    arm : FittedArm
    at : callable
        Poses for readings (R, n), the numbers (R,) of their rows, and directions (n,) to add.
    readings, velocity : np.ndarray, shape (C, n)
        rad; signs of the motion before the pose, 0 where it is not known.
    poses : Poses
        In the middle of the lost motion.
    """
    out = np.zeros((len(readings), readings.shape[1], 3))
    if not any(p.driver.kind in ("direction", "flank") for p in arm.model.parameters):
        return out
    for j, axis in enumerate(np.eye(readings.shape[1])):
        rows = np.flatnonzero(velocity[:, j] == 0)
        if len(rows):
            out[rows, j] = at(readings[rows], rows, axis).points - poses.points[rows]
    return out
