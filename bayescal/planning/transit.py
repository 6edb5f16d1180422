"""Motions between contacts: whether they are collision-free, and where they must pass otherwise.

Controllers move between approaches by joint angles, all joints at the same time. Such a motion from one face
of an artefact to another usually passes through it.
"""

from __future__ import annotations

from collections.abc import Iterator
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


def seconds_between(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Times (...), s, of motions between readings (..., n), rad."""
    return np.abs(end - begin).max(axis=-1, initial=0.0) / RATE


@dataclass(frozen=True)
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

    def ways(self, begin: np.ndarray, end: np.ndarray) -> list[np.ndarray | None]:
        """Readings (K, n), rad, K = 1 or 2, to pass between readings (M, n); None if no free way is found.

        The nodes of the shortest ways are tried for all motions at once. Where none of them will do, two of
        them are, and then all nodes.
        """
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

    def _groups(self, begin: np.ndarray, end: np.ndarray) -> Iterator[tuple[Place, np.ndarray]]:
        """Motions between rows (M,), by the place where they are; none where tool or artefact is changed."""
        tool = self.pool.session.measurements.tool
        a, b = self._labels[begin], self._labels[end]
        label = np.where(b == "", a, b)
        moved = (tool[begin] == tool[end]) & ((a == "") | (b == "") | (a == b))
        for k, name in sorted(
            {(int(t), str(n)) for t, n in zip(tool[end][moved], label[moved], strict=True)}
        ):
            yield self._place(k, name), np.flatnonzero(moved & (tool[end] == k) & (label == name))

    def blocked(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Which straight motions between the approaches of rows (M,) collide, (M,)."""
        out, approach = np.zeros(len(begin), bool), self.pool.approach
        for place, some in self._groups(begin, end):
            out[some] = ~place.free(approach[begin[some]], approach[end[some]])
        return out

    def via(self, rows: np.ndarray) -> tuple[np.ndarray | None, ...]:
        """Where the arm passes between rows (M,) in the order of probing.

        Returns
        -------
        tuple of np.ndarray, shape (K, n), or None
            Readings, rad, that are passed before the approach of each row; most often K = 0. None where no
            free way from the row before was found.
        """
        out: list[np.ndarray | None] = [np.empty((0, self.pool.approach.shape[1]))] * len(rows)
        begin, end = rows[:-1], rows[1:]
        for place, some in self._groups(begin, end):
            a, b = self.pool.approach[begin[some]], self.pool.approach[end[some]]
            bad = np.flatnonzero(~place.free(a, b))
            for k, way in zip(bad, place.ways(a[bad], b[bad]), strict=True):
                out[int(some[k]) + 1] = way
        return tuple(out)
