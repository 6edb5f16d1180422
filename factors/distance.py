"""A ball bar or draw wire: ``|p - c| - L = 0`` from a fixed pivot."""

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
