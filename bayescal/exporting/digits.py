"""Numbers as text, with all their digits."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def number(value: float) -> str:
    """A number with all its digits; no minus zero."""
    return repr(float(value) + 0.0)


def numbers(values: Iterable[float] | np.ndarray) -> str:
    """Numbers with all their digits, separated by blanks."""
    return " ".join(map(number, np.asarray(values, float).tolist()))
