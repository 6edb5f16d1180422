"""Calibration methods of a published survey and of bayescal, compared on the same validation measurements."""

from __future__ import annotations

from bayescal.methods.compare import METHODS, Comparison, Result, Row, compare
from bayescal.methods.published import Method
from bayescal.methods.solving import Solution

__all__ = ["METHODS", "Comparison", "Method", "Result", "Row", "Solution", "compare"]
