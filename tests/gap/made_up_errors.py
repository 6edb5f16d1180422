"""Validation errors that the tests of the gate and of the shares removed make up."""

import numpy as np

from bayescal.predict.crossvalidation import VALIDATED
from bayescal.predict.errors import CentreDistances, ValidationErrors

NOISE = 5e-6


def held(residual, sd=NOISE, distances=None, distance_sd=NOISE, block=None):
    """Contacts that leave these residuals, under a model that expects `sd`."""
    count = len(residual)
    distances = np.zeros(0) if distances is None else distances
    names = tuple((f"a@{k // 3}", f"b@{k // 3}") for k in range(len(distances)))
    return ValidationErrors(
        VALIDATED,
        "contact",
        residual,
        np.full(count, NOISE),
        np.full((count, 1), np.sqrt(max(sd**2 - NOISE**2, 0.0))),
        np.arange(count),
        np.full(count, "planes"),
        np.full(count, "contact"),
        np.full(count, "cube.+x"),
        np.arange(count) if block is None else block,
        CentreDistances(
            names, distances, np.zeros((len(names), 1)), np.full((len(names), 1), distance_sd),
            np.zeros((len(names), 1)),
            np.tile([1.0, 0.0, 0.0], (len(names), 1)),
        ),
    )  # fmt: skip
