"""Fitted arms with random values of their parameters, without a fit."""

from dataclasses import replace

import numpy as np

from bayescal.estimate import estimate
from bayescal.fitted.arm import of_estimate
from bayescal.model import Scene, build


def arm_with(effects: tuple[str, ...], session, seed: int = 0):
    """An arm with deviations of about 0.7 prior standard deviations, and u of a tenth of them."""
    model = build(Scene(session), effects)
    found = estimate(build(Scene(session), ("geometry",)))
    z = 0.7 * np.random.default_rng(seed).standard_normal(model.size)
    return of_estimate(replace(found, model=model, z=z), 0.01 * np.eye(model.size))
