"""The problem linearised at a point, whitened."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayescal.estimate.weights import Weights
from bayescal.model.block import ARM, Block, Constraint
from bayescal.model.model import Model


@dataclass(frozen=True)
class Linear:
    """The problem linearised at z, whitened, without the prior: contacts of each block, then constraints."""

    residual: np.ndarray  # (R,)
    jacobian: np.ndarray  # (R, D)
    of_block: Mapping[str, slice]  # rows of each block's contacts, by the block's name


class Evaluations:
    """Residuals and slopes of a model's blocks and constraints, each kept for the point asked for last.

    The solver, the search for outliers and the noise ask for the same points one after another, with other
    weights. The arrays are not whitened, and not to be changed.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._known: dict[int, tuple[bytes, Any]] = {}

    def block(
        self, block: Block, arm: np.ndarray, own: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (R,), m, and slopes by the arm's z (R, P) and by the target's (R, size)."""

        def new() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            r, by_arm, by_target = block.linearise(self.model.deviations(arm), own)
            by_arm *= self.model.sd
            return r, by_arm, by_target

        found: tuple[np.ndarray, np.ndarray, np.ndarray] = self._at(block, new, (arm, own))
        return found

    def constraint(
        self, constraint: Constraint, parts: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """As `Model.linearised`."""
        found: tuple[np.ndarray, dict[str, np.ndarray]] = self._at(
            constraint,
            lambda: self.model.linearised(constraint, parts),
            [parts[name] for name in constraint.variables],
        )
        return found

    def _at(self, of: Block | Constraint, new: Callable[[], Any], point: Sequence[np.ndarray]) -> Any:
        here = b"".join([part.tobytes() for part in point])
        at, found = self._known.get(id(of), (b"", None))
        if found is None or at != here:
            found = new()
            self._known[id(of)] = here, found
        return found


def linearise(
    model: Model, z: np.ndarray, weights: Weights, evaluations: Evaluations | None = None
) -> Linear:
    """Whitened residuals and Jacobian at z, in NumPy arrays; from evaluations of the model, where given."""
    evaluations = evaluations or Evaluations(model)
    count = sum(b.residuals for b in model.blocks) + sum(t.rows for t in model.constraints)
    residual, jacobian, of_block, at = np.empty(count), np.zeros((count, model.size)), {}, 0
    arm = model.slices[ARM]
    for block in model.blocks:
        own, mine = model.slices[block.target], slice(at, at + block.residuals)
        r, by_arm, by_target = evaluations.block(block, z[arm], z[own])
        whiten = weights.whitening(block)
        residual[mine] = r * whiten
        np.multiply(
            by_arm, whiten[:, None], out=jacobian[mine, arm]
        )  # in place: of a large session each copy counts
        jacobian[mine, own] = by_target * whiten[:, None]
        of_block[block.name] = mine
        at = mine.stop
    for constraint in model.constraints:
        mine = slice(at, at + constraint.rows)
        parts = {name: z[model.slices[name]] for name in constraint.variables}
        residual[mine], by = evaluations.constraint(constraint, parts)
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
