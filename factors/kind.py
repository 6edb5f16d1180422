"""What all measurement kinds share."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np


class Kind(Protocol):
    """One target as the residuals of its contacts see it; see the package's docstring."""

    rows: ClassVar[int]  # residuals a contact
    parts: ClassVar[tuple[tuple[str, str], ...]]  # name and SI unit of each component of x

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


def tilted(normal: np.ndarray, basis: np.ndarray, tilt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vector n = (normal + tilt . basis) / norm, (..., 3), and dn/dtilt, (..., 2, 3)."""
    inverse = 1.0 / np.sqrt(1.0 + np.sum(tilt * tilt, axis=-1))[..., None]  # the three are orthonormal
    unit = (normal + tilt @ basis) * inverse
    # the component of a basis vector along the unit vector is its tilt over the norm
    slopes = (basis - unit[..., None, :] * (tilt * inverse)[..., None]) * inverse[..., None]
    return unit, slopes


def dot(vector: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Inner product of vectors (..., 3) with points (..., 3, C): (..., C)."""
    # written out: for stacks of small matrices this is several times faster than matmul
    out = vector[..., 0, None] * p[..., 0, :]
    out += vector[..., 1, None] * p[..., 1, :]
    out += vector[..., 2, None] * p[..., 2, :]
    return out
