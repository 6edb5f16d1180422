"""Clearance of planned motions by fine sampling: forward kinematics and distances of its own.

It takes from the program the numbers of capsules and solids, which pairs are compared, and the plan. It
computes nothing with the program: poses follow from the rows of the kinematic table, distances of segments
from boxes, segments and planes from closed forms, and the lines of the tool from its own inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

STEP = np.radians(0.05)
"""rad, or m of a prismatic joint: of the fastest joint, between configurations."""
LINE = 0.25e-3
"""m: of the tool, between configurations on a line."""
NEAR = 0.06
"""m: larger clearances are not of interest."""
FAR = 0.3
"""m: axes of capsules that are farther from a box are not compared with it; radii are smaller."""


@dataclass
class Table:
    """A robot's kinematic table: rows alpha, a, d, offset; matrix of readings; base and flange (4, 4).

    Joints in `slides` (n,) move along their axes.
    """

    rows: np.ndarray
    convention: str
    coupling: np.ndarray
    base: np.ndarray
    flange: np.ndarray
    slides: np.ndarray

    def frames(self, readings: np.ndarray) -> np.ndarray:
        """Poses (K, n + 2, 4, 4) of the base, the frame behind each joint's motion, and the flange."""
        moved = readings @ self.coupling.T
        angles = np.where(self.slides, 0.0, moved) + self.rows[:, 3]
        shifts = np.where(self.slides, moved, 0.0) + self.rows[:, 2]
        out = [np.broadcast_to(self.base, (len(readings), 4, 4))]
        at = out[0]
        for k, (alpha, a, _, _) in enumerate(self.rows):
            fixed = screw(alpha, a)
            turned = np.zeros((len(readings), 4, 4))
            c, s = np.cos(angles[:, k]), np.sin(angles[:, k])
            turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 0], turned[:, 1, 1] = c, -s, s, c
            turned[:, 2, 2] = turned[:, 3, 3] = 1.0
            turned[:, 2, 3] = shifts[:, k]
            if self.convention == "mdh":
                at = at @ fixed @ turned
                out.append(at)
            else:
                at = at @ turned
                out.append(at)
                at = at @ fixed
        out.append(at @ self.flange)
        return np.stack(out, axis=1)


