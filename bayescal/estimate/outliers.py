"""Rows that no noise explains: sought with Student t weights, then left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from bayescal.estimate.noise import by_group
from bayescal.estimate.solver import solve
from bayescal.estimate.weights import Weights
from bayescal.model.block import ARM
from bayescal.model.model import Model

TAIL = 4.0
"""Degrees of freedom of the Student t that weighs rows while outliers are sought."""
ROUNDS = 25
"""At most so many reweightings."""
MEDIAN_SIZE = {1: 0.6745, 3: 0.8881}
"""Median of the root mean square of one, or three, standard normal residuals."""
FALSE_REJECTIONS = 0.01
"""Contacts of clean normal noise that a session loses as outliers on average."""


def row_sizes(model: Model, weights: Weights, z: np.ndarray) -> dict[str, np.ndarray]:
    """Residuals over the stated noise, one size a row (C,): the root mean square over a row's residuals."""
    out = {}
    arm = model.deviations(z[model.slices[ARM]])
    for block in model.blocks:
        r = block.residual(arm, z[model.slices[block.target]])
        r = r / weights.sigma[block.name].reshape(r.shape)
        out[block.name] = np.sqrt(np.mean(r**2, axis=0))
    return out


def robust_scales(model: Model, sizes: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Robust noise scales by group: the median size of a row over that of normal noise."""
    out, every = {}, sum(b.residuals for b in model.blocks)  # a group has its share of the parameters
    for group, blocks in by_group(model).items():
        size = np.concatenate([sizes[b.name] / MEDIAN_SIZE[b.kind.rows] for b in blocks])
        count = sum(b.residuals for b in blocks)
        spare = max(count - model.size * count / every, 0.25 * count)
        out[group] = max(float(np.median(size)) * np.sqrt(count / spare), 1e-3)
    return out


def without_outliers(model: Model, z: np.ndarray, weights: Weights) -> tuple[np.ndarray, Weights, int]:
    """Student t reweighting until the fit rests, then the rows beyond what their number explains left out."""
    iterations = 0
    count = sum(len(b.rows) for b in model.blocks)
    for _ in range(ROUNDS):
        sizes = row_sizes(model, weights, z)
        scale = robust_scales(model, sizes)
        row = {
            b.name: (TAIL + b.kind.rows) / (TAIL + b.kind.rows * (sizes[b.name] / scale[b.group]) ** 2)
            for b in model.blocks
        }
        weights = replace(weights, row=row, scale=scale)
        before = z
        z, _, more = solve(model, weights, z)
        iterations += more
        if np.max(np.abs(z - before), initial=0.0) < 1e-3:
            break
    for _ in range(4):
        sizes = row_sizes(model, weights, z)
        scale = robust_scales(model, sizes)
        limit = -ndtri(FALSE_REJECTIONS / 2 / count)
        row = {}
        for b in model.blocks:
            row[b.name] = (sizes[b.name] <= limit * scale[b.group]).astype(float)
        if all(np.array_equal(row[k], weights.row[k]) for k in row):
            break
        weights = replace(weights, row=row, scale=scale)
        z, _, more = solve(model, weights, z)
        iterations += more
    return z, weights, iterations
