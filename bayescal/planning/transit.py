"""Motions between contacts: whether they are collision-free, and where they must pass otherwise.

Controllers move between approaches by joint angles, all joints at the same time. Such a motion from one face
of an artefact to another usually passes through it. Where a tool, the placement of an artefact or the payload
is changed, the arm first goes to a raised pose, far from all solids, and waits there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.collision import Clearance
from bayescal.planning.hand import Hand
from bayescal.planning.obstacles import placements, scene
from bayescal.planning.pool import Pool

STEP = np.radians(3.0)
"""rad: motion of the fastest joint between configurations that are checked: some 30 mm at the ball."""
RATE = np.radians(45.0)
"""rad/s: mean velocity of a joint between contacts (assumed: a quarter of that of a small arm)."""
COARSE = 4  # of these configurations one in four is checked first
NODES = 3000  # random configurations, of which the motion may pass one or two
AT_ONCE = 8  # of them that are tried at once, those of the shortest way first
MOST = 64
"""Configurations that are tried for a motion before all of them are."""
RESERVE = 300  # of the others that are tried at once
PAIRED = 12  # on each side, where two configurations must be passed
RAISED = 0.1
"""m: distance of the tool from all solids where the arm waits for a change, if it can be had (assumed)."""
WAITING = 24  # raised poses that are tried, those of the shortest way first


def seconds_between(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Times (...), s, of motions between readings (..., n), rad."""
    return np.abs(end - begin).max(axis=-1, initial=0.0) / RATE


