"""Validation measurements replayed in a simulator: the difference between the simulator and the machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.estimate.outliers import rejected, scale
from bayescal.exporting.fitted import FittedArm
from bayescal.model import Block
from bayescal.predict.errors import USUAL
from bayescal.predict.locate import locate
from bayescal.predict.rows import certified_diameters
from bayescal.predict.targets import centre_of, unknown_tool, with_diameter


@dataclass(frozen=True)
class Residuals:
    """Residuals (K, C), m, of C rows of one target, of a kind: "planes" or "points"."""

    rows: np.ndarray  # (C,) of the session
    kind: str
    values: np.ndarray
    sigma: np.ndarray  # (C,) m, stated

    @property
    def chi2(self) -> np.ndarray:
        """Chi-square (C,) of each row, with the stated noise."""
        return np.sum((self.values / self.sigma) ** 2, axis=0)


@dataclass(frozen=True)
class Measured:
    """Errors of an arm in validation data: residuals of targets, and errors of certified distances, m."""

    residuals: tuple[Residuals, ...]
    pairs: tuple[tuple[str, str], ...]
    distance: np.ndarray  # (D,) measured by the arm minus certified

    def rms(self, kind: str, without: np.ndarray) -> float:
        """RMS error, m, of a kind ("planes", "points" or "distances") without some rows; nan without any."""
        if kind == "distances":
            every = self.distance
        else:
            own = [r.values[:, ~np.isin(r.rows, without)].ravel() for r in self.residuals if r.kind == kind]
            every = np.concatenate(own) if own else np.zeros(0)
        return float(np.sqrt(np.mean(every**2))) if len(every) else float("nan")

    @property
    def gross(self) -> np.ndarray:
        """Rows that are off by far more than the others of their kind."""
        out = []
        for kind in ("planes", "points"):
            own = [r for r in self.residuals if r.kind == kind]
            if not own:
                continue
            chi2, size = np.concatenate([r.chi2 for r in own]), len(own[0].values)
            usual = max(scale(chi2, size, share=USUAL["kind"]), 1.0)
            out.append(np.concatenate([r.rows for r in own])[rejected(chi2, size, usual)])
        return np.concatenate(out) if out else np.zeros(0, int)


def validation_rows(arm: FittedArm) -> np.ndarray:
    """Rows that no fit used."""
    return arm.model.scene.rows("validate", "locate")


def measured(arm: FittedArm, rows: np.ndarray, points: np.ndarray, noise: Mapping[str, float]) -> Measured:
    """Errors of validation measurements, for TCP positions (C, 3), m, of a simulator in these rows.

    A target that was not fitted is located from its own rows, with these points. Effects of the probe are
    those of the arm's model. Rows whose tool no fitted row used are left out.
    """
    scene, m = arm.model.scene, arm.dataset.measurements
    where = np.full(len(m.ids), -1)
    where[rows] = np.arange(len(rows))
    certified, centres, found = certified_diameters(scene), {}, []
    for t, target in enumerate(arm.dataset.targets):
        own = scene.rows_of(t, scene.rows("validate"))
        if not len(own) or unknown_tool(scene, own):
            continue
        block, state = arm.model.block(t, own), arm.states.get(target.name)
        if state is None:
            apart = scene.rows_of(t, scene.rows("locate"))
            of = own if scene.declared[t].found or not len(apart) else apart
            u = certified.get(target.name)
            near = arm.model.block(t, of) if u is None else with_diameter(arm.model.block(t, of), u)
            state = _located(near, arm, points[where[of]].T, noise.get(near.group, 1.0))
            if scene.declared[t].centred:
                centres[target.name] = centre_of(near, state)
            if scene.declared[t].found:
                continue
        r = block.kind.residual(state, points[where[own]].T) + block.at_contact(arm.values)
        found.append(Residuals(own, "planes" if len(r) == 1 else "points", r, block.sigma))
    pairs, distance = _distances(arm, centres)
    return Measured(tuple(found), pairs, distance)


def _located(block: Block, arm: FittedArm, p: np.ndarray, noise: float) -> np.ndarray:
    """State of a target by its own rows, from TCP positions (3, C), m."""
    kind = block.touched(arm.values)
    at, _ = locate(block.target, kind, p, np.tile(noise * block.sigma, (kind.rows, 1)), strict=False)
    return np.asarray(at.x[0])


def _distances(
    arm: FittedArm, centres: dict[str, np.ndarray]
) -> tuple[tuple[tuple[str, str], ...], np.ndarray]:
    pairs, errors = [], []
    for c in arm.dataset.certificates:
        if c.kind == "distance" and c.distance is not None and all(name in centres for name in c.targets):
            a, b = c.targets
            pairs.append((a, b))
            errors.append(float(np.linalg.norm(centres[a] - centres[b])) - c.distance)
    return tuple(pairs), np.array(errors)
