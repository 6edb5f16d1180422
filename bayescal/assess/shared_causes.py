"""Rejected measurements that share something are no outliers: a permutation test of what they share.

Outliers fall on rows at random. So among all groups of rows (`groups`) the one in which rejected rows are
most over-represented is compared with the same of rejections dealt to the rows at random. The probability
within one group is hypergeometric (Fisher's exact test); the permutation corrects for the number of groups
of a kind and for what they have in common (Westfall and Young 1993, min-P).

The measurements of one stop of the arm (corners of an image, reflectors on a flange) are wrong together. They
are one piece of evidence: one rejected row of each stop, drawn at random, is tested.

Groups of rows that may share a cause: target, tool, direction of motion, pose, period of time, slip.

The last level of a fit, complete: the form of uneven faces, and the rejected rows that share a cause.

`fit`, the baseline of `gap` and its refits are completed by the same rule, and differ in effects alone.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from bayescal.assess import WORDS
from bayescal.estimate import Estimate, estimate
from bayescal.estimate.families import stops_of
from bayescal.estimate.unexplained import FaceCheck, check_faces, with_uneven_faces
from bayescal.estimate.widths import simpler_level
from bayescal.model.block import ARM, Block
from bayescal.model.options import FitOptions
from bayescal.model.scene import Scene
from bayescal.predict.targets import noise_of
from bayescal.statistics import chi2_sf, hypergeometric_log_sf

SHORTEST = 4
"""Stops of the shortest stretch of time, and of the smallest neighbourhood of a pose."""
COARSEST = 8
"""A joint's range is looked at in parts of 1/8, 1/4 and 1/2 of its rows."""
SLIPS = 400
"""Rows of a tool or target at which a slip is tried: all of most sessions (cost)."""
CENTRES = 200
"""At most so many poses whose neighbourhoods are looked at."""
MOST_ENTRIES = 4_000_000
"""Rows of all slips of a tool, and twice those of all neighbourhoods: sessions of more than 10 000 rows have
fewer of them."""


@dataclass(frozen=True)
class Group:
    """Rows that have something in common."""

    kind: str  # target, tool, session, role, payload, direction of motion, joint range, pose, slip, ...
    label: str
    rows: np.ndarray  # (K,) positions among the rows that were given, in order


def groups_of(scene: Scene, rows: np.ndarray) -> tuple[Group, ...]:
    """All groups of some rows of a session that hold some, but not all, of them."""
    stops = stops_of(scene, rows)
    least = SHORTEST * max(round(len(rows) / (np.max(stops, initial=0) + 1)), 1)  # rows
    every = (*_named(scene, rows), *_directions(scene, rows), *_ranges(scene, rows, least),
             *_neighbourhoods(scene, rows, least), *_stretches(scene, rows, least),
             *_slips(scene, rows, stops, least))  # fmt: skip
    return tuple(g for g in every if 0 < len(g.rows) < len(rows))


def _named(scene: Scene, rows: np.ndarray) -> Iterator[Group]:
    d, m = scene.dataset, scene.dataset.measurements
    target = m.target[rows]
    columns: dict[str, np.ndarray] = {
        "target": np.array([t.name for t in d.targets])[target],
        "tool": np.array([t.name for t in d.tools])[m.tool[rows]],
        "session": np.array([t.session for t in d.targets])[target],
        "role": m.role[rows],
    }
    if m.payload is not None:
        columns["payload"] = np.array([f"{kg:g} kg" for kg in m.payload[rows]])
    for kind, values in columns.items():
        for value in np.unique(values):
            yield Group(kind, str(value), np.flatnonzero(values == value))


def _directions(scene: Scene, rows: np.ndarray) -> Iterator[Group]:
    velocity = scene.dataset.measurements.velocity
    if velocity is None:
        return
    names = scene.dataset.robot.joint_names
    for name, v in zip(names, velocity[rows].T, strict=True):
        for sign, way in ((1.0, "positive"), (-1.0, "negative")):
            yield Group("direction of motion", f"{way} motion of {name}", np.flatnonzero(sign * v > 0))


