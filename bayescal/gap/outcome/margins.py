"""Margins: residuals by target, joint, region, time and direction, each bin tested against noise only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from bayescal.estimate import Estimate, linearise, root
from bayescal.gap.result import MARGINS, Margin
from bayescal.gap.settings import OUTCOME
from bayescal.model.model import length_blocks
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import VALIDATED
from bayescal.predict.errors import ValidationErrors
from bayescal.statistics import f_sf, rms, t_sf

AXES = "xyz"
Bin = tuple[str, str, str, np.ndarray]  # a family, a label (of gap.json), the same as text, a mask (R,)


@dataclass(frozen=True)
class Residuals:
    """Calibration and validation residuals r (R,) m; r / noise has covariance 1 -+ S S'."""

    residual: np.ndarray  # (R,) m, corrected for their leverage in the fit
    white: np.ndarray  # (R,) over the noise, not corrected
    spread: np.ndarray  # (R, F) S
    fitted: np.ndarray  # (R,) bool: minus sign of S S'
    suspect: np.ndarray  # (R,) bool: rejected, or gross
    rows: np.ndarray  # (R,) of the session
    direction: np.ndarray  # (R, 3) in F0, in which the residual is measured
    signed: np.ndarray  # (R,) bool: a surface, touched from one side
    dof: float  # of the noise


def margins(
    estimate: Estimate, held: ValidationErrors, noise: float | None = None, noise_dof: float | None = None
) -> dict[str, tuple[Margin, ...]]:
    """Residuals of calibration and validation contacts, in groups by possible dependence.

    Parameters
    ----------
    estimate : Estimate
    held : ValidationErrors
        Of the same model.
    noise : float, optional
        Noise of a contact, m, if a better estimate than that of the fit exists, with `noise_dof` degrees of
        freedom.

    Returns
    -------
    dict
        target, joint, region, time and direction; empty where the session does not record it. p-values are
        corrected by Holm's rule for all bins.
    """
    scene = estimate.model.scene
    r = residuals(estimate, held, noise, noise_dof)
    entries: list[tuple[str, str, Margin]] = []
    for margin, bins in _bins(scene, r).items():
        for family, label, text, mask in bins:
            tested = margin_of(r, label, text, mask)
            if tested is not None:
                entries.append((margin, family, tested))
    corrected = holm(np.array([m.p_value for _, _, m in entries]))
    entries = [(a, b, replace(m, p_value=float(p))) for (a, b, m), p in zip(entries, corrected, strict=True)]
    out: dict[str, tuple[Margin, ...]] = {}
    for margin in MARGINS:
        mine = [(family, m) for kind, family, m in entries if kind == margin]
        if margin == "joint":
            mine = [pair for pair in mine if pair in _most_deviant(mine)]
        out[margin] = tuple(m for _, m in mine)
    return out


def _most_deviant(pairs: list[tuple[str, Margin]]) -> list[tuple[str, Margin]]:
    """Of each family the bins with the smallest p-value, then the largest RMS."""
    out = []
    for family in dict.fromkeys(name for name, _ in pairs):
        ranked = sorted((p for p in pairs if p[0] == family), key=lambda p: (p[1].p_value, -p[1].rms))
        out += ranked[: OUTCOME.joints_shown]
    return out


def holm(p: np.ndarray) -> np.ndarray:
    """P-values (K,) corrected for their number by Holm's step-down rule."""
    order = np.argsort(p)
    stepped = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    out = np.empty(len(p))
    out[order] = np.minimum(stepped, 1.0)
    return out


