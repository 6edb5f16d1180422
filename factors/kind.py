"""What all measurement kinds share."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import numba
import numpy as np


class Kind(Protocol):
    """One target as the residuals of its contacts see it; see the package's docstring."""

    @property
    def rows(self) -> int:
        """Residuals a contact."""
        ...

    @property
    def parts(self) -> tuple[tuple[str, str], ...]:
        """Name and SI unit of each component of x."""
        ...

    @property
    def sd(self) -> np.ndarray:
        """Prior standard deviations of x, (size,), m and rad; 0 where known."""
        ...

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Residuals (..., rows, C), m."""
        ...

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals and their gradients by p (..., rows, 3, C) and by x (..., rows, C, size)."""
        ...

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        """The target at state x under the contract's keys without units, SI."""
        ...


def tangents(normal: np.ndarray) -> np.ndarray:
    """Two unit vectors (2, 3) that complete a unit normal (3,) to a right-handed basis."""
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(helper, normal)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def _compiled(function: Callable[..., None]) -> Any:
    """Compile `tilted`; the compiled code is kept on disk where any folder for it can be written."""
    types, layout = ["void(f8[:], f8[:, :], f8[:], f8[:], f8[:, :])"], "(k),(m,k),(m)->(k),(m,k)"
    try:
        return numba.guvectorize(types, layout, nopython=True, cache=True)(function)
    except RuntimeError:  # neither beside this file nor in the user's cache folder
        return numba.guvectorize(types, layout, nopython=True)(function)


def direction(v: np.ndarray, axis: int = -1) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along an axis of v and their lengths; a vector of no length has no direction: zero."""
    length = np.linalg.norm(v, axis=axis, keepdims=True)
    return v / np.where(length > 0.0, length, 1.0), length


@_compiled
def tilted(normal, basis, tilt, unit, slopes):
    """Unit vector n = (normal + tilt . basis) / norm, (..., 3), and dn/dtilt, (..., 2, 3).

    `normal` and `basis` (2, 3) are orthonormal, so the norm is sqrt(1 + tilt . tilt). Compiled,
    because NumPy takes five times as long for three numbers.
    """
    inverse = 1.0 / math.sqrt(1.0 + tilt[0] * tilt[0] + tilt[1] * tilt[1])
    for k in range(3):
        unit[k] = (normal[k] + tilt[0] * basis[0, k] + tilt[1] * basis[1, k]) * inverse
    for j in range(2):
        for k in range(3):
            slopes[j, k] = (basis[j, k] - tilt[j] * inverse * unit[k]) * inverse


def dot(vector: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Inner product of vectors (..., 3) with points (..., 3, C): (..., C)."""
    # written out: for stacks of small matrices this is several times faster than matmul
    out = vector[..., 0, None] * p[..., 0, :]
    out += vector[..., 1, None] * p[..., 1, :]
    out += vector[..., 2, None] * p[..., 2, :]
    return out
