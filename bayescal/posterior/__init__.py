"""The posterior: its density, draws of it, and its ArviZ record.

`sample` (emcee) is imported where it is called: its import takes a second, and most commands draw nothing.
"""

from __future__ import annotations

from bayescal.posterior.density import Density, Pointwise, pointwise, prior_draws
from bayescal.posterior.linearised import Draws, approximate, gaussian

__all__ = ["Density", "Draws", "Pointwise", "approximate", "gaussian", "pointwise", "prior_draws"]
