"""Whether the arm of a user's file is the arm of the session, and where its frames are.

Both arms are compared at zero readings. A file may have another base frame, other frames on the links, and
axes of the opposite sense: a rigid transform takes the axes of the file to those of the arm, each a line.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from bayescal.arm.robot import Robot
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import zero_frames

ANGLE, LENGTH = np.radians(0.5), 3e-3
"""rad, m: axes that differ by more are those of another arm; calibrated ones differ by less."""
PARALLEL = np.radians(2.0)
"""rad: axes that differ by less have no common point nearby."""
EXACT = 1e-6
"""rad, m: agreement of frames that are the same except for rounding in a file."""


@dataclass(frozen=True)
class FileArm:
    """The moving joints of a file at zero: names, frames (n, 4, 4) in its root, axes (n, 3) in these frames.

    `fixed` (n, 4, 4) stands in the file between the frame of the joint before and the origin of each joint;
    `tip` (4, 4) is the pose of the tip in the frame of the last joint.
    """

    names: tuple[str, ...]
    frames: np.ndarray
    axes: np.ndarray
    fixed: np.ndarray
    tip: np.ndarray


@dataclass(frozen=True)
class Match:
    """Where a file's frames are: of its root in F0, of its links in those of the arm; senses of its axes."""

    root: np.ndarray  # (4, 4)
    own: np.ndarray  # (n, 4, 4): rotations and slides that keep the joint's axis
    signs: np.ndarray  # (n,)


def match(robot: Robot, file: FileArm, name: str) -> Match:
    """Match the arm of a file with the nominal arm of a session.

    Raises
    ------
    BayescalError
        With the first difference, if they are not the same arm.
    """
    _check_names(robot, file, name)
    ours = zero_frames(robot)[:-1]
    p, a = ours[:, :3, 3], ours[:, :3, 2]
    r, b = file.frames[:, :3, 3], np.einsum("kij,kj->ki", file.frames[:, :3, :3], file.axes)
    _check_pairs(robot, file, name, _pairs(p, a), _pairs(r, b))
    root = _alignment(p, a, r, b)
    here = np.eye(4) if _off(p, a, r, b, np.eye(4))[2] <= _off(p, a, r, b, root)[2] + EXACT else root
    angle, length, _ = _off(p, a, r, b, here)
    for k in np.flatnonzero((angle > ANGLE) | (length > LENGTH)).tolist():
        what = (
            f"at zero readings the axis of {file.names[k]} is {np.degrees(angle[k]):.2f} deg and "
            f"{1e3 * length[k]:.2f} mm off that of {robot.joint_names[k]}"
        )
        raise BayescalError(what, name, f"give the file of this arm ({robot.name}), with the same zeros")
    own = np.linalg.inv(ours) @ here @ file.frames
    signs = np.sign(np.einsum("ki,ki->k", a, b @ here[:3, :3].T))
    for k in range(robot.n):
        own[k, :2, 3] = 0.0
        own[k, :3, :3] = (
            smallest_turn(own[k, :3, :3] @ file.axes[k], np.array([0.0, 0.0, signs[k]])) @ own[k, :3, :3]
        )
    return Match(here, own, signs)


def _check_names(robot: Robot, file: FileArm, name: str) -> None:
    """Refuse another number of joints, and names of joints in another order; names may all be different."""
    if len(file.names) != robot.n:
        what = f"{len(file.names)} joints turn before the tip, the arm {robot.name} has {robot.n}"
        raise BayescalError(what, name, "name the link that carries the tool, as in arm.urdf#tool0")
    if set(file.names) & set(robot.joint_names):
        for k, (theirs, own) in enumerate(zip(file.names, robot.joint_names, strict=True), start=1):
            if theirs != own:
                what = f"joint {k} is called {theirs}, in the arm {robot.name} it is {own}"
                raise BayescalError(what, name, "give the file of this arm")


