"""The problem linearised at a point, whitened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.estimate.weights import Weights
from bayescal.model.block import ARM
from bayescal.model.model import Model


@dataclass(frozen=True)
class Linear:
    """The problem linearised at z, whitened, without the prior: contacts of each block, then constraints."""

    residual: np.ndarray  # (R,)
    jacobian: np.ndarray  # (R, D)
    of_block: Mapping[str, slice]  # rows of each block's contacts, by the block's name


def linearise(model: Model, z: np.ndarray, weights: Weights) -> Linear:
    """Whitened residuals and Jacobian at z, in NumPy arrays."""
    count = sum(b.residuals for b in model.blocks) + sum(t.rows for t in model.constraints)
    residual, jacobian, of_block, at = np.empty(count), np.zeros((count, model.size)), {}, 0
    arm = model.slices[ARM]
    values = model.deviations(z[arm])
    for block in model.blocks:
        own, mine = model.slices[block.target], slice(at, at + block.residuals)
        r, by_arm, by_target = block.linearise(values, z[own])
        whiten = weights.whitening(block)
        residual[mine] = r * whiten
        of_arm = jacobian[mine, arm]  # in place: of a large session each copy counts
        np.multiply(by_arm, model.sd, out=of_arm)
        of_arm *= whiten[:, None]
        jacobian[mine, own] = by_target * whiten[:, None]
        of_block[block.name] = mine
        at = mine.stop
    for constraint in model.constraints:
        mine = slice(at, at + constraint.rows)
        residual[mine], by = model.linearised(
            constraint, {name: z[model.slices[name]] for name in constraint.variables}
        )
        for name, slope in by.items():
            jacobian[mine, model.slices[name]] = slope
        at = mine.stop
    return Linear(residual, jacobian, of_block)


def leverages(linear: Linear, covariance: np.ndarray) -> np.ndarray:
    """Leverage of each residual, (R,)."""
    return np.einsum("ij,jk,ik->i", linear.jacobian, covariance, linear.jacobian, optimize=True)


def root(covariance: np.ndarray) -> np.ndarray:
    """Factor L (D, D) with L L' = covariance, also of a nearly singular covariance."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))
