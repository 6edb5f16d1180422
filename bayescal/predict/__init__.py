"""Validation: measured errors of the calibrated arm against predicted uncertainty and certified values."""

from __future__ import annotations

from bayescal.predict.crossvalidation import inside95, interval95
from bayescal.predict.forecast import DistanceErrors, Forecast, forecast
from bayescal.predict.validation import DiameterCheck, DistanceCheck, Errors, RowCheck, Validation, validate

__all__ = [
    "DiameterCheck",
    "DistanceCheck",
    "DistanceErrors",
    "Errors",
    "Forecast",
    "RowCheck",
    "Validation",
    "forecast",
    "inside95",
    "interval95",
    "validate",
]
