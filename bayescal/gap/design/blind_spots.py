"""Blind spots: effects of plausible amplitude that are not detectable, and the resulting distance errors.

All is linear at one state. The column x of an effect, projected off the model, has the detectability x'Mx.
The calibration absorbs z = Cov J'x of it, which displaces every located centre.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.effects import Parameter, Site
from bayescal.estimate import Estimate
from bayescal.gap.design.settings import DESIGN
from bayescal.gap.linear.evidence import Projected, project
from bayescal.gap.linear.state import State
from bayescal.gap.result import BlindSpot
from bayescal.gap.search.candidates import Candidates
from bayescal.model import ARM, Block, Model
from bayescal.model.scene import Scene
from bayescal.predict.errors import by_points
from bayescal.predict.locate import Rows, locate
from bayescal.predict.targets import as_certified, centre_of


@dataclass(frozen=True)
class Seat:
    """Parameters of an effect at one site, in one unit: columns of the pool."""

    effect: str
    site: Site
    unit: str
    columns: np.ndarray  # (k,)


def seats(candidates: Candidates, named: Sequence[str] = ()) -> list[Seat]:
    """Sites of every candidate except the named ones, in the usual setting: the first one."""
    out: list[Seat] = []
    for effect, variants in candidates.variants.items():
        if effect in named:
            continue
        indices = np.unique(np.concatenate([v.columns for v in variants if v.setting == variants[0].setting]))
        groups: dict[tuple[Site, str], list[int]] = {}
        for k in indices:
            p = candidates.pool[k]
            groups.setdefault((p.site, p.unit), []).append(int(k))
        out += [Seat(effect, *key, np.array(columns)) for key, columns in groups.items()]
    return out


def blind_spots(
    fitted: Estimate, candidates: Candidates, state: State, named: tuple[str, ...] = ()
) -> tuple[BlindSpot, ...]:
    """Detectability of every effect that is neither in the model nor named, largest distance error first.

    Parameters
    ----------
    fitted : Estimate
        The baseline, as the problem of `state` was linearised at.
    candidates : Candidates
        Their pool is that of the problem.
    state : State
        Baseline and named effects, with weights and noise.
    named : tuple of str
        Effects that are not assessed.

    Returns
    -------
    tuple of BlindSpot
        One per effect; `unseen` selects the blind spots.

    Notes
    -----
    The parameters of a site (of one unit) are a random draw of their prior: the detectability of the site is
    the sum over its parameters, and so is the mean square error of a distance. The least detectable
    combination is not used: of many functions on a face, or of the two phases of a wave, one is always
    undetectable and mostly harmless. `plausible` and `smallest` are root mean squares over the parameters;
    `smallest` is infinite where the contacts cannot show the effect at all. An effect is represented by its
    undetected site with the largest distance error or, if all sites are detectable, by the least detectable
    one. The least detectable site in general is not relevant: it is always a wrist joint without load.
    """
    judged = seats(candidates, named)
    if not judged:
        return ()
    free = state.columns[state.columns < len(candidates.pool)]
    used = np.union1d(np.concatenate([s.columns for s in judged]), free)
    seen = project(state, state.problem.pool[:, used])
    raw = np.sum(seen.weighted**2, axis=0)
    strength = np.maximum(raw - np.sum(seen.across * seen.solved, axis=0), DESIGN.rounding * raw)
    moved = distances(fitted, [candidates.pool[k] for k in used], used, seen)
    harm = np.mean(moved**2, axis=0) if len(moved) else np.full(len(used), np.nan)
    best: dict[str, tuple[tuple[bool, float], BlindSpot]] = {}
    for s in judged:
        index = np.searchsorted(used, s.columns)
        total = float(np.sum(strength[index]))
        ratio = np.sqrt(DESIGN.named / total) if total > 0 else np.inf
        plausible = float(np.sqrt(np.mean([candidates.pool[k].sd ** 2 for k in s.columns])))
        error = float(np.sqrt(np.sum(harm[index])))
        spot = BlindSpot(s.effect, s.site, float(ratio) * plausible, plausible, s.unit, error)
        blind = bool(ratio > 1.0)
        rank = (blind, error if blind and not np.isnan(error) else float(ratio))
        if s.effect not in best or rank > best[s.effect][0]:
            best[s.effect] = rank, spot
    spots = [spot for _, spot in best.values()]
    return tuple(sorted(spots, key=lambda b: -np.nan_to_num(b.distance_error, nan=-1.0)))


def unseen(spots: Iterable[BlindSpot]) -> tuple[BlindSpot, ...]:
    """Effects that would not be named at their plausible amplitude."""
    return tuple(b for b in spots if b.smallest > b.plausible)


def distances(fitted: Estimate, extra: Sequence[Parameter], used: np.ndarray, seen: Projected) -> np.ndarray:
    """Errors of distances (Q, K), m, by one prior standard deviation of each of K unmodelled candidates.

    Parameters
    ----------
    fitted : Estimate
    extra : sequence of Parameter
        The candidates.
    used : np.ndarray, shape (K,)
        Indices of the candidates in the pool, ascending.
    seen : Projected
        Their columns, projected by a state, which includes named columns.

    Returns
    -------
    np.ndarray
        Of certified distances between centres; where there are none, of distances between points of the
        session; (0, K) where there is neither.
    """
    model, state = fitted.model, seen.state
    wide = Model(model.scene, model.effects, (*model.parameters, *extra), (), ())
    arm_size, size, count = len(model.parameters), len(fitted.z), len(used)
    values = np.append(model.deviations(fitted.z[model.slices[ARM]]), np.zeros(count))
    # error of the calibrated arm
    off = np.zeros((arm_size + count, count))
    off[:arm_size] = seen.solved[:arm_size]
    free = np.flatnonzero(np.isin(state.columns, used))
    index = np.searchsorted(used, state.columns[free])
    off[arm_size + index] += state.scales[free, None] * seen.solved[size + free]
    off[arm_size + np.arange(count), np.arange(count)] -= 1.0
    off *= wide.sd[:, None]
    centres: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    pairs = certified_distances(model.scene)
    for name in dict.fromkeys(name for pair in pairs for name in pair):
        if (centre := _centre(fitted, wide, name, values, off, seen.solved)) is not None:
            centres[name] = centre
    ends = [(centres[a], centres[b]) for a, b in pairs if a in centres and b in centres]
    if not ends:
        ends = _points(wide, values, off)
    out = np.empty((len(ends), count))
    for i, ((a, da), (b, db)) in enumerate(ends):
        out[i] = (a - b) / np.linalg.norm(a - b) @ (da - db)
    return out


def certified_distances(scene: Scene) -> list[tuple[str, ...]]:
    """Targets of all certified distances."""
    return [c.targets for c in scene.dataset.certificates if c.kind == "distance"]


def located(
    fitted: Estimate, wide: Model, target: int, values: np.ndarray
) -> tuple[Block, np.ndarray] | None:
    """A validation sphere or socket as a block of its own contacts, and its part of z at the solution.

    A certified diameter is fixed. None if it was touched by a tool that was not fitted, or has no contact.
    """
    scene = fitted.model.scene
    validated = scene.rows_of(target, scene.rows("validate"))  # without any, its rows may not locate it
    rows = scene.rows_of(target, scene.rows("validate", "locate")) if len(validated) else validated
    m = scene.dataset.measurements
    if not len(rows) or not np.isin(m.tool[rows], m.tool[scene.rows("calibrate")]).all():
        return None
    block = wide.block(target, rows)
    if not scene.declared[target].centred or not np.all(block.kind.sd[:3] > 0):
        return None
    block = as_certified(scene, block)
    sigma = np.tile(block.sigma, (block.kind.rows, 1))
    location, _ = locate(block.target, Rows(block.kind, block.motion.points(values), sigma))
    return block, location.x[0, block.free] / block.sd


def _centre(
    fitted: Estimate, wide: Model, name: str, values: np.ndarray, off: np.ndarray, solved: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Centre of a target (3,) and its errors (3, K), m, for errors `off` (P + K, K) of the arm."""
    model = fitted.model
    if name in model.block_of:
        block, part = model.block_of[name], model.slices[name]
        if not model.scene.declared_of(name).centred:
            return None
        shift = np.zeros((len(block.kind.sd), solved.shape[1]))
        shift[block.free] = solved[part] * block.sd[:, None]
        return centre_of(block, block.state(fitted.z[part])), shift[:3]
    location = located(fitted, wide, model.scene.index[name], values)
    if location is None:
        return None
    block, z = location
    _, by_arm, by_target = block.linearise(values, z)
    sigma = np.tile(block.sigma, block.kind.rows)[:, None]
    slopes, errors = by_target / sigma, (by_arm @ off) / sigma
    shift = -np.linalg.solve(slopes.T @ slopes + np.eye(block.size), slopes.T @ errors)
    return centre_of(block, block.state(z)), shift[:3] * block.sd[:3, None]


def _points(
    wide: Model, values: np.ndarray, off: np.ndarray
) -> list[tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]]:
    """Pairs of ball centres at least `DESIGN.apart` apart, and the errors of their distances, m."""
    rng = np.random.default_rng(0)
    rows = wide.scene.rows("calibrate")
    rows = np.sort(rng.permutation(rows)[: DESIGN.points])
    motion = wide.motion(rows)
    p = motion.points(values)
    shift = np.stack([by.T @ off for by in by_points(motion, values, p)], axis=1)  # (points, 3, K)
    a, b = np.triu_indices(len(rows), 1)
    far = np.flatnonzero(np.linalg.norm(p[:, a] - p[:, b], axis=0) >= DESIGN.apart)
    chosen = rng.permutation(far)[: DESIGN.pairs]
    return [((p[:, i], shift[i]), (p[:, j], shift[j])) for i, j in zip(a[chosen], b[chosen], strict=True)]
