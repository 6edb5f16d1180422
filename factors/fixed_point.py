"""A nest locates the ball centre at one point (a cone, a socket): ``p - c = 0``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.kind import Centred


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
