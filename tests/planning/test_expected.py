"""Expected uncertainties against simulated estimates, and their parts against each other."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_pools import MODEL, linear, mixed, pool, pool_of

from bayescal.estimate import root
from bayescal.planning.exchange import select
from bayescal.planning.expected import Random, curves, equals_random, expected, parameters, u_of
from bayescal.planning.goals import goals
from bayescal.planning.pool import linearised


@pytest.fixture(scope="module")
def plan():
    found = linear()
    of = goals(pool(), found)
    return found, of, select(found, of, 60, np.random.default_rng(0), starts=1)


def test_uncertainty_is_the_scatter_of_linear_estimates(plan):
    found, of, chosen = plan
    rng = np.random.default_rng(0)
    j = found.blocks[chosen].reshape(-1, found.model.size)
    c = found.covariance(chosen)
    factor = root(found.certificates)
    true = rng.standard_normal((4000, len(c)))
    read = rng.standard_normal((4000, len(j)))
    said = rng.standard_normal(true.shape) @ factor.T
    # most probable z of a true z, read by contacts with noise and by certificates with an error
    estimate = (true @ (j.T @ j + found.certificates) + read @ j + said) @ c
    for goal, e in zip(of, expected(found, of, chosen, Random(pool())), strict=True):
        scatter = np.mean(((estimate - true) @ goal.slopes.T) ** 2) + goal.known
        assert np.sqrt(scatter) == pytest.approx(e.u, rel=0.03)


def test_shares_add_up_and_follow_their_origin(plan):
    found, of, chosen = plan
    got = expected(found, of, chosen, Random(pool()))
    for e, goal in zip(got, of, strict=True):
        assert sum(e.shares.values()) == pytest.approx(1.0, abs=1e-6)
        assert e.u == pytest.approx(u_of(found, goal, chosen), rel=1e-6)
        assert e.u < e.u_random
    assert got[0].shares["probing"] > 0.1
    assert got[1].shares["probing"] == 0.0
    # contacts of a tenth of the noise: its share falls, those of prior and certificates rise
    d = pool().session
    quiet = linearised(pool_of(replace(d, noise=replace(d.noise, contact=0.1 * d.noise.contact))), MODEL)
    exact = expected(quiet, goals(pool(), quiet), chosen, Random(pool()))
    assert exact[1].shares["noise"] < got[1].shares["noise"]
    assert exact[1].shares["certificate"] > got[1].shares["certificate"]
    assert exact[1].u < got[1].u


def test_without_contacts_all_is_prior():
    found = linear()
    bare = replace(found, certificates=np.zeros_like(found.certificates))
    (_, e) = expected(bare, goals(pool(), bare), [], Random(pool()))
    assert e.shares == pytest.approx({"noise": 0, "certificate": 0, "probing": 0, "prior": 1})
    p = parameters(bare, [])
    assert all(k.u == pytest.approx(k.prior) for k in p)


def test_parameters_have_units_of_files(plan):
    found, _, chosen = plan
    got = {p.name: p for p in parameters(found, chosen)}
    assert {p.unit for p in got.values()} == {"mm", "deg", "urad/(N m)"}
    assert all(0 < p.u <= p.prior * (1 + 1e-9) for p in got.values())
    arm = np.diag(found.covariance(chosen))[: len(got)]
    name, k = next((p.name, k) for k, p in enumerate(found.model.parameters) if p.unit == "rad")
    assert got[name].u == pytest.approx(np.degrees(np.sqrt(arm[k]) * found.model.sd[k]))


def test_random_contacts_are_equally_many_on_every_target():
    random = Random(pool())
    target = pool().session.measurements.target[pool().candidates]
    for count in (40, 41, 600):
        for chosen in random.selections(count, 3):
            assert len(set(chosen)) == count
            assert np.ptp(np.bincount(target[chosen])) <= (1 if count < 600 else 0)
    for few, many in zip(random.selections(40, 3), random.selections(60, 3), strict=True):
        assert np.array_equal(few, many[:40])  # so that the median falls with every further contact
    a, b = (random.selections(40, 2) for _ in range(2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a[0], a[1])


def test_random_contacts_have_no_payload_where_there_are_others():
    d = pool().session
    m = d.measurements
    load = np.where(np.arange(len(m.role)) % 2 == 1, 2.0, 0.0)
    loaded = pool_of(replace(d, measurements=replace(m, payload=load)))
    (chosen,) = Random(loaded).selections(100, 1)
    assert np.all(load[loaded.candidates[chosen]] == 0)
    assert len(Random(loaded).selections(500, 1)[0]) == 500


def test_equal_number_of_random_contacts(plan):
    found, of, chosen = plan
    random = Random(pool())
    itself = equals_random(found, of[1], random.u(found, of[1], 200), random)
    assert itself == pytest.approx(200, rel=0.03)
    assert equals_random(found, of[0], u_of(found, of[0], chosen), random) > 90
    assert equals_random(found, of[0], 0.9 * random.u(found, of[0], 600), random) == np.inf
    assert equals_random(found, of[0], 1.0, random) == pytest.approx(8)


def test_curves(plan):
    found, of, chosen = plan
    got = curves(found, of, chosen, Random(pool()))
    counts, u = np.array(got.plan).T
    assert 60 in counts
    assert counts[0] > found.model.size
    assert counts[-1] == 120
    assert np.all(np.diff(u) < 0)
    assert dict(got.plan)[60] == pytest.approx(u_of(found, of[0], chosen))
    assert dict(got.plan)[120] < got.next_u < dict(got.plan)[60]
    assert all(a < b for (_, a), (_, b) in zip(got.plan, got.random, strict=True))
    last = curves(found, of, np.arange(590), Random(pool()))
    assert last.next_u < u_of(found, of[0], np.arange(590))  # ten candidates are left


def test_points_of_an_instrument_are_planned_too():
    found = linearised(mixed(), MODEL)
    of = goals(mixed(), found)
    chosen = select(found, of, 45, np.random.default_rng(0), starts=1)
    tracked = np.isfinite(mixed().session.measurements.xyz[mixed().candidates[chosen], 0])
    got = expected(found, of, chosen, Random(mixed()))
    assert tracked.sum() > 0
    assert all(e.u < e.u_random for e in got)
