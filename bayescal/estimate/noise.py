"""The noise scale of each group, estimated with the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.estimate.linear import Linear, leverages
from bayescal.estimate.weights import Weights
from bayescal.model.block import Block
from bayescal.model.model import Model

STATED_WORTH = 8.0
"""Weight of the stated noise, in contacts, as a prior of the noise scale (inverse gamma)."""


def by_group(model: Model) -> dict[str, list[Block]]:
    """Blocks by noise group."""
    out: dict[str, list[Block]] = {}
    for block in model.blocks:
        out.setdefault(block.group, []).append(block)
    return out


def rescaled_weights(
    model: Model, weights: Weights, linear: Linear, covariance: np.ndarray
) -> tuple[Weights, dict[str, float]]:
    """Noise scales estimated from the residuals, and their degrees of freedom."""
    effective_dof = leverages(linear, covariance)
    scale, dof = {}, {}
    for group, blocks in by_group(model).items():
        at = [linear.of_block[b.name] for b in blocks]
        chi2 = sum(float(np.sum(linear.residual[s] ** 2)) for s in at) * weights.scale[group] ** 2
        count = sum(float(np.sum(weights.row[b.name])) * b.kind.rows for b in blocks)
        dof[group] = max(count - sum(float(np.sum(effective_dof[s])) for s in at), 0.0)
        scale[group] = float(np.sqrt((STATED_WORTH + chi2) / (STATED_WORTH + dof[group])))
    return replace(weights, scale=scale), dof
