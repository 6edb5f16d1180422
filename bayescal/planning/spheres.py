"""Contacts that locate spheres: distributed over the upper part of each, in one configuration of the arm.

A sphere is located by contacts at nearly one orientation of the tool, so that an error of the arm that
depends on the configuration does not deform it. All spheres are searched together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.arm.transforms import cross
from bayescal.planning.hand import Hand, Reached
from bayescal.planning.pool import Setup
from bayescal.planning.search import Search, room_of
from bayescal.planning.sites import Sites, join, sites_on
from bayescal.simulation.probing import spread
from bayescal.simulation.reach import cone

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
