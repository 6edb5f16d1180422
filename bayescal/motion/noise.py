"""Noise of torques: autoregressive, a model per joint.

White noise would be wrong by far: residuals of neighbouring rows share what the controller, the load cells of
the gears and the friction do between them, and an effect would gain from each row anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, solve_toeplitz, toeplitz
from scipy.sparse import csr_array

from bayescal.motion.settings import NOISE

Motions = Sequence[np.ndarray]
"""Rows (M, n) of several motions."""
BLOCK = 128
"""Rows that are whitened at once (cost)."""


@dataclass(frozen=True)
class Noise:
    """Filters (n, p + 1) that whiten residuals, and `starts` (n, p, p) for the first p rows."""

    filters: np.ndarray
    starts: np.ndarray
    sd: np.ndarray  # (n,) N m, of the residuals before
    lag1: np.ndarray  # (n,) autocorrelation of neighbouring rows; nan where there are none

    @property
    def order(self) -> int:
        """Rows before a row on which it depends."""
        return self.filters.shape[1] - 1

    def whitened(self, x: np.ndarray, joint: int) -> np.ndarray:
        """Rows (M, ...) of one joint in one motion without their predictable part, in units of the noise."""
        order, band = self.order, self._bands[joint]
        first = min(order, len(x))
        parts = [self.starts[joint][:first, :first] @ x[:first]]
        for low in range(order, len(x), BLOCK):
            rows = x[low - order : low + BLOCK]
            parts.append(band[: len(rows) - order, : len(rows)] @ rows)
        return np.concatenate(parts)

    def without(self, white: np.ndarray, missing: np.ndarray, joint: int) -> np.ndarray:
        """Whitened rows (M, ...) without what the values of some rows (k,) would change: they are missing.

        Each such row has a free value, which is projected out: the likelihood of the others is exact.
        """
        if not len(missing):
            return white
        order = self.order
        first = min(order, len(white))
        low, lag = np.broadcast_arrays(missing[:, None], np.arange(order + 1))
        row, value = low + lag, np.broadcast_to(self.filters[joint], low.shape)
        late = (row >= first) & (row < len(white))
        early = missing[missing < first]
        starts = self.starts[joint][:first, early]
        column = np.broadcast_to(np.arange(len(missing))[:, None], low.shape)
        rows = np.r_[row[late], np.repeat(np.arange(first), len(early))]
        columns = np.r_[column[late], np.tile(np.arange(len(early)), first)]
        entries = np.r_[value[late], starts.ravel()], (rows, columns)
        free = csr_array(entries, shape=(len(white), len(missing)))
        gram = (free.T @ free).tocoo()
        below = gram.row >= gram.col
        band = np.zeros((order + 1, len(missing)))
        band[(gram.row - gram.col)[below], gram.col[below]] = gram.data[below]
        solved = cho_solve_banded((cholesky_banded(band, lower=True), True), free.T @ white)
        return np.asarray(white - free @ solved)

    @cached_property
    def _bands(self) -> np.ndarray:
        """The filters as matrices (n, BLOCK, BLOCK + p): their products take a third of the time of sums."""
        out = np.zeros((len(self.filters), BLOCK, BLOCK + self.order))
        for row in range(BLOCK):
            out[:, row, row : row + self.order + 1] = self.filters[:, ::-1]
        return out

    def wider(self, factor: float | np.ndarray) -> Noise:
        """The same noise, larger by a factor, or by one of each channel (n,)."""
        each = np.broadcast_to(factor, self.sd.shape)
        filters, starts = self.filters / each[:, None], self.starts / each[:, None, None]
        return replace(self, filters=filters, starts=starts, sd=self.sd * each)


def noise_of(
    residuals: Motions,
    followed: Iterable[Sequence[np.ndarray]] = (),
    same: Sequence[str] = (),
    weights: Motions = (),
) -> Noise:
    """Noise of residuals (M, n) of several motions, by the Yule-Walker equations.

    Residuals are taken about their mean in each motion: a torque that changes from motion to motion is an
    error of the model, which slow noise would hide. What a fit and these means follow of the noise is added:
    residuals e = y - X b have the covariance S - X C X' under noise S, where C is that of the estimates b.

    What repeats of a motion share is no noise: where their differences are clearly smaller than residuals,
    they determine it.

    Parameters
    ----------
    residuals
        A part per motion.
    followed
        Of each motion and channel X L (M, k), where L L' = C; none if nothing was fitted.
    same : sequence of str
        The motion that each repeats.
    weights : sequence of np.ndarray
        Of the rows of each motion (M, n), by which residuals and `followed` are multiplied; 1 if not given.
    """
    weights = weights or [np.ones_like(r) for r in residuals]
    parts = [_apart(r, w) for r, w in zip(residuals, weights, strict=True)]
    seen = np.sum([np.sum(w**2, axis=0) for w in weights], axis=0)
    count = np.maximum(seen, 1.0)
    # of the pairs of rows that are there, as many as if all were
    pairs, every = (_autocovariance(x) for x in (weights, [np.ones_like(w) for w in weights]))
    there = count[:, None] * np.maximum(pairs, 1e-9) / np.maximum(pairs[:, :1], 1e-9)
    there = there * np.maximum(every[:, :1], 1.0) / np.maximum(every, 1.0)
    covariance = _autocovariance(parts) / there
    for followers, w in zip(followed, weights, strict=False):
        for j, x in enumerate(followers):
            covariance[j] += np.sum(_autocovariance([_apart(x, w[:, j : j + 1])]), axis=0) / there[j]
    differences = _differences(parts, same)
    if differences:
        share = sum(map(len, differences)) / sum(map(len, parts))
        rows, repeated = share * count, _autocovariance(differences) / (share * there)
        share = repeated / np.maximum(repeated[:, :1], 1e-300)
        # a variance of correlated rows has as many degrees of freedom as there are independent rows
        independent = rows / np.maximum(2.0 * np.sum(share, axis=1) - 1.0, 1.0)
        clearly = np.maximum(np.log(NOISE.smaller), NOISE.sure * np.sqrt(2.0 / independent))
        smaller = covariance[:, 0] > repeated[:, 0] * np.exp(clearly)
        covariance = np.where(smaller[:, None], repeated, covariance)
    # the mean of correlated noise over a motion has its density at frequency 0 over the rows as variance
    about = covariance
    for _ in range(NOISE.of_means):
        of_mean = np.sum(_filters(covariance)[0], axis=1) ** -2.0 * len(parts) / count
        covariance = about + of_mean[:, None]
    lag1 = np.where(seen > 0.0, covariance[:, 1] / covariance[:, 0], np.nan)
    return Noise(*_filters(covariance), np.sqrt(covariance[:, 0]), lag1)


def _apart(x: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted rows (M, n) about their mean."""
    mean = np.sum(weight * x, axis=0) / np.maximum(np.sum(weight**2, axis=0), 1e-9)
    return np.asarray(x - weight * mean)


