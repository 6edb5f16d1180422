"""95 % intervals: of draws, and of a value with its bootstrap draws."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from bayescal.distributions import t_ppf

TAILS = (0.025, 0.975)
"""Probabilities below the ends of a 95 % interval."""


def interval95(predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central 95 % interval of draws (S, ...): lower and upper ends, (...)."""
    low, high = np.quantile(predicted, TAILS, axis=0)
    return low, high


def inside95(measured: np.ndarray | float, predicted: np.ndarray) -> np.ndarray:
    """Which measured values (...) lie in the 95 % intervals of draws (S, ...)."""
    low, high = interval95(predicted)
    return (low <= measured) & (measured <= high)


def bootstrap_interval95(value: float, draws: np.ndarray, blocks: int) -> tuple[float, float]:
    """95 % interval of a value from its bootstrap draws, widened for few blocks (Student t)."""
    if blocks < 2 or not len(draws):
        return float("nan"), float("nan")
    wider = np.sqrt(blocks / (blocks - 1)) * t_ppf(TAILS[1], blocks - 1) / ndtri(TAILS[1])
    low, high = value + wider * (np.quantile(draws, TAILS) - value)
    return float(low), float(high)
