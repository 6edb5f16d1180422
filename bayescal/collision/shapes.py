"""Shapes of an arm and of what stands around it: frozen types, and the distance of points from each.

A shape is solid. Distances are in m, signed: negative inside. The arm consists of capsules (`links`), which
move with its frames; what stands around it consists of boxes, balls, capsules and half spaces in F0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from bayescal.arm.transforms import length

FIXED = -1
"""Frame index of a capsule that stands in F0 and does not move with the arm."""


@dataclass(frozen=True)
class Capsule:
    """All points within `radius`, m, of the segment from `a` to `b` (3,), m; a ball if the two are equal.

    The ends are in frame `frame` of `NominalArm.frames` (0 base, 1 to n links, n + 1 flange), or in F0 if it
    is `FIXED`. `probe` marks the last part of a stylus, which is allowed to touch the target.
    """

    frame: int
    a: np.ndarray
    b: np.ndarray
    radius: float
    name: str = ""
    probe: bool = False

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distances (...) of points (..., 3) in the capsule's frame, m."""
        along = self.b - self.a
        part = np.clip((points - self.a) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
        return length(points - self.a - part[..., None] * along) - self.radius

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m."""
        return float(min(self.a @ up, self.b @ up)) - self.radius

    @cached_property
    def pose(self) -> np.ndarray:
        """Pose (4, 4) in `frame` of its middle, with the z axis along the segment."""
        out, along = np.eye(4), self.b - self.a
        z = along / self.length if self.length else np.array([0.0, 0.0, 1.0])
        x = np.eye(3)[int(np.argmin(np.abs(z)))]
        x = x - (x @ z) * z
        x /= np.linalg.norm(x)
        out[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        out[:3, 3] = 0.5 * (self.a + self.b)
        return out

    @cached_property
    def length(self) -> float:
        """Length of the segment, m."""
        return float(np.linalg.norm(self.b - self.a))


@dataclass(frozen=True)
class Box:
    """A box by its pose (4, 4) in F0 (centre, and edges along the axes) and half its sizes (3,), m."""

    pose: np.ndarray
    half: np.ndarray

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distances (...) of points (..., 3) in F0, m."""
        beyond = np.abs((points - self.pose[:3, 3]) @ self.pose[:3, :3]) - self.half
        outside = length(np.maximum(beyond, 0.0))
        return outside + np.minimum(reduce(np.maximum, np.moveaxis(beyond, -1, 0)), 0.0)

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m."""
        return float(self.pose[:3, 3] @ up - np.abs(self.pose[:3, :3].T @ up) @ self.half)


@dataclass(frozen=True)
class Ball:
    """A ball by its centre (3,), m in F0, and its radius, m."""

    centre: np.ndarray
    radius: float

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distances (...) of points (..., 3) in F0, m."""
        return length(points - self.centre) - self.radius

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m."""
        return float(self.centre @ up) - self.radius


@dataclass(frozen=True)
class HalfSpace:
    """All points x of F0 with `normal` . x <= `offset`, m; the normal (3,) is a unit vector."""

    normal: np.ndarray
    offset: float

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distances (...) of points (..., 3) in F0, m."""
        return points @ self.normal - self.offset

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m: without limit."""
        return -np.inf


Shape = Capsule | Box | Ball | HalfSpace
