"""The search for contacts on several targets at once: places are tried until each target has its share.

Contacts that locate spheres: distributed over the upper part of each, in one configuration of the arm.

A sphere is located by contacts at nearly one orientation of the tool, so that an error of the arm that
depends on the configuration does not deform it. All spheres are searched together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayescal.arm.transforms import cross
from bayescal.dataset import Dataset
from bayescal.dataset.target_kinds import KINDS
from bayescal.planning.hand import Hand, Reached
from bayescal.planning.pool import Setup
from bayescal.planning.sites import Room, Sites, join, sites_on
from bayescal.probing.approach import spread
from bayescal.probing.reach import cone

BATCH = 4000  # places that are tried at once: memory
EXPECTED = 0.25  # share of places that become contacts, assumed of a target before any is tried
SPARE = 1.1  # times as many places as are expected to be needed
HOPELESS = 1500, 0.004
"""Places on a target after which a smaller share of contacts ends the search."""


@dataclass
class Search:
    """The search on one target: contacts so far with their tools, places tried, and why others were none.

    `by_hand`: contacts to which no free way leads are among them.
    """

    target: int
    hands: Mapping[int, Hand]
    solid: int
    found: list[tuple[int, Reached]] = field(default_factory=list)
    tried: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    by_hand: bool = False

    @property
    def have(self) -> int:
        """Number of contacts."""
        return sum(len(reached) for _, reached in self.found)

    @property
    def share(self) -> float:
        """Expected share of places that become contacts."""
        return (self.have + 10 * EXPECTED) / (self.tried + 10)

    @property
    def hopeless(self) -> bool:
        """Whether no further places are tried."""
        return self.tried >= HOPELESS[0] and self.have < HOPELESS[1] * self.tried


def tools_for(dataset: Dataset, target: int) -> list[int]:
    """Indices of the tools that measure a target: those that did, else those of its kind.

    A surface needs a ball; an instrument sees a tool without one, if there is any.
    """
    m = dataset.measurements
    used = np.unique(m.tool[m.target == target])
    if len(used):
        return [int(k) for k in used]
    kind = KINDS[dataset.targets[target].kind]
    balls = [k for k, tool in enumerate(dataset.tools) if tool.ball_radius is not None]
    others = [k for k, tool in enumerate(dataset.tools) if tool.ball_radius is None]
    if kind.touched:
        return balls
    return others if kind.of_instrument and others else balls or others


def room_of(setup: Setup, hand: Hand, tool: int) -> Room:
    """Of the places for a tool: the volume of interest, the cone, the radius of its ball."""
    return Room(hand.points, setup.volume, setup.cone, setup.dataset.tools[tool].ball_radius or 0.0)


def goals(searches: Sequence[Search], count: int) -> list[int]:
    """Contacts wanted of each search, together `count`: where a search is hopeless, others have more."""
    lost = [s.have if s.hopeless else None for s in searches]
    rest = max(0, count - sum(have for have in lost if have is not None))
    active = sum(have is None for have in lost)
    out, k = [], 0
    for have in lost:
        if have is None:
            out.append(rest // active + (k < rest % active))
            k += 1
        else:
            out.append(have)
    return out


def tried_once(
    setup: Setup, searches: Sequence[Search], count: int, turning: float, rng: np.random.Generator
) -> bool:
    """Try as many places as are expected to be needed for `count` contacts; False if none are missing."""
    missing = [goal - s.have for s, goal in zip(searches, goals(searches, count), strict=True)]
    if not any(number > 0 for number in missing):
        return False
    for tool, hand in sorted({k: hand for s in searches for k, hand in s.hands.items()}.items()):
        room, own, parts = room_of(setup, hand, tool), [], []
        for search, number in zip(searches, missing, strict=True):
            if number > 0 and tool in search.hands:
                target = setup.dataset.targets[search.target]
                tries = int(np.ceil(SPARE * number / search.share / len(search.hands))) + 8
                parts.append(sites_on(target, setup.regions.get(target.name), room, min(tries, BATCH), rng))
                own.append(search)
        if not parts:
            continue
        sites = join(parts)
        of = np.repeat(np.arange(len(own)), [len(part) for part in parts])
        solid = np.array([s.solid for s in own])[of]
        for begin in range(0, len(sites), BATCH):
            some = slice(begin, begin + BATCH)
            by_hand = any(s.by_hand for s in own)
            reached = hand.reach(sites[some], solid[some], rng, turning=turning, by_hand=by_hand)
            for k, search in enumerate(own):
                rows = np.flatnonzero(of[some] == k)
                search.tried += len(rows)
                search.dropped.update(w for w in reached.reason[rows] if w)
                good = rows[reached.reason[rows] == ""]
                search.found.append((tool, reached[good]))
    return True


def chosen(search: Search, count: int, rng: np.random.Generator) -> tuple[np.ndarray, Reached]:
    """At most `count` of the contacts of a search at random: their tools (K,), and the contacts."""
    tool = np.concatenate([np.full(len(reached), k) for k, reached in search.found])
    rows = rng.permutation(len(tool))[:count]
    every = Reached.join([reached for _, reached in search.found])
    return tool[rows], every[rows]


EACH = 11
"""Contacts on a sphere that validates: four unknowns, and enough to average the noise."""
FIRST = 60  # places on a sphere that are tried, to find configurations
HOMES = 8  # configurations that are compared: half of them those with the tool most nearly along gravity
PROBES = 16  # places that are tried in each of them
EXTRA = 1.6  # times as many contacts as are taken, to choose those far from each other
WEAKEST = 0.2
"""Least spread of the normals along any direction, below which the centre is not identifiable."""
TILT = np.radians(10.0)  # variation of the direction of the tool
ROUNDS = 6


def located(
    setup: Setup, searches: Sequence[Search], tool: int, hand: Hand, rng: np.random.Generator
) -> list[Reached]:
    """`EACH` contacts on the sphere of each search; none (K = 0) where too little of it can be touched.

    The configuration is that, of a few, from which most of the sphere is reached. Reasons are counted in the
    searches.
    """
    out: list[Reached] = [_nothing(hand)] * len(searches)
    for _ in range(ROUNDS):
        left = [k for k, own in enumerate(out) if not len(own)]
        if not left:
            break
        some = [searches[k] for k in left]
        for k, own in zip(left, _located(setup, some, tool, hand, rng), strict=True):
            out[k] = own
    return out


def _nothing(hand: Hand) -> Reached:
    none = np.empty((0, hand.arm.robot.n))
    return Reached(none, none, np.empty(0, object))


def _located(
    setup: Setup, searches: Sequence[Search], tool: int, hand: Hand, rng: np.random.Generator
) -> list[Reached]:
    room, targets = room_of(setup, hand, tool), [setup.dataset.targets[s.target] for s in searches]

    def places(count: np.ndarray) -> Sites:
        """Random places on each sphere, `count` (S,)."""
        each = zip(targets, count, strict=True)
        return join([sites_on(t, setup.regions[t.name], room, int(n), rng) for t, n in each])

    def reach(sites: Sites, sphere: np.ndarray, starts: np.ndarray | None = None) -> Reached:
        reached = hand.reach(sites, np.array([s.solid for s in searches])[sphere], rng, starts)
        for k, search in enumerate(searches):
            search.tried += int(np.sum(sphere == k))
            search.dropped.update(why for why in reached.reason[sphere == k] if why)
        return reached

    def around(
        home: np.ndarray, axes: np.ndarray, of: np.ndarray, tries: np.ndarray
    ) -> tuple[Sites, Reached]:
        """Places on the sphere `of` (H,) of each home (H, n), with the tool along its axis if possible."""
        number = np.repeat(np.arange(len(home)), tries)
        sites = places(np.bincount(of, weights=tries, minlength=len(searches)).astype(int))
        own = _alike(axes[number], sites.normals, hand.cone, rng)
        return sites, reach(replace(sites, axes=own), of[number], home[number])

    sphere = np.repeat(np.arange(len(searches)), FIRST)
    first = reach(places(np.full(len(searches), FIRST)), sphere)
    axes = hand.arm.tool_axis(hand.arm.frames(first.readings))
    up = np.array([setup.regions[t.name].up for t in targets])
    rank = np.where(first.reason == "", np.sum(axes * up[sphere], axis=1), np.inf)
    homes = np.concatenate([k * FIRST + _homes(own, rng) for k, own in enumerate(rank.reshape(-1, FIRST))])
    if not len(homes):
        return [_nothing(hand)] * len(searches)
    of = sphere[homes]
    _, probed = around(first.readings[homes], axes[homes], of, np.full(len(homes), PROBES))
    share = (probed.reason == "").reshape(-1, PROBES).mean(axis=1)
    best = np.array(
        [rows[np.argmax(share[rows])] for k in np.unique(of) for rows in [np.flatnonzero(of == k)]]
    )
    best = best[share[best] * PROBES >= 2]
    if not len(best):
        return [_nothing(hand)] * len(searches)
    tries = np.ceil(EXTRA * EACH / share[best]).astype(int)
    sites, more = around(first.readings[homes[best]], axes[homes[best]], of[best], tries)
    number = np.repeat(of[best], tries)
    return [
        more[_spread(sites.normals, np.flatnonzero((number == k) & (more.reason == "")))]
        for k in range(len(searches))
    ]


def _homes(rank: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Indices of at most `HOMES` finite ranks (M,): half of them the smallest, the others at random."""
    rows = np.argsort(rank, kind="stable")[: np.sum(np.isfinite(rank))]
    rest = rng.permutation(rows[HOMES // 2 :])
    return np.asarray(np.concatenate([rows[: HOMES // 2], rest])[:HOMES])


def _alike(axes: np.ndarray, normals: np.ndarray, half_angle: float, rng: np.random.Generator) -> np.ndarray:
    """Directions (M, 3) near `axes` (M, 3), turned into the cone (rad) about the inward normals (M, 3)."""
    wanted, inward = cone(axes, TILT, rng), -normals
    beside = cross(cross(inward, wanted), inward)
    beside /= np.maximum(np.linalg.norm(beside, axis=1), 1e-12)[:, None]
    angle = np.arccos(np.clip(np.sum(inward * wanted, axis=1), -1, 1))
    angle = np.minimum(angle, 0.98 * half_angle)[:, None]
    return np.cos(angle) * inward + np.sin(angle) * beside


def _spread(normals: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """`EACH` of `rows` with normals (M, 3) far from each other; none if they would not locate a sphere."""
    if len(rows) < EACH:
        return rows[:0]
    rows = rows[spread(normals[rows], EACH)]
    off = normals[rows] - normals[rows].mean(axis=0)
    return rows if np.linalg.svd(off, compute_uv=False)[-1] / np.sqrt(EACH) > WEAKEST else rows[:0]
