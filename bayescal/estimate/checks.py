"""Solutions that are refused: no known length, not converged, beyond the range of the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.arm.kernel import MAX_ANGLE
from bayescal.errors import BayescalError
from bayescal.estimate.linear import Linear
from bayescal.model.block import ARM
from bayescal.model.model import Model

LARGEST_SCALE_SD = 5e-3
"""Relative standard deviation of the arm's size beyond which it counts as not identifiable."""
LARGEST_STEP = 0.1
"""Maximum distance of a converged solution from its optimum, in posterior standard deviations."""


def check_length(model: Model) -> None:
    """Refuse a model in which the arm's size is not identifiable: the fit would shrink the arm, unnoticed."""
    lengths = [p for p in model.parameters if p.unit == "m" and p.effect == "geometry" and p.nominal]
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
        how = (
            f"{left:.2g} standard deviations short of its optimum"
            if np.isfinite(left)
            else "without a solution"
        )
        reasons = "the robot file, the units of the readings and the nominal positions of the targets"
        raise BayescalError(
            f"the fit stopped {how}", "dataset.yaml", f"check {'; '.join(suspects[:1]) or reasons}"
        )


def check_within_reach(model: Model, z: np.ndarray) -> None:
    """Refuse a solution with rotations beyond the range of the chain's series, or of any plausible error."""
    values = model.deviations(z[model.slices[ARM]])
    for value, p in zip(values, model.parameters, strict=True):
        if p.unit == "rad" and abs(value) > MAX_ANGLE and p.effect == "geometry":
            raise BayescalError(
                f"the fit changes {p.name} by {np.degrees(value):.0f} deg from its nominal value",
                "robot",
                "check offset_deg, the signs of link_from_reading and the units of the readings",
            )
