"""Contact with a sphere: ``|p - c| - (D / 2 + r) = 0``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.kind import Feature, direction, point


@dataclass(frozen=True)
class Sphere:
    """A datum sphere, by its centre and diameter.

    Parameters
    ----------
    centre : (3,) nominal, m
    diameter : nominal, m
    radius : (C,) ball radius, m
    sd : (4,) prior standard deviations of the centre and of the diameter, m
    """

    centre: np.ndarray
    diameter: float
    radius: np.ndarray
    sd: np.ndarray
    rows = 1
    parts = (("x", "m"), ("y", "m"), ("z", "m"), ("diameter", "m"))

    def _apart(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        return p - (self.centre + x[..., :3])[..., None]

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        length = np.linalg.norm(self._apart(x, p), axis=-2)
        return (length - (0.5 * (self.diameter + x[..., 3, None]) + self.radius))[..., None, :]

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u, length = direction(self._apart(x, p), axis=-2)
        r = length[..., 0, :] - (0.5 * (self.diameter + x[..., 3, None]) + self.radius)
        dx = np.empty((*r.shape, 4))
        dx[..., :3] = -np.swapaxes(u, -1, -2)
        dx[..., 3] = -0.5
        return r[..., None, :], u[..., None, :, :], dx[..., None, :, :]

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        return {"centre": self.centre + x[:3], "diameter": float(self.diameter + x[3])}

    def feature(self, x: np.ndarray) -> Feature:
        return point(self.centre, x)
