"""The noise scale of a fit, between its residuals and what was stated."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.estimate import linearise, unit_weights
from bayescal.estimate.solver import rescaled_weights
from bayescal.model import build
from bayescal.model.scene import Scene


def test_stated_noise_counts_as_eight_contacts_more(cube):
    """The scale is the RMS of all residuals and of eight more of the stated noise."""
    count = 60
    model = build(Scene(cube(seed=1, count=count).dataset), ())
    z = np.zeros(model.size)
    weights = unit_weights(model, z)
    linear, nothing = linearise(model, z, weights), np.zeros((model.size, model.size))
    size = np.ones_like(linear.residual)
    for factor in (0.0, 1.0, 2.0):
        found, dof = rescaled_weights(model, weights, replace(linear, residual=factor * size), nothing)
        (group,) = dof
        assert dof[group] == pytest.approx(count)
        every = np.concatenate([np.full(count, factor), np.ones(8)])
        assert found.scale[group] == pytest.approx(np.sqrt(np.mean(every**2)))
