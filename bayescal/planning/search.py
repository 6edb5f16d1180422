"""The search for contacts on several targets at once: places are tried until each target has its share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.target_kinds import KINDS
from bayescal.planning.hand import Hand, Reached
from bayescal.planning.pool import Setup
from bayescal.planning.sites import Room, join, sites_on

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
