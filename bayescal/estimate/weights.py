"""Weights of the residuals: standard uncertainties, noise scales, row weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.model.block import ARM, Block
from bayescal.model.model import Model


@dataclass(frozen=True)
class Weights:
    """Weights of the residuals by block: `sigma` (R,) m at noise scale 1, row weights (C,)."""

    sigma: Mapping[str, np.ndarray]
    row: Mapping[str, np.ndarray]
    scale: Mapping[str, float]  # by noise group

    def whitening(self, block: Block) -> np.ndarray:
        """Factors (R,) that whiten a block's residuals."""
        row = np.tile(self.row[block.name], block.kind.rows)
        return np.sqrt(row) / (self.sigma[block.name] * self.scale[block.group])


def unit_weights(model: Model, z: np.ndarray) -> Weights:
    """Full weight for every contact, at its stated noise, plus reading noise through the Jacobian at z."""
    joint = model.scene.dataset.noise.joint
    sigma = {}
    for block in model.blocks:
        own = np.tile(block.sigma, block.kind.rows)
        if joint > 0:
            coupling = model.scene.dataset.robot.link_from_reading
            slices = model.slices
            by = block.by_readings(model.deviations(z[slices[ARM]]), z[slices[block.target]], coupling)
            own = np.sqrt(own**2 + joint**2 * np.sum(by**2, axis=1))
        sigma[block.name] = own
    row = {block.name: np.ones(len(block.rows)) for block in model.blocks}
    return Weights(sigma, row, {block.group: 1.0 for block in model.blocks})
