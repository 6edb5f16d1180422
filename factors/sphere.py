"""Contact with a sphere: ``|p - c| - (D / 2 + r) = 0``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.kind import Centred, direction


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
