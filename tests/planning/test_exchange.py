"""Selection of contacts against exhaustive search, dense inverses, and growth by the I criterion alone."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from simulated_pools import MODEL, linear, mixed, pool

from bayescal.planning import exchange
from bayescal.planning.exchange import Selection, grow, mean_variance, root_of, select, shrink
from bayescal.planning.goals import Goal, goals
from bayescal.planning.pool import Linearised, linearised


def toy(count: int = 8, residuals: int = 1, size: int = 3, seed: int = 0) -> Linearised:
    """Random candidates without a model."""
    rng = np.random.default_rng(seed)
    contact = np.repeat(np.arange(count), residuals)
    none = np.zeros((size, size))
    return Linearised(
        None, np.zeros(size), None, rng.standard_normal((len(contact), size)), contact, count, none, none
    )


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


def test_growing_by_the_i_criterion_from_nothing_fails():
    found = linear()
    of = goals(pool(), found)
    root = root_of(of, found.covariance(np.arange(100)))
    blind = Selection(found, [], root)
    grow(blind, 60, Selection.gains)
    chosen = select(found, of, 60, np.random.default_rng(0), starts=1)
    certified, region = of
    assert u(found, region, blind.chosen) > 2 * u(found, region, chosen)
    assert u(found, certified, blind.chosen) > 1.3 * u(found, certified, chosen)


def test_sixty_chosen_contacts_are_better_than_twice_as_many_random_ones():
    found = linear()
    of = goals(pool(), found)
    chosen = select(found, of, 60, np.random.default_rng(0), starts=1)
    for each in of:
        some = [np.random.default_rng(k).permutation(found.count)[:120] for k in range(9)]
        assert u(found, each, chosen) < np.median([u(found, each, c) for c in some])


def test_given_contacts_stay():
    found, of = toy(30), goal()
    chosen = select(found, [of], 12, np.random.default_rng(0), start=[29, 4])
    assert list(chosen[:2]) == [29, 4]
    assert len(set(chosen)) == 12
    assert len(select(found, [of], 30, np.random.default_rng(0))) == 30


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


def test_dropping_keeps_what_is_asked():
    found, of = toy(30), goal()
    s = Selection(found, range(30), root_of([of], found.covariance(range(30))))
    shrink(s, 5, kept=[7, 8])
    assert len(s.chosen) == 5
    assert {7, 8} <= set(s.chosen)


def test_all_goals_become_more_accurate_than_with_the_largest_determinant():
    found = linear()
    of = goals(pool(), found)
    start = Selection(found, [], np.zeros((len(found.z), 0)))
    grow(start, 60, Selection.determinants)
    chosen = select(found, of, 60, np.random.default_rng(0), starts=1)
    ratios = [u(found, each, chosen) / u(found, each, start.chosen) for each in of]
    assert max(ratios) < 0.95
    assert max(ratios) / min(ratios) < 1.25
