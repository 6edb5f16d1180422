"""The posterior: its density, draws of it, and its ArviZ record.

`sample` (emcee) is imported where it is called: its import takes a second, and most commands draw nothing.
"""

from __future__ import annotations

from bayescal.posterior.density import Density
from bayescal.posterior.draws import Draws, approximate, gaussian
from bayescal.posterior.pointwise import Pointwise, pointwise, prior_draws

__all__ = ["Density", "Draws", "Pointwise", "approximate", "gaussian", "pointwise", "prior_draws"]
