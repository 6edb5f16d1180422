"""Validation: what the calibrated arm measures elsewhere, against what it predicted and what is certified."""

from __future__ import annotations

from bayescal.predict.forecast import Distances, Forecast, forecast
from bayescal.predict.locate import Found, find
from bayescal.predict.validation import (
    DiameterCheck,
    DistanceCheck,
    PlaneCheck,
    PointCheck,
    TurnCheck,
    Validation,
    inside95,
    interval95,
    validate,
)

__all__ = [
    "DiameterCheck",
    "DistanceCheck",
    "Distances",
    "Forecast",
    "Found",
    "PlaneCheck",
    "PointCheck",
    "TurnCheck",
    "Validation",
    "find",
    "forecast",
    "inside95",
    "interval95",
    "validate",
]
