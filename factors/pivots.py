"""A fixed point from which the ball keeps a distance, or in which it sits.

- a ball bar or draw wire: ``|p - c| - L = 0`` from a fixed pivot
- a nest that locates the ball centre at one point (a cone, a socket): ``p - c = 0``
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.kind import Centred, direction


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
