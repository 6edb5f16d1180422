"""Convergence of chains as ArviZ computes it: rank-normalised split R-hat, bulk and tail ESS.

Vehtari, Gelman, Simpson, Carpenter, Buerkner (2021), Rank-normalization, folding, and localization: an
improved R-hat, Bayesian Analysis 16, 667. ArviZ itself takes seconds to import and works on one component at
a time; tests compare the results.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

TAILS = (0.05, 0.95)
"""Quantiles whose indicators measure the tails."""


@dataclass(frozen=True)
class Convergence:
    """Effective draws in the bulk and in the tails, and R-hat, of every component, (D,)."""

    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    rhat: np.ndarray

    @property
    def ess(self) -> np.ndarray:
        """The smaller of the two effective sample sizes, (D,)."""
        return np.minimum(self.ess_bulk, self.ess_tail)


def convergence(chains: np.ndarray) -> Convergence:
    """Effective sample sizes and R-hat of chains.

    Parameters
    ----------
    chains : np.ndarray, shape (M, N, D)
        M chains of N draws (8 or more) of D components.
    """
    halves = _split(chains)
    normal = _rank_normalised(halves)
    folded = _rank_normalised(np.abs(halves - np.median(halves, axis=(0, 1))))
    tails = [_ess(_split(chains <= np.quantile(chains, q, axis=(0, 1))).astype(float)) for q in TAILS]
    return Convergence(_ess(normal), np.minimum(*tails), np.maximum(_rhat(normal), _rhat(folded)))


def split_rhat(chains: np.ndarray) -> np.ndarray:
    """R-hat (D,) of chains (M, N, D), each cut in two halves, without ranks."""
    return _rhat(_split(chains))


def _split(chains: np.ndarray) -> np.ndarray:
    """Each chain cut in two halves: (2 M, N // 2, D)."""
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, -half:]])


def _rank_normalised(chains: np.ndarray) -> np.ndarray:
    """Normal scores of the ranks over all chains (Blom), ties at their mean rank."""
    flat = chains.reshape(-1, chains.shape[-1])
    out = np.empty_like(flat)
    for k, column in enumerate(flat.T):
        _, which, count = np.unique(column, return_inverse=True, return_counts=True)
        rank = np.cumsum(count) - 0.5 * (count - 1)
        out[:, k] = ndtri((rank - 0.375) / (len(column) + 0.25))[which]
    return out.reshape(chains.shape)


def _rhat(chains: np.ndarray) -> np.ndarray:
    """R-hat (D,) of chains (M, N, D)."""
    count = chains.shape[1]
    within = chains.var(axis=1, ddof=1).mean(axis=0)
    between = chains.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sqrt((count - 1) / count + between / within)


def _ess(chains: np.ndarray) -> np.ndarray:
    """Effective sample size (D,) of chains (M, N, D), by Geyer's initial monotone sequence."""
    m, n, size = chains.shape
    long = 1 << (2 * n - 1).bit_length()  # a power of two; `scipy.fft` is slow to import
    spectrum = np.fft.rfft(chains - chains.mean(axis=1, keepdims=True), n=long, axis=1)
    power = np.mean(spectrum.real**2 + spectrum.imag**2, axis=0)
    covariance = np.fft.irfft(power, n=long, axis=0)[:n] / n
    within = covariance[0] * n / (n - 1.0)
    variance = covariance[0] + (chains.mean(axis=1).var(axis=0, ddof=1) if m > 1 else 0.0)
    still = np.ptp(chains, axis=(0, 1)) < np.finfo(float).resolution
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = 1.0 - (within - covariance) / variance
    rho[0] = 1.0
    out = np.full(size, float(m * n))
    for k in np.flatnonzero(~still):
        out[k] /= max(_time(rho[:, k]), 1.0 / np.log10(m * n))
    return out


def _time(rho: np.ndarray) -> float:
    """Autocorrelation time from autocorrelations (N,): pairs of lags while positive, made monotone."""
    n = len(rho)
    pairs = rho[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    most = max((n - 3) // 2, 0)  # as in ArviZ
    ends = np.flatnonzero(pairs[: most + 1] <= 0)
    end = int(ends[0]) if len(ends) else most
    return float(-1.0 + 2.0 * np.sum(np.minimum.accumulate(pairs[:end])) + max(rho[2 * end], 0.0))
