"""Circumstances of a fitted model: added loads act through the compliances that the fit found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.effects import Circumstances, compliances
from bayescal.effects.compliance import COMPLIANCE
from bayescal.estimate.estimate import Estimate
from bayescal.model import ARM, Model

LEAST = 0.2
"""Least compliance of a joint through which a load acts, as a share of its prior mean (assumed).

With an estimate near zero, or below, a payload would not deflect the joint.
"""


def with_compliances(c: Circumstances, fitted: Estimate) -> Circumstances:
    """Circumstances with the fitted compliances."""
    return compliant(c, fitted.model, fitted.model.deviations(fitted.z[fitted.model.slices[ARM]]))


def compliant(c: Circumstances, model: Model, values: np.ndarray) -> Circumstances:
    """Circumstances with the compliances of a model for deviations (P,) of its arm, SI."""
    found = dict(compliances(model.parameters, values))
    for p in model.parameters:
        if p.effect == COMPLIANCE.name:
            found[p.name] = max(found[p.name], LEAST * p.centre)
    return replace(c, compliances=found)
