"""The estimate: Levenberg-Marquardt on the factor graph, outliers, noise, covariance."""

from __future__ import annotations

from bayescal.estimate.checks import check_converged, check_enough, check_length, check_within_reach
from bayescal.estimate.estimate import (
    Estimate,
    at_solution,
    calibrated,
    estimate,
    fitted_level,
    settled,
)
from bayescal.estimate.solver import (
    STATED_WORTH,
    Linear,
    Weights,
    add_constraints,
    linearise,
    root,
    solve,
    unit_weights,
)

__all__ = [
    "STATED_WORTH",
    "Estimate",
    "Linear",
    "Weights",
    "add_constraints",
    "at_solution",
    "calibrated",
    "check_converged",
    "check_enough",
    "check_length",
    "check_within_reach",
    "estimate",
    "fitted_level",
    "linearise",
    "root",
    "settled",
    "solve",
    "unit_weights",
]