def _ranges(scene: Scene, rows: np.ndarray, least: int) -> Iterator[Group]:
    readings, robot = scene.dataset.measurements.readings[rows], scene.dataset.robot
    for name, unit, q in zip(robot.joint_names, robot.units, robot.shown(readings).T, strict=True):
        order = np.argsort(q, kind="stable")
        for start, stop in _windows(len(rows), max(len(rows) // COARSEST, least)):
            part = order[start:stop]
            label = f"{name} from {q[part[0]]:.0f} to {q[part[-1]]:.0f} {unit}"
            yield Group("joint range", label, np.sort(part))


def _neighbourhoods(scene: Scene, rows: np.ndarray, least: int) -> Iterator[Group]:

    m = scene.dataset.measurements
    readings = m.readings[rows]
    # each joint by its own spread: a wrist turns further than a shoulder
    scaled = readings / np.maximum(np.std(readings, axis=0), 1e-6)
    tree, size = cKDTree(scaled), least
    centres = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _affordable(CENTRES, rows))).astype(int))
    while size <= len(rows) // 4:
        near = np.asarray(tree.query(scaled[centres], k=size)[1])
        for centre, mine in zip(centres, near, strict=True):
            yield Group("pose", f"poses near that of row {m.ids[rows[centre]]}", np.sort(mine))
        size *= 2


def _stretches(scene: Scene, rows: np.ndarray, least: int) -> Iterator[Group]:
    m = scene.dataset.measurements
    order = np.argsort(rows if m.time is None else m.time[rows], kind="stable")
    for start, stop in _windows(len(rows), least):
        part = order[start:stop]
        label = f"rows {m.ids[rows[part[0]]]} to {m.ids[rows[part[-1]]]}"
        yield Group("stretch of time", label, np.sort(part))


def _slips(scene: Scene, rows: np.ndarray, stops: np.ndarray, least: int) -> Iterator[Group]:
    """All rows of a tool or a target from the first of a stop on, and all before: what its slip separates."""
    d, m = scene.dataset, scene.dataset.measurements
    time = rows if m.time is None else m.time[rows]
    for kind, of, names in (("tool", m.tool, d.tools), ("target", m.target, d.targets)):
        for k in np.unique(of[rows]):
            index = np.flatnonzero(of[rows] == k)
            index = index[np.argsort(time[index], kind="stable")]
            begins = np.flatnonzero(np.diff(stops[index])) + 1
            begins = begins[(begins >= least) & (begins <= len(index) - least)]
            some = np.linspace(0, len(begins) - 1, min(len(begins), _affordable(SLIPS, rows)))
            for first in begins[some.astype(int)]:
                row, name = m.ids[rows[index[first]]], names[k].name
                yield Group("slip", f"{kind} {name} from row {row} on", np.sort(index[first:]))
                yield Group("slip", f"{kind} {name} before row {row}", np.sort(index[:first]))


