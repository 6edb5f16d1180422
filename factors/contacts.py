"""Contacts with surfaces, and points that a fixed pivot holds. Residuals are signed lengths.

- plane: ``n . p - offset - r = 0``
- cylinder: ``dist(p, axis) - (D / 2 + r) = 0``
- sphere: ``|p - c| - (D / 2 + r) = 0``
- a ball bar or draw wire: ``|p - c| - L = 0`` from a fixed pivot
- a nest that locates the ball centre at one point (a cone, a socket): ``p - c = 0``
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.kind import Centred, Feature, direction, dot, slopes, tangents, tilted


@dataclass(frozen=True)
class Plane:
    """A face, tilted about a pivot near its contacts so that tilt and offset stay apart.

    Parameters
    ----------
    normal : (3,) nominal outward unit normal
    pivot : (3,) a point on the nominal plane, m
    radius : (C,) ball radius, m
    sd : (3,) prior standard deviations of the two tilts (rad) and the offset (m)
    """

    normal: np.ndarray
    pivot: np.ndarray
    radius: np.ndarray
    sd: np.ndarray
    rows = 1
    parts = (("tilt 1", "rad"), ("tilt 2", "rad"), ("offset", "m"))

    @cached_property
    def tangents(self) -> np.ndarray:
        """The two directions, (2, 3), towards which the normal tilts."""
        return tangents(self.normal)

    def normal_and_offset(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit normal (..., 3) and offset from the origin of F0 (...), m."""
        normal, _ = tilted(self.normal, self.tangents, x[..., :2])
        return normal, normal @ self.pivot + x[..., 2]

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        normal, offset = self.normal_and_offset(x)
        return (dot(normal, p) - (offset[..., None] + self.radius))[..., None, :]

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        normal, slopes = tilted(self.normal, self.tangents, x[..., :2])
        out = p - self.pivot[:, None]
        r = dot(normal, out) - (x[..., 2, None] + self.radius)
        by_x = np.empty((*r.shape[:-1], 3, r.shape[-1]))  # by component, as the solver takes them
        np.matmul(slopes, out, out=by_x[..., :2, :])
        by_x[..., 2, :] = -1.0
        dx = np.swapaxes(by_x, -1, -2)
        u = np.broadcast_to(normal[..., None], (*r.shape[:-1], 3, r.shape[-1]))
        return r[..., None, :], u[..., None, :, :], dx[..., None, :, :]

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        normal, offset = self.normal_and_offset(x)
        return {"normal": normal, "offset": float(offset)}

    def feature(self, x: np.ndarray) -> Feature:
        by, turn = slopes(x), slopes(x)
        normal, turn[..., :2, :] = tilted(self.normal, self.tangents, x[..., :2])
        by[..., :2, :] = x[..., 2, None, None] * turn[..., :2, :]
        by[..., 2, :] = normal
        return Feature(self.pivot + x[..., 2:] * normal, by, normal, turn)