def _filters(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Filters (n, p + 1), and (n, p, p) of the first rows, for noise of autocovariances (n, p + 1)."""
    n, order = len(covariance), covariance.shape[1] - 1
    filters, starts = np.empty((n, order + 1)), np.empty((n, order, order))
    for j, autocovariance in enumerate(covariance):
        if not autocovariance[0] > 0.0:  # of a joint that never moves no row counts
            autocovariance = np.eye(order + 1)[0]
        # with rows missing a matrix of covariances may have negative eigenvalues
        least = float(np.linalg.eigvalsh(toeplitz(autocovariance))[0])
        ridge = NOISE.ridge * autocovariance[0] - min(least, 0.0)
        ridged = autocovariance + np.r_[ridge, np.zeros(order)]
        by = solve_toeplitz(ridged[:-1], autocovariance[1:])
        filters[j] = np.r_[1.0, -by] / np.sqrt(max(ridged[0] - by @ autocovariance[1:], 1e-300))
        starts[j] = np.linalg.inv(np.linalg.cholesky(toeplitz(ridged[:-1])))
    return filters, starts


def _autocovariance(parts: Motions) -> np.ndarray:
    """Sums of products (n, lags) of parts (M, n) with themselves, later by each lag."""

    def lagged(r: np.ndarray, lag: int) -> np.ndarray:
        return np.sum(r[lag:] * r[: max(len(r) - lag, 0)], axis=0)  # 0 of a part that is shorter

    return np.array([sum(lagged(r, lag) for r in parts) for lag in range(NOISE.order + 1)]).T


def _differences(parts: Motions, same: Sequence[str]) -> list[np.ndarray]:
    """Parts (M, n) less the mean of all repeats of their motion, with the variance of a single one."""
    out = []
    for name in dict.fromkeys(same):
        group = [r for r, label in zip(parts, same, strict=True) if label == name]
        rows = min(map(len, group))
        if len(group) > 1:
            mean = sum(r[:rows] for r in group) / len(group)
            out += [(r[:rows] - mean) * np.sqrt(len(group) / (len(group) - 1.0)) for r in group]
    return out


def white_noise(sd: np.ndarray) -> Noise:
    """White noise of these standard deviations (n,): a start."""
    filters = np.zeros((len(sd), NOISE.order + 1))
    filters[:, 0] = 1.0 / sd
    return Noise(filters, np.eye(NOISE.order) / sd[:, None, None], sd, np.zeros(len(sd)))
