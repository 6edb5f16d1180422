"""Rotations as rotation vectors: exponential, logarithm and the slopes of both, broadcasting."""

from __future__ import annotations

import numpy as np

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