@dataclass(frozen=True)
class Cylinder:
    """A pin or a bore's outside, by its axis and diameter.

    Parameters
    ----------
    point : (3,) a point of the nominal axis, best near the contacts, m
    axis : (3,) nominal unit direction
    diameter : nominal, m
    radius : (C,) ball radius, m
    sd : (5,) prior standard deviations of two tilts (rad), two shifts across the axis and the diameter (m)
    """

    point: np.ndarray
    axis: np.ndarray
    diameter: float
    radius: np.ndarray
    sd: np.ndarray
    rows = 1
    parts = (("tilt 1", "rad"), ("tilt 2", "rad"), ("shift 1", "m"), ("shift 2", "m"), ("diameter", "m"))

    @cached_property
    def tangents(self) -> np.ndarray:
        """The two directions, (2, 3), across the nominal axis."""
        return tangents(self.axis)

    def _apart(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
        basis = self.tangents
        axis, slopes = tilted(self.axis, basis, x[..., :2])
        out = p - (self.point + x[..., 2:4] @ basis)[..., None]
        along = dot(axis, out)
        across = out - axis[..., None] * along[..., None, :]
        u, length = direction(across, axis=-2)
        return basis, slopes, along, u, length[..., 0, :]

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        *_, length = self._apart(x, p)
        return (length - (0.5 * (self.diameter + x[..., 4, None]) + self.radius))[..., None, :]

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        basis, slopes, along, u, length = self._apart(x, p)
        r = length - (0.5 * (self.diameter + x[..., 4, None]) + self.radius)
        dx = np.empty((*r.shape, 5))
        # u is across the axis, so only the tilt of the axis at the contact's height counts
        dx[..., :2] = -np.swapaxes((slopes @ u) * along[..., None, :], -1, -2)
        dx[..., 2:4] = -np.swapaxes(basis @ u, -1, -2)
        dx[..., 4] = -0.5
        return r[..., None, :], u[..., None, :, :], dx[..., None, :, :]

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        basis = self.tangents
        axis, _ = tilted(self.axis, basis, x[:2])
        return {"point": self.point + x[2:4] @ basis, "axis": axis, "diameter": float(self.diameter + x[4])}

    def feature(self, x: np.ndarray) -> Feature:
        by, turn = slopes(x), slopes(x)
        axis, turn[..., :2, :] = tilted(self.axis, self.tangents, x[..., :2])
        by[..., 2:4, :] = self.tangents
        return Feature(self.point + x[..., 2:4] @ self.tangents, by, axis, turn)


@dataclass(frozen=True)
class Sphere(Centred):
    """A datum sphere, by its centre and diameter.

    Parameters
    ----------
    centre : (3,) nominal, m
    diameter : nominal, m
    radius : (C,) ball radius, m
    sd : (4,) prior standard deviations of the centre and of the diameter, m
    """

    diameter: float
    radius: np.ndarray
    sd: np.ndarray
    rows = 1
    parts = (*Centred.parts, ("diameter", "m"))

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        length = np.linalg.norm(self.apart(x, p), axis=-2)
        return (length - (0.5 * (self.diameter + x[..., 3, None]) + self.radius))[..., None, :]

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u, length = direction(self.apart(x, p), axis=-2)
        r = length[..., 0, :] - (0.5 * (self.diameter + x[..., 3, None]) + self.radius)
        dx = np.empty((*r.shape, 4))
        dx[..., :3] = -np.swapaxes(u, -1, -2)
        dx[..., 3] = -0.5
        return r[..., None, :], u[..., None, :, :], dx[..., None, :, :]

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        return super().describe(x) | {"diameter": float(self.diameter + x[3])}


@dataclass(frozen=True)
class Distance(Centred):
    """A pivot from which a length is kept or read.

    Parameters
    ----------
    centre : (3,) nominal pivot, m
    length : (C,) length of each row, m
    sd : (3,) prior standard deviations of the pivot, m
    """

    length: np.ndarray
    sd: np.ndarray
    rows = 1

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        return (np.linalg.norm(self.apart(x, p), axis=-2) - self.length)[..., None, :]

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u, length = direction(self.apart(x, p), axis=-2)
        r = length[..., 0, :] - self.length
        return r[..., None, :], u[..., None, :, :], -np.swapaxes(u, -1, -2)[..., None, :, :]


@dataclass(frozen=True)
class FixedPoint(Centred):
    """A point that the ball centre returns to.

    Parameters
    ----------
    centre : (3,) nominal, m
    sd : (3,) prior standard deviations, m
    """

    sd: np.ndarray
    rows = 3

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        return self.apart(x, p)

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r = self.residual(x, p)
        count = r.shape[-1]
        u = np.broadcast_to(np.eye(3)[:, :, None], (*r.shape[:-2], 3, 3, count))
        dx = np.broadcast_to(-np.eye(3)[:, None, :], (*r.shape[:-2], 3, count, 3))
        return r, u, dx
