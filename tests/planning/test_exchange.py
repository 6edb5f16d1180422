"""Selection of contacts against exhaustive search, dense inverses, and growth by the I criterion alone."""

import re
from dataclasses import replace
from itertools import combinations, permutations
from types import SimpleNamespace

import numpy as np
import pytest
from cases import refused
from simulated_pools import MODEL, every, linear, mixed, pool, pool_of

from bayescal.dataset import Measurements, Noise
from bayescal.dataset.write import taken
from bayescal.errors import BayescalError
from bayescal.estimate import linearise, unit_weights
from bayescal.model import ARM, Scene, build
from bayescal.model.options import parts_of
from bayescal.planning import exchange
from bayescal.planning import order as orders
from bayescal.planning.exchange import (
    Selection,
    arm_information,
    grow,
    mean_variance,
    observability,
    observability_of,
    root_of,
    select,
    shrink,
)
from bayescal.planning.goals import Goal, goals
from bayescal.planning.pool import Linearised, check_count, inverse, linearised
from bayescal.probing.motions import RATE
from bayescal.robots import load_robot


def toy(count: int = 8, residuals: int = 1, size: int = 3, seed: int = 0) -> Linearised:
    """Random candidates without a model."""
    rng = np.random.default_rng(seed)
    contact = np.repeat(np.arange(count), residuals)
    none = np.zeros((size, size))
    jacobian = rng.standard_normal((len(contact), size))
    return Linearised(None, np.zeros(size), jacobian, contact, count, none, none)


def goal(size: int = 3, count: int = 5, seed: int = 9) -> Goal:
    slopes = np.random.default_rng(seed).standard_normal((count, size))
    return Goal("distances", slopes, np.zeros(count), np.zeros(count))


def u(found: Linearised, of: Goal, chosen) -> float:
    return float(np.sqrt(mean_variance(of.slopes, found.covariance(chosen))))


@pytest.fixture(scope="module")
def of_mixed():
    found = linearised(mixed(), MODEL)
    return found, root_of(goals(mixed(), found), found.covariance(np.arange(100)))


