"""Draws of the posterior, and those of its Gaussian approximation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.estimate import Estimate
from bayescal.posterior.density import Density
from bayescal.posterior.linearised import Linearised

CHAINS = 4


@dataclass(frozen=True)
class Draws:
    """Draws of the posterior in four chains, with their convergence.

    A chain is an ensemble, its walkers concatenated, so that the autocorrelation of a walker is that of the
    chain. Convergence is computed from these draws, as ArviZ does.
    """

    z: np.ndarray  # (chains, draws, D)
    log_kappa: np.ndarray  # (chains, draws, G), noise scale of each group over its stated noise
    log_density: np.ndarray  # (chains, draws)
    names: tuple[str, ...]  # of the D components and the noise scales
    ess_bulk: np.ndarray  # (D + G,) effective draws in the bulk
    ess_tail: np.ndarray  # (D + G,) effective draws in the tails, of the 5 % and the 95 % quantile
    rhat: np.ndarray  # (D + G,) rank-normalised split R-hat, nan where not sampled
    acceptance: dict[str, float]  # by move
    moves: str
    steps: int  # of each ensemble after burn-in
    walkers: int
    converged: bool
    complaint: str  # reason, where not converged

    @property
    def ess(self) -> np.ndarray:
        """Effective draws, the smaller of bulk and tails, (D + G,)."""
        return np.minimum(self.ess_bulk, self.ess_tail)

    @property
    def flat(self) -> np.ndarray:
        """All draws of z, (chains * draws, D)."""
        chains, draws, size = self.z.shape  # not -1: there may be no components at all
        return self.z.reshape(chains * draws, size)

    @property
    def kappa(self) -> np.ndarray:
        """Noise scales of `flat`, (chains * draws, G), in the order of `noise_groups`."""
        return np.exp(self.log_kappa.reshape(-1, self.log_kappa.shape[-1]))


def scale_names(groups: Sequence[str]) -> tuple[str, ...]:
    """Names of the noise scales: that of the first group is the noise scale of a fit."""
    return tuple(f"noise scale of {g}" if k else "noise scale" for k, g in enumerate(groups))


def approximate(estimate: Estimate, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Draws z (count, D) of `gaussian` and their noise scales (count, G), without their density."""
    x, size = _linearised(Density(estimate), seed, count), estimate.model.size
    return x[:, :size] + estimate.from_free, np.exp(x[:, size:])


def _linearised(density: Density, seed: int, count: int) -> np.ndarray:
    return Linearised.of(density).draw(count, np.random.default_rng(seed))


def gaussian(estimate: Estimate, seed: int, count: int = 4000) -> Draws:
    """Draws of the linearised posterior: the Gaussian approximation, with the noise scales unknown.

    They are about the estimate, also where this has parameters at their bound.
    """
    density = Density(estimate)
    x = _linearised(density, seed, count).reshape(CHAINS, -1, density.size)
    x[..., : estimate.model.size] += estimate.from_free
    lp = np.stack([density(part) for part in x])
    every, size = np.full(density.size, float(count)), density.model.size
    return Draws(
        x[..., :size], x[..., size:], lp, (*estimate.model.names, *scale_names(density.groups)),
        every, every, np.full(density.size, np.nan), {},
        "none: independent draws of the linearised posterior", count, 1, True, "",
    )  # fmt: skip
