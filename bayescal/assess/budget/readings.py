"""Distances between points that an instrument read in validation measurements, as a measurand."""

from __future__ import annotations

import numpy as np

from bayescal.assess.budget.inputs import PROBING, Basis, Input, Own, reading_shares
from bayescal.assess.budget.located import own_errors
from bayescal.assess.budget.measurand import DISTANCES, Measurand, in_common
from bayescal.estimate import STATED_WORTH
from bayescal.predict.forecast import POINTS, READINGS, SMALLEST
from bayescal.predict.pairs import evenly, far_pairs, lengths
from bayescal.predict.rows import RowPrediction

NAME = f"error of a distance between {READINGS}"


def readings(basis: Basis) -> Measurand | None:
    """Error of any distance between readings of one target, for the pairs that a fit predicts."""
    wide = basis.stated.wide
    scene = wide.model.scene
    by_z, own = [np.zeros((0, wide.model.size))], list[Own]()
    for r in basis.prepared.rows:
        xyz = scene.dataset.measurements.xyz
        if xyz is None or r.block.kind.rows != 3 or scene.declared_of(r.block.target).reads != "xyz":
            continue
        pick = evenly(len(r.block.rows), POINTS)
        at = xyz[r.block.rows[pick]].T
        pairs = far_pairs(at)
        if np.max(lengths(at, pairs), initial=0.0) < SMALLEST:
            continue
        by = _by_residuals(at, pairs, pick, len(r.block.rows))
        before = sum(len(part) for part in by_z)
        by_z.append(by @ _slopes(r))
        for source, errors in _own(basis, r, by):
            own.append((source, np.pad(errors, ((before, 0), (0, 0)))))
    count = sum(len(part) for part in by_z)
    if not count:
        return None
    padded = [(source, np.pad(by, ((0, count - len(by)), (0, 0)))) for source, by in own]
    name = f"{NAME} ({count} distances)"
    return Measurand(DISTANCES, name, "m", None, np.concatenate(by_z), in_common(padded), any_of=True)


def _by_residuals(at: np.ndarray, pairs: np.ndarray, pick: np.ndarray, count: int) -> np.ndarray:
    """Slopes (K, 3 C) of the distances of pairs of points `at` (3, N) by the residuals of all C rows."""
    first, second = pairs.T
    apart = at[:, first] - at[:, second]
    along = apart / np.linalg.norm(apart, axis=0)
    out = np.zeros((len(pairs), 3, count))
    k = np.arange(len(pairs))
    for axis in range(3):
        out[k, axis, pick[first]] += along[axis]
        out[k, axis, pick[second]] -= along[axis]
    return out.reshape(len(pairs), 3 * count)


def _slopes(r: RowPrediction) -> np.ndarray:
    """Slopes (R, D') of the residuals by the unknowns of a fit, with the target located anew."""
    out = -r.by_z
    if r.target is not None:
        out[:, : r.target.by_arm.shape[1]] -= r.by_target @ r.target.by_arm
    return out


def _own(basis: Basis, r: RowPrediction, by: np.ndarray) -> list[Own]:
    """Errors of the readings themselves, and of locating their target; `by` (K, R)."""
    wide = basis.stated.wide
    fitted = r.block.group in wide.weights.scale
    factor = float(np.sqrt(basis.stated.white)) if fitted else 1.0
    dof = wide.dof[r.block.group] + STATED_WORTH if fitted else np.inf
    z = wide.z[wide.model.slices[r.block.target]] if r.target is None else r.target.z
    share = np.tile(reading_shares(wide, r.block, z), r.block.kind.rows)
    noise = factor * r.noise
    kind = "A" if fitted else "B"
    u = float(np.sqrt(np.mean(noise**2 * (1.0 - share))))
    scale = r.block.group
    read = Input(PROBING, "noise of the compared readings", kind, "m", 0.0, u, dof, scale=scale)
    joint = factor * wide.model.scene.dataset.noise.joint * wide.weights.scale.get(r.block.group, 1.0)
    turned = Input(
        PROBING, "joint readings at the compared rows", kind, "rad", 0.0, joint, dof, scale=r.block.group
    )
    # rows that locate their target: their errors change the target too
    each = by if not r.own or r.target is None else by + by @ r.by_target @ r.target.gain
    out: list[Own] = [(read, each * (noise * np.sqrt(1.0 - share)))]
    if np.any(share):
        out.append((turned, each * (noise * np.sqrt(share))))
    if basis.excess and r.target is not None:  # the noise scale of fitted targets includes it
        instrument = wide.model.scene.declared_of(r.block.target).of_instrument
        out.append((basis.unexplained(), basis.excess * (each if instrument else by @ r.by_point)))
    if r.target is not None:
        found = own_errors(basis, r.target, -by @ r.by_target)
        out += [one for one in found if not r.own or one[0].evaluation == "B"]
    return out
