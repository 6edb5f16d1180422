"""An estimate linearised with further parameters of the arm, which are zero at it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.effects import Parameter
from bayescal.estimate.estimate import Estimate
from bayescal.estimate.solver import Linear, linearise
from bayescal.model import ARM, Model, with_parameters

MOST_VALUES = 1_500_000
"""Values of the columns of functions computed at a time: the model of all takes several times more memory."""


def linearised_with(
    fitted: Estimate, every: list[Parameter]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Whitened columns of the unknowns and of further parameters, residuals, rows; without outliers.

    `every` is empty afterwards: parameters are freed as soon as their columns are known.
    """
    model = fitted.model
    # all columns of the same pass: those of fewer parameters differ in rounding
    rows = np.concatenate([np.tile(b.rows, b.kind.rows) for b in model.blocks])
    used = _used(fitted)
    columns = np.empty((int(np.sum(used)), len(every)))
    at_once = max(MOST_VALUES // len(used), 1)
    for start in range(0, max(len(every), 1), at_once):
        some, every[:at_once] = every[:at_once], []
        linear, index, extra = widened(fitted, some)
        columns[:, start : start + at_once] = linear.jacobian[: len(used), extra][used]
    mine = linear.jacobian[: len(used)][used][:, index]
    return mine, columns, linear.residual[: len(used)][used], rows[used]


def scales_of(fitted: Estimate) -> np.ndarray:
    """Factor on the stated noise by which each residual of `linearised_with` is whitened."""
    scale = fitted.weights.scale
    return np.concatenate([np.full(b.residuals, scale[b.group]) for b in fitted.model.blocks])[_used(fitted)]


def _used(fitted: Estimate) -> np.ndarray:
    """Whether each residual of the blocks is one of a row that is no outlier."""
    row = fitted.weights.row
    return np.concatenate([np.tile(row[b.name], b.kind.rows) for b in fitted.model.blocks]) > 0


def widened(fitted: Estimate, some: Sequence[Parameter]) -> tuple[Linear, np.ndarray, np.ndarray]:
    """A fit with further parameters at zero, linearised; places of its own and of the further unknowns."""
    wide, index, extra = model_with(fitted.model, some)
    z = np.zeros(wide.size)
    z[index] = fitted.z
    return linearise(wide, z, fitted.weights), index, extra


def model_with(model: Model, further: Sequence[Parameter]) -> tuple[Model, np.ndarray, np.ndarray]:
    """A model with further parameters of the arm; places of its own unknowns, and of the further ones."""
    wide = with_parameters(model.scene, model.effects, (*model.parameters, *further))
    first = model.slices[ARM].stop
    extra = np.arange(first, first + len(further))
    return wide, np.setdiff1d(np.arange(wide.size), extra), extra
