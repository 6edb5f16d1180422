"""Solutions that are refused: no known length, not converged, beyond the range of the model.

Whether a session has enough rows to calibrate an arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np

from bayescal.arm.kernel import MAX_ANGLE
from bayescal.effects import MODELS, Parameter
from bayescal.errors import BayescalError
from bayescal.estimate.solver import Linear, linearise, unit_weights
from bayescal.model.block import ARM
from bayescal.model.model import Model, with_parameters
from bayescal.model.scene import Scene

LARGEST_SCALE_SD = 5e-3
"""Relative standard deviation of the arm's size beyond which it counts as not identifiable."""
LARGEST_STEP = 0.1
"""Maximum distance of a converged solution from its optimum, in posterior standard deviations."""


def is_dimension(p: Parameter) -> bool:
    """Whether a parameter is a length or an angle of the arm."""
    return p.effect in MODELS and MODELS[p.effect].dimensions


def check_length(model: Model) -> None:
    """Refuse a model in which the arm's size is not identifiable: the fit would shrink the arm, unnoticed."""
    lengths = [p for p in model.parameters if p.unit == "m" and is_dimension(p) and p.nominal]
    if model.knows_length or not lengths:
        return
    # least squares of a common factor on the lengths, from their priors alone; a ball's radius does not count
    size = sum(p.nominal**2 for p in lengths)
    sd = float(np.sqrt(sum((p.nominal * p.sd) ** 2 for p in lengths)) / size)
    if not sd < LARGEST_SCALE_SD:
        raise BayescalError(
            f"no length is known: the priors leave the size of the arm uncertain to {100 * sd:.2g} %, "
            "and a fit would shrink it",
            "dataset.yaml",
            "certify a distance between two fitted targets (certificates: parallel or distance), "
            "or keep the priors (--prior-width 1)",
        )


def check_converged(
    linear: Linear, covariance: np.ndarray, z: np.ndarray, suspects: Sequence[str] = ()
) -> None:
    """Refuse a solution that a Newton step would still move by a tenth of a standard deviation.

    `suspects` are contradictions in the session, which the message then names as the probable reason.
    """
    step = covariance @ (linear.jacobian.T @ linear.residual + z)
    left = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance)), initial=0.0))
    if not left < LARGEST_STEP:
        short = f"{left:.2g} standard deviations short of its optimum"
        what = f"the fit stopped {short if np.isfinite(left) else 'without a solution'}"
        reasons = "the robot file, the units of the readings and the nominal positions of the targets"
        raise BayescalError(what, "dataset.yaml", f"check {'; '.join(suspects[:1]) or reasons}")


def check_within_reach(model: Model, z: np.ndarray) -> None:
    """Refuse a solution with rotations beyond the range of the chain's series, or of any plausible error."""
    values = model.deviations(z[model.slices[ARM]])
    for value, p in zip(values, model.parameters, strict=True):
        if p.unit == "rad" and abs(value) > MAX_ANGLE and is_dimension(p):
            what = f"the fit changes {p.name} by {np.degrees(value):.0f} deg from its nominal value"
            remedy = "check offset_deg, the signs of link_from_reading and the units of the readings"
            raise BayescalError(what, "robot", remedy)


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
    numbers = sum(b.residuals for b in model.blocks)  # of the rows; the certificates' residuals follow
    joints = scene.dataset.robot.n
    if numbers - model.size > joints:
        return
    z = np.zeros(model.size)
    jacobian = linearise(model, z, unit_weights(model, z)).jacobian
    located = _determined(jacobian)
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
