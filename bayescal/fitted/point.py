"""The TCP at given joint readings as a measurand; the direction of approach that a pose does not state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.assess.inputs import READINGS, Basis, Input
from bayescal.assess.measurand import POINT, Measurand
from bayescal.errors import BayescalError
from bayescal.fitted.arm import FittedArm, Poses
from bayescal.fitted.unmodelled import Unmodelled
from bayescal.model import ARM


def lost_motion(poses: Poses, velocity: np.ndarray) -> np.ndarray:
    """Displacements (C, n, 3), m, of TCP positions by the lost motion of each joint of unknown direction.

    The joint rests on either side of its lost motion: one standard deviation from the middle.

    Parameters
    ----------
    poses : Poses
        In the middle of the lost motion.
    velocity : np.ndarray, shape (C, n)
        Signs of the motion before the pose, 0 where it is not known.
    """
    out = np.zeros((*velocity.shape, 3))
    if not any(p.driver.kind in ("direction", "flank") for p in poses.arm.model.parameters):
        return out
    for j, axis in enumerate(np.eye(velocity.shape[1])):
        rows = np.flatnonzero(velocity[:, j] == 0)
        if len(rows):
            out[rows, j] = poses.again(rows, velocity=velocity[rows] + axis).points - poses.points[rows]
    return out


def point(
    arm: FittedArm, basis: Basis, readings: np.ndarray, *, tool: str | None = None, payload_kg: float = 0.0
) -> Measurand:
    """Position of the TCP that the calibrated arm reaches, in F0: its error vector.

    Parameters
    ----------
    arm : FittedArm
    basis : Basis
        Of the same fit.
    readings : np.ndarray, shape (n,)
        rad, as the controller shows them.
    tool : str, optional
        Name; default: that of the last fitted row.
    payload_kg : float
        kg, beyond the tool.

    Raises
    ------
    BayescalError
        If the number of readings is wrong, there is no such tool, or the arm has no equilibrium.
    """
    n = arm.dataset.robot.n
    if readings.shape != (n,) or not np.all(np.isfinite(readings)):
        what = f"{readings.size} readings, or one that is no finite number, for {n} joints"
        raise BayescalError(what, "--point-deg", "give one reading in deg for each joint, with commas")
    with_errors = replace(arm, unmodelled=Unmodelled.of(basis))  # with the signs of its unknowns
    poses, unknowns = with_errors.at(readings, tool=tool, payload_kg=payload_kg), basis.stated.wide.model
    units = np.append(arm.model.sd, np.ones(len(poses.errors)))  # of the unknowns: errors have unit variance
    by_z = np.zeros((3, unknowns.size))
    by_z[:, : unknowns.slices[ARM].stop] = poses.by_all[0] * units
    independent = []
    if basis.excess:
        independent.append((basis.unexplained(), basis.excess * np.eye(3)))
    for j, off in enumerate(lost_motion(poses, np.zeros((1, n)))[0]):
        if np.any(off):
            name = f"direction of motion of joint {j + 1} is not known"
            side = Input(READINGS, name, "B", "1", 0.0, 1.0, distribution="two values")
            independent.append((side, off[:, None]))
    shown = ", ".join(f"{q:.6g}" for q in arm.dataset.robot.shown(readings))
    named = f"TCP at ({shown}) {arm.dataset.robot.unit_words}"
    return Measurand(POINT, named, "m", None, by_z, tuple(independent), position=poses.points[0])