def residuals(
    estimate: Estimate, held: ValidationErrors, noise: float | None = None, noise_dof: float | None = None
) -> Residuals:
    """All lengths of calibration rows, and of validation data where there are any; as for `margins`."""
    model, blocks = estimate.model, length_blocks(estimate.model)
    weights = replace(estimate.weights, row={k: np.ones_like(w) for k, w in estimate.weights.row.items()})
    linear, factor = linearise(model, estimate.z, weights), root(estimate.covariance)
    count = sum(b.residuals for b in blocks)
    spread = linear.jacobian[:count] @ factor
    rows = np.concatenate([np.tile(b.rows, b.kind.rows) for b in blocks])
    kept = np.concatenate([np.tile(estimate.weights.row[b.name], b.kind.rows) for b in blocks]) > 0
    sd = np.concatenate([1.0 / weights.whitening(b) for b in blocks])
    group = np.concatenate([np.full(b.residuals, b.group) for b in blocks])
    white = linear.residual[:count]
    residual_ratio = np.sqrt(np.maximum(1.0 - np.where(kept, np.sum(spread**2, axis=1), 0.0), 0.05))
    parts = [(white * sd / residual_ratio, white, spread, kept, ~kept, rows, group)]
    if held.how == VALIDATED:
        shared = held.by_parameters / held.noise[:, None]
        never = np.zeros(len(held.rows), bool)
        normalised = held.residual / held.noise
        validation = (held.residual, normalised, shared, never, held.gross, held.rows, held.group)
        width = max(spread.shape[1], shared.shape[1])
        parts = [
            (*p[:2], np.pad(p[2], ((0, 0), (0, width - p[2].shape[1]))), *p[3:])
            for p in (parts[0], validation)
        ]
    r, white, spread, fitted, suspect, rows, group = (np.concatenate(p) for p in zip(*parts, strict=True))
    dof = estimate.dof[held.main]
    if noise is not None:
        fit = rms(sd[kept & (group[: len(kept)] == held.main)])
        white = white * np.where(group == held.main, fit / noise, 1.0)
        dof = dof if noise_dof is None else noise_dof
    direction, signed = _directions(model.scene, rows)
    return Residuals(r, white, spread, fitted, suspect, rows, direction, signed, max(dof, 1.0))


