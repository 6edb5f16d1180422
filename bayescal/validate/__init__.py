"""Validation: what the calibrated arm measures elsewhere, against what it predicted and what is certified."""

from __future__ import annotations

from bayescal.validate.find import Found, find
from bayescal.validate.heldout import (
    DiameterCheck,
    DistanceCheck,
    PlaneCheck,
    PointCheck,
    Validation,
    inside95,
    interval95,
    validate,
)

__all__ = [
    "DiameterCheck",
    "DistanceCheck",
    "Found",
    "PlaneCheck",
    "PointCheck",
    "Validation",
    "find",
    "inside95",
    "interval95",
    "validate",
]
