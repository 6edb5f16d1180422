"""A ball bar or draw wire: ``|p - c| - L = 0`` from a fixed pivot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.kind import Feature, direction, point


@dataclass(frozen=True)
class Distance:
    """A pivot from which a length is kept or read.

    Parameters
    ----------
    centre : (3,) nominal pivot, m
    length : (C,) length of each row, m
    sd : (3,) prior standard deviations of the pivot, m
    """

    centre: np.ndarray
    length: np.ndarray
    sd: np.ndarray
    rows = 1
    parts = (("x", "m"), ("y", "m"), ("z", "m"))

    def residual(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        out = p - (self.centre + x)[..., None]
        return (np.linalg.norm(out, axis=-2) - self.length)[..., None, :]

    def linearise(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        out = p - (self.centre + x)[..., None]
        u, length = direction(out, axis=-2)
        r = length[..., 0, :] - self.length
        return r[..., None, :], u[..., None, :, :], -np.swapaxes(u, -1, -2)[..., None, :, :]

    def describe(self, x: np.ndarray) -> dict[str, np.ndarray | float]:
        return {"centre": self.centre + x}

    def feature(self, x: np.ndarray) -> Feature:
        return point(self.centre, x)
