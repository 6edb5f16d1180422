"""Whether the arm of a user's file is the arm of the session, and where its frames are.

Both arms are compared at zero readings. A file may have another base frame, other frames on the links, and
axes of the opposite sense: a rigid transform takes the axes of the file to those of the arm, each a line.

A file may be calibrated already, by its manufacturer or by an earlier export. Its zeros then differ from the
nominal ones, and its frames are those of the earlier calibration. It is turned by the difference of the zeros
before its frames are compared: the new calibration replaces the earlier one.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rigid
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import steps, zero_frames
from bayescal.robots.urdf import smallest_turn

ANGLE, LENGTH = np.radians(0.5), 3e-3
"""rad, m: axes that differ by more are those of another arm; calibrated ones differ by less."""
PARALLEL = np.radians(2.0)
"""rad: axes that differ by less have no common point nearby."""
ZERO = np.radians(2.0)
"""rad: joint zeros that differ by more are those of another arm; those of calibrated arms differ by less."""
NOMINAL = np.radians(0.05)
"""rad: axes that differ by less are nominal, with rounded angles; else the file is calibrated."""
PLACED = (np.radians(2.0), LENGTH)
"""rad, m: a root within this of a multiple of 90 deg, and of F0, is there, unless the file is exact."""
ROUNDED = 1e-5
"""rad, m: difference of axes beyond which lengths of a file are rounded, or it is calibrated."""
LEVER, STEPS, STEP = 0.3, 20, 1e-6
"""m: length that counts as a radian where zeros are found; iterations, and step of their differences, rad."""
EXACT = 1e-6
"""rad, m: agreement of frames that are the same except for rounding in a file."""


@dataclass(frozen=True)
class FileArm:
    """The moving joints of a file at zero: names, frames (n, 4, 4) in its root, axes (n, 3) in these frames.

    Those of `slides` (n,) are prismatic.

    `fixed` (n, 4, 4) stands in the file between the frame of the joint before and the origin of each joint;
    `tip` (4, 4) is the pose of the tip in the frame of the last joint.
    """

    names: tuple[str, ...]
    frames: np.ndarray
    axes: np.ndarray
    fixed: np.ndarray
    tip: np.ndarray
    slides: np.ndarray

    def turned(self, angles: np.ndarray) -> np.ndarray:
        """Frames (..., n, 4, 4) with the joints at angles (..., n), rad; shifts, m, of prismatic ones."""
        pose, out = np.eye(4), []
        for k, step in enumerate(steps(self.frames)):
            spin = np.zeros((*angles.shape[:-1], 4, 4))
            along = angles[..., k, None] * self.axes[k]
            spin[..., :3, :3] = np.eye(3) if self.slides[k] else Rotation.from_rotvec(along).as_matrix()
            spin[..., :3, 3] = along if self.slides[k] else 0.0
            spin[..., 3, 3] = 1.0
            pose = pose @ step @ spin
            out.append(pose)
        return np.stack(out, axis=-3)


@dataclass(frozen=True)
class Match:
    """Where a file's frames are: of its root in F0, of its links in those of the arm; senses of its axes."""

    root: np.ndarray  # (4, 4)
    links: np.ndarray  # (n, 4, 4): rotations and slides that keep the joint's axis
    signs: np.ndarray  # (n,)
    notes: tuple[str, ...] = ()


def match(robot: Robot, file: FileArm, name: str) -> Match:
    """Match the arm of a file with the nominal arm of a session.

    Raises
    ------
    BayescalError
        With the first difference, if they are not the same arm.
    """
    if len(file.names) != robot.n:
        what = f"{len(file.names)} joints turn before the tip, the arm {robot.name} has {robot.n}"
        raise BayescalError(what, name, "name the link that carries the tool, as in arm.urdf#tool0")
    with_flange = zero_frames(robot)
    ours = with_flange[:-1]
    p, a = _lines(ours, np.tile([0.0, 0.0, 1.0], (robot.n, 1)))
    r, b = _lines(file.frames, file.axes)
    for what in _differences(robot, file, _pairs(p, a), _pairs(r, b)):
        raise BayescalError(what, name, "give the file of this arm")
    by_reading = a * np.sign(np.diag(robot.link_from_reading))[:, None]
    root = _alignment(p, by_reading, r, b)
    least = _off(p, a, r, b, root)[2]
    here, in_f0 = root, np.eye(4)
    opposite = [np.sum(_senses(by_reading, b, way) < 0) for way in (in_f0, root)]
    if _off(p, a, r, b, in_f0)[2] <= least + EXACT and opposite[0] <= opposite[1]:
        here = in_f0
    angle, length, _ = _off(p, a, r, b, here)
    if least > ROUNDED and np.max(_off(p, a, r, b, _placed(root))[1]) <= LENGTH:
        here = _placed(root)
    frames, notes = file.frames, tuple[str, ...]()
    if np.max(angle) > NOMINAL:
        root, zeros = _zeros(p, a, file, root)
        angle, length, _ = _off(p, a, *_lines(file.turned(zeros), file.axes), root)
        here, zeros = _settled(file, root, zeros, with_flange[-1])
        frames, notes = file.turned(zeros), _calibrated(robot, file, zeros, name)
    for k in np.flatnonzero((angle > ANGLE) | (length > LENGTH)).tolist():
        off = f"{np.degrees(angle[k]):.2f} deg and {1e3 * length[k]:.2f} mm off"
        what = f"at zero readings the axis of {file.names[k]} is {off} that of {robot.joint_names[k]}"
        raise BayescalError(what, name, f"give the file of this arm ({robot.name}), with the same zeros")
    links = np.linalg.inv(ours) @ here @ frames
    signs = _senses(a, _lines(frames, file.axes)[1], here)
    for k in range(robot.n):
        links[k, :2, 3] = 0.0
        turn = smallest_turn(links[k, :3, :3] @ file.axes[k], np.array([0.0, 0.0, signs[k]]))
        links[k, :3, :3] = turn @ links[k, :3, :3]
    # the tip of a calibrated file is off the flange by its earlier calibration
    slide = (links[-1] @ file.tip)[2, 3] - (np.linalg.inv(ours[-1]) @ with_flange[-1])[2, 3]
    if notes and abs(slide) <= LENGTH:
        links[-1, 2, 3] -= slide
    return Match(here, links, signs, notes)


