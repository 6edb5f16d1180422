"""The TCP at given joint readings as a measurand; the direction of approach that a pose does not state."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.assess.inputs import READINGS, Basis, Input
from bayescal.assess.measurand import POINT, Measurand
from bayescal.errors import BayescalError
from bayescal.estimate.discrepancy import inputs, mixed, sized
from bayescal.estimate.families import families
from bayescal.fitted.arm import FittedArm, Poses
from bayescal.fitted.unmodelled import Circumstance, posed_rows
from bayescal.model import ARM, Model


def lost_motion(
    arm: FittedArm,
    poses_at: Callable[[np.ndarray, np.ndarray, np.ndarray], Poses],
    readings: np.ndarray,
    velocity: np.ndarray,
    poses: Poses,
) -> np.ndarray:
    """Displacements (C, n, 3), m, of TCP positions by the lost motion of each joint of unknown direction.

    The joint rests on either side of its lost motion: one standard deviation from the middle.

    Parameters
    ----------
    arm : FittedArm
    poses_at : callable
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
            out[rows, j] = poses_at(readings[rows], rows, axis).points - poses.points[rows]
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
    here = Circumstance.of(arm.dataset, 1, tool, payload_kg, None, None)
    posed, rows = posed_rows(arm.model, arm.values, here.source, here.changed(readings[None], None), True)
    wide = basis.stated.wide
    around = posed.scene.circumstances(posed.scene.rows("calibrate"))
    functions = [
        *sized(families(around), basis.stated.variances),
        *mixed(inputs(basis.stated.plain, around), basis.stated.inputs.mixing),
    ]
    count = wide.model.slices[ARM].stop
    if len(posed.parameters) + len(functions) != count:
        raise BayescalError(
            "the model discrepancy differs at this pose", "--point-deg", "choose another pose"
        )
    values = np.concatenate([arm.values, np.zeros(len(functions))])
    motion = Model(posed.scene, wide.model.effects, (*posed.parameters, *functions), (), ()).motion(rows)
    position = motion.points(values)
    by_z = np.zeros((3, wide.model.size))
    for axis in range(3):
        u = np.zeros((3, 1))
        u[axis] = 1.0
        by_z[axis, :count] = motion.columns(values, position, u)[:, 0] * wide.model.sd
    independent = []
    if basis.excess:
        independent.append((basis.unexplained(), basis.excess * np.eye(3)))
    middle = arm.at(readings, tool=tool, payload_kg=payload_kg)

    def directed(q: np.ndarray, which: np.ndarray, way: np.ndarray) -> Poses:
        return arm.at(q, tool=tool, payload_kg=payload_kg, direction=way)

    for j, off in enumerate(lost_motion(arm, directed, readings[None], np.zeros((1, n)), middle)[0]):
        if np.any(off):
            name = f"direction of motion of joint {j + 1} is not known"
            side = Input(READINGS, name, "B", "1", 0.0, 1.0, distribution="two values")
            independent.append((side, off[:, None]))
    shown = ", ".join(f"{q:.6g}" for q in np.degrees(readings))
    named = f"TCP at ({shown}) deg"
    return Measurand(POINT, named, "m", None, by_z, tuple(independent), position=position[:, 0])
