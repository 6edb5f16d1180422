"""Contact with a plane: ``n . p - offset - r = 0``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.kind import Feature, dot, slopes, tangents, tilted


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

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit normal (..., 3) and offset from the origin of F0 (...), m."""
        normal, _ = tilted(self.normal, self.tangents, x[..., :2])
        return normal, normal @ self.pivot + x[..., 2]

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        normal, offset = self.at(x)
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
        normal, offset = self.at(x)
        return {"normal": normal, "offset": float(offset)}

    def feature(self, x: np.ndarray) -> Feature:
        by, turn = slopes(x), slopes(x)
        normal, turn[..., :2, :] = tilted(self.normal, self.tangents, x[..., :2])
        by[..., :2, :] = x[..., 2, None, None] * turn[..., :2, :]
        by[..., 2, :] = normal
        return Feature(self.pivot + x[..., 2:] * normal, by, normal, turn)
