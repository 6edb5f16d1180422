"""ArviZ's own diagnostics of one component (chains, draws), on either line (0.x, 1.x)."""

import numpy as np

from bayescal.posterior.inference import arviz

az = arviz()


def arviz_ess(values: np.ndarray, method: str) -> float:
    """Effective sample size."""
    further = {"prob": (0.05, 0.95)} if method == "tail" else {}
    return float(np.asarray(az.ess(np.asarray(values), method=method, **further)))


def arviz_rhat(values: np.ndarray) -> float:
    """Rank-normalised split R-hat."""
    return float(np.asarray(az.rhat(np.asarray(values))))
