"""Motions between contacts: collisions are seen, ways around them are free, and orders avoid them."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from bayescal.planning import order as orders
from bayescal.planning.candidates import candidates
from bayescal.planning.hand import LINE
from bayescal.planning.place import placements, scene, seconds_between
from bayescal.planning.pool import CLEAR
from bayescal.planning.setup import continued, read_setup
from bayescal.planning.transit import Transits
from bayescal.probing.clearance import Clearance

EXAMPLE = Path(__file__).parents[2] / "data" / "lrmate200ic-cube"
FINE = np.radians(0.2)


@pytest.fixture(scope="module")
def pool():
    dataset = read_setup(EXAMPLE).dataset
    targets = tuple(t for t in dataset.targets if t.kind == "plane")
    certificates = tuple(c for c in dataset.certificates if c.targets[0].startswith("cube"))
    return candidates(continued(replace(dataset, targets=targets, certificates=certificates)), 32, seed=5)


@pytest.fixture(scope="module")
def ordered(pool):
    """Rows in sweeps without and with regard to collisions, and the transits."""
    moves = Transits(pool)
    blind = orders.ordered(pool, pool.candidates, "sweeps", np.random.default_rng(0))
    seeing = orders.ordered(pool, pool.candidates, "sweeps", np.random.default_rng(0), moves.blocked)
    return moves, pool.candidates[blind], pool.candidates[seeing]


def depths(pool, points):
    """Smallest distance, m, of anything on straight motions through readings (P, n)."""
    setup = pool.setup
    clearance = Clearance.of(setup.dataset.robot, setup.dataset.tools[0], scene(setup).solids)
    out = []
    for a, b in pairwise(points):
        number = int(np.ceil(np.abs(b - a).max() / FINE)) + 1
        out.append(clearance.distances(a + np.linspace(0, 1, number)[:, None] * (b - a)).min())
    return np.array(out)


def test_collisions_between_contacts_are_seen(pool, ordered):
    """Against distances at many configurations on each motion."""
    moves, blind, _ = ordered
    blocked = moves.blocked(blind[:-1], blind[1:])
    depth = depths(pool, pool.approach[blind])
    assert 3 < blocked.sum() < len(blind) - 3
    assert np.all(depth[blocked] < CLEAR + 1e-3)
    assert depth[~blocked].min() > CLEAR


def test_orders_avoid_collisions(ordered):
    moves, blind, seeing = ordered
    before, after = (moves.blocked(rows[:-1], rows[1:]).sum() for rows in (blind, seeing))
    assert after < 0.9 * before


def test_ways_around_are_free(pool, ordered):
    moves, _, seeing = ordered
    ways = moves.ways(seeing)
    via = ways.via
    same = np.array([not text for text in ways.changes[1:]])
    blocked = moves.blocked(seeing[:-1], seeing[1:])
    assert [len(way) > 0 for way in via[1:]] == (blocked & same).tolist()
    assert [len(way) for way in ways.leave[:1]] == [1]
    points = [
        p
        for *both, row in zip(ways.leave, via, seeing, strict=True)
        for p in (*both[0], *both[1], pool.approach[row])
    ]
    found = depths(pool, np.array(points))
    assert found.min() > CLEAR
    assert ways.clearance.min() <= found.min() + 1e-6
    assert ways.clearance.min() > min(CLEAR, LINE)
    times = orders.travel(pool, seeing, via), orders.travel(pool, seeing)
    assert times[1] < times[0] < times[1] + 10.0 * blocked.sum()


def test_no_way_is_said(pool, ordered):
    """An approach inside of the cube cannot be left."""
    inside = pool.approach.copy()
    row = int(pool.candidates[0])
    inside[row] = pool.session.measurements.readings[row] - 2 * (
        inside[row] - pool.session.measurements.readings[row]
    )
    moves = Transits(replace(pool, approach=inside))
    other = int(pool.candidates[1])
    found = moves.ways(np.array([other, row, other]))
    first, *others = found.via
    assert len(first) == 0
    assert others == [None, None]
    assert [bool(words) for words in found.by_hand] == [False, True, True]
    assert orders.travel(moves.pool, np.array([other, row]), [first, None]) > 0


def test_placements_that_come_one_after_the_other_are_not_between_each_other():
    assert placements(["cube.+x", "ball.A@1", "ball.B@2"]) == ["", "1", "2"]
    assert placements(["cube.+x", "ball.A@1", "ball.B@1"]) == ["", "", ""]
    setup = read_setup(EXAMPLE)
    names = ("cube.+y", "cube.-y", "cube.-x", "cube.+z", "ball.B@1", "ball.B@3")
    dataset = replace(
        setup.dataset, targets=tuple(t for t in setup.dataset.targets if t.name in names), certificates=()
    )
    pool = candidates(replace(continued(dataset), validated=frozenset(names[4:])), 8, seed=0)
    m, moves = pool.session.measurements, Transits(pool)
    one, other = (np.flatnonzero(m.target == names.index(name))[0] for name in names[4:])
    there = {key: sum(bool(s.shapes) for s in moves._place(0, key).clearance.solids) for key in ("1", "")}
    assert there == {"1": 3, "": 2}  # cube, one sphere, table
    assert not moves.blocked(np.array([one]), np.array([other])).any()  # the artefact is moved between them
    ways = moves.ways(np.array([one, pool.candidates[0], other]))
    assert ways.changes == ("move the artefact to placement 1", "", "move the artefact to placement 3")
    assert [len(way) > 0 for way in ways.leave] == [True, False, True]


def test_times_between_readings():
    assert seconds_between(np.zeros(3), np.array([0.1, -np.pi / 4, 0])) == pytest.approx(1.0)
