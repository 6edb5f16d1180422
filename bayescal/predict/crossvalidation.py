"""Validation errors of one estimate and their predicted uncertainty, propagated linearly.

Contacts of fitted targets are compared with the fit. Where the session has too few validation data, each
fitted contact is left out in turn, in closed form (leave-one-out cross-validation). A target that was not
fitted (a sphere, an instrument) is first located from its own rows. Only lengths are validated: an
orientation that a row measures together with its point is used in the fit and is never left out.

A test of a name needs more: neighbours share errors. For it, fitted measurements are left out in `folds`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.estimate import Estimate, linearise, root
from bayescal.model import ARM, Block
from bayescal.model.length_blocks import length_blocks
from bayescal.predict.bootstrap import blocks
from bayescal.predict.distances import centre_distances
from bayescal.predict.errors import ValidationErrors
from bayescal.predict.folds import folds, without_fold
from bayescal.predict.rows import RowPrediction, prepared

VALIDATED, LEFT_OUT = "validation measurements", "leave-one-out cross-validation"
BLOCKED = "blocked cross-validation"
"""How validation errors were obtained."""
FEWEST = 8
"""Number of validation data of fitted targets below which leave-one-out cross-validation is used instead."""


@dataclass(frozen=True)
class _Part:
    """Residuals of one target, component by component; fields as in `ValidationErrors`."""

    target: str
    group: str
    kind: str
    rows: np.ndarray
    residual: np.ndarray
    noise: np.ndarray
    by_parameters: np.ndarray
    own: np.ndarray


def validation_errors(estimate: Estimate, strict: bool = True, without: str = LEFT_OUT) -> ValidationErrors:
    """Residuals, predictions and distances of rows that an estimate did not use.

    Parameters
    ----------
    estimate : Estimate
    strict : bool
        As for `prepared`.
    without : str
        What is done if the session has too few validation measurements: `LEFT_OUT` or `BLOCKED`.

    Raises
    ------
    BayescalError
        If a target cannot be located from its rows.
    """
    scene = estimate.model.scene
    known, factor = prepared(estimate, strict=strict), root(estimate.covariance)
    fitted = [r for r in known.rows if r.target is None]
    how = VALIDATED if sum(len(r.block.rows) for r in fitted) >= FEWEST else without
    if how == VALIDATED:
        parts = [_predicted(r, factor) for r in fitted]
    else:
        parts = left_out(estimate) if how == LEFT_OUT else blocks_left_out(estimate)
    main = "contact" if any(p.group == "contact" for p in parts) else "point"
    parts += [_predicted(r, factor) for r in known.rows if r.target is not None]
    at = np.concatenate([p.rows for p in parts])
    order = np.argsort(at, kind="stable")

    def joined(values: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate(values)[order]

    def padded(values: Sequence[np.ndarray]) -> np.ndarray:
        width = max([v.shape[1] for v in values], default=0)
        return joined([np.pad(v, ((0, 0), (0, width - v.shape[1]))) for v in values])

    return ValidationErrors(
        how,
        main,
        joined([p.residual for p in parts]),
        joined([p.noise for p in parts]),
        padded([p.by_parameters for p in parts]),
        at[order],
        joined([np.full(len(p.rows), p.kind) for p in parts]),
        joined([np.full(len(p.rows), p.group) for p in parts]),
        joined([np.full(len(p.rows), p.target) for p in parts]),
        blocks(scene, at[order]),
        centre_distances(scene, known.located, factor[estimate.model.slices[ARM]]),
        padded([p.own for p in parts]),
        estimate.dof,
        folds(scene.dataset.measurements, at[order]) if how == BLOCKED else None,
    )


def _predicted(r: RowPrediction, factor: np.ndarray) -> _Part:
    """Validation measurements by the posterior's factor (D, D)."""
    spread = r.by_z @ factor
    if r.target is None:
        return _part(r.block, r.residual, r.noise, spread)
    spread = spread + (r.by_target @ r.target.by_arm) @ factor[: r.target.by_arm.shape[1]]
    scatter = r.by_target @ r.target.scatter
    if not r.own:
        return _part(r.block, r.residual, r.noise, np.column_stack([spread, scatter]))
    # with G = by_target gain, (1 - G) noise and the prior add up to noise^2 - scatter^2
    less = np.maximum(r.noise**2 - np.sum(scatter**2, axis=1), 1e-3 * r.noise**2)
    return _part(r.block, r.residual, np.sqrt(less), spread)


