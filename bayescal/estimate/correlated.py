"""Noise that rows share: the corners of an image have the errors of its readings in common.

Over the standard uncertainty of each row, the covariance of the noise of an image is D + S S', with S (R, n)
the standard errors of n readings and D diagonal, 1 - |S|^2. What whitens it is symmetric: each whitened
residual is nearly that of its row, so that outliers stay rows. With Q = D^-1/2 S, and Q' Q = V L V',

    (I + Q Q')^-1/2 D^-1/2 = (I - U (1 - (1 + L)^-1/2) U') D^-1/2,  U = Q V L^-1/2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import csr_array

LEAST = 1e-12
"""Variance of a common error, in units of the noise, below which there is none (rounding)."""


@dataclass(frozen=True)
class Shared:
    """Standard errors that the residuals (R,) of a block share, over the noise of each."""

    by: np.ndarray  # (R, n)
    image: np.ndarray  # (R,) int, from 0: residuals with the same number share all n errors

    @classmethod
    def of(cls, by: np.ndarray, readings: np.ndarray) -> Shared:
        """Errors `by` (k C, n) of C rows of k residuals; rows with equal readings (C, n) share them."""
        image = np.unique(readings, axis=0, return_inverse=True)[1].ravel()
        return cls(by, np.tile(image, len(by) // max(len(image), 1)))

    @classmethod
    def joined(cls, parts: Sequence[Shared | int]) -> Shared:
        """That of the residuals of blocks in order; a block of independent ones is given by their number."""
        width = max(0 if isinstance(part, int) else part.by.shape[1] for part in parts)
        by, image = [np.zeros((0, width))], np.zeros(0, int)
        for part in parts:
            s = cls(np.zeros((part, width)), np.arange(part)) if isinstance(part, int) else part
            by.append(np.pad(s.by, ((0, 0), (0, width - s.by.shape[1]))))
            image = np.append(image, int(np.max(image, initial=-1)) + 1 + s.image)
        return cls(np.vstack(by), image)

    def without(self, rows: np.ndarray) -> Shared:
        """The same with the residuals `rows` (R,), bool, having noise of their own alone."""
        return replace(self, by=np.where(rows[:, None], 0.0, self.by))

    def __getitem__(self, kept: np.ndarray) -> Shared:
        """The part of some residuals (R,), bool."""
        return Shared(self.by[kept], self.image[kept])

    def decorrelated(self, row: np.ndarray | float = 1.0) -> Decorrelation:
        """What whitens residuals with weights `row` (R,), over the noise of each."""
        from scipy.sparse import csr_array  # slow to import, and few sessions need it

        alone = 1.0 / np.sqrt(1.0 - np.sum(self.by**2, axis=1))
        q = self.by * (alone * np.sqrt(row))[:, None]
        count, n = int(self.image.max(initial=-1)) + 1, q.shape[1]
        gram = np.empty((count, n, n))
        for i, j in np.ndindex(n, n):  # `np.add.at` takes several times longer
            gram[:, i, j] = np.bincount(self.image, q[:, i] * q[:, j], count)
        size, turn = np.linalg.eigh(gram)
        across = turn * np.where(size > LEAST, 1.0 / np.sqrt(np.maximum(size, LEAST)), 0.0)[:, None]
        basis = np.einsum("ri,rij->rj", q, across[self.image])
        place = (n * self.image[:, None] + np.arange(n)).ravel()
        ends = n * np.arange(len(q) + 1)
        return Decorrelation(
            alone, csr_array((basis.ravel(), place, ends), (len(q), n * count)), np.maximum(size, 0.0).ravel()
        )


def fields(pixel: np.ndarray, image: np.ndarray, power: int) -> np.ndarray:
    """Errors (2 C, n) of both coordinates of corners (C, 2), px, that those of an image (C,) share.

    They are polynomials of a degree up to `power` (2 at most) of the place of the corner in its image, about
    the middle of its corners, over their spread.
    """
    count = np.maximum(np.bincount(image), 1)[:, None]

    def mean(x: np.ndarray) -> np.ndarray:
        return np.column_stack([np.bincount(image, column) for column in x.T]) / count

    away = pixel - mean(pixel)[image]
    x, y = (away / np.sqrt(np.maximum(mean(away**2), 1e-12))[image]).T
    powers = [np.ones(len(x)), x, y, x**2 - 1.0, x * y, y**2 - 1.0][: (1, 3, 6)[power]]
    return np.kron(np.eye(2), np.column_stack(powers))


@dataclass(frozen=True)
class Decorrelation:
    """A symmetric factor that whitens residuals (R,), or columns (R, K), of unit noise."""

    alone: np.ndarray  # (R,)
    basis: csr_array  # (R, M)
    size: np.ndarray  # (M,)

    def white(self, x: np.ndarray) -> np.ndarray:
        """Residuals or columns with independent unit noise."""
        return self._moved((x.T * self.alone).T, 1.0 / np.sqrt(1.0 + self.size) - 1.0)

    def turned(self, x: np.ndarray) -> np.ndarray:
        """Products with the transpose of `white`."""
        return (self._moved(x, 1.0 / np.sqrt(1.0 + self.size) - 1.0).T * self.alone).T

    def each(self, x: csr_array) -> csr_array:
        """`white` of columns with few values, as such columns."""
        apart = x.multiply(self.alone[:, None]).tocsr()
        across = (self.basis.T @ apart).multiply((1.0 / np.sqrt(1.0 + self.size) - 1.0)[:, None])
        return (apart + self.basis @ across.tocsr()).tocsr()

    def coloured(self, x: np.ndarray) -> np.ndarray:
        """The inverse of `white`."""
        return (self._moved(x, np.sqrt(1.0 + self.size) - 1.0).T / self.alone).T

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of `white`."""
        return float(np.sum(np.log(self.alone)) - 0.5 * np.sum(np.log1p(self.size)))

    def _moved(self, x: np.ndarray, by: np.ndarray) -> np.ndarray:
        return np.asarray(x + self.basis @ ((self.basis.T @ x).T * by).T)
