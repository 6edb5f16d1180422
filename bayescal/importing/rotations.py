"""Measured orientations in the conventions of controllers and instruments, as rotation matrices.

Sources: the programming manuals of the manufacturers, for the order and the axes of their angles; UR:
rotation vector, in the description of `p[x, y, z, rx, ry, rz]`; ABB: orient, q1 is the real part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rpy_matrix, rpy_of
from bayescal.errors import BayescalError
from bayescal.importing.units import is_number, is_unit, unit_of

LOOSE = 1e-3
"""Deviation of a quaternion from unit length, or of a matrix from a rotation: rounding is less."""


@dataclass(frozen=True)
class Convention:
    """`count` numbers a row, angles or not; the rotations, or matrices, of numbers (N, count); words."""

    count: int
    angles: bool
    rotations: Callable[[np.ndarray], Rotation | np.ndarray]
    words: str


REAL_FIRST = partial(Rotation.from_quat, scalar_first=True)
CONVENTIONS: dict[str, Convention] = {
    "rpy": Convention(3, True, rpy_matrix, "R = Rz(third) Ry(second) Rx(first)"),
    "wpr": Convention(3, True, rpy_matrix, "FANUC W P R: R = Rz(R) Ry(P) Rx(W)"),
    "abc": Convention(3, True, partial(Rotation.from_euler, "ZYX"), "KUKA A B C: R = Rz(A) Ry(B) Rx(C)"),
    "zyx": Convention(3, True, partial(Rotation.from_euler, "ZYX"), "R = Rz(first) Ry(second) Rx(third)"),
    "xyz": Convention(3, True, partial(Rotation.from_euler, "XYZ"), "Stäubli Rx Ry Rz: R = Rx Ry Rz"),
    "oat": Convention(3, True, partial(Rotation.from_euler, "ZYZ"), "Kawasaki O A T: R = Rz(O) Ry(A) Rz(T)"),
    "rotvec": Convention(3, True, Rotation.from_rotvec, "Universal Robots: rotation vector"),
    "wxyz": Convention(4, False, REAL_FIRST, "quaternion, real part first (ABB q1 ... q4)"),
    "xyzw": Convention(4, False, Rotation.from_quat, "quaternion, real part last (ROS)"),
    "matrix": Convention(9, False, lambda v: v.reshape(-1, 3, 3), "rotation matrix, row by row"),
    "matrix-columns": Convention(
        9, False, lambda v: v.reshape(-1, 3, 3).transpose(0, 2, 1), "rotation matrix, column by column"
    ),
}
"""By the word that states them in a map."""


def not_rotations(values: np.ndarray, name: str) -> tuple[np.ndarray, str]:
    """Rows (N,) of numbers (N, count) that are no rotation, and in words what they are not."""
    if name in ("wxyz", "xyzw"):
        return np.abs(np.linalg.norm(values, axis=1) - 1) > LOOSE, "a unit quaternion"
    if name.startswith("matrix"):
        m = values.reshape(-1, 3, 3)
        off = np.abs(m @ m.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        return (off > LOOSE) | (np.linalg.det(np.nan_to_num(m)) < 0), "a rotation matrix"
    return np.zeros(len(values), bool), ""


def matrices(values: np.ndarray, name: str) -> np.ndarray:
    """Rotation matrices (N, 3, 3) of numbers (N, count), angles in rad; nan where a number is missing."""
    given = np.isfinite(values).all(axis=1)
    out = np.full((len(values), 3, 3), np.nan)
    if given.any():
        turns = CONVENTIONS[name].rotations(values[given])
        u, _, vt = np.linalg.svd(turns.as_matrix() if isinstance(turns, Rotation) else turns)
        out[given] = u @ vt  # the nearest rotation, of rounded numbers
    return out


def roll_pitch_yaw(turns: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (N, 3), rad, of rotation matrices (N, 3, 3); nan where these are."""
    return np.array([rpy_of(turn) if np.isfinite(turn).all() else np.full(3, np.nan) for turn in turns])


def stated_rotation(text: str, where: str) -> np.ndarray:
    """Roll, pitch, yaw (3,), rad, of a text such as ``0 0 90 wpr deg`` or ``1 0 0 0 wxyz``.

    Raises
    ------
    BayescalError
        For a convention that is not known, another count of numbers, and what is no rotation.
    """
    words = text.replace(",", " ").split()
    unit = unit_of(words.pop(), "angle", where) if words and is_unit(words[-1]) else None
    name = words.pop() if words else ""
    convention = CONVENTIONS.get(name)
    if convention is None or len(words) != convention.count or convention.angles == (unit is None):
        what = f"'{text.strip()}' is not an orientation"
        remedy = f"write `0 0 90 wpr deg` or `1 0 0 0 wxyz`; {', '.join(CONVENTIONS)}"
        raise BayescalError(what, where, remedy)
    if not all(map(is_number, words)):
        raise BayescalError(f"'{text.strip()}' has a word that is not a number", where, "write plain numbers")
    values = np.array([[float(word) for word in words]]) * (unit.scale if unit else 1.0)
    bad, what = not_rotations(values, name)
    if bad.any():
        raise BayescalError(f"'{text.strip()}' is not {what}", where, "check the numbers")
    return np.asarray(roll_pitch_yaw(matrices(values, name))[0])
