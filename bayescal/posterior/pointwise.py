"""Log likelihood and replicated residuals of each fitted row under the posterior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.estimate import STATED_WORTH, Estimate
from bayescal.posterior.density import Density

UM = 1e6
PRIOR = 0x9A10
"""Second word of the seed of prior draws."""
CHUNK = 64
"""Number of draws per call of the density, as in the sampler."""
PARTS = 8
"""Parts in which residuals are computed of a session that is too large for so many draws: of its points."""


@dataclass(frozen=True)
class Pointwise:
    """The fitted measurements without outliers, with their log likelihood and replicated residuals.

    `log_likelihood` (S, C) is a density of the residuals of a row in µm and µrad. `replicated` (S, C), µm, is
    the residual of simulated data at the estimate. Both vary by more than their seventh figure from draw to
    draw: single precision. `observed` (C,), m, is the residual of the measured data. The residual is signed
    where a row has a single one, and a vector length where it has several; of a full pose it is that of the
    point.
    """

    rows: np.ndarray  # (C,) rows of the session
    log_likelihood: np.ndarray
    replicated: np.ndarray
    observed: np.ndarray


def pointwise(estimate: Estimate, z: np.ndarray, kappa: np.ndarray, rng: np.random.Generator) -> Pointwise:
    """Log likelihoods and replicated residuals of the fitted measurements.

    Parameters
    ----------
    estimate : Estimate
        Rows that were excluded as outliers are omitted.
    z : np.ndarray, shape (S, D)
        Draws of the whitened parameters.
    kappa : np.ndarray, shape (S, G)
        Noise scales of the same draws, in the order of `noise_groups`.
    rng : np.random.Generator
        Of the noise of replicated data.
    """
    density = Density(estimate)
    blocks = density.blocks
    rows = np.unique(np.concatenate([b.rows for b in blocks]))
    at = [np.searchsorted(rows, b.rows) for b in blocks]
    here, _ = density.whitened(estimate.z[None])
    log_likelihood = np.empty((len(z), len(rows)), np.float32)
    replicated = np.full((len(z), len(rows)), np.nan, np.float32)
    observed = np.full(len(rows), np.nan)
    pointlike = [k for k, b in enumerate(blocks) if b.name == b.target]
    for k in pointlike:
        observed[at[k]] = _size(here[k][0] / density.inverse_sigma[k])
    chunk = min(CHUNK, density.at_once)
    for start in range(0, len(z), chunk):
        part = slice(start, start + chunk)
        terms = np.zeros((len(z[part]), len(rows)))
        for k, r in enumerate(_whitened(density, z[part])):
            inverse = density.inverse_sigma[k]
            scale = kappa[part, density.groups.index(blocks[k].group), None, None]
            term = np.log(1e-6 * inverse / np.sqrt(2.0 * np.pi) / scale) - 0.5 * (r / scale) ** 2
            terms[:, at[k]] += term.sum(axis=1)
            if k in pointlike:
                anew = here[k] - r + scale * rng.standard_normal(r.shape)
                replicated[part, at[k]] = UM * _size(anew / inverse)
        log_likelihood[part] = terms
    return Pointwise(rows, log_likelihood, replicated, observed)


def _whitened(density: Density, z: np.ndarray) -> list[np.ndarray]:
    """Residuals of every block at z (W, D) as of `Density.whitened`; points of few draws are held at once."""
    few = max(density.at_once // PARTS, 1)
    if len(z) <= few:
        return density.whitened(z)[0]
    out = [np.empty((len(z), *inverse.shape)) for inverse in density.inverse_sigma]
    for k in range(0, len(z), few):
        for own, part in zip(out, density.whitened(z[k : k + few])[0], strict=True):
            own[k : k + few] = part
    return out


def _size(residuals: np.ndarray) -> np.ndarray:
    """The single residual of each row, or the length of several, (..., C), of (..., rows of the kind, C)."""
    return residuals[..., 0, :] if residuals.shape[-2] == 1 else np.linalg.norm(residuals, axis=-2)


def prior_draws(size: int, groups: int, chains: int, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draws of the prior: z (chains, draws, size), and logs of the noise scales (chains, draws, groups).

    Only the parameters have a prior; certificates between targets are data. The prior of each noise scale
    gives the stated noise the weight of `STATED_WORTH` contacts.
    """
    rng = np.random.default_rng([seed, PRIOR])
    z = rng.standard_normal((chains, draws, size))
    return z, -0.5 * np.log(rng.chisquare(STATED_WORTH, (chains, draws, groups)) / STATED_WORTH)
