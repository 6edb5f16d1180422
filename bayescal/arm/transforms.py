"""Rotations and rigid transforms. All active; ``A_from_B @ x_B = x_A``; angles in rad.

A transform between two joints as one DH row.

Functions compiled by numba, kept on disk where any folder for them can be written.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

AXES = ("rz", "tz", "rx", "tx", "ry", "ty")
"""The six components of a frame's displacement, in the order in which they are multiplied."""


def rotation(axis: int, angle: np.ndarray | float) -> np.ndarray:
    """Rotation matrices about a coordinate axis.

    Parameters
    ----------
    axis : int
        0, 1, 2 for x, y, z.
    angle : array_like, shape (...,)
        rad.

    Returns
    -------
    np.ndarray, shape (..., 3, 3)
    """
    angle = np.asarray(angle, float)
    c, s = np.cos(angle), np.sin(angle)
    out = np.zeros((*angle.shape, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1.0
    out[..., i, i] = out[..., j, j] = c
    out[..., i, j] = -s
    out[..., j, i] = s
    return out


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products (..., 3) of vectors (..., 3): those of `np.cross` to the bit, in a third of the time."""
    ax, ay, az, bx, by, bz = a[..., 0], a[..., 1], a[..., 2], b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def length(v: np.ndarray) -> np.ndarray:
    """Lengths (...) of vectors (..., 3): those of `np.linalg.norm` to the bit, in a third of the time."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.sqrt(x * x + y * y + z * z)


def rigid(rotation_: np.ndarray | None = None, translation: np.ndarray | None = None) -> np.ndarray:
    """Homogeneous 4 x 4 transform of a rotation (3, 3) and a translation (3,), m."""
    out = np.eye(4)
    if rotation_ is not None:
        out[:3, :3] = rotation_
    if translation is not None:
        out[:3, 3] = translation
    return out


def rpy_matrix(rpy: np.ndarray) -> np.ndarray:
    """Fixed-axis roll, pitch, yaw (..., 3), rad, to Rz(yaw) Ry(pitch) Rx(roll), (..., 3, 3)."""
    rpy = np.asarray(rpy, float)
    roll, pitch, yaw = (rotation(axis, rpy[..., axis]) for axis in range(3))
    return yaw @ pitch @ roll


def rpy_of(matrix: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (3,), rad, of a rotation matrix (3, 3): the inverse of `rpy_matrix`.

    Exact to rounding at every pitch. SciPy's `as_euler` drops the yaw within 1e-7 rad of gimbal lock, which
    turns a robot.yaml written from a frame there by up to 2e-7 rad.
    """
    m = np.asarray(matrix)
    pitch = np.arctan2(-m[2, 0], np.hypot(m[0, 0], m[1, 0]))
    if np.hypot(m[0, 0], m[1, 0]) < 1e-12:  # gimbal lock: the yaw goes into the roll
        return np.array([np.arctan2(-m[1, 2], m[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(m[2, 1], m[2, 2]), pitch, np.arctan2(m[1, 0], m[0, 0])])


def alignment(to: np.ndarray, of: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Find the rotation that best turns vectors into others: least ``sum w |to - R of|^2`` (Kabsch 1976).

    Parameters
    ----------
    to, of : np.ndarray, shape (N, 3)
        In the same order; any unit.
    weight : np.ndarray, shape (N,), optional
        Positive weights.

    Returns
    -------
    np.ndarray, shape (3, 3)
        Where the vectors do not determine it (one point, points of a line), one of the best.
    """
    if len(of) == 1 and not (np.any(to) and np.any(of)):
        return np.eye(3)  # the deviation of a single point from its own mean
    from scipy.spatial.transform import Rotation  # slow to import, and most sessions align nothing

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Optimal rotation is not uniquely", UserWarning)
        return Rotation.align_vectors(to, of, weight)[0].as_matrix()


def rigid_alignment(to: np.ndarray, of: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Find the transform T (4, 4) with least ``sum w |to - T of|^2``; points (N, 3), m, weights (N,)."""
    a, b = np.average(to, axis=0, weights=weight), np.average(of, axis=0, weights=weight)
    turn = alignment(to - a, of - b, weight)
    return rigid(turn, a - turn @ b)


FAR, FAR_ANGLE, PASSES = 10.0, np.radians(10.0), 10
"""Rotations that differ from their mean by more than this times the median, and by this angle, are not of it;
passes of the search."""


def common_rotation(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mean (3, 3) of rotations (C, 3, 3), and the angle (C,), rad, of each from it.

    Those that are far from most others do not count, as mirrored poses of a flat tag are.
    """
    from scipy.spatial.transform import Rotation  # slow to import, and many sessions need none

    every = Rotation.from_matrix(matrices)
    weight = np.ones(len(matrices))
    for _ in range(PASSES):
        angle = (every.mean(weight).inv() * every).magnitude()
        weight = np.asarray(1.0 / (1.0 + (angle / max(2.0 * float(np.median(angle)), 1e-12)) ** 2))
    near = angle <= max(FAR_ANGLE, FAR * float(np.median(angle)))
    mean = every[near].mean()
    return mean.as_matrix(), np.asarray((mean.inv() * every).magnitude())


def cone(axis: np.ndarray, half_angle: float, rng: np.random.Generator) -> np.ndarray:
    """Unit vectors (M, 3), uniform in the cone of `half_angle` (rad) about each of axis (M, 3)."""
    count = len(axis)
    cosine = rng.uniform(np.cos(half_angle), 1.0, count)
    across = cross(axis, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    return cosine[:, None] * axis + np.sqrt(1 - cosine**2)[:, None] * across


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator like `numba.njit`, which keeps the compiled code only where that is possible."""

    def compile_(function: Callable[..., Any]) -> Any:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # neither beside the module nor in the user's cache folder
            return numba.njit(**options)(function)

    return compile_


def split(
    m: np.ndarray, parallel: float = np.radians(5.0)
) -> tuple[tuple[float, float, float], tuple[float, float], tuple[float, float]]:
    """Split a transform into ``Rz Tz`` (before), ``Rx(alpha) Tx(a) Ry(beta)``, and ``Rz Tz`` (behind).

    Between near-parallel axes beta takes the place of a distance along the second axis, which there
    is ill determined; elsewhere beta is zero (Hayati and Mirmirani 1985). Any rigid transform can be
    split so: what stands between two joints is a row, and what it leaves to the joints beside it.

    Parameters
    ----------
    m : np.ndarray, shape (4, 4)
        From one joint's frame to the next, each turning about its z. m and rad.
    parallel : float
        Axes that differ by less count as parallel, rad.

    Returns
    -------
    tuple
        (alpha, a, beta), (angle, length) before, (angle, length) behind. rad and m.
    """
    axis = m[:3, 2]  # the second axis seen from the first
    if np.hypot(axis[0], axis[1]) < np.sin(parallel):
        turn = _small(np.arctan2(m[1, 3], m[0, 3])) if np.hypot(m[0, 3], m[1, 3]) > 1e-12 else 0.0
        r, p = rotation(2, -turn) @ m[:3, :3], rotation(2, -turn) @ m[:3, 3]
        alpha, beta = np.arctan2(-r[1, 2], r[2, 2]), np.arcsin(np.clip(r[0, 2], -1.0, 1.0))
        remaining = rotation(1, -beta) @ rotation(0, -alpha) @ r
        before, behind = p[2], 0.0
    else:  # turn about the first axis until the second has no component along x: the common normal
        turn = _small(np.arctan2(axis[0], -axis[1]))
        r, p = rotation(2, -turn) @ m[:3, :3], rotation(2, -turn) @ m[:3, 3]
        alpha, beta = np.arctan2(-r[1, 2], r[2, 2]), 0.0
        remaining = rotation(0, -alpha) @ r
        behind = -p[1] / np.sin(alpha)  # p = Tz(before) Tx(a) Rx(alpha) Tz(behind)
        before = p[2] - np.cos(alpha) * behind
    return (
        (float(alpha), float(p[0]), float(beta)),
        (float(turn), float(before)),
        (float(np.arctan2(remaining[1, 0], remaining[0, 0])), float(behind)),
    )


def _small(turn: float) -> float:
    """Of the two turns half a revolution apart the smaller: a and alpha keep their nominal signs."""
    return float(turn - np.pi * np.round(turn / np.pi))
