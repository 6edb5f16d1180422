"""The estimate: Levenberg-Marquardt on the factor graph, outliers, noise, covariance."""

from __future__ import annotations

from bayescal.estimate.checks import check_enough
from bayescal.estimate.estimate import Estimate, calibrated, estimate, fitted_level, settled, unfitted
from bayescal.estimate.solver import STATED_WORTH, Weights, linearise, root, solve, unit_weights

__all__ = [
    "STATED_WORTH",
    "Estimate",
    "Weights",
    "calibrated",
    "check_enough",
    "estimate",
    "fitted_level",
    "linearise",
    "root",
    "settled",
    "solve",
    "unfitted",
    "unit_weights",
]
