"""Residuals of rows that were not fitted, and their slopes by the unknowns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.estimate import Estimate
from bayescal.model import ARM, Block
from bayescal.model.scene import Scene
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
    """Linearised validation rows and located targets of a session."""

    rows: tuple[RowPrediction, ...]  # of contacts and points, without spheres that were located
    located: Mapping[str, LocatedTarget]  # by name; spheres with their certified diameter
    loose: Mapping[str, LocatedTarget]  # spheres with their diameter as an unknown


def prepared(estimate: Estimate, loose: bool = False, strict: bool = True) -> Prepared:
    """Locate targets that were not fitted, and linearise all validation rows.

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
    out, located, free = [], {}, {}
    for t in map(int, np.unique(scene.dataset.measurements.target[rows])):
        name, own = scene.dataset.targets[t].name, scene.rows_of(t, rows)
        if name in model.block_of:
            out.append(predicted_rows(estimate, model.block(t, own)))
            continue
        apart = scene.rows_of(t, scene.rows("locate"))
        found = scene.declared[t].found
        u = certified.get(name)
        located[name] = located_target(estimate, t, own if found or not len(apart) else apart, u, strict)
        if not found:
            out.append(predicted_rows(estimate, model.block(t, own), located[name]))
        elif loose:
            free[name] = located[name] if u is None else located_target(estimate, t, own, None, strict)
    return Prepared(tuple(out), located, free)


def certified_diameters(scene: Scene) -> dict[str, float]:
    """Standard uncertainty, m, of every diameter that a certificate states, by target."""
    stated = (c for c in scene.dataset.certificates if c.kind == "diameter")
    return {c.targets[0]: c.u_distance or 0.0 for c in stated}
