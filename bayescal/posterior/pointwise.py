"""What a posterior says of each fitted row: its log likelihood, and residuals that it would have given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.estimate import STATED_WORTH, Estimate
from bayescal.posterior.density import Density

PRIOR = 0x9A10
"""Word of the seed of prior draws."""
CHUNK = 64
"""Draws at a time, as many as the sampler judges."""


@dataclass(frozen=True)
class Pointwise:
    """The rows that count, and what draws say of them.

    `log_likelihood` (S, C) is of a row's residuals in um and urad. `replicated` (S, C), m, is the residual at
    the estimate of data drawn anew, `observed` (C,), m, that of the data: with its sign where a row has one
    residual, its length where it has several; of a full pose that of its point.
    """

    rows: np.ndarray  # (C,) rows of the session
    log_likelihood: np.ndarray
    replicated: np.ndarray
    observed: np.ndarray


def pointwise(estimate: Estimate, z: np.ndarray, kappa: np.ndarray, rng: np.random.Generator) -> Pointwise:
    """Judge the fitted rows by draws.

    Parameters
    ----------
    estimate : Estimate
        Rows that it left out as outliers do not appear.
    z : np.ndarray, shape (S, D)
        Draws of the whitened parameters.
    kappa : np.ndarray, shape (S,)
        Noise scales of the same draws.
    rng : np.random.Generator
        Of the noise of replicated data.
    """
    density = Density(estimate)
    blocks = density.blocks
    rows = np.unique(np.concatenate([b.rows for b in blocks]))
    at = [np.searchsorted(rows, b.rows) for b in blocks]
    here, _ = density.whitened(estimate.z[None])
    log_likelihood = np.zeros((len(z), len(rows)))
    replicated = np.full((len(z), len(rows)), np.nan)
    observed = np.full(len(rows), np.nan)
    pointlike = [k for k, b in enumerate(blocks) if b.name == b.target]
    for k in pointlike:
        observed[at[k]] = _size(here[k][0] / density.inverse_sigma[k])
    for start in range(0, len(z), CHUNK):
        part = slice(start, start + CHUNK)
        scale = kappa[part, None, None]
        residuals, _ = density.whitened(z[part])
        for k, r in enumerate(residuals):
            inverse = density.inverse_sigma[k]
            term = np.log(1e-6 * inverse / np.sqrt(2.0 * np.pi) / scale) - 0.5 * (r / scale) ** 2
            log_likelihood[part, at[k]] += term.sum(axis=1)
            if k in pointlike:
                anew = here[k] - r + scale * rng.standard_normal(r.shape)
                replicated[part, at[k]] = _size(anew / inverse)
    return Pointwise(rows, log_likelihood, replicated, observed)


def _size(residuals: np.ndarray) -> np.ndarray:
    """Of residuals (..., rows of the kind, C): the only one, or the length of several, (..., C)."""
    return residuals[..., 0, :] if residuals.shape[-2] == 1 else np.linalg.norm(residuals, axis=-2)


def prior_draws(size: int, chains: int, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draws of the prior: z (chains, draws, size), and logs of the noise scale (chains, draws).

    Of the parameters alone: what certificates state between targets is data. The noise scale's prior is
    that of a stated noise worth `STATED_WORTH` contacts.
    """
    rng = np.random.default_rng([seed, PRIOR])
    z = rng.standard_normal((chains, draws, size))
    return z, -0.5 * np.log(rng.chisquare(STATED_WORTH, (chains, draws)) / STATED_WORTH)
