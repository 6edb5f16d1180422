"""The linear problem of a diagnosis: residuals, columns of the model, columns of the candidates.

Everything is linear at one estimate: linear and refitted chi-squares agree to 0.15 %. Contacts are whitened
by their stated noise. `state` then computes noise scale, outliers and evidence of any hypothesis with small
matrices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.estimate.outliers import limit


@dataclass(frozen=True)
class Problem:
    """Residuals (R,), Jacobian (R, D) and pool of candidate columns (R, K), contacts first, then constraints.

    Contacts are whitened by their stated noise, columns scaled by their prior standard deviations. `z` (D,)
    is where the problem was linearised; the prior mean is 0. `contact` (C,) numbers the contact of each of
    the first C rows; the three rows of a point are used or excluded together. `worth` (C,) is the number of
    independent residuals that each is worth; 1 if not given. `sharing` (contacts,) are those that are no
    outliers of any hypothesis, because they share a cause. The first L of these rows are
    lengths, the others orientations, each with its own contact number. Columns and evidence use both;
    results in metres are of lengths only.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    pool: np.ndarray
    z: np.ndarray
    contact: np.ndarray
    rows: np.ndarray  # (contacts,) row of the session of each contact
    sigma: np.ndarray  # (L,) m, stated noise of each of the first L rows
    worth: np.ndarray | None = None
    sharing: np.ndarray | None = None

    @cached_property
    def base(self) -> np.ndarray:
        """Weights (R,) of rows that are not excluded; constraints 1."""
        out = np.ones(len(self.residual))
        if self.worth is not None:
            out[: self.count] = self.worth
        return out

    @property
    def count(self) -> int:
        """Number C of residuals of contacts."""
        return len(self.contact)

    @property
    def lengths(self) -> int:
        """Number L of residuals that are lengths."""
        return len(self.sigma)

    @cached_property
    def by_size(self) -> list[np.ndarray]:
        """Residuals (C, k) of the contacts of k rows, for every k."""
        order, size = np.argsort(self.contact, kind="stable"), np.bincount(self.contact)
        first = np.cumsum(size) - size
        return [order[first[size == k][:, None] + np.arange(k)] for k in np.unique(size)]

    @property
    def ends(self) -> np.ndarray:
        """End of the contacts of each size except the last, in the order of `by_size`."""
        return np.cumsum([len(at) for at in self.by_size])[:-1]

    @cached_property
    def gross(self) -> np.ndarray:
        """Log density (contacts,) of an outlier: that of a good contact at the limit of rejection."""
        size = np.bincount(self.contact)
        return -0.5 * limit(size) * np.bincount(self.contact, self.base[: self.count]) / size


def without_nuisance(p: Problem, size: int) -> Problem:
    """The same problem with the first `size` columns of its Jacobian: the model's own parameters."""
    return replace(p, jacobian=p.jacobian[:, :size], z=p.z[:size])
