"""Whether a session has enough rows to calibrate an arm."""

from __future__ import annotations

from math import ceil

import numpy as np

from bayescal.errors import BayescalError
from bayescal.estimate.linear import linearise
from bayescal.estimate.weights import unit_weights
from bayescal.model.model import with_parameters
from bayescal.model.scene import Scene


def check_enough(scene: Scene) -> None:
    """Refuse a session whose rows determine hardly more than the positions of its targets.

    Rows locate the targets first. With the singular values s of the whitened Jacobian of the targets alone,
    sum s^2 / (1 + s^2) of their unknowns are located by rows and certificates, and the same sum over the
    certificates' part by these alone. The difference is the number of rows that the targets need: one for
    each unknown of a target without stated uncertainty, none for a known target (`u_mm: 0`). At least one
    further row per joint is required, for the joint offsets, the minimum of a calibration. The other
    parameters have tolerance priors, so a session may have fewer rows than parameters.

    Raises
    ------
    BayescalError
        With the required number of rows.
    """
    model = with_parameters(scene, (), ())
    z = np.zeros(model.size)
    jacobian = linearise(model, z, unit_weights(model, z)).jacobian
    numbers = sum(b.residuals for b in model.blocks)  # of the rows; the certificates' residuals follow
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
        f"measure {needed} or more: at least one per joint, in addition to those that locate the targets",
    )


def _determined(jacobian: np.ndarray) -> float:
    """Number of unknowns that whitened residuals determine beyond their priors; Jacobian (R, D)."""
    square = np.maximum(np.linalg.eigvalsh(jacobian.T @ jacobian), 0.0)
    return float(np.sum(square / (1.0 + square)))