def _senses(a: np.ndarray, b: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Senses (n,) of the file's axes along those of the arm: 1, or -1 if opposite."""
    return np.sign(np.einsum("ki,ki->k", a, b @ root[:3, :3].T))


def _lines(frames: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and directions (n, 3) of the axes of joints."""
    return frames[:, :3, 3], np.einsum("kij,kj->ki", frames[:, :3, :3], axes)


def _zeros(p: np.ndarray, a: np.ndarray, file: FileArm, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root (4, 4) and angles of the joints (n,), rad, at which the file's axes are closest to lines (p, a).

    That of the first joint is part of the root; that of the last one moves no axis.
    """
    n = len(p)
    across = np.eye(3) - a[:, :, None] * a[:, None, :]

    def placed(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turn = rigid(Rotation.from_rotvec(x[:3]).as_matrix(), x[3:6])
        return turn @ root, np.concatenate([[0.0], x[6:], [0.0]])[:n]

    def residual(x: np.ndarray) -> np.ndarray:
        here, zeros = placed(x)
        r, b = _lines(file.turned(zeros), file.axes)
        off = r @ here[:3, :3].T + here[:3, 3] - p
        tilt = np.cross(a, b @ here[:3, :3].T)
        return np.concatenate([np.einsum("kij,kj->ki", across, off).ravel(), LEVER * tilt.ravel()])

    x = np.zeros(6 + max(n - 2, 0))
    for _ in range(STEPS):
        residuals = residual(x)
        by = np.array([(residual(x + STEP * e) - residuals) / STEP for e in np.eye(len(x))]).T
        step = np.linalg.lstsq(by, -residuals, rcond=1e-7)[0]
        x = x + step
        if np.max(np.abs(step)) < STEP:
            break
    return placed(x)


def _settled(
    file: FileArm, root: np.ndarray, zeros: np.ndarray, flange: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The root of a calibrated file without the earlier calibration of its base, and angles of all joints.

    A root close to a multiple of 90 deg is there, one close to F0 is in it; what it is turned by about the
    first axis is the zero of the first joint. A tip that is close to a multiple of 90 deg about the last axis
    of the flange has the zero of the last one.
    """
    here, zeros = _placed(root), zeros.copy()
    off = Rotation.from_matrix(root[:3, :3] @ here[:3, :3].T).as_rotvec()
    zeros[0] = float(off @ here[:3, :3] @ _lines(file.frames, file.axes)[1][0])
    tip = np.linalg.inv(flange) @ here @ file.turned(zeros)[-1]
    axis, tip = tip[:3, :3] @ file.axes[-1], tip @ file.tip
    x, y, _ = tip[:3, np.argmin(np.abs(tip[2, :3]))]  # the axis of the tip that is across the last joint's
    angle = float(np.arctan2(y, x))
    past = angle - np.round(angle / (0.5 * np.pi)) * 0.5 * np.pi
    zeros[-1] = -float(np.sign(axis[2])) * past if abs(past) <= PLACED[0] else 0.0
    return here, zeros


def _placed(root: np.ndarray) -> np.ndarray:
    """A root (4, 4) at a multiple of 90 deg and in F0, where it is close to them."""
    near = np.round(root[:3, :3])
    turned = abs(np.linalg.det(near)) == 1
    close = turned and Rotation.from_matrix(root[:3, :3] @ near.T).magnitude() <= PLACED[0]
    shift = root[:3, 3] if np.linalg.norm(root[:3, 3]) > PLACED[1] else np.zeros(3)
    return rigid(near if close else root[:3, :3], shift)


def _calibrated(robot: Robot, file: FileArm, zeros: np.ndarray, name: str) -> tuple[str, ...]:
    """What is told of a file that is calibrated already.

    Raises
    ------
    BayescalError
        If its zeros differ too much.
    """
    k = int(np.argmax(np.abs(zeros)))
    degrees = abs(float(np.degrees(zeros[k])))
    if abs(zeros[k]) > ZERO:
        what = f"the zero of {file.names[k]} is {degrees:.2f} deg off that of {robot.joint_names[k]}"
        remedy = f"give the file of this arm ({robot.name}): zeros differ by {np.degrees(ZERO):g} deg at most"
        raise BayescalError(what, name, remedy)
    difference = f"zeros within {degrees:.2g} deg of the nominal ones" if degrees > 0.005 else "nominal zeros"
    return (f"{name} is calibrated already, with {difference}: this calibration replaces the earlier one",)


def _differences(robot: Robot, file: FileArm, ours: np.ndarray, theirs: np.ndarray) -> Iterator[str]:
    """What tells two arms apart: kinds and order of joints, and `_pairs` of the axes.

    Names of the joints may all be different.
    """
    for k in np.flatnonzero(file.slides != robot.slides).tolist():
        kind = "prismatic" if file.slides[k] else "revolute"
        yield f"joint {file.names[k]} is {kind}, in the arm {robot.name} it is not"
    if set(file.names) & set(robot.joint_names):
        for k, (other, name) in enumerate(zip(file.names, robot.joint_names, strict=True), start=1):
            if other != name:
                yield f"joint {k} is called {other}, in the arm {robot.name} it is {name}"
    for k, (here, there) in enumerate(zip(ours, theirs, strict=True)):
        axes, arm = f"the axes of {file.names[k]} and {file.names[k + 1]}", f"in the arm {robot.name}"
        if abs(here[0] - there[0]) > ANGLE:
            yield f"{axes} differ by {np.degrees(there[0]):.2f} deg, {arm} by {np.degrees(here[0]):.2f} deg"
        if abs(here[1] - there[1]) > LENGTH:
            yield f"the distance of {axes} is {1e3 * there[1]:.2f} mm, {arm} {1e3 * here[1]:.2f} mm"


def _shortest(p: np.ndarray, a: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Shortest vectors (M, 3) from lines i (M,) to lines j (M,) of points and directions (n, 3)."""
    off, across = p[j] - p[i], np.cross(a[i], a[j])
    square = np.sum(across**2, axis=1, keepdims=True)
    parallel = square < np.sin(PARALLEL) ** 2
    beside = off - a[i] * np.sum(a[i] * off, axis=1, keepdims=True)
    normal = across * np.sum(off * across, axis=1, keepdims=True) / np.where(parallel, 1.0, square)
    return np.where(parallel, beside, normal)


def _pairs(p: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Angle, rad, and distance, m, between each axis and the next, as lines, (n - 1, 2)."""
    before = np.arange(len(p) - 1)
    sine = np.linalg.norm(np.cross(a[:-1], a[1:]), axis=1)
    angle = np.arctan2(sine, np.abs(np.sum(a[:-1] * a[1:], axis=1)))
    return np.column_stack([angle, np.linalg.norm(_shortest(p, a, before, before + 1), axis=1)])


def _off(
    p: np.ndarray, a: np.ndarray, r: np.ndarray, b: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Angles and distances (n,) of the file's axes from those of the arm; the largest of all."""
    turned, moved = b @ root[:3, :3].T, r @ root[:3, :3].T + root[:3, 3]
    angle = np.arctan2(np.linalg.norm(np.cross(a, turned), axis=1), np.abs(np.sum(a * turned, axis=1)))
    off = moved - p
    length = np.linalg.norm(off - a * np.sum(a * off, axis=1, keepdims=True), axis=1)
    return angle, length, float(max(angle.max(), length.max()))


def _alignment(p: np.ndarray, a: np.ndarray, r: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rigid transform (4, 4) that best takes lines (r, b) to lines (p, a), whatever their senses."""
    n = len(p)
    every = np.triu_indices(n, 1)  # no sense of an axis changes the vectors between all pairs of lines
    ours, theirs = _shortest(p, a, *every), _shortest(r, b, *every)
    best, turn = np.inf, np.eye(3)
    for signs in itertools.product((1.0, -1.0), repeat=n):
        flipped = b * np.array(signs)[:, None]
        u, _, v = np.linalg.svd(a.T @ flipped + ours.T @ theirs)
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        off = np.sum((a - flipped @ rotation.T) ** 2) + np.sum((ours - theirs @ rotation.T) ** 2)
        # symmetric arms fit in several ways: of equal ones the fewest opposite senses, then the smallest turn
        off += EXACT**2 * (3.0 - np.trace(rotation) + 5.0 * signs.count(-1.0))
        if off < best:
            best, turn = off, rotation
    across = np.eye(3) - a[:, :, None] * a[:, None, :]
    wanted = np.einsum("kij,kj->ki", across, p - r @ turn.T)
    shift = np.linalg.lstsq(across.reshape(-1, 3), wanted.ravel(), rcond=1e-9)[0]
    return rigid(turn, shift)
