"""Ways to calibrate an arm, ours among those of the survey, judged by the same held-out rows."""

from __future__ import annotations

from bayescal.methods.compare import METHODS, Comparison, Result, Row, compare
from bayescal.methods.method import Method, Solution

__all__ = ["METHODS", "Comparison", "Method", "Result", "Row", "Solution", "compare"]
