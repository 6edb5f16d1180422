"""How parameters and lengths are stated: an amplitude is a number with a name, of one parameter or more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Gradient = np.ndarray
Value = tuple[float, Gradient]


def micrometres(size: float) -> str:
    """A length, m, in print: in µm with two significant digits."""
    return f"{float(f'{1e6 * size:.2g}'):.9g} µm"


def itself(x: np.ndarray) -> Value:
    """A single parameter with its sign."""
    return float(x[0]), np.ones(1)


def magnitude(x: np.ndarray) -> Value:
    """A single parameter without its sign, which the effect defines."""
    return float(abs(x[0])), np.array([1.0 if x[0] >= 0 else -1.0])


def length(x: np.ndarray) -> Value:
    """Length of a vector; amplitude of a wave from its sine and cosine. At zero: of its first component."""
    size = float(np.linalg.norm(x))
    return size, x / size if size > 0 else np.eye(len(x))[0]


def phase(x: np.ndarray) -> Value:
    """Phase phi of a sin t + b cos t = A sin(t + phi), rad, from -pi to pi."""
    a, b = x
    return float(np.arctan2(b, a)), np.array([-b, a]) / max(float(a * a + b * b), np.finfo(float).tiny)


@dataclass(frozen=True)
class Size:
    """How parameters of one unit at one site, with one driver, read as an amplitude."""

    what: str  # "half-width"
    value: Callable[[np.ndarray], Value] = itself
    phase: Callable[[np.ndarray], Value] | None = None

    @property
    def joins(self) -> bool:
        """Whether it is one number for all of these parameters, not one for each."""
        return self.value is length


def propagated(
    of: Callable[[np.ndarray], Value], x: np.ndarray, covariance: np.ndarray
) -> tuple[float, float]:
    """A function of parameters and its standard uncertainty (GUM, first order).

    Parameters
    ----------
    of : callable
        Value and gradient (k,) at `x`.
    x : np.ndarray, shape (k,)
        Deviations from nominal, SI.
    covariance : np.ndarray, shape (k, k)
    """
    value, gradient = of(x)
    return value, float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))


def of_sign(what: str, value: float) -> tuple[str, float]:
    """An amplitude in words, and its value there: without a sign where words state it."""
    return (OPPOSITE[what], -value) if what in OPPOSITE and value < 0.0 else (what, value)


LATER, OLDER = "readings later than the measurement by", "readings older than the measurement by"
OPPOSITE = {LATER: OLDER}
"""Words of a negative amplitude, by those of a positive one: 'late' has two meanings."""
DEVIATION = Size("deviation")
WAVE = Size("amplitude", length, phase)
COMPLIANT = Size("compliance")
FACTOR = Size("factor on the usual values")