def _directions(scene: Scene, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nominal direction (R, 3) in which each residual is measured, and whether it is a surface's (R,)."""
    target = scene.dataset.measurements.target[rows]
    out, signed = np.zeros((len(rows), 3)), np.zeros(len(rows), bool)
    for t in np.unique(target):
        mine = np.flatnonzero(target == t)
        each, number = np.unique(rows[mine], return_inverse=True)
        u = scene.looks(int(t), each)
        # the first residual of a row is its first component
        order = np.argsort(rows[mine], kind="stable")
        component = np.empty(len(mine), int)
        component[order] = np.arange(len(mine)) % len(u)
        out[mine] = u[component, :, number]
        signed[mine] = len(u) == 1
    return out, signed


def margin_of(r: Residuals, label: str, text: str, mask: np.ndarray) -> Margin | None:
    """A bin, or None where it is too small; its uncorrected p-value is twice the smaller of two tests."""
    # slips may be anywhere; many rejected contacts in one bin are a sign of an effect and are counted
    if np.sum(r.suspect[mask]) < max(OUTCOME.gathered * np.sum(mask), 3):
        mask = mask & ~r.suspect
    contacts = len(np.unique(r.rows[mask]))
    if contacts < OUTCOME.fewest_in_bin:
        return None
    e, s, fitted = r.white[mask], r.spread[mask], r.fitted[mask]
    taken, added = s[fitted], s[~fitted]
    variance = len(e) - float(np.sum(np.sum(taken, axis=0) ** 2)) + float(np.sum(np.sum(added, axis=0) ** 2))
    trace = len(e) - float(np.sum(taken**2)) + float(np.sum(added**2))
    square = len(e) - 2 * float(np.sum(taken**2)) + 2 * float(np.sum(added**2))
    square += float(np.sum((taken.T @ taken) ** 2)) + float(np.sum((added.T @ added) ** 2))
    p = [1.0]
    if trace > OUTCOME.absorbed * len(e):  # a sum of squares of this mean and variance is nearly chi-squared
        p.append(float(f_sf(np.sum(e**2) / trace, max(trace**2 / square, 1.0), r.dof)))
    if variance > OUTCOME.absorbed * len(e):
        p.append(2 * float(t_sf(abs(np.sum(e)) / np.sqrt(variance), r.dof)))
    residual = r.residual[mask]
    return Margin(label, text, contacts, rms(residual), float(np.mean(residual)), min(2 * min(p), 1.0))


def _bins(scene: Scene, r: Residuals) -> dict[str, Iterable[Bin]]:
    """All bins by margin."""
    m = scene.dataset.measurements
    names = np.array([t.name for t in scene.dataset.targets])[m.target[r.rows]]
    return {
        "target": [("", str(name), str(name), names == name) for name in dict.fromkeys(names)],
        "joint": _joints(scene, r.rows),
        "region": _regions(scene.points[r.rows]),
        "time": () if m.time is None else _times(m.time[r.rows]),
        "direction": chain(_contact_directions(r), _approaches(scene, r.rows)),
    }


def _cut(x: np.ndarray, bins: int) -> Iterator[tuple[float, float, np.ndarray]]:
    """Bins of equal counts: their ends and masks."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, bins + 1)))
    number = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    for k in range(len(edges) - 1):
        yield float(edges[k]), float(edges[k + 1]), number == k


def _joints(scene: Scene, rows: np.ndarray) -> Iterator[Bin]:
    robot = scene.dataset.robot
    readings = robot.shown(scene.dataset.measurements.readings[rows])
    for j, (x, unit) in enumerate(zip(readings.T, robot.units, strict=True), start=1):
        for low, high, mask in _cut(x, OUTCOME.joint_bins):
            ends = f"{low:.0f} to {high:.0f} {unit}"
            yield str(j), f"joint {j}: {ends}", f"J{j} from {ends}", mask


def _regions(points: np.ndarray) -> Iterator[Bin]:
    """Octants of the workspace about the median of the contacts."""
    low, middle, high = (1e3 * np.quantile(points, q, axis=0) for q in (0.0, 0.5, 1.0))
    halved = [k for k in range(3) if high[k] - low[k] > 1e3 * OUTCOME.smallest_span]
    for octant in range(2 ** len(halved)):
        mask, parts = np.ones(len(points), bool), []
        for bit, k in enumerate(halved):
            upper = bool(octant >> bit & 1)
            mask &= (1e3 * points[:, k] >= middle[k]) == upper
            ends = (middle[k], high[k]) if upper else (low[k], middle[k])
            parts.append(f"{AXES[k]} {ends[0]:.0f} to {ends[1]:.0f}")
        if parts:
            label = ", ".join(parts) + " mm"
            yield "", label, label, mask


def _times(time: np.ndarray) -> Iterator[Bin]:
    span = float(np.ptp(time))
    unit, size = ("h", 3600.0) if span > 4 * 3600 else ("min", 60.0) if span > 4 * 60 else ("s", 1.0)
    digits = 0 if span / size > 4 * OUTCOME.time_bins else 1
    for low, high, mask in _cut(time - time.min(), OUTCOME.time_bins):
        label = f"{low / size:.{digits}f} to {high / size:.{digits}f} {unit}"
        yield "", label, f"time {label}", mask


def _contact_directions(r: Residuals) -> Iterator[Bin]:
    """Base axis nearest to the outward normal of a surface, or to the coordinate of a point."""
    axis = np.argmax(np.abs(r.direction), axis=1)
    negative = np.take_along_axis(r.direction, axis[:, None], axis=1)[:, 0] < 0
    for k, name in enumerate(AXES):
        for sign, below in (("+", False), ("-", True)):
            mask = r.signed & (axis == k) & (negative == below)
            if np.any(mask):
                yield "", f"touched from {sign}{name}", f"outward normal {sign}{name}", mask
        if np.any(~r.signed & (axis == k)):
            yield "", f"along {name}", f"coordinate {name}", ~r.signed & (axis == k)


def _approaches(scene: Scene, rows: np.ndarray) -> Iterator[Bin]:
    """Direction of motion of each joint, where both directions occur."""
    velocity = scene.dataset.measurements.velocity
    if velocity is None:
        return
    for j, v in enumerate(velocity[rows].T, start=1):
        if np.any(v > 0) and np.any(v < 0):
            for way, mask in (("positive", v > 0), ("negative", v < 0)):
                label = f"direction of motion of J{j}, {way}"
                yield str(j), label, label, mask


def residuals_in_time(before: Estimate, after: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the session in the order of time, and residuals before and after at each, m."""
    rows = np.concatenate([np.tile(b.rows, b.kind.rows) for b in length_blocks(before.model)])
    old, new = (
        np.concatenate([e.residuals(b).ravel() for b in length_blocks(e.model)]) for e in (before, after)
    )
    m = before.model.scene.dataset.measurements
    order = np.lexsort((rows, rows if m.time is None else m.time[rows]))
    return rows[order], old[order], new[order]
