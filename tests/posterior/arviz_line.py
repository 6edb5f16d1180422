"""ArviZ's own diagnostics of one component (chains, draws), on either line (0.x, 1.x)."""

import warnings

import numpy as np

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)
    import arviz as az


def arviz_ess(values: np.ndarray, method: str) -> float:
    """Effective sample size."""
    further = {"prob": (0.05, 0.95)} if method == "tail" else {}
    return float(np.asarray(az.ess(np.asarray(values), method=method, **further)))


def arviz_rhat(values: np.ndarray) -> float:
    """Rank-normalised split R-hat."""
    return float(np.asarray(az.rhat(np.asarray(values))))
