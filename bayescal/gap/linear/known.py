"""Circumstances of a fitted model: candidates act through the compliances that the fit found."""

from __future__ import annotations

from dataclasses import replace

from bayescal.effects import Circumstances, compliances
from bayescal.effects.compliance import COMPLIANCE
from bayescal.estimate import Estimate
from bayescal.model import ARM

LEAST = 0.2
"""Least compliance of a joint through which a candidate acts, as a share of its prior mean (assumed).

With an estimate near zero, or below, a payload would not deflect the joint.
"""


def with_compliances(c: Circumstances, fitted: Estimate) -> Circumstances:
    """Circumstances with the fitted compliances."""
    model = fitted.model
    found = dict(compliances(model.parameters, model.deviations(fitted.z[model.slices[ARM]])))
    for p in model.parameters:
        if p.effect == COMPLIANCE.name:
            found[p.name] = max(found[p.name], LEAST * p.centre)
    return replace(c, compliances=found)
