"""What all measurement kinds share.

Of a target, a certificate speaks of the point, axis or plane that it is at a state x: its feature. Rotations
are rotation vectors: exponential, logarithm and the slopes of both, broadcasting.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol, cast

import numpy as np


class Kind(Protocol):
    """One target as the residuals of its contacts see it; see the package's docstring."""

    @property
    def rows(self) -> int:
        """Residuals a contact."""

    @property
    def parts(self) -> tuple[tuple[str, str], ...]:
        """Name and SI unit of each component of x."""

    @property
    def sd(self) -> np.ndarray:
        """Prior standard deviations of x, (size,), m and rad; 0 where known."""

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Residuals (..., rows, C), m."""

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals and their gradients by p (..., rows, 3, C) and by x (..., rows, C, size)."""

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        """The target at state x under the contract's keys without units, SI."""


def tangents(normal: np.ndarray) -> np.ndarray:
    """Two unit vectors (2, 3) that complete a unit normal (3,) to a right-handed basis."""
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(helper, normal)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def direction(v: np.ndarray, axis: int = -1) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along an axis of v and their lengths; a vector of no length has no direction: zero."""
    length = np.linalg.norm(v, axis=axis, keepdims=True)
    return v / np.where(length > 0.0, length, 1.0), length


def tilted(normal: np.ndarray, basis: np.ndarray, tilt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vector n = (normal + tilt . basis) / norm, (..., 3), and dn/dtilt, (..., 2, 3).

    `normal` and `basis` (2, 3) are orthonormal, so the norm is sqrt(1 + tilt . tilt). A single `tilt` (2,) is
    computed with numbers of Python: NumPy takes five times as long for three numbers.
    """
    if tilt.ndim == 1:
        (a, b), n, ((s0, s1, s2), (t0, t1, t2)) = tilt.tolist(), normal.tolist(), basis.tolist()
        f = 1.0 / math.sqrt(1.0 + a * a + b * b)
        x, y, z = (n[0] + a * s0 + b * t0) * f, (n[1] + a * s1 + b * t1) * f, (n[2] + a * s2 + b * t2) * f
        a, b = a * f, b * f
        by_a = (s0 - a * x) * f, (s1 - a * y) * f, (s2 - a * z) * f
        by_b = (t0 - b * x) * f, (t1 - b * y) * f, (t2 - b * z) * f
        return np.array((x, y, z)), np.array((by_a, by_b))
    first, second = tilt[..., :1], tilt[..., 1:]
    norm = 1.0 / np.sqrt(1.0 + first * first + second * second)
    turned = (normal + first * basis[0] + second * basis[1]) * norm
    slopes = (basis - (tilt * norm)[..., None] * turned[..., None, :]) * norm[..., None]
    return turned, slopes


def dot(vector: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Inner product of vectors (..., 3) with points (..., 3, C): (..., C)."""
    # written out: for stacks of small matrices this is several times faster than matmul
    out = vector[..., 0, None] * p[..., 0, :]
    out += vector[..., 1, None] * p[..., 1, :]
    out += vector[..., 2, None] * p[..., 2, :]
    return out


@dataclass(frozen=True)
class Feature:
    """A point, or a point of an axis or plane and the unit vector along or normal to it.

    Parameters
    ----------
    place : (..., 3) m, in F0
    by_place : (..., size, 3) its slopes by the state
    direction, by_direction : the same of the unit vector; None of a point
    """

    place: np.ndarray
    by_place: np.ndarray
    direction: np.ndarray | None = None
    by_direction: np.ndarray | None = None


class Placed(Kind, Protocol):
    """A kind of which a certificate may speak."""

    def feature(self, x: np.ndarray) -> Feature:
        """Its feature at the states x (..., size)."""


def feature(kind: Kind, x: np.ndarray) -> Feature:
    """The feature of a target at its states x (..., size)."""
    return cast(Placed, kind).feature(x)


def slopes(x: np.ndarray) -> np.ndarray:
    """Room (..., size, 3) for slopes by the state, all zero."""
    return np.zeros((*x.shape, 3))


@dataclass(frozen=True)
class Centred:
    """What has a centre (3,) in F0, nominal, m, whose displacement leads the state."""

    centre: np.ndarray
    parts: ClassVar[tuple[tuple[str, str], ...]] = (("x", "m"), ("y", "m"), ("z", "m"))

    def apart(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """The points p (..., 3, C) from the centre."""
        return p - (self.centre + x[..., :3])[..., None]

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        return {"centre": self.centre + x[:3]}

    def feature(self, x: np.ndarray) -> Feature:
        by = slopes(x)
        by[..., :3, :] = np.eye(3)
        return Feature(self.centre + x[..., :3], by)


SMALL = 1e-4  # rad: below it the series' first term is exact to rounding


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) with ``K @ w = v x w``, of v (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products (..., K, L, C) of many (..., K, 3, C) and (..., 3, L, C): `matmul` is slow for small ones."""
    first, second, third = (a[..., :, j, None, :] * b[..., None, j, :, :] for j in range(3))
    return np.asarray(first + second + third)


def turned(v: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad."""
    from scipy.spatial.transform import Rotation  # slow to import, and many sessions need none

    flat = np.array(v, float).reshape(-1, 3)  # a copy: SciPy takes no read-only array
    return Rotation.from_rotvec(flat).as_matrix().reshape(*v.shape, 3)


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3), rad, of rotation matrices (..., 3, 3): the inverse of `turned`."""
    from scipy.spatial.transform import Rotation  # slow to import, and many sessions need none

    flat = np.array(matrix, float).reshape(-1, 3, 3)
    return Rotation.from_matrix(flat).as_rotvec().reshape(matrix.shape[:-1])


def left_jacobian(v: np.ndarray) -> np.ndarray:
    """J with exp(v + dv) = exp(J dv) exp(v), (..., 3, 3) (Sola et al., A micro Lie theory, 2018)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = cross_matrix(v)
    first = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    safe = np.where(angle < SMALL, 1.0, angle)
    second = np.where(angle < SMALL, 1 / 6, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + first * k + second * (k @ k)


def inverse_left_jacobian(v: np.ndarray) -> np.ndarray:
    """The inverse of `left_jacobian`, (..., 3, 3), of vectors no longer than half a turn."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = cross_matrix(v)
    safe = np.where(angle < SMALL, 1.0, angle)
    second = np.where(angle < SMALL, 1 / 12, (1 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2)
    return np.eye(3) - 0.5 * k + second * (k @ k)
