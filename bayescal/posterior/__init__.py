"""The posterior: emcee on the whitened model, its convergence, and its ArviZ record."""

from __future__ import annotations

from bayescal.posterior.density import Density
from bayescal.posterior.pointwise import Pointwise, pointwise, prior_draws
from bayescal.posterior.sample import Draws, gaussian, sample

__all__ = ["Density", "Draws", "Pointwise", "gaussian", "pointwise", "prior_draws", "sample"]
