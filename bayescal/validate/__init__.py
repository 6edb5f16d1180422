"""Validation: what the calibrated arm measures elsewhere, against what it predicted and what is certified."""

from __future__ import annotations

from bayescal.validate.comfort import false_comfort
from bayescal.validate.find import Found, find
from bayescal.validate.forecast import Distances, Forecast, forecast
from bayescal.validate.heldout import (
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
    "false_comfort",
    "find",
    "forecast",
    "inside95",
    "interval95",
    "validate",
]