def _part(
    block: Block, residual: np.ndarray, noise: np.ndarray, by: np.ndarray, own: np.ndarray | None = None
) -> _Part:
    """Residuals (R,) of a block; `own` (C, k, k) is the covariance of `noise`, independent if not given."""
    k = block.kind.rows
    if own is None:
        own = np.eye(k) * noise.reshape(k, -1).T[:, None] ** 2
    kind = "planes" if k == 1 else "points"
    flat = np.swapaxes(own, 0, 1).reshape(len(noise), k)
    return _Part(block.target, block.group, kind, np.tile(block.rows, k), residual, noise, by, flat)


def left_out(estimate: Estimate) -> list[_Part]:
    """Leave-one-out residuals of all fitted contacts: (1 - H)^-1 r, with H the leverage of a contact.

    Exact for a linear model. A rejected contact was not fitted; its residual is unchanged. `noise` includes
    the uncertainty of the fit to the other contacts, which is nearly uncorrelated between contacts. An
    orientation that a row measures together with its point stays in the fit.
    """
    model = estimate.model
    full = {name: np.ones_like(row) for name, row in estimate.weights.row.items()}
    linear = linearise(model, estimate.z, replace(estimate.weights, row=full))
    factor, out = root(estimate.covariance), []
    for b in length_blocks(model):
        mine, k, c = linear.of_block[b.target], b.kind.rows, len(b.rows)
        noise = 1.0 / replace(estimate.weights, row=full).whitening(b)
        by = (linear.jacobian[mine] @ factor).reshape(k, c, -1)
        leverage = np.einsum("icf,jcf->cij", by, by)  # of whitened residuals
        weight = estimate.weights.row[b.name][:, None, None]
        free = np.linalg.inv(np.eye(k) - np.minimum(weight, 1 - 1e-9) * leverage)
        r = np.einsum("cij,jc->ic", free, linear.residual[mine].reshape(k, c))
        spread = np.where(weight > 0, free, np.eye(k) + leverage)
        each = noise.reshape(k, c)
        own = spread * np.einsum("ic,jc->cij", each, each)
        sd = np.sqrt(np.einsum("cii->ic", own)).ravel()
        out.append(_part(b, r.ravel() * noise, sd, np.zeros((k * c, 0)), own))
    return out


def blocks_left_out(estimate: Estimate) -> list[_Part]:
    """Residuals of all fitted contacts by fits without their block of poses and time (`folds`).

    Rejected contacts are predicted too. Residuals of one block are dependent through `by_parameters`; those
    of different blocks are not.
    """
    model = estimate.model
    full = {name: np.ones_like(row) for name, row in estimate.weights.row.items()}
    whole = replace(estimate.weights, row=full)
    linear = linearise(model, estimate.z, whole)
    lengths = length_blocks(model)
    at = np.concatenate([np.arange(len(linear.residual))[linear.of_block[b.target]] for b in lengths])
    rows = np.concatenate([np.tile(b.rows, b.kind.rows) for b in lengths])
    weight = np.concatenate([np.tile(estimate.weights.row[b.name], b.kind.rows) for b in lengths])
    noise = np.concatenate([1.0 / whole.whitening(b) for b in lengths])
    residual = linear.residual[at]
    by = linear.jacobian[at] @ root(estimate.covariance)
    spread = np.empty_like(by)
    fold = folds(model.scene.dataset.measurements, rows)
    for mine, moved, own in without_fold(residual.copy(), by, weight, fold):
        residual[mine], spread[mine] = moved, own
    ends = np.cumsum([b.residuals for b in lengths])
    return [
        _part(b, residual[own] * noise[own], noise[own], spread[own] * noise[own, None])
        for b, own in zip(lengths, np.split(np.arange(len(rows)), ends[:-1]), strict=True)
    ]
