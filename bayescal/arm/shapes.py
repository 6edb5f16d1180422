"""Shapes of an arm and of what stands around it.

A shape is solid and convex. Distances are in m, signed: negative inside. The arm consists of capsules, which
move with its frames (`probing.scene.arm_capsules`); what stands around it consists of all shapes, in F0.
`kind` and `numbers` state a shape to the compiled distances from it (`probing.sweep.point`): numbers, and
planes (F, 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from bayescal.arm.transforms import length

Numbers = tuple[np.ndarray, np.ndarray]
SHARP = 1e-6  # of a sum of normals, below which they are opposite

BALLS, BOX, HALF_SPACE, CYLINDER, HULL = range(5)
"""Kinds: all points within a radius of a segment, and four more."""
NO_PLANES = np.empty((0, 4))
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

    kind: ClassVar[int] = BALLS

    @property
    def numbers(self) -> Numbers:
        """Ends and radius."""
        return np.array([*self.a, *self.b, self.radius], float), NO_PLANES

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m."""
        return float(min(self.a @ up, self.b @ up)) - self.radius

    @cached_property
    def length(self) -> float:
        """Length of the segment, m."""
        return float(np.linalg.norm(self.b - self.a))


@dataclass(frozen=True)
class Box:
    """A box by its pose (4, 4) in F0 (centre, and edges along the axes) and half its sizes (3,), m."""

    pose: np.ndarray
    half: np.ndarray

    kind: ClassVar[int] = BOX

    @property
    def numbers(self) -> Numbers:
        """Rotation, centre, half sizes."""
        return np.array([*self.pose[:3, :3].ravel(), *self.pose[:3, 3], *self.half], float), NO_PLANES

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m."""
        return float(self.pose[:3, 3] @ up - np.abs(self.pose[:3, :3].T @ up) @ self.half)


def ball(centre: np.ndarray, radius: float) -> Capsule:
    """A ball by its centre (3,), m in F0, and its radius, m."""
    return Capsule(FIXED, centre, centre, radius)


@dataclass(frozen=True)
class HalfSpace:
    """All points x of F0 with `normal` . x <= `offset`, m; the normal (3,) is a unit vector."""

    normal: np.ndarray
    offset: float

    kind: ClassVar[int] = HALF_SPACE

    @property
    def numbers(self) -> Numbers:
        """Normal and offset."""
        return np.array([*self.normal, self.offset], float), NO_PLANES

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m: without limit."""
        return -np.inf


@dataclass(frozen=True)
class Cylinder:
    """A cylinder by its centre (3,), m in F0, its axis (3,), half its length and radius, m."""

    centre: np.ndarray
    axis: np.ndarray
    half: float
    radius: float

    kind: ClassVar[int] = CYLINDER

    @property
    def numbers(self) -> Numbers:
        """Axis, centre, half length and radius."""
        return np.array([*self.axis, *self.centre, self.half, self.radius], float), NO_PLANES

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m."""
        along = float(self.axis @ up)
        beside = self.radius * np.sqrt(max(0.0, 1 - along**2))
        return float(self.centre @ up - self.half * abs(along) - beside)


@dataclass(frozen=True)
class Hull:
    """The convex hull of points (K, 3), m in F0, that are not in a plane.

    Distances are those from the planes that bound it: its faces, and at every edge and corner a plane across
    it, as a bevel that takes nothing off. They are not above the distance from the hull, and exact beside
    faces.
    """

    points: np.ndarray

    kind: ClassVar[int] = HULL

    @cached_property
    def planes(self) -> np.ndarray:
        """Outward unit normals and offsets (F, 4), m."""
        from scipy.spatial import ConvexHull

        hull = ConvexHull(self.points)
        faces, normals = hull.simplices, hull.equations[:, :3]
        across = [normals]
        for k, beside in enumerate(hull.neighbors):
            across.append(normals[k] + normals[beside[beside > k]])
        sums = np.zeros((len(self.points), 3))
        for corner in faces.T:
            np.add.at(sums, corner, normals)
        across.append(sums[hull.vertices])
        every = np.concatenate(across)
        size = length(every)
        every = np.unique(np.round(every[size > SHARP] / size[size > SHARP, None], 9), axis=0)
        every /= length(every)[:, None]
        return np.column_stack([every, (every @ self.points[hull.vertices].T).max(axis=1)])

    @property
    def numbers(self) -> Numbers:
        """The planes, and from which to which."""
        return np.array([0, len(self.planes)], float), self.planes

    def lowest(self, up: np.ndarray) -> float:
        """Height of the lowest point along the unit vector `up` (3,), m."""
        return float((self.points @ up).min())


Shape = Capsule | Box | HalfSpace | Cylinder | Hull
