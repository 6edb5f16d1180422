"""Whether a session has enough rows to calibrate an arm at all."""

from __future__ import annotations

from math import ceil

import numpy as np

from bayescal.errors import BayescalError
from bayescal.estimate.linear import linearise
from bayescal.estimate.weights import unit_weights
from bayescal.model.model import with_parameters
from bayescal.model.scene import Scene


def check_enough(scene: Scene) -> None:
    """Refuse a session whose rows say nearly nothing beyond where its targets are.

    Rows locate the targets first. With the singular values s of the whitened Jacobian of the targets alone,
    sum s^2 / (1 + s^2) of their unknowns are located by rows and certificates, and the same sum of the
    certificates' part by these alone; the difference is the rows taken up: one for each unknown of a loose
    target, none for a target that is known (`u_mm: 0`). What is left must be at least one row for each
    joint, the joint offsets being the least that a calibration determines. Tolerance priors carry the other
    parameters, so fewer rows than parameters are no reason to refuse.

    Raises
    ------
    BayescalError
        With the number of rows that is needed.
    """
    model = with_parameters(scene, (), ())
    z = np.zeros(model.size)
    jacobian = linearise(model, z, unit_weights(model, z)).jacobian
    numbers = sum(b.residuals for b in model.blocks)  # that the rows state; certificates stand behind them
    located = _determined(jacobian)
    joints = scene.dataset.robot.n
    left = numbers - (located - _determined(jacobian[numbers:]))
    if left > joints - 0.5:
        return
    rows = len(scene.rows("calibrate"))
    needed = rows + ceil((joints - left + model.size - located) * rows / numbers - 1e-3)
    word = "row has" if rows == 1 else "rows have"
    raise BayescalError(
        f"{rows} {word} the role calibrate: too few for {joints} joints and {len(model.states)} targets "
        f"({model.size} unknowns)",
        "measurements.csv",
        f"measure {needed} or more: at least one for each joint beyond what locates the targets",
    )


def _determined(jacobian: np.ndarray) -> float:
    """How many unknowns whitened residuals determine beyond their priors; Jacobian (R, D)."""
    square = np.maximum(np.linalg.eigvalsh(jacobian.T @ jacobian), 0.0)
    return float(np.sum(square / (1.0 + square)))
