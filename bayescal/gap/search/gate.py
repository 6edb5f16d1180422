"""The last test: an effect that increases validation errors is not named."""

from __future__ import annotations

import numpy as np

from bayescal.gap.outcome.levels import difference, log_predictive
from bayescal.gap.settings import GATE
from bayescal.predict.crossvalidation import LEFT_OUT, ValidationErrors, kept


def worse(before: ValidationErrors, after: ValidationErrors) -> str:
    """How a refit increased the validation errors, as text; "" where it did not."""
    if before.how != LEFT_OUT:
        gain, se = difference(log_predictive(after)[0] - log_predictive(before)[0], log_predictive(before)[1])
        fair = kept(before, after)
        old, new = (float(np.sqrt(np.mean(h.residual[fair] ** 2))) for h in (before, after))
        unlikely = gain < -GATE.loss and (np.isnan(se) or gain < -GATE.errors * se) and new > old
        if unlikely or new > GATE.worse * old:
            return f"validation RMS from {1e6 * old:.1f} to {1e6 * new:.1f} µm"
    if len(before.distances.error):
        old, new = (float(np.sqrt(np.mean(h.distances.error**2))) for h in (before, after))
        expected = float(np.sqrt(np.mean(before.distances.predicted_sd() ** 2)))
        if new > GATE.grown * max(old, expected):
            return f"distance RMS from {1e6 * old:.1f} to {1e6 * new:.1f} µm"
    return ""
