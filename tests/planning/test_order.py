"""Orders of probing: every row once, sweeps over all targets, short paths."""

from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.planning import order as orders
from bayescal.planning.place import RATE

TARGETS = ("cube.+x", "cube.+y", "cube.+z", "ball.A@1", "ball.A@2", "ball.A@3")


def made_up(count=240, payloads=(0.0, 2.0), targets=TARGETS, seed=0):
    """A pool of random approaches; rows on targets with an @ validate."""
    rng = np.random.default_rng(seed)
    target = np.arange(count) % len(targets)
    readings = rng.uniform(-1, 1, (count, 6)) + 3 * target[:, None] * np.eye(6)[0]
    role = np.where(["@" in targets[t] for t in target], "validate", "calibrate")
    payload = np.where(role == "calibrate", rng.choice(payloads, count), 0.0)
    rows = SimpleNamespace(
        tool=np.zeros(count, int),
        ids=tuple(map(str, range(count))),
        role=role,
        target=target,
        readings=readings,
        payload=payload,
    )
    session = SimpleNamespace(targets=[SimpleNamespace(name=name) for name in targets], measurements=rows)
    return SimpleNamespace(session=session, approach=readings + 0.01)


def put(pool, rows, order, seed=0):
    rows = np.asarray(rows)
    at = orders.ordered(pool, rows, order, np.random.default_rng(seed))
    assert sorted(at) == list(range(len(rows)))
    return rows[at]


def changes(values):
    return int(np.sum(np.asarray(values[1:]) != np.asarray(values[:-1])))


@pytest.mark.parametrize("order", orders.ORDERS)
def test_every_row_is_visited_once_and_the_seed_decides(order):
    pool = made_up()
    rows = np.random.default_rng(1).permutation(240)[:100]
    assert np.array_equal(put(pool, rows, order), put(pool, rows, order))


def test_sweeps_visit_all_targets_and_change_the_payload_once():
    pool = made_up()
    m = pool.session.measurements
    got = put(pool, np.arange(240), "sweeps")
    fitted = got[m.role[got] == "calibrate"]
    quarters = np.array_split(fitted, orders.COUNT)
    for quarter in quarters:
        counts = np.bincount(m.target[quarter], minlength=6)[:3]
        assert counts.min() >= 8
        assert np.ptp(counts) <= 3
        assert changes(m.payload[quarter]) <= 2  # quarters by number are not the sweeps to the contact
    assert changes(m.payload[fitted]) == orders.COUNT


def test_a_drift_is_not_along_the_targets():
    """The mean time of every target is within a tenth of the session of its middle."""
    pool = made_up()
    m = pool.session.measurements
    got = put(pool, np.flatnonzero(m.role == "calibrate"), "sweeps")
    for t in range(3):
        at = np.flatnonzero(m.target[got] == t) / len(got)
        assert abs(np.mean(at) - 0.5) < 0.1
        assert np.ptp(at) > 0.75


def test_validation_is_in_the_middle_and_at_the_end_a_placement_at_once():
    pool = made_up()
    m = pool.session.measurements
    for order in orders.ORDERS:
        got = put(pool, np.arange(240), order)
        checked = m.role[got] == "validate"
        assert checked[-1]
        assert not checked[0]
        target = m.target[got][checked]
        assert changes(target) == 2  # each of three placements together
    got = put(pool, np.arange(240), "sweeps")
    assert changes(m.role[got]) == 3  # calibrate, validate, calibrate, validate
    first = np.flatnonzero(m.role[got] == "validate")[0]
    assert 0.2 < first / len(got) < 0.5


def test_a_target_that_stays_validates_in_both():
    pool = made_up(targets=("cube.+x", "cube.+y", "ball.A@1"))
    m = pool.session.measurements
    got = put(pool, np.arange(240), "sweeps")
    checked = np.flatnonzero(m.role[got] == "validate")
    assert changes(np.diff(checked) > 1) == 2  # two blocks
    assert checked[-1] == len(got) - 1


def test_placements_that_are_calibrated_on_are_not_mixed():
    pool = made_up(targets=("ball.A@1", "ball.B@1", "ball.A@2", "ball.B@2"))
    m = pool.session.measurements
    m.role[:] = "calibrate"
    got = put(pool, np.arange(240), "sweeps")
    placement = m.target[got] // 2
    assert changes(placement) == 1
    halves = np.array_split(m.target[got][placement == 0], 2)
    assert all(len(set(half)) == 2 for half in halves)  # two sweeps over its spheres


def test_repeats_are_apart():
    pool = made_up()
    m = pool.session.measurements
    fitted = np.flatnonzero(m.role == "calibrate")
    rows = np.concatenate([fitted, fitted[:10], fitted[:5]])
    got = put(pool, rows, "sweeps")
    for k, row in enumerate(fitted[:10]):
        at = np.flatnonzero(got == row)
        assert np.diff(at).min() > (2 if k < 5 else len(got) / 8)


def test_the_path_is_short():
    """Never longer than the nearest neighbour's; near the best of all for a few points."""
    for seed in range(8):
        at = np.random.default_rng(seed).uniform(size=(8, 3))
        seconds = np.abs(at[:, None] - at[None]).max(axis=2)

        def length(path, seconds=seconds):
            return seconds[path[:-1], path[1:]].sum()

        near, short = orders.nearest(seconds, 0), orders.shorter(seconds, 0)
        assert short[0] == 0
        assert sorted(short) == list(range(8))
        best = min(length(np.array([0, *rest])) for rest in permutations(range(1, 8)))
        assert best - 1e-12 <= length(short) <= length(near) + 1e-12
        assert length(short) < 1.25 * best


def test_times_of_travel():
    pool = made_up()
    rows = np.arange(240)
    times = {order: orders.travel(pool, put(pool, rows, order)) for order in orders.ORDERS}
    assert times["shortest"] < times["sweeps"] < times["random"]
    pool = made_up(2)
    pool.approach[:] = [[0.0] * 6, [0.0, 0.9, 0, 0, -0.3, 0]]
    assert orders.travel(pool, np.array([0, 1])) == pytest.approx(0.9 / RATE + 2 * (4.0 + 1.0))
    pool.session.measurements.readings[:] = pool.approach
    assert orders.travel(pool, np.array([0, 1])) == pytest.approx(0.9 / RATE)  # nothing is touched


@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("order", orders.ORDERS)
def test_few_rows(order, count):
    assert len(put(made_up(), np.arange(count), order)) == count