def screw(alpha: float, a: float) -> np.ndarray:
    """Rotation by alpha about x and translation by a along it."""
    c, s = np.cos(alpha), np.sin(alpha)
    return np.array([[1, 0, 0, a], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


@dataclass
class Cell:
    """Capsules (frame, a, b, radius, probe) and solids by their numbers.

    What is compared: pairs of capsules, `own`, and pairs of a capsule and a solid, `pairs`.
    """

    table: Table
    capsules: list
    own: list
    pairs: set
    solids: list = field(default_factory=list)

    def clearance(self, readings: np.ndarray, touched: int = -1) -> np.ndarray:
        """Smallest distance (K,), m; `NEAR` where all are more. The probe may touch the solid `touched`."""
        frames = self.table.frames(readings)
        ends = [
            (f[:, :3, :3] @ a + f[:, :3, 3], f[:, :3, :3] @ b + f[:, :3, 3])
            for frame, a, b, _, _ in self.capsules
            for f in [frames[:, frame]]
        ]
        out = np.full(len(readings), NEAR)
        for s, shapes in enumerate(self.solids):
            for k, (kind, *numbers) in enumerate(shapes):
                for c, ((a, b), (*_, radius, probe)) in enumerate(zip(ends, self.capsules, strict=True)):
                    if (c, s) not in self.pairs or (s == touched and k == 0 and probe):
                        continue
                    out = np.minimum(out, FROM[kind](a, b, *numbers) - radius)
        for i, j in self.own:
            gap = segments(*ends[i], *ends[j]) - self.capsules[i][3] - self.capsules[j][3]
            out = np.minimum(out, gap)
        return out

    def motion(self, begin: np.ndarray, end: np.ndarray, touched: int = -1) -> float:
        """The same on a motion of all joints at the same time."""
        count = int(np.ceil(np.abs(end - begin).max() / STEP)) + 1
        part = np.linspace(0, 1, count)[:, None]
        return float(self.clearance(begin + part * (end - begin), touched).min())

    def line(self, begin: np.ndarray, end: np.ndarray, tool: np.ndarray, touched: int) -> float:
        """The same on the line of the tool between two readings, with evenly turning orientation."""
        first, last = (self.table.frames(q[None])[0, -1] for q in (begin, end))
        axis = vector(first[:3, :3].T @ last[:3, :3])
        start, stop = (f[:3, :3] @ tool + f[:3, 3] for f in (first, last))
        q, out = begin.copy(), []
        for part in np.linspace(0, 1, int(np.ceil(np.linalg.norm(stop - start) / LINE)) + 1):
            turn, place = first[:3, :3] @ matrix(part * axis), start + part * (stop - start)
            for _ in range(4):
                off, slopes = self._error(q, tool, turn, place)
                q = q - np.linalg.lstsq(slopes, off, rcond=None)[0]
            assert np.abs(self._error(q, tool, turn, place)[0]).max() < 1e-5
            out.append(q)
        return float(self.clearance(np.array(out), touched).min())

    def _error(self, q, tool, turn, place):
        def at(q):
            f = self.table.frames(q)[:, -1]
            r = np.swapaxes(np.broadcast_to(turn, (len(q), 3, 3)), 1, 2) @ f[:, :3, :3]
            skew = np.stack([r[:, i, j] - r[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
            return np.concatenate([f[:, :3, :3] @ tool + f[:, :3, 3] - place, 0.5 * skew], axis=1)

        step = 1e-6
        values = at(np.concatenate([q[None], q + step * np.eye(len(q)), q - step * np.eye(len(q))]))
        n = len(q)
        return values[0], (values[1 : n + 1] - values[n + 1 :]).T / (2 * step)


def matrix(v: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector, by the formula of Rodrigues."""
    angle = np.linalg.norm(v)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = v / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def vector(r: np.ndarray) -> np.ndarray:
    """Rotation vector of a rotation matrix by less than half a turn."""
    skew = 0.5 * np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    sine = np.linalg.norm(skew)
    angle = np.arctan2(sine, 0.5 * (np.trace(r) - 1))
    return skew if sine < 1e-12 else skew * angle / sine


def segments(a, b, c, d) -> np.ndarray:
    """Distances (K,) of segments a b from segments c d, each (K, 3): of lines, clamped to both."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = (np.einsum("ki,ki->k", *pair) for pair in ((u, u), (v, v), (u, v), (u, w), (v, w)))
    det = uu * vv - uv**2
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(det > 1e-14 * uu * vv, (uv * vw - vv * uw) / det, 0.0)
        t = np.clip(np.nan_to_num((uv * np.clip(s, 0, 1) + vw) / vv), 0, 1)
        s = np.clip(np.nan_to_num((uv * t - uw) / uu), 0, 1)
    away = w + s[:, None] * u - t[:, None] * v
    return np.sqrt(np.einsum("ki,ki->k", away, away))


def from_segment(a, b, c, d, radius) -> np.ndarray:
    return segments(a, b, np.broadcast_to(c, a.shape), np.broadcast_to(d, a.shape)) - radius


def from_plane(a, b, normal, offset) -> np.ndarray:
    return np.minimum(a @ normal, b @ normal) - offset


def from_box(a, b, turn, centre, half) -> np.ndarray:
    """From a box: the nearest is a point of an edge, or an end of the segment; 0 where they intersect."""
    a, b = (a - centre) @ turn, (b - centre) @ turn
    reach = 0.5 * np.linalg.norm(b - a, axis=1)
    rough = np.linalg.norm(np.maximum(np.abs(0.5 * (a + b)) - half, 0), axis=1) - reach
    out = np.array(rough)
    near = np.flatnonzero(rough < FAR)
    if not len(near):
        return out
    a, b = a[near], b[near]
    best = np.minimum(*(np.linalg.norm(np.maximum(np.abs(p) - half, 0), axis=1) for p in (a, b)))
    for axis in range(3):
        for i in (-1, 1):
            for j in (-1, 1):
                corner = half * np.roll([0, i, j], axis)
                edge = np.zeros(3)
                edge[axis] = half[axis]
                best = np.minimum(best, from_segment(a, b, corner - edge, corner + edge, 0.0))
    along = b - a
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    low, high = (-half - a) / along, (half - a) / along
    enter, leave = np.minimum(low, high), np.maximum(low, high)
    first, last = np.maximum(enter.max(axis=1), 0), np.minimum(leave.min(axis=1), 1)
    out[near] = np.where(first <= last, 0.0, best)
    return out


FROM = {"segment": from_segment, "plane": from_plane, "box": from_box}