def _pairs(p: np.ndarray, a: np.ndarray) -> list[tuple[float, float]]:
    """Angle, rad, and distance, m, between each axis and the next, as lines."""
    out = []
    for k in range(len(p) - 1):
        across = np.cross(a[k], a[k + 1])
        sine, between = float(np.linalg.norm(across)), p[k + 1] - p[k]
        if sine < np.sin(PARALLEL):
            distance = float(np.linalg.norm(between - a[k] * (a[k] @ between)))
        else:
            distance = abs(float(between @ across)) / sine
        out.append((float(np.arctan2(sine, abs(a[k] @ a[k + 1]))), distance))
    return out


def _check_pairs(
    robot: Robot, file: FileArm, name: str, ours: list[tuple[float, float]], theirs: list[tuple[float, float]]
) -> None:
    for k, (own, other) in enumerate(zip(ours, theirs, strict=True)):
        axes = f"of {file.names[k]} and {file.names[k + 1]}"
        if abs(own[0] - other[0]) > ANGLE:
            what = f"the axes {axes} differ by {np.degrees(other[0]):.2f} deg, in the arm {robot.name} by "
            raise BayescalError(f"{what}{np.degrees(own[0]):.2f} deg", name, "give the file of this arm")
        if abs(own[1] - other[1]) > LENGTH:
            what = f"the distance of the axes {axes} is {1e3 * other[1]:.2f} mm, in the arm {robot.name} "
            raise BayescalError(f"{what}{1e3 * own[1]:.2f} mm", name, "give the file of this arm")


def _off(
    p: np.ndarray, a: np.ndarray, r: np.ndarray, b: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Angles and distances (n,) of the file's axes from those of the arm; the largest of all."""
    turned, moved = b @ root[:3, :3].T, r @ root[:3, :3].T + root[:3, 3]
    angle = np.arctan2(np.linalg.norm(np.cross(a, turned), axis=1), np.abs(np.sum(a * turned, axis=1)))
    off = moved - p
    length = np.linalg.norm(off - a * np.sum(a * off, axis=1, keepdims=True), axis=1)
    return angle, length, float(max(angle.max(), length.max()))


def _between(p: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Shortest vectors between all pairs of lines: those that no sense of an axis changes."""
    out = []
    for i, j in itertools.combinations(range(len(p)), 2):
        off = p[j] - p[i]
        across = np.cross(a[i], a[j])
        if np.linalg.norm(across) < np.sin(PARALLEL):
            out.append(off - a[i] * (a[i] @ off))
        else:
            out.append(across * (off @ across) / (across @ across))
    return np.array(out).reshape(-1, 3)


def _alignment(p: np.ndarray, a: np.ndarray, r: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rigid transform (4, 4) that best takes lines (r, b) to lines (p, a), whatever their senses."""
    n = len(p)
    ours, theirs = _between(p, a), _between(r, b)
    best, turn = np.inf, np.eye(3)
    for signs in itertools.product((1.0, -1.0), repeat=n):
        flipped = b * np.array(signs)[:, None]
        u, _, v = np.linalg.svd(a.T @ flipped + ours.T @ theirs)
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        off = np.sum((a - flipped @ rotation.T) ** 2) + np.sum((ours - theirs @ rotation.T) ** 2)
        # of equal ones the smallest turn: symmetric arms fit in several ways
        off += EXACT**2 * (3.0 - np.trace(rotation))
        if off < best:
            best, turn = off, rotation
    across = np.eye(3) - a[:, :, None] * a[:, None, :]
    wanted = np.einsum("kij,kj->ki", across, p - r @ turn.T)
    shift = np.linalg.lstsq(across.reshape(-1, 3), wanted.ravel(), rcond=1e-9)[0]
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, shift
    return out


def smallest_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) that takes a unit vector to another, nearby one."""
    cross = np.cross(a, b)
    skew = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + float(a @ b))