@pytest.mark.parametrize("residuals", [1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_exchange_finds_the_best_of_all_selections(residuals, seed):
    found, of = toy(8, residuals, seed=seed), goal()
    best = min(u(found, of, list(c)) for c in combinations(range(8), 4))
    chosen = select(found, [of], 4, np.random.default_rng(0), starts=6)
    assert len(set(chosen)) == 4
    assert u(found, of, chosen) == pytest.approx(best, rel=1e-9)


def test_benefit_of_every_candidate_is_that_of_a_dense_inverse(of_mixed):
    found, root = of_mixed
    chosen = list(range(0, 240, 3))
    s = Selection(found, chosen, root)

    def dense(of) -> tuple[float, float]:
        c = np.linalg.inv(found.information(of))
        return float(np.sum((c @ root) * root)), float(np.linalg.slogdet(found.information(of))[1])

    value, determinant = dense(chosen)
    assert s.value == pytest.approx(value)
    for k in (301, 302, 303):
        more = dense([*chosen, k])
        assert s.gains()[k] == pytest.approx(value - more[0], rel=1e-5)
        assert s.determinants()[k] == pytest.approx(more[1] - determinant, rel=1e-5)
    for k in (0, 3, 6):
        assert s.losses([k])[0] == pytest.approx(dense([c for c in chosen if c != k])[0] - value, rel=1e-5)


def test_updates_equal_a_new_factorisation(of_mixed, monkeypatch):
    monkeypatch.setattr(exchange, "FRESH", 10**9)
    found, root = of_mixed
    s = Selection(found, list(range(100)), root)
    rng = np.random.default_rng(0)
    for k in rng.permutation(np.arange(100, 200))[:30]:
        s.change(int(k), 1.0)
    for k in rng.permutation(100)[:20]:
        s.change(int(k), -1.0)
    again = Selection(found, s.chosen, root)
    for name in ("covariance", "spread", "moved"):
        a, b = getattr(s, name), getattr(again, name)
        assert np.max(np.abs(a - b)) < 1e-6 * np.max(np.abs(b)), name
    assert len(s.chosen) == len(set(s.chosen)) == 110


def test_chosen_contacts_are_better_than_others():
    found = linear()
    of = goals(pool(), found)
    chosen = select(found, of, 60, np.random.default_rng(0), starts=1)
    for each in of:
        some = [np.random.default_rng(k).permutation(found.count)[:120] for k in range(9)]
        assert u(found, each, chosen) < np.median([u(found, each, c) for c in some])
    # growing by the i criterion from nothing fails
    blind = Selection(found, [], root_of(of, found.covariance(np.arange(100))))
    grow(blind, 60, Selection.gains)
    certified, region = of
    assert u(found, region, blind.chosen) > 2 * u(found, region, chosen)
    assert u(found, certified, blind.chosen) > 1.3 * u(found, certified, chosen)
    # all goals become more accurate than with the largest determinant
    start = Selection(found, [], np.zeros((len(found.z), 0)))
    grow(start, 60, Selection.determinants)
    ratios = [u(found, each, chosen) / u(found, each, start.chosen) for each in of]
    assert max(ratios) < 0.95
    assert max(ratios) / min(ratios) < 1.25


def test_all_candidates_can_be_chosen():
    found, of = toy(30), goal()
    assert len(set(select(found, [of], 12, np.random.default_rng(0)))) == 12
    assert len(select(found, [of], 30, np.random.default_rng(0))) == 30
    # dropping ends at the count
    s = Selection(found, range(30), root_of([of], found.covariance(range(30))))
    shrink(s, 5)
    assert len(s.chosen) == 5


def test_order_of_candidates_and_unit_of_the_goals_do_not_matter():
    found, of = toy(30, 3), goal()
    base = u(found, of, select(found, [of, goal(seed=4)], 10, np.random.default_rng(0), starts=4))
    order = np.random.default_rng(2).permutation(30)
    turned = replace(found, jacobian=found.blocks[order].reshape(-1, 3))
    again = select(turned, [of, goal(seed=4)], 10, np.random.default_rng(0), starts=4)
    assert u(turned, of, again) == pytest.approx(base, rel=0.02)
    scaled = [replace(g, slopes=1e3 * g.slopes) for g in (of, goal(seed=4))]
    same = select(found, scaled, 10, np.random.default_rng(0), starts=4)
    assert u(found, of, same) == pytest.approx(base, rel=1e-9)


# --- Information of candidate contacts against fits of the chosen rows alone, and matrices with known values.


def only(dataset, rows):
    """The session with some of its rows."""
    return replace(dataset, measurements=taken(dataset.measurements, rows))


def equal(a, b) -> bool:
    """Whether two information matrices are equal except for rounding."""
    return bool(np.max(np.abs(a - b)) < 1e-9 * np.max(np.abs(b)))


def test_parts_that_the_model_lacks_are_no_unknowns():
    found = linearised(pool(), MODEL, without=parts_of(["geometry at joint 4"], MODEL))
    lost = {p.name for p in linear().model.parameters} - {p.name for p in found.model.parameters}
    assert "theta4" in lost
    assert found.jacobian.shape[1] == linear().jacobian.shape[1] - len(lost)


@pytest.mark.parametrize("of", [lambda: pool(), mixed])
def test_covariance_is_that_of_a_model_of_the_chosen_rows(of):
    p = of()
    found = linearised(p, MODEL)
    chosen = np.sort(np.random.default_rng(0).permutation(found.count)[:150])
    model = build(Scene(only(p.session, p.candidates[chosen])), MODEL)
    nominal = np.zeros(model.size)  # where `linearised` is: compliances deflect the mean of the prior
    nominal[model.slices[ARM]] = -model.shift / model.sd
    j = linearise(model, nominal, unit_weights(model, nominal)).jacobian
    own = np.linalg.inv(np.eye(model.size) + j.T @ j)
    size = len(model.parameters)
    # a plane tilts about the middle of its own contacts: its loose prior is another one
    sd = [np.sqrt(np.diag(c)[:size]) for c in (found.covariance(chosen), own)]
    np.testing.assert_allclose(*sd, rtol=3e-3)


def test_blocks_have_as_many_residuals_as_the_kind():
    found = linearised(mixed(), MODEL)
    tracked = np.isfinite(mixed().session.measurements.xyz[mixed().candidates, 0])
    assert found.blocks.shape[1] == 3
    assert np.array_equal(np.bincount(found.contact), np.where(tracked, 3, 1))
    assert np.all(found.blocks[~tracked, 1:] == 0)
    rows = found.jacobian[np.isin(found.contact, [5, 9, 11])]
    assert equal(found.selected([5, 9, 11]), rows.T @ rows)


def test_rows_measured_already_count():
    p = pool()
    first, rest = np.arange(100), np.arange(100, 600)
    continued = linearised(pool_of(p.session, measured=100), MODEL)
    assert continued.count == 500
    assert continued.residuals == 100
    assert equal(continued.information([]), linear().information(first))
    assert equal(continued.information(every(continued)), linear().information(np.append(first, rest)))


def test_order_and_noise():
    p, found = pool(), linear()
    order = np.random.default_rng(1).permutation(len(p.session.measurements.role))
    shuffled = pool_of(only(p.session, order))
    where = np.argsort(order)[p.candidates]  # rows of the shuffled session
    chosen = np.arange(0, 600, 5)
    same = np.searchsorted(shuffled.candidates, where[chosen])
    assert equal(linearised(shuffled, MODEL).information(same), found.information(chosen))
    noisy = replace(p.session, noise=Noise(contact=2 * p.session.noise.contact))
    assert equal(4 * linearised(pool_of(noisy), MODEL).selected(chosen), found.selected(chosen))


def test_joint_noise_lowers_the_information():
    d = pool().session
    shaky = linearised(pool_of(replace(d, noise=replace(d.noise, joint=1e-4))), MODEL)
    ratio = np.linalg.norm(shaky.jacobian, axis=1) / np.linalg.norm(linear().jacobian, axis=1)
    assert np.all(ratio < 0.5)
    assert np.ptp(ratio) > 0.01


def test_refusals_of_a_pool():
    d = pool().session
    for silent in (None, 0.0):
        with pytest.raises(BayescalError, match="noise of cube"):
            linearised(pool_of(replace(d, noise=Noise(contact=silent))), MODEL)
    refused("no candidate", lambda: linearised(pool_of(d, measured=len(d.measurements.role)), MODEL))


def test_counts_that_are_refused_or_warned_of():
    found = linear()
    size = found.model.size
    refused(rf"{size} contacts are not more than the {size} unknowns", lambda: check_count(found, size))
    assert f"{size + 40} or more" in check_count(found, size + 39)
    assert check_count(found, size + 40) == ""
    refused("601 contacts of 600 candidates", lambda: check_count(found, 601))
    assert check_count(linearised(pool_of(pool().session, measured=100), MODEL), 1) == ""


def test_observability_of_known_singular_values():
    rng = np.random.default_rng(0)
    u, v = (np.linalg.qr(rng.standard_normal(shape))[0] for shape in ((50, 3), (3, 3)))
    j = u @ np.diag([8.0, 2.0, 1.0]) @ v
    found = observability(j.T @ j, 50)
    expected = {"O1": 16 ** (1 / 3) / 50**0.5, "O2": 1 / 8, "O3": 1.0, "O4": 1 / 8, "O5": 1 / 1.625}
    assert found == pytest.approx(expected)


def test_a_continued_plan_counts_the_measured_rows():
    """Rows measured already and those chosen have the indices of one plan of both."""
    measured, chosen = 100, np.arange(100, 140)
    continued = linearised(pool_of(pool().session, measured=measured), MODEL)
    found = observability_of(continued, chosen - measured)
    assert found == pytest.approx(observability_of(linear(), np.arange(140)), rel=1e-6)
    s = np.sqrt(np.linalg.eigvalsh(arm_information(continued, chosen - measured)))
    assert found["O1"] == pytest.approx(np.exp(np.mean(np.log(s))) / np.sqrt(140))


def test_information_grows_with_contacts_and_leaves_out_what_no_contact_determines():
    found = linear()
    few, many = np.arange(80), np.arange(400)
    a, b = (np.linalg.eigvalsh(arm_information(found, chosen)) for chosen in (few, many))
    assert np.all(b > a)
    assert a[0] > 2.0
    assert np.linalg.eigvalsh(inverse(inverse(found.information(many))[:27, :27]))[0] < 1.1
    assert len(arm_information(found, many)) == 26
    assert set(observability_of(found, many)) == {"O1", "O2", "O3", "O4", "O5"}
    assert observability_of(found, many)["O3"] > observability_of(found, few)["O3"]


# --- Orders of probing: every row once, sweeps over all targets, short paths.

TARGETS = ("cube.+x", "cube.+y", "cube.+z", "ball.A@1", "ball.A@2", "ball.A@3")


def made_up(count=240, payloads=(0.0, 2.0), targets=TARGETS, seed=0):
    """A pool of random approaches; rows on targets with an @ validate."""
    rng = np.random.default_rng(seed)
    target = np.arange(count) % len(targets)
    readings = rng.uniform(-1, 1, (count, 6)) + 3 * target[:, None] * np.eye(6)[0]
    role = np.where(["@" in targets[t] for t in target], "validate", "calibrate")
    payload = np.where(role == "calibrate", rng.choice(payloads, count), 0.0)
    none, ids = np.zeros(count, int), tuple(map(str, range(count)))
    rows = Measurements(ids, role, target, none, readings, none, payload=payload)
    session = SimpleNamespace(targets=[SimpleNamespace(name=name) for name in targets], measurements=rows)
    return SimpleNamespace(session=session, approach=readings + 0.01)


def put(pool, rows, order, seed=0):
    rows = np.asarray(rows)
    at = orders.ordered(pool, rows, order, np.random.default_rng(seed), lambda a, b: np.zeros(len(a), bool))
    assert sorted(at) == list(range(len(rows)))
    return rows[at]


def changes(values):
    return int(np.sum(np.asarray(values[1:]) != np.asarray(values[:-1])))


@pytest.mark.parametrize("order", orders.ORDERS)
def test_every_row_is_visited_once_and_the_seed_decides(order):
    pool = made_up()
    rows = np.random.default_rng(1).permutation(240)[:100]
    assert np.array_equal(put(pool, rows, order), put(pool, rows, order))


def test_sweeps_visit_all_targets_change_the_payload_once_and_keep_repeats_apart():
    pool = made_up()
    m = pool.session.measurements
    got = put(pool, np.arange(240), "sweeps")
    fitted = got[m.role[got] == "calibrate"]
    for quarter in np.array_split(fitted, orders.COUNT):
        counts = np.bincount(m.target[quarter], minlength=6)[:3]
        assert counts.min() >= 8
        assert np.ptp(counts) <= 3
        assert changes(m.payload[quarter]) <= 2  # quarters by number are not the sweeps to the contact
    assert changes(m.payload[fitted]) == orders.COUNT
    # repeats are apart
    fitted = np.flatnonzero(m.role == "calibrate")
    got = put(pool, np.concatenate([fitted, fitted[:10], fitted[:5]]), "sweeps")
    for k, row in enumerate(fitted[:10]):
        assert np.diff(np.flatnonzero(got == row)).min() > (2 if k < 5 else len(got) / 8)


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
    assert 0.2 < np.flatnonzero(m.role[got] == "validate")[0] / len(got) < 0.5


def test_a_target_that_stays_validates_in_both():
    pool = made_up(targets=("cube.+x", "cube.+y", "ball.A@1"))
    m = pool.session.measurements
    got = put(pool, np.arange(240), "sweeps")
    checked = np.flatnonzero(m.role[got] == "validate")
    assert changes(np.diff(checked) > 1) == 2  # two blocks
    assert checked[-1] == len(got) - 1
    # placements that are calibrated on are not mixed
    pool = made_up(targets=("ball.A@1", "ball.B@1", "ball.A@2", "ball.B@2"))
    m = pool.session.measurements
    m.role[:] = "calibrate"
    got = put(pool, np.arange(240), "sweeps")
    placement = m.target[got] // 2
    assert changes(placement) == 1
    halves = np.array_split(m.target[got][placement == 0], 2)
    assert all(len(set(half)) == 2 for half in halves)  # two sweeps over its spheres


def test_the_path_is_short():
    """Never longer than the nearest neighbour's; near the best of all for a few points."""
    for seed in range(8):
        at = np.random.default_rng(seed).uniform(size=(8, 3))
        seconds = np.abs(at[:, None] - at[None]).max(axis=2)

        def length(path, seconds=seconds):
            return seconds[path[:-1], path[1:]].sum()

        near = orders.nearest(seconds, 0)
        short = orders.exchanged(seconds, near)
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


def test_an_arm_is_jogged_by_its_base_then_its_wrist_then_its_shoulder():
    robot, _ = load_robot("universal-robots-ur5e")
    words = orders.by_hand(np.radians([10.0, 20.0, 30.0, 40.0, 50.0, 60.0]), robot)
    assert " ".join(re.findall(r"J\d [\d.]+", words)) == "J1 10.0 J4 40.0 J5 50.0 J6 60.0 J2 20.0 J3 30.0"
