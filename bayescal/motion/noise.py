"""Noise of torques: autoregressive, a model per joint.

White noise would be wrong by far: residuals of neighbouring rows share what the controller, the load cells of
the gears and the friction do between them, and an effect would gain from each row anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz

from bayescal.motion.settings import NOISE


@dataclass(frozen=True)
class Noise:
    """Filters (n, p + 1) that whiten residuals, each divided by the standard deviation of what is left."""

    filters: np.ndarray
    sd: np.ndarray  # (n,) N m, of the residuals before
    lag1: np.ndarray  # (n,) autocorrelation of neighbouring rows

    def whitened(self, x: np.ndarray, joint: int) -> np.ndarray:
        """Rows (M, ...) of one joint in one motion without their predictable part (M - p, ...)."""
        order = self.filters.shape[1] - 1
        shifted = (c * x[order - k : len(x) - k] for k, c in enumerate(self.filters[joint]))
        return sum(shifted, np.zeros_like(x[order:], dtype=float))


def noise_of(residuals: Sequence[np.ndarray], taken: float, same: Sequence[str] = ()) -> Noise:
    """Noise of residuals (M, n) of several motions, by the Yule-Walker equations.

    What repeats of a motion share is no noise: where their differences are clearly smaller than residuals,
    they determine it.

    Parameters
    ----------
    residuals
        A part per motion.
    taken : float
        Degrees of freedom of the rows of each channel that a fit took up.
    same : sequence of str
        The motion that each repeats.
    """
    covariance = _autocovariance(residuals, taken)
    differences = _differences(residuals, same)
    if differences:
        repeated = _autocovariance(differences, 0.0)
        share = repeated / repeated[:, :1]
        # a variance of correlated rows has as many degrees of freedom as there are independent rows
        rows = sum(map(len, differences)) / np.maximum(2.0 * np.sum(share, axis=1) - 1.0, 1.0)
        clearly = np.maximum(np.log(NOISE.smaller), NOISE.sure * np.sqrt(2.0 / rows))
        smaller = np.log(covariance[:, 0] / repeated[:, 0]) > clearly
        covariance = np.where(smaller[:, None], repeated, covariance)
    order, n = NOISE.order, len(covariance)
    filters = np.empty((n, order + 1))
    for j in range(n):
        ridged = covariance[j] + np.r_[NOISE.ridge * covariance[j, 0], np.zeros(order)]
        by = solve_toeplitz(ridged[:-1], covariance[j, 1:])
        variance = ridged[0] - by @ covariance[j, 1:]
        filters[j] = np.r_[1.0, -by] / np.sqrt(max(variance, 1e-300))
    return Noise(filters, np.sqrt(covariance[:, 0]), covariance[:, 1] / covariance[:, 0])


def _autocovariance(parts: Sequence[np.ndarray], taken: float) -> np.ndarray:
    """Autocovariances (n, lags) of parts (M, n)."""
    count = sum(map(len, parts))
    return np.array(
        [sum(np.sum(r[lag:] * r[: len(r) - lag], axis=0) for r in parts) for lag in range(NOISE.order + 1)]
    ).T / max(count - taken, 1.0)


def _differences(parts: Sequence[np.ndarray], same: Sequence[str]) -> list[np.ndarray]:
    """Parts (M, n) less the mean of all repeats of their motion, with the variance of a single one."""
    out = []
    for name in dict.fromkeys(same):
        group = [r for r, label in zip(parts, same, strict=True) if label == name]
        rows = min(map(len, group))
        if len(group) > 1:
            mean = sum(r[:rows] for r in group) / len(group)
            out += [(r[:rows] - mean) * np.sqrt(len(group) / (len(group) - 1.0)) for r in group]
    return out


def white_noise(sd: np.ndarray) -> Noise:
    """White noise of these standard deviations (n,): a start."""
    filters = np.zeros((len(sd), NOISE.order + 1))
    filters[:, 0] = 1.0 / sd
    return Noise(filters, sd, np.zeros(len(sd)))
