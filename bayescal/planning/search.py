"""The search for contacts on several targets at once: places are tried until each target has its share.

A sphere that validates is located by contacts at nearly one orientation of the tool (`located`), so that an
error of the arm that depends on the configuration does not deform it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayescal.arm.transforms import cone, cross
from bayescal.dataset import Dataset
from bayescal.dataset.target_kinds import KINDS
from bayescal.planning.pool import Setup
from bayescal.probing.contacts import Contacts, Hand, Sites, Straight
from bayescal.probing.placement import spread

BATCH = 4000  # places that are tried at once: memory
EXPECTED = 0.25  # share of places that become contacts, assumed of a target before any is tried
SPARE = 1.1  # times as many places as are expected to be needed
HOPELESS = 1500, 0.004
"""Places on a target after which a smaller share of contacts ends the search."""


@dataclass
class Search:
    """The search on one target: contacts so far with their tools, places tried, and why others were none.

    `tools` are those that measure it.

    `by_hand`: contacts to which no free way leads are among them.
    """

    target: int
    tools: Sequence[int]
    solid: int
    contacts: list[tuple[int, Contacts]] = field(default_factory=list)
    tried: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    by_hand: bool = False

    def count(self, reached: Contacts, rows: np.ndarray) -> None:
        """Count what was tried, in some rows (M,) bool, and why it is no contact."""
        self.tried += int(np.sum(rows))
        self.dropped.update(why for why in reached.reason[rows] if why)

    @property
    def have(self) -> int:
        """Number of contacts."""
        return sum(len(reached) for _, reached in self.contacts)

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


def sites_on(setup: Setup, search: Search, tool: int, count: int, rng: np.random.Generator) -> Sites:
    """`count` random places of a tool on the target of a search, with random directions within its cone.

    Where the kind of the target gives none, they are in the volume of interest, or wherever the arm reaches.
    """
    entry, radius = setup.dataset.targets[search.target], setup.dataset.tools[tool].ball_radius or 0.0
    solid = np.full(count, search.solid)
    planned, region, places = KINDS[entry.kind].probing, setup.regions.get(entry.name), None
    if planned.places is not None and region is not None:
        places = planned.places(entry, region, radius, count, rng)
    if planned.aims is not None and region is not None:
        poses = planned.aims(entry, region, count, rng)
        fault = np.full(len(poses), "", object)
        if planned.faults is not None:
            fault = planned.faults(entry, region, poses)
        nothing = np.full((count, 3), np.nan)
        return Sites(poses[:, :, 3], nothing, poses[:, :, 2], poses[:, :, :3], fault, solid)
    points, normals = places or (_in_volume(setup, tool, count, rng), np.full((count, 3), np.nan))
    axes = cone(np.tile([0.0, 0.0, 1.0], (count, 1)), np.pi, rng)
    touched = np.isfinite(normals[:, :1])
    axes = np.where(touched, cone(np.where(touched, -normals, axes), setup.cone, rng), axes)
    return Sites.of(points, normals, axes, solid)


def _in_volume(setup: Setup, tool: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """TCP positions (count, 3), m, in the volume of interest, or of random configurations."""
    if setup.volume is None:
        points = setup.hands[tool].points
        return points[rng.integers(len(points), size=count)]
    return setup.volume.centre + rng.uniform(-0.5, 0.5, (count, 3)) * setup.volume.size


def goals(searches: Sequence[Search], count: int) -> list[int]:
    """Contacts wanted of each search, together `count`: where a search is hopeless, others have more."""
    active = sum(not s.hopeless for s in searches)
    wanted = max(0, count - sum(s.have for s in searches if s.hopeless))
    shares = (wanted // active + (k < wanted % active) for k in range(active))
    return [s.have if s.hopeless else next(shares) for s in searches]


def tried_once(
    setup: Setup, searches: Sequence[Search], count: int, turning: float, rng: np.random.Generator
) -> bool:
    """Try as many places as are expected to be needed for `count` contacts; False if none are missing."""
    missing = [goal - s.have for s, goal in zip(searches, goals(searches, count), strict=True)]
    if not any(number > 0 for number in missing):
        return False
    for tool in sorted({k for s in searches for k in s.tools}):
        hand, active, parts = setup.hands[tool], [], []
        for search, number in zip(searches, missing, strict=True):
            if number > 0 and tool in search.tools:
                tries = int(np.ceil(SPARE * number / search.share / len(search.tools))) + 8
                parts.append(sites_on(setup, search, tool, min(tries, BATCH), rng))
                active.append(search)
        if not parts:
            continue
        sites = Sites.join(parts)
        index = np.repeat(np.arange(len(active)), [len(part) for part in parts])
        way = Straight(hand, turning, any(s.by_hand for s in active))
        for begin in range(0, len(sites), BATCH):
            some = slice(begin, begin + BATCH)
            reached = way.reach(sites[some], rng)
            for k, search in enumerate(active):
                _judge(setup, search, hand, reached, index[some] == k)
                search.count(reached, index[some] == k)
                search.contacts.append((tool, reached[(index[some] == k) & (reached.reason == "")]))
    return True


HIDDEN = "the board hidden by the arm or a solid"


def _judge(setup: Setup, search: Search, hand: Hand, reached: Contacts, rows: np.ndarray) -> None:
    """State of contacts in some rows (M,) bool what makes their pose useless: of arms with few joints."""
    entry = setup.dataset.targets[search.target]
    planned = KINDS[entry.kind].probing
    good = np.flatnonzero(rows & (reached.reason == ""))
    if planned.faults is not None and len(good):
        poses = hand.arm.tool_poses(hand.arm.frames(reached.readings[good]))[:, :3]
        reached.reason[good] = planned.faults(entry, setup.regions[entry.name], poses)
    good = np.flatnonzero(rows & (reached.reason == ""))
    if planned.sights is not None and len(good):
        poses = hand.arm.tool_poses(hand.arm.frames(reached.readings[good]))[:, :3]
        ends = planned.sights(entry, setup.regions[entry.name], poses)
        reached.reason[good[hand.clearance.hidden(reached.readings[good], *ends)]] = HIDDEN


def chosen(search: Search, count: int, rng: np.random.Generator) -> tuple[np.ndarray, Contacts]:
    """At most `count` of the contacts of a search at random: their tools (K,), and the contacts."""
    tool = np.concatenate([np.full(len(reached), k) for k, reached in search.contacts])
    rows = rng.permutation(len(tool))[:count]
    every = Contacts.join([reached for _, reached in search.contacts])
    return tool[rows], every[rows]


EACH = 11
"""Contacts on a sphere that validates: four unknowns, and enough to average the noise."""
FIRST = 60  # places on a sphere that are tried, to find configurations
HOMES = 8  # configurations that are compared: half of them those with the tool most nearly along gravity
PROBES = 16  # places that are tried in each of them
EXTRA = 1.6  # times as many contacts as are taken, to choose those far from each other
TILT = np.radians(10.0)  # variation of the direction of the tool
ROUNDS = 6


def located(setup: Setup, searches: Sequence[Search], tool: int, rng: np.random.Generator) -> list[Contacts]:
    """`EACH` contacts on the sphere of each search; none (K = 0) where too little of it can be touched.

    The configuration is that, of a few, from which most of the sphere is reached. Reasons are counted in the
    searches.
    """
    out = [Contacts.none(setup.dataset.robot.n)] * len(searches)
    for _ in range(ROUNDS):
        missing = [k for k, contacts in enumerate(out) if not len(contacts)]
        if not missing:
            break
        some = [searches[k] for k in missing]
        for k, contacts in zip(missing, _located(setup, some, tool, rng), strict=True):
            out[k] = contacts
    return out


def _located(setup: Setup, searches: Sequence[Search], tool: int, rng: np.random.Generator) -> list[Contacts]:
    hand, names = setup.hands[tool], [setup.dataset.targets[s.target].name for s in searches]

    def places(count: np.ndarray) -> Sites:
        """Random places on each sphere, `count` (S,)."""
        each = zip(searches, count, strict=True)
        return Sites.join([sites_on(setup, s, tool, int(n), rng) for s, n in each])

    def reach(sites: Sites, sphere: np.ndarray, starts: np.ndarray | None = None) -> Contacts:
        reached = Straight(hand).reach(sites, rng, starts)
        for k, search in enumerate(searches):
            search.count(reached, sphere == k)
        return reached

    def around(
        home: np.ndarray, axes: np.ndarray, of: np.ndarray, tries: np.ndarray
    ) -> tuple[Sites, Contacts]:
        """Places on the sphere `of` (H,) of each home (H, n), with the tool along its axis if possible."""
        number = np.repeat(np.arange(len(home)), tries)
        sites = places(np.bincount(of, weights=tries, minlength=len(searches)).astype(int))
        alike = _alike(axes[number], sites.normals, hand.cone, rng)
        return sites, reach(replace(sites, axes=alike), of[number], home[number])

    nothing = [Contacts.none(hand.arm.robot.n)] * len(searches)
    sphere = np.repeat(np.arange(len(searches)), FIRST)
    first = reach(places(np.full(len(searches), FIRST)), sphere)
    axes = hand.arm.tool_axis(hand.arm.frames(first.readings))
    up = np.array([setup.regions[name].up for name in names])
    rank = np.where(first.reason == "", np.sum(axes * up[sphere], axis=1), np.inf)
    homes = np.concatenate([k * FIRST + _homes(r, rng) for k, r in enumerate(rank.reshape(-1, FIRST))])
    if not len(homes):
        return nothing
    of = sphere[homes]
    _, probed = around(first.readings[homes], axes[homes], of, np.full(len(homes), PROBES))
    share = (probed.reason == "").reshape(-1, PROBES).mean(axis=1)
    each = [np.flatnonzero(of == k) for k in np.unique(of)]
    best = np.array([rows[np.argmax(share[rows])] for rows in each])
    best = best[share[best] * PROBES >= 2]
    if not len(best):
        return nothing
    tries = np.ceil(EXTRA * EACH / share[best]).astype(int)
    sites, more = around(first.readings[homes[best]], axes[homes[best]], of[best], tries)
    number = np.repeat(of[best], tries)
    return [
        more[spread(sites.normals, np.flatnonzero((number == k) & (more.reason == "")), EACH)]
        for k in range(len(searches))
    ]


def _homes(rank: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Indices of at most `HOMES` finite ranks (M,): half of them the smallest, the others at random."""
    rows = np.argsort(rank, kind="stable")[: np.sum(np.isfinite(rank))]
    others = rng.permutation(rows[HOMES // 2 :])
    return np.asarray(np.concatenate([rows[: HOMES // 2], others])[:HOMES])


def _alike(axes: np.ndarray, normals: np.ndarray, half_angle: float, rng: np.random.Generator) -> np.ndarray:
    """Directions (M, 3) near `axes` (M, 3), turned into the cone (rad) about the inward normals (M, 3)."""
    wanted, inward = cone(axes, TILT, rng), -normals
    beside = cross(cross(inward, wanted), inward)
    beside /= np.maximum(np.linalg.norm(beside, axis=1), 1e-12)[:, None]
    angle = np.arccos(np.clip(np.sum(inward * wanted, axis=1), -1, 1))
    angle = np.minimum(angle, 0.98 * half_angle)[:, None]
    return np.cos(angle) * inward + np.sin(angle) * beside