@dataclass(frozen=True, eq=False)
class Place:
    """An arm with its tool among the solids that are there at the same time."""

    hand: Hand
    clearance: Clearance

    def free(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Which motions from `begin` to `end`, readings (M, n), rad, are free between their ends, (M,)."""
        number = np.ceil(np.abs(end - begin).max(axis=1, initial=0.0) / STEP).astype(int) - 1
        number = np.maximum(number, 0)
        of = np.repeat(np.arange(len(begin)), number)
        at = np.arange(len(of)) - np.repeat(np.cumsum(number) - number, number) + 1
        out = np.ones(len(begin), bool)
        first = at % COARSE == 1
        for some in (first, ~first):  # most motions that collide do so at the first
            rows = np.flatnonzero(some & out[of])
            k = of[rows]
            readings = begin[k] + (at[rows] / (number[k] + 1))[:, None] * (end[k] - begin[k])
            if len(rows):
                out[k[self.clearance.collides(readings) != 0]] = False
        return out

    @cached_property
    def nodes(self) -> np.ndarray:
        """Random readings (K, n), rad, that are free."""
        some = self.hand.anywhere[:NODES]
        return some[self.clearance.collides(some) == 0]

    @cached_property
    def raised(self) -> np.ndarray:
        """Readings (K, n), rad, at which the arm can wait, with its tool far from all solids."""
        away = self.away(self.nodes)
        return self.nodes[away >= min(RAISED, np.quantile(away, 0.9))] if len(away) else self.nodes

    def away(self, readings: np.ndarray) -> np.ndarray:
        """Distances (M,), m, of the tool from all solids at readings (M, n); -1 where anything collides."""
        tool = tuple(c for c in self.clearance.capsules if c.frame == self.hand.arm.robot.n + 1)
        away = replace(self.clearance, capsules=tool, own=()).distances(readings)
        return np.where(self.clearance.collides(readings) != 0, -1.0, away)

    def ways(self, begin: np.ndarray, end: np.ndarray) -> list[np.ndarray | None]:
        """Readings (K, n), rad, K <= 2, to pass between readings (M, n); None if no free way is found.

        The nodes of the shortest ways are tried for all motions at once that are not free without. Where none
        of them will do, two of them are, and then all nodes.
        """
        free = self.free(begin, end)
        out: list[np.ndarray | None] = [begin[:0] if own else None for own in free]
        bad = np.flatnonzero(~free)
        for k, way in zip(bad, self._around(begin[bad], end[bad]), strict=True):
            out[k] = way
        return out

    def _around(self, begin: np.ndarray, end: np.ndarray) -> list[np.ndarray | None]:
        out: list[np.ndarray | None] = [None] * len(begin)
        detour = seconds_between(begin[:, None], self.nodes) + seconds_between(self.nodes, end[:, None])
        order = np.argsort(detour, axis=1, kind="stable")
        near = np.zeros(order.shape, bool)  # free from the begin
        left = np.arange(len(begin))
        for first in range(0, MOST, AT_ONCE):
            k = np.arange(first, min(first + AT_ONCE, order.shape[1]))
            move, k = np.repeat(left, len(k)), np.tile(k, len(left))
            some = self.nodes[order[move, k]]
            ok = near[move, k] = self.free(begin[move], some)
            ok[ok] = self.free(some[ok], end[move[ok]])
            for m in np.unique(move[ok]):
                out[m] = some[[int(np.argmax(ok & (move == m)))]]
            left = np.array([m for m in left if out[m] is None], int)
        for m in left:
            nodes = self.nodes[order[m]]
            some = nodes[:MOST]
            far = some[self.free(some, np.broadcast_to(end[m], some.shape))]
            out[m] = self._of_two(begin[m], end[m], nodes[near[m]][:PAIRED], far[:PAIRED])
            for first in range(MOST, len(nodes), RESERVE):
                if out[m] is None:
                    out[m] = self._of_any(begin[m], end[m], nodes[first : first + RESERVE])
        return out

    def _of_two(
        self, begin: np.ndarray, end: np.ndarray, near: np.ndarray, far: np.ndarray
    ) -> np.ndarray | None:
        """The shortest free way over one of `near` (K, n), free from `begin`, and one of `far`."""
        a, b = np.repeat(near, len(far), axis=0), np.tile(far, (len(near), 1))
        ok = self.free(a, b)
        if not np.any(ok):
            return None
        time = seconds_between(begin, a) + seconds_between(a, b) + seconds_between(b, end)
        best = int(np.argmin(np.where(ok, time, np.inf)))
        return np.stack([a[best], b[best]])

    def _of_any(self, begin: np.ndarray, end: np.ndarray, nodes: np.ndarray) -> np.ndarray | None:
        """The first of `nodes` (K, n) that is free from `begin` and to `end`, or two of them."""
        near = nodes[self.free(np.broadcast_to(begin, nodes.shape), nodes)]
        direct = self.free(near, np.broadcast_to(end, near.shape))
        if np.any(direct):
            return near[[int(np.argmax(direct))]]
        far = nodes[self.free(nodes, np.broadcast_to(end, nodes.shape))]
        return self._of_two(begin, end, near[:PAIRED], far[:PAIRED])


@dataclass(frozen=True)
class Ways:
    """Motions to the approaches of M rows in the order of probing; see the fields of `result.Plan`."""

    leave: tuple[np.ndarray | None, ...]
    via: tuple[np.ndarray | None, ...]
    changes: tuple[str, ...]
    by_hand: tuple[str, ...]
    clearance: np.ndarray


@dataclass(frozen=True)
class Transits:
    """Motions between the approaches of rows of a pool."""

    pool: Pool

    @cached_property
    def _places(self) -> dict[tuple[int, str], Place]:
        return {}

    @cached_property
    def _labels(self) -> np.ndarray:
        """Placement of each row, (N,)."""
        session = self.pool.session
        own = np.array(placements([t.name for t in session.targets]), object)
        return own[session.measurements.target]

    def _place(self, tool: int, label: str) -> Place:
        """The place of a tool while a placement of the artefact is there."""
        if (tool, label) not in self._places:
            setup = self.pool.setup
            around = scene(setup)
            hand = next((p.hand for (k, _), p in self._places.items() if k == tool), None)
            hand = hand or Hand.of(setup.dataset, tool, around, setup.cone)
            there = [replace(s, placement="") for s in around.solids if s.placement in ("", label)]
            self._places[tool, label] = Place(hand, hand.clearance.among(there))
        return self._places[tool, label]

    def blocked(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Which straight motions between the approaches of rows (M,) collide, (M,).

        None where tool or artefact is changed on the way: the arm stops there.
        """
        out, approach = np.zeros(len(begin), bool), self.pool.approach
        tool = self.pool.session.measurements.tool
        a, b = self._labels[begin], self._labels[end]
        label = np.where(b == "", a, b)
        moved = (tool[begin] == tool[end]) & ((a == "") | (b == "") | (a == b))
        for k, name in sorted(
            {(int(tool[e]), str(n)) for e, n in zip(end[moved], label[moved], strict=True)}
        ):
            some = moved & (tool[end] == k) & (label == name)
            out[some] = ~self._place(k, name).free(approach[begin[some]], approach[end[some]])
        return out

    def ways(self, rows: np.ndarray) -> Ways:
        """The motions to rows (M,) in the order of probing, with the stops where something is changed."""
        approach, labels = self.pool.approach[rows], self._placed(rows)
        tool = self.pool.session.measurements.tool[rows]
        changes = self._changes(rows, labels)
        stops = np.array([k == 0 or bool(text) for k, text in enumerate(changes)])
        none = np.empty((0, approach.shape[1]))
        leave: list[np.ndarray | None] = [none] * len(rows)
        via: list[np.ndarray | None] = [none] * len(rows)
        places = [self._place(int(t), str(n)) for t, n in zip(tool, labels, strict=True)]
        for k in np.flatnonzero(stops):
            before = None if k == 0 else (places[k - 1], approach[k - 1])
            leave[k], via[k] = stopped(before, (places[k], approach[k]))
        for place in dict.fromkeys(places):
            some = np.array([k for k, own in enumerate(places) if own is place and not stops[k]], int)
            for k, way in zip(some, place.ways(approach[some - 1], approach[some]), strict=True):
                via[k] = way
        words = tuple(by_hand(end) if way is None else "" for end, way in zip(approach, via, strict=True))
        return Ways(tuple(leave), tuple(via), changes, words, np.full(len(rows), np.nan))

    def _placed(self, rows: np.ndarray) -> np.ndarray:
        """Placement of the artefact while each of rows (M,) is probed, (M,).

        It stays where it is until a row needs another, and is there from the beginning.
        """
        out = self._labels[rows]
        known = np.flatnonzero(out != "")
        if len(known):
            out = out[known[np.maximum(np.searchsorted(known, np.arange(len(rows)), side="right") - 1, 0)]]
        return out

    def _changes(self, rows: np.ndarray, labels: np.ndarray) -> tuple[str, ...]:
        """What the person has to do before each of rows (M,), or ""."""
        session = self.pool.session
        m = session.measurements
        payload = np.zeros(len(rows)) if m.payload is None else m.payload[rows]
        names = [session.tools[k].name for k in m.tool[rows]]
        several = {"tool": len(set(names)) > 1, "placement": len(set(labels)) > 1}
        out = []
        for k, (name, label, load) in enumerate(zip(names, labels, payload, strict=True)):
            parts = []
            if several["tool"] and (k == 0 or name != names[k - 1]):
                parts.append(f"mount tool {name}")
            if several["placement"] and (k == 0 or label != labels[k - 1]):
                parts.append(f"move the artefact to placement {label}")
            if load != (payload[k - 1] if k else 0.0):
                parts.append(f"attach {load:g} kg to the tool" if load else "remove the payload")
            out.append("; ".join(parts))
        return tuple(out)


def stopped(
    before: tuple[Place, np.ndarray] | None, after: tuple[Place, np.ndarray]
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Ways (K, n) from an approach (n,) to a raised pose where the arm waits, and from there to another.

    The last of the first is where it waits. At the start of a session (`before` is None) it is the only. None
    for both if there is no such way.
    """
    place, end = after
    raised = place.raised
    if before is not None and before[0] is not place:
        away = before[0].away(raised)
        raised = raised[away >= min(RAISED, 0.5 * away.max(initial=0.0))]
    begin = end if before is None else before[1]
    order = np.argsort(seconds_between(begin, raised) + seconds_between(raised, end), kind="stable")
    best = raised[order[:WAITING]]
    down = place.ways(best, np.broadcast_to(end, best.shape))
    up = [best[:0]] * len(best)
    if before is not None:
        up = before[0].ways(np.broadcast_to(begin, best.shape), best)
    for wait, a, b in zip(best, up, down, strict=True):
        if a is not None and b is not None:
            return np.concatenate([a, wait[None]]), b
    return None, None


def by_hand(end: np.ndarray) -> str:
    """How the arm is jogged manually to readings (n,), rad, to which no free way is known."""
    joints = ", ".join(f"J{k} {angle:.1f}" for k, angle in enumerate(np.degrees(end), 1))
    return f"jog manually: raise the tool above all that stands there, then to {joints} deg"
