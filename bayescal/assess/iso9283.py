"""Performance of the calibrated arm in the terms of ISO 9283:1998, from validation measurements.

Pose accuracy AP is the distance from the stated pose to the barycentre of the attained poses (7.2.1), pose
repeatability RP = l + 3 S_l of the distances l from that barycentre (7.2.2), distance accuracy AD the mean
attained distance minus the stated one (7.3.2). The stated pose is here that of the calibrated model at the
joint readings. A contact shows the component along the normal of its surface alone.

u is of the measurement: noise of the validation data, location of the target, certificates. The uncertainty
of the arm's parameters is not in it, because the figures describe this arm as it is calibrated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.assess.inputs import UNEXPLAINED, Basis
from bayescal.assess.measurand import certified_distances, distances
from bayescal.estimate.families import poses
from bayescal.predict.targets import RowPrediction

CYCLES, POSES = 30, 5
"""Cycles and poses of the standard."""
FEWEST_CYCLES = 3
"""Repeats of a pose from which on a repeatability is stated."""


@dataclass(frozen=True)
class Figure:
    """One figure over `count` poses or distances; m. `u` is that of the mean, `u_max` of the maximum."""

    symbol: str
    words: str
    count: int
    mean: float
    maximum: float
    u: float | None = None
    u_max: float | None = None


@dataclass(frozen=True)
class Iso9283:
    """Figures in the terms of the standard, and what differs from its procedure."""

    figures: tuple[Figure, ...]
    differs: tuple[str, ...]


@dataclass(frozen=True)
class _Poses:
    """Errors at one target: `error` (P, k) of the barycentres, and the pose (C,) of each row."""

    error: np.ndarray
    pose: np.ndarray
    scatter: tuple[np.ndarray, ...]  # distances from the barycentre, of each pose

    def along(self, way: np.ndarray) -> np.ndarray:
        """Sum over poses of the errors' components along `way` (P, k), as slopes (k C,) by the residuals."""
        size = np.bincount(self.pose, minlength=len(self.error))
        return (way / size[:, None])[self.pose].T.ravel()


def iso9283(basis: Basis) -> Iso9283:
    """Figures from all validation measurements; none without such rows."""
    points = [r for r in basis.prepared.rows if r.block.kind.rows == 3]
    planes = [r for r in basis.prepared.rows if r.block.kind.rows == 1]
    figures = [
        *_accuracy(basis, points, "AP", "pose accuracy (position)"),
        *_accuracy(basis, planes, "AP n", "pose accuracy, component along the normal of the surface"),
        *_distance_accuracy(basis),
    ]
    return Iso9283(tuple(figures), tuple(_differs(basis, points + planes)) if figures else ())


def _accuracy(basis: Basis, parts: list[RowPrediction], symbol: str, words: str) -> Iterator[Figure]:
    each = [(r, _by_pose(basis, r)) for r in parts]
    if not each:
        return
    size = np.concatenate([np.linalg.norm(p.error, axis=1) for _, p in each])
    mean_square, largest, of_largest = 0.0, -1.0, 0.0
    for r, p in each:
        length = np.linalg.norm(p.error, axis=1)
        way = p.error / np.where(length > 0, length, 1.0)[:, None]
        mean_square += _variance(basis, r, p.along(way) / len(size))
        k = int(np.argmax(length))
        if length[k] > largest:
            only = np.where(np.arange(len(way))[:, None] == k, way, 0.0)
            largest, of_largest = float(length[k]), _variance(basis, r, p.along(only))
    u, u_max = np.sqrt([mean_square, of_largest]).tolist()
    yield Figure(symbol, words, len(size), float(np.mean(size)), largest, u, u_max)
    repeats = [d for _, p in each for d in p.scatter if len(d) >= FEWEST_CYCLES]
    if repeats:
        rp = np.array([np.mean(d) + 3.0 * np.std(d, ddof=1) for d in repeats])
        words = "pose repeatability (position)" + (", component along the normal" if symbol != "AP" else "")
        yield Figure(symbol.replace("AP", "RP"), words, len(rp), float(rp.mean()), float(rp.max()))


def _by_pose(basis: Basis, r: RowPrediction) -> _Poses:
    """Barycentres of the residuals of each pose."""
    pose = poses(basis.stated.wide.model.scene.dataset.measurements, r.block.rows)
    error = r.in_rows  # (k, C)
    size = np.bincount(pose)
    mean = np.stack([np.bincount(pose, own) for own in error], axis=1) / size[:, None]
    away = np.linalg.norm(error - mean[pose].T, axis=0)
    scatter = tuple(np.split(away[np.argsort(pose, kind="stable")], np.cumsum(size)[:-1]))
    return _Poses(mean, pose, scatter)


def _variance(basis: Basis, r: RowPrediction, by: np.ndarray) -> float:
    """Variance, m2, of a combination `by` (R,) of residuals: their noise, and the location of the target."""
    if r.target is None:
        plain = basis.stated.plain
        own = plain.linear.jacobian[:, plain.model.slices[r.block.target]]
        moved = by @ r.by_z[:, basis.stated.wide.model.slices[r.block.target]]
        at_known_arm = np.linalg.solve(own.T @ own + np.eye(own.shape[1]), moved)
        return float(np.sum((by * r.noise) ** 2) + moved @ at_known_arm)
    moved = by @ r.by_target
    if r.own:
        return float(np.sum(((by + moved @ r.target.gain) * r.noise) ** 2))
    return float(np.sum((by * r.noise) ** 2) + np.sum((moved @ r.target.scatter) ** 2))


def _distance_accuracy(basis: Basis) -> Iterator[Figure]:
    pairs = certified_distances(basis)
    if not pairs:
        return
    m = distances(basis, pairs, "")
    error = np.array(m.values)
    own = [by for source, by in m.own if source.group != UNEXPLAINED]
    k = int(np.argmax(np.abs(error)))
    mean = np.sign(error) / len(error)
    u, u_max = (
        float(np.sqrt(sum(np.sum((way @ by) ** 2) for by in own))) for way in (mean, np.eye(len(error))[k])
    )
    size = np.abs(error)
    yield Figure(
        "AD", "distance accuracy, absolute", len(error), float(np.mean(size)), float(size[k]), u, u_max
    )


def _differs(basis: Basis, parts: list[RowPrediction]) -> Iterator[str]:
    """What differs from the procedure of the standard."""
    scene = basis.stated.wide.model.scene
    d, m = scene.dataset, scene.dataset.measurements
    rows = scene.rows("validate")
    yield "the stated pose is that of the calibrated model at the joint readings, not a commanded pose"
    if parts:
        sizes = np.concatenate([np.bincount(poses(m, r.block.rows)) for r in parts])
        cycles = f"{sizes.min()}" if sizes.min() == sizes.max() else f"{sizes.min()} to {sizes.max()}"
        times = "1 cycle" if cycles == "1" else f"{cycles} cycles"
        yield f"{len(sizes)} poses with {times} each; the standard: {POSES} poses, {CYCLES} cycles"
    if any(r.block.kind.rows == 1 for r in parts):
        yield "contacts with a surface show the component of the error along its normal alone"
    mass = max((t.mass for t in d.tools), default=0.0)
    extra = 0.0 if m.payload is None else float(np.max(m.payload[rows], initial=0.0))
    added = f"up to {extra:.3g} kg additional payload" if extra else "no additional payload"
    load = f"{mass:.3g} kg tool, {added}"
    yield f"load: {load}; the standard: 100 % of the rated load"
    yield "the arm stands still or probes slowly; the standard: 100 % of the rated speed before each pose"
    yield "orientations (AP a, b, c) are not part of these figures"
