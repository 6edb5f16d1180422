"""Solutions that are refused: no length known, not converged, out of reach."""

from __future__ import annotations

import numpy as np

from bayescal.arm.kernel import MAX_ANGLE
from bayescal.errors import BayescalError
from bayescal.estimate.linear import Linear
from bayescal.model.block import ARM
from bayescal.model.model import Model

LARGEST_SCALE_SD = 5e-3
"""Relative standard deviation of the arm's size beyond which no length counts as known."""
LARGEST_STEP = 0.1
"""Posterior standard deviations that a converged solution may be off its optimum."""


def check_length(model: Model) -> None:
    """Refuse a model in which nothing fixes the arm's size: it would shrink to fit, and report no error."""
    lengths = [p for p in model.parameters if p.unit == "m" and p.effect == "geometry" and p.nominal]
    if model.knows_length or not lengths:
        return
    # least squares of a common factor on the lengths, by their priors alone: a ball's radius is no yardstick
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


def check_converged(linear: Linear, covariance: np.ndarray, z: np.ndarray) -> None:
    """Refuse a solution that a Newton step would still move by a tenth of a standard deviation."""
    step = covariance @ (linear.jacobian.T @ linear.residual + z)
    left = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance)), initial=0.0))
    if not left < LARGEST_STEP:
        raise BayescalError(
            f"the fit stopped {left:.2g} standard deviations short of its optimum",
            "Levenberg-Marquardt",
            "check the robot file, the units of the readings and the targets' nominal places",
        )


def check_within_reach(model: Model, z: np.ndarray) -> None:
    """Refuse a solution with frames turned further than the chain's series, and any sane drawing, allow."""
    values = model.deviations(z[model.slices[ARM]])
    for value, p in zip(values, model.parameters, strict=True):
        if p.unit == "rad" and abs(value) > MAX_ANGLE and p.effect == "geometry":
            raise BayescalError(
                f"{p.name} would have to be {np.degrees(value):.0f} deg off its drawing",
                "robot",
                "check offset_deg, the signs of link_from_reading and the units of the readings",
            )
