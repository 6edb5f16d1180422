"""Noise of the torque: the sum of a fast and a slow process, and the filter that makes it white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

SETTLE = 6
"""Rows at the start of a motion that are not used: there the filter has not yet seen its past."""


@dataclass(frozen=True)
class Noise:
    """Two correlated processes by joint: RMS of their sum, share of the slow one, time constants."""

    rms: np.ndarray
    slow: np.ndarray
    fast_s: np.ndarray
    slow_s: np.ndarray


def draw(rng: np.random.Generator, level: np.ndarray) -> Noise:
    """Draw noise around a level (n,)."""
    n = len(level)
    return Noise(level * np.exp(0.22 * rng.standard_normal(n)), rng.uniform(0.3, 0.6, n),
                 rng.uniform(0.008, 0.03, n), rng.uniform(0.2, 0.7, n))  # fmt: skip


def process(rng: np.random.Generator, rows: int, step: float, constant: float) -> np.ndarray:
    """Draw an exponentially correlated process of variance 1 (rows,), from its stationary state."""
    keep = np.exp(-step / constant)
    kicks = rng.standard_normal(rows) * np.sqrt(1 - keep**2)
    kicks[0] /= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], kicks)


def sampled(rng: np.random.Generator, noise: Noise, runs: Sequence[slice], step: float) -> np.ndarray:
    """Draw the noise of all motions (rows, n)."""
    out = np.empty((runs[-1].stop, len(noise.rms)))
    for j in range(len(noise.rms)):
        for run in runs:
            parts = [process(rng, run.stop - run.start, step, tau[j]) for tau in (noise.fast_s, noise.slow_s)]
            out[run, j] = noise.rms[j] * (
                np.sqrt(1 - noise.slow[j]) * parts[0] + np.sqrt(noise.slow[j]) * parts[1]
            )
    return out


def whitening(noise: Noise, j: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return numerator and denominator of the filter that makes the noise of a joint white, of variance 1.

    The sum of two first-order processes is an ARMA(2, 1) process (Granger and Morris 1976).
    """
    p, r = np.exp(-step / noise.fast_s[j]), np.exp(-step / noise.slow_s[j])
    a, b = ((1 - k**2) * s for k, s in ((p, 1 - noise.slow[j]), (r, noise.slow[j])))
    zero, one = a * (1 + r**2) + b * (1 + p**2), -(a * r + b * p)
    half = zero / (2 * one)
    theta = half + np.sqrt(half**2 - 1)
    spread = np.sqrt(one / theta) * noise.rms[j]
    return np.array([1.0, -(p + r), p * r]) / spread, np.array([1.0, theta])


def white(noise: Noise, j: int, values: np.ndarray, runs: Sequence[slice], step: float) -> np.ndarray:
    """Return rows (rows, ...) of some motions, one after the other, with the noise of a joint made white."""
    top, bottom = whitening(noise, j, step)
    return np.concatenate([lfilter(top, bottom, values[run], axis=0)[SETTLE:] for run in runs])
