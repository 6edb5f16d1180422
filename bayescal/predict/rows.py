"""Residuals of rows that were not fitted, and their slopes by the unknowns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, linearise, unit_weights
from bayescal.model import ARM, Block, Model, with_parameters
from bayescal.model.scene import Scene
from bayescal.predict.locate import AmbiguousPositionError
from bayescal.predict.targets import LocatedTarget, carrying, located_target, noise_of, slopes_of


@dataclass(frozen=True)
class RowPrediction:
    """R residuals of rows of one target, and the slopes from which they are predicted.

    In the order of `Block.linearise`; m, or rad for orientations.
    """

    block: Block
    residual: np.ndarray  # (R,) at the estimate
    noise: np.ndarray  # (R,) standard uncertainty of the measurement
    by_z: np.ndarray  # (R, D) slopes by the estimate's z
    target: LocatedTarget | None  # None where the target was fitted
    by_target: np.ndarray  # (R, m) slopes by the unknowns of a located target
    by_point: np.ndarray  # (R, 3) slopes by one shift of all ball centres, m

    @property
    def own(self) -> bool:
        """Whether these rows located the target, so that its position depends on their noise."""
        t = self.target
        return t is not None and (self.block.name, *self.block.rows) == (t.block.name, *t.block.rows)

    @property
    def in_rows(self) -> np.ndarray:
        """The residuals as (rows of the kind, C)."""
        return self.residual.reshape(self.block.kind.rows, -1)


def predicted_rows(estimate: Estimate, block: Block, target: LocatedTarget | None = None) -> RowPrediction:
    """Rows (contacts, points or orientations) of a fitted target, or of the located `target`."""
    model = estimate.model
    arm = model.slices[ARM]
    if target is None:
        own = model.slices[block.target]
        z, tool_sd = estimate.z[own], 0.0
    else:
        z, tool_sd = target.z, target.tool_sd
        block = carrying(block, target.tool) if tool_sd else block
    r, by_arm, by_target, by_point = slopes_of(estimate, block, z, tool_sd)
    by_z = np.zeros((len(r), len(estimate.z)))
    by_z[:, arm] = by_arm
    if target is None:
        by_z[:, own] = by_target
        by_target = by_target[:, :0]
    return RowPrediction(block, r, noise_of(estimate, block, z), by_z, target, by_target, by_point)


@dataclass(frozen=True)
class Prepared:
    """Linearised validation measurements and located targets of a session."""

    rows: tuple[RowPrediction, ...]  # of contacts and points, without spheres that were located
    located: Mapping[str, LocatedTarget]  # by name; spheres with their certified diameter
    loose: Mapping[str, LocatedTarget]  # spheres with their diameter as an unknown


def prepared(estimate: Estimate, loose: bool = False, strict: bool = True) -> Prepared:
    """Locate targets that were not fitted, and linearise all validation measurements.

    Parameters
    ----------
    estimate : Estimate
    loose : bool
        Also locate spheres with their diameter as an unknown.
    strict : bool
        Refuse a target with another position that is nearly as probable. A model level that only serves for
        comparison, such as the nominal arm, has errors of millimetres: there the most probable one is taken.

    Raises
    ------
    BayescalError
        If a target cannot be located from its rows.
    """
    scene, model = estimate.model.scene, estimate.model
    certified = certified_diameters(scene)
    rows = scene.rows("validate")
    by = dict(_located_apart(scene, model))
    out, located, free = [], {}, {}
    for t in map(int, np.unique(scene.dataset.measurements.target[rows])):
        name, own = scene.dataset.targets[t].name, scene.rows_of(t, rows)
        if t not in by:
            out.append(predicted_rows(estimate, model.block(t, own)))
            continue
        u, block = certified.get(name), model.block(t, own)
        apart = block if np.array_equal(by[t], own) else model.block(t, by[t])
        located[name] = located_target(estimate, apart, u, strict)
        if not scene.declared[t].found:
            out.append(predicted_rows(estimate, block, located[name]))
        elif loose:
            free[name] = located[name] if u is None else located_target(estimate, block, None, strict)
    return Prepared(tuple(out), located, free)


def check_located(scene: Scene) -> None:
    """Refuse targets whose rows leave two positions equally probable for any arm, before the arm is fitted.

    Only targets with no more values than unknowns are looked at: their residuals vanish whatever the arm, and
    the prior alone decides between two positions. All others are decided with the fitted arm.

    Raises
    ------
    AmbiguousPositionError
        With the target and the distance of the two positions.
    """
    model = with_parameters(scene, (), ())
    z = np.zeros(model.size)
    weights = unit_weights(model, z)
    linear = linearise(model, z, weights)
    nominal = Estimate(model, z, np.eye(model.size), weights, linear, 0, np.zeros(0, int), {})
    certified = certified_diameters(scene)
    for t, rows in _located_apart(scene, model):
        block = model.block(t, rows)
        if block.residuals > block.size:
            continue
        try:
            located_target(nominal, block, certified.get(scene.dataset.targets[t].name))
        except AmbiguousPositionError:
            raise
        except BayescalError:  # a search that does not converge with the nominal arm may do so when fitted
            continue


def _located_apart(scene: Scene, model: Model) -> Iterator[tuple[int, np.ndarray]]:
    """Targets with validation measurements that are not fitted, and the rows that locate them."""
    rows = scene.rows("validate")
    for t in map(int, np.unique(scene.dataset.measurements.target[rows])):
        if scene.dataset.targets[t].name not in model.block_of:
            own, apart = scene.rows_of(t, rows), scene.rows_of(t, scene.rows("locate"))
            yield t, own if scene.declared[t].found or not len(apart) else apart


def certified_diameters(scene: Scene) -> dict[str, float]:
    """Standard uncertainty, m, of every diameter that a certificate states, by target."""
    stated = (c for c in scene.dataset.certificates if c.kind == "diameter")
    return {c.targets[0]: c.u_distance or 0.0 for c in stated}