def _affordable(most: int, rows: np.ndarray) -> int:
    """At most `most` groups, of which each may have a good part of all rows."""
    return max(min(most, MOST_ENTRIES // len(rows)), 1)


def _windows(count: int, shortest: int) -> Iterator[tuple[int, int]]:
    """Windows of `shortest` rows and its doubles up to half of all, each half over the one before."""
    size = shortest
    while size <= count // 2:
        for start in range(0, count - size // 2, max(size // 2, 1)):
            yield start, min(start + size, count)
        size *= 2


LEVEL = 0.005
"""Chance that outliers dealt at random are said to share a cause; each kind of group has its share of it."""
PERMUTATIONS = 2000
FIRST = 200
"""Permutations at a time, after each of which a session that will hardly reach `LEVEL` is let go."""
FEWEST = 3
"""Stops with rejected measurements from which on these can be said to share anything."""
MOST_VALUES = 4_000_000
"""Counts, of groups by permutations, that are held at a time."""
MOST = 3
"""Causes that are told, one of a kind: face and direction of motion may be the same rows."""
FALSE_REJECTIONS = 0.01
"""Validation measurements of normal noise that a session loses as outliers on average."""


@dataclass(frozen=True)
class SharedCause:
    """A group of rows with more rejected measurements than expected by chance."""

    kind: str
    label: str
    rows: np.ndarray  # rejected measurements of the session that are in the group
    size: int  # rows of the group
    rejected: int  # rejected measurements in all
    count: int  # rows in all
    p_value: float  # corrected for the number of groups

    @property
    def words(self) -> str:
        """What they share: ``10 of 11 rejected measurements share the direction of motion: negative ...``."""
        return str(WORDS["shared_cause"].format(c=self, share=len(self.rows)))


def shared_causes(fitted: Estimate, seed: int = 0) -> tuple[SharedCause, ...]:
    """What the rejected measurements of an estimate share, the most significant first; () of true outliers.

    Validation measurements of fitted targets count too: as rejected where their prediction excludes them.
    """
    fitted_rows = np.unique(np.concatenate([b.rows for b in fitted.model.states]))
    checked, off = _validation_rows(fitted)
    rows = np.concatenate([fitted_rows, checked])
    rejected = np.concatenate([np.isin(fitted_rows, fitted.rejected), off])
    if np.sum(rejected) < FEWEST:
        return ()
    order = np.argsort(rows)
    rows, rejected, scene = rows[order], rejected[order], fitted.model.scene
    return shared(groups_of(scene, rows), rows, rejected, seed, stops_of(scene, rows))


def shared(
    groups: Sequence[Group], rows: np.ndarray, rejected: np.ndarray, seed: int = 0,
    stops: np.ndarray | None = None,
) -> tuple[SharedCause, ...]:  # fmt: skip
    """Test of rejected measurements against groups of rows.

    Parameters
    ----------
    groups : sequence of Group
    rows : np.ndarray, shape (N,)
        Rows of the session.
    rejected : np.ndarray of bool, shape (N,)
    seed : int
        Of the permutations.
    stops : np.ndarray of int, shape (N,), optional
        Number of the stop of each row, from 0. Without it each row is of its own.
    """
    rng, count = np.random.default_rng(seed), len(rows)
    deal = _Deal(np.arange(count) if stops is None else stops, rng)
    tested = deal.one_of_each(np.flatnonzero(rejected))
    total = len(tested)
    if total < FEWEST or total == count or not groups:
        return ()
    members = _incidence([g.rows for g in groups], count)
    sizes, of_size = np.unique([len(g.rows) for g in groups], return_inverse=True)
    table = hypergeometric_log_sf(sizes, total, count)

    def log_p(flagged: Sequence[np.ndarray]) -> np.ndarray:
        """Log probabilities (G, M) of so many of each of M lists of flagged rows in each group."""
        return table[of_size[:, None], (members @ _incidence(flagged, count).T).toarray()]

    kinds, of_kind = np.unique([g.kind for g in groups], return_inverse=True)
    observed = log_p([tested])[:, 0]
    at_once = max(min(FIRST, MOST_VALUES // len(groups)), 1)
    least = np.empty((len(kinds), 0))
    while least.shape[1] < PERMUTATIONS:
        for start in range(0, FIRST, at_once):
            many = range(start, min(start + at_once, FIRST))
            dealt = log_p([deal.rows(total) for _ in many])
            dealt = np.stack([dealt[of_kind == k].min(axis=0) for k in range(len(kinds))])
            least = np.append(least, dealt, axis=1)
        # groups of one kind overlap (minimum over them); kinds share the level (Bonferroni)
        as_small = np.sum(least[of_kind] <= observed[:, None] + 1e-9, axis=1)
        p = len(kinds) * (1 + as_small) / (1 + least.shape[1])
        if np.min(p) > 20 * LEVEL or len(kinds) * (1 + np.min(as_small)) > LEVEL * (1 + PERMUTATIONS):
            return ()
    out: dict[str, SharedCause] = {}
    explained = np.empty(0, int)  # rejected measurements of the causes so far
    for k in np.argsort(observed, kind="stable"):
        group = groups[k]
        if p[k] > LEVEL or group.kind in out or len(out) == MOST:
            continue
        mine, size = np.intersect1d(group.rows, tested), len(group.rows)
        if len(mine) < FEWEST:
            continue
        # the same measurements in other words, or further ones, which are not there by chance
        more = np.setdiff1d(mine, explained)
        if len(explained) and len(more):
            others = size - len(mine) + len(more), total - len(explained), count - len(explained)
            chance = np.exp(hypergeometric_log_sf(np.array(others[:1]), *others[1:])[0, len(more)])
            if len(kinds) * np.sum(of_kind == of_kind[k]) * chance > LEVEL:
                continue
        explained = np.union1d(explained, mine)
        every = rows[group.rows[rejected[group.rows]]]
        numbers = size, int(np.sum(rejected)), count, float(p[k])
        out[group.kind] = SharedCause(group.kind, group.label, every, *numbers)
    return tuple(out.values())


class _Deal:
    """Rejections of one row a stop, of `stops` (N,), dealt at random."""

    def __init__(self, stops: np.ndarray, rng: np.random.Generator) -> None:
        self.stops, self.rng = stops, rng
        self.order, self.size = np.argsort(stops, kind="stable"), np.bincount(stops)
        self.first = np.cumsum(self.size) - self.size

    def one_of_each(self, rows: np.ndarray) -> np.ndarray:
        """One of the rows of each stop, of these rows (K,), in order."""
        some = rows if np.all(self.size == 1) else self.rng.permutation(rows)
        return np.sort(some[np.unique(self.stops[some], return_index=True)[1]])

    def rows(self, total: int) -> np.ndarray:
        """A row of each of so many stops."""
        stops = np.argpartition(self.rng.random(len(self.size)), total - 1)[:total]
        within = 0 if np.all(self.size == 1) else self.rng.random(total) * self.size[stops]
        return np.asarray(self.order[self.first[stops] + np.asarray(within, int)])


def _incidence(groups: Sequence[np.ndarray], count: int) -> csr_array:
    """Matrix (G, N) of ones where a group, a list of row numbers below N, holds a row."""
    ends = np.cumsum([0, *map(len, groups)])
    rows = np.concatenate(groups)
    return csr_array((np.ones(len(rows), np.int32), rows, ends), shape=(len(groups), count))


def judged_level(scene: Scene, effects: tuple[str, ...], options: FitOptions, seed: int = 0) -> Estimate:
    """A simpler level of a model, its rejected rows judged as in a fit with this model alone."""
    fitted = simpler_level(scene, effects, options)
    return judged_complete(fitted, seed)[0] if options.robust else fitted


def judged_complete(fitted: Estimate, seed: int = 0) -> tuple[Estimate, tuple[SharedCause, ...]]:
    """Judge the outliers of a complete model: those that share a cause are fitted, the others are not."""
    causes = shared_causes(fitted, seed)
    if not causes:
        return fitted, ()
    kept = np.unique(np.concatenate([cause.rows for cause in causes]))
    return estimate(fitted.model, start=fitted.z, left_out=np.setdiff1d(fitted.rejected, kept)), causes


def rejected_share(fitted: Estimate) -> float:
    """Share of the fitted measurements that an estimate rejects."""
    return len(fitted.rejected) / sum(len(b.rows) for b in fitted.model.states)


def _validation_rows(fitted: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Validation measurements (V,) of fitted targets, and which of them their predictions exclude."""
    scene, rows, p = fitted.model.scene, [np.empty(0, int)], [np.empty(0)]
    for k, target in enumerate(scene.dataset.targets):
        of_target = scene.rows_of(k, scene.rows("validate"))
        if target.name in fitted.model.block_of and len(of_target):
            rows.append(of_target)
            p.append(_tail(fitted, fitted.model.block(k, of_target)))
    tails = np.concatenate(p)
    return np.concatenate(rows), tails < FALSE_REJECTIONS / max(len(tails), 1)


def _tail(fitted: Estimate, block: Block) -> np.ndarray:
    """Probability (C,) of so large a residual of each row, by noise and the parameters' covariance."""
    model = fitted.model
    arm, target = model.slices[ARM], model.slices[block.target]
    r, by_arm, by_target = block.linearise(model.deviations(fitted.z[arm]), fitted.z[target])
    slopes = np.zeros((len(r), model.size))
    slopes[:, arm], slopes[:, target] = by_arm * model.sd, by_target
    noise = noise_of(fitted, block, fitted.z[target])
    variance = noise**2 + np.einsum("rd,de,re->r", slopes, fitted.covariance, slopes, optimize=True)
    square = (r**2 / variance).reshape(block.kind.rows, -1)
    return np.asarray(chi2_sf(np.sum(square, axis=0), block.kind.rows))


@dataclass(frozen=True)
class Completed:
    """A fit with what it decided about faces and rows."""

    fitted: Estimate
    faces: tuple[FaceCheck, ...]  # tests of the forms, before any was added
    causes: tuple[SharedCause, ...]  # of rows that the level rejects and that are used all the same


def completed(level: Estimate, robust: bool = True, seed: int = 0, *, flat: bool = False) -> Completed:
    """Fit the form of uneven faces, then judge the outliers.

    Parameters
    ----------
    level : Estimate
        As `calibrated` returns it.
    robust : bool
        Reject outliers. Those that share a cause are fitted.
    seed : int
        Of the permutations that the test of shared causes uses.
    flat : bool
        Faces stay flat, as those of a level without effects do.
    """
    faces = check_faces(level)
    if level.model.effects and not flat:
        level = with_uneven_faces(level, faces, robust)
    level, causes = judged_complete(level, seed) if robust else (level, ())
    return Completed(level, faces, causes)
