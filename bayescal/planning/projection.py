"""Columns of effects, projected off the model by the contacts that are chosen so far.

With the whitened Jacobian J (R, D) of the chosen contacts, certificates and measurements, the columns X
(R, K) of effects, and C = inv(I + J'J), the model leaves X - J C J'X of them, and G = X'X - X'J C J'X is the
detectability of their combinations. A further residual with the row j and the columns x has the variance
v = j'Cj and the error e = x - j'C J'X; it increases G by e e' / (1 + v) (Sherman and Morrison). No step
needs a refit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CandidateColumns:
    """Residuals of candidates, and of what is known without them, whitened by their stated noise.

    Attributes
    ----------
    design : np.ndarray, shape (R, D)
        By the parameters of the model and the masses, in units of their prior standard deviations.
    columns : np.ndarray, shape (R, K)
        By the parameters of effects that the model lacks, in the same units.
    candidate : np.ndarray of int, shape (R,)
        Number of the candidate of each residual, ascending.
    known_design, known_columns : np.ndarray, shapes (Q, D), (Q, K)
        The same of certificates and of rows that were measured already.
    """

    design: np.ndarray
    columns: np.ndarray
    candidate: np.ndarray
    known_design: np.ndarray
    known_columns: np.ndarray

    @property
    def count(self) -> int:
        """Number of candidates."""
        return int(self.candidate[-1]) + 1 if len(self.candidate) else 0

    def residuals(self, candidates: Sequence[int] | np.ndarray) -> np.ndarray:
        """Residuals of some candidates, in their order; a candidate that is given twice has them twice."""
        at = np.asarray(candidates, int)
        if len(self.candidate) == self.count:
            return at
        first, last = (np.searchsorted(self.candidate, at, side=side) for side in ("left", "right"))
        return np.concatenate(
            [np.empty(0, int), *(np.arange(a, b) for a, b in zip(first, last, strict=True))]
        )


class Projection:
    """The candidates' residuals as the chosen contacts determine the model.

    Attributes
    ----------
    error : np.ndarray, shape (K, R)
        What the model leaves of each column at every residual.
    variance : np.ndarray, shape (R,)
        Of the prediction of each residual, in units of the noise.
    information : np.ndarray, shape (K, K)
        G of the chosen contacts.
    """

    def __init__(self, linear: CandidateColumns, chosen: Sequence[int] | np.ndarray = ()) -> None:
        rows = linear.residuals(chosen)
        design = np.concatenate([linear.known_design, linear.design[rows]])
        columns = np.concatenate([linear.known_columns, linear.columns[rows]])
        self.linear = linear
        self.covariance = np.linalg.inv(np.eye(design.shape[1]) + design.T @ design)
        across = design.T @ columns
        absorbed = self.covariance @ across
        self.information = columns.T @ columns - across.T @ absorbed
        self.error = np.ascontiguousarray(linear.columns.T - absorbed.T @ linear.design.T)
        self.variance = np.sum((linear.design @ self.covariance) * linear.design, axis=1)

    def variance_of_candidates(self) -> np.ndarray:
        """Sum of the variances of each candidate's residuals, (candidates,)."""
        return np.bincount(self.linear.candidate, self.variance, self.linear.count)

    def add(self, candidate: int) -> None:
        """Choose a candidate, once more if it is chosen already."""
        for row in self.linear.residuals([candidate]).tolist():
            self._changed(row, 1.0)

    def remove(self, candidate: int) -> None:
        """Drop a candidate that was chosen."""
        for row in self.linear.residuals([candidate]).tolist():
            self._changed(row, -1.0)

    def _changed(self, row: int, sign: float) -> None:
        j = self.linear.design[row]
        gain = self.covariance @ j
        across, by = self.linear.design @ gain, sign + float(j @ gain)  # of a removed one: v - 1
        wrong = self.error[:, row].copy()
        self.information += np.outer(wrong, wrong / by)
        self.error -= np.outer(wrong / by, across)
        self.variance -= across**2 / by
        self.covariance -= np.outer(gain, gain / by)
