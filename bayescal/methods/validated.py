"""Validation of all methods: the same validation measurements, targets located by the same rule.

A method answers for the arm alone. Every target that has rows to calibrate with is found from those, with
the method's arm held; then validation planes, spheres and points are assessed as `validate` judges a fit's.
"""

from __future__ import annotations

import numpy as np

from bayescal.estimate import Estimate, linearise, unit_weights
from bayescal.estimate.unexplained import unexplained
from bayescal.methods.method import Solution
from bayescal.model import ARM, Model, with_parameters
from bayescal.posterior import gaussian
from bayescal.predict import Validation, validate
from bayescal.predict.locate import locate
from bayescal.statistics import spawned

DRAWS = 2000


def located(model: Model, values: np.ndarray) -> np.ndarray:
    """The z of a model with its arm at deviations (P,), SI, and each target where its rows then say it is."""
    z = np.zeros(model.size)
    z[model.slices[ARM]] = (values - model.shift) / model.sd
    for block in model.states:
        kind, p = block.touched(values), block.motion.points(values)
        sigma = np.tile(block.sigma, (block.kind.rows, 1))
        at, _ = locate(block.target, kind, p, sigma)
        z[model.slices[block.target]] = at.x[0, block.free] / block.sd
    return z


def validated(solution: Solution) -> Validation:
    """Errors of a method on validation measurements; predicted uncertainties in it are void."""
    model = with_parameters(solution.model.scene, solution.model.effects, solution.model.parameters)
    z = located(model, solution.values)
    weights = unit_weights(model, z)
    unsaid = np.full((model.size, model.size), np.nan)
    at = Estimate(model, z, unsaid, weights, linearise(model, z, weights), 0, np.array([], int), {})
    return validate(at, z[None], np.ones((1, len(weights.scale))))


def predicted(solution: Solution, seed: int) -> Validation | None:
    """Predicted uncertainties of validation measurements, for a method that has them; else None."""
    found = solution.estimate
    if found is None:
        return None
    of_draws, of_noise = spawned(seed, 2)
    draws = gaussian(found, of_draws, DRAWS)
    return validate(found, draws.flat, draws.kappa, unexplained(found).excess, of_noise)
