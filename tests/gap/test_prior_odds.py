"""What prior probabilities and shares make of made-up linear problems: which set of effects leads."""

import numpy as np
import pytest
from scipy.optimize import brentq

from bayescal.effects.location import Driver, joint
from bayescal.gap.linear.problem import Problem
from bayescal.gap.linear.state import fit_state
from bayescal.gap.search.beam import Search
from bayescal.gap.search.candidates import Candidates, Variant
from bayescal.gap.search.makers import Cell
from bayescal.gap.search.unknown import Pool
from bayescal.gap.search.verdict import decide, weigh

ROWS, SIZE = 1200, 6
RNG = np.random.default_rng(4)
UNITS = np.linalg.qr(RNG.standard_normal((ROWS, 20)))[0]
"""Orthogonal unit columns (R, 20): of the model, of effects."""
JACOBIAN, UNIT = 30 * UNITS[:, :SIZE], UNITS[:, SIZE:]
ELSEWHERE, ONCE_A_TURN = (joint(5), Driver("torque", 5)), (joint(3), Driver("angle", 3, order=1.0))
"""Places of an effect."""
NOISE = RNG.standard_normal(ROWS)
NOISE -= UNITS @ (UNITS.T @ NOISE)


def problem(columns, contribution):
    """Contacts of unit noise that no column explains, with a contribution (R,)."""
    rows = np.arange(ROWS)
    return Problem(NOISE + contribution, JACOBIAN, columns, np.zeros(SIZE), rows, rows, np.full(ROWS, 1e-6))


def search_of(p, place=ELSEWHERE):
    """A search over one effect for each column of the pool."""
    variants = {
        f"effect {k}": (Variant(f"effect {k}", None, (), np.array([k]), 0.0, (place,)),)
        for k in range(p.pool.shape[1])
    }
    return Search(p, Candidates((), variants, {}), robust=False)


def first(search):
    """The hypothesis of the first effect alone."""
    return search.hypotheses[frozenset(("effect 0",))]


@pytest.mark.parametrize(("nats", "leads"), [(3.5, 1), (5.5, 2)])
def test_a_further_effect_must_be_worth_its_prior(nats, leads):
    """Of ten effects a second one is there in one case of five: fifty to one against each of them."""
    columns = 30 * UNIT[:, :10]

    def searched(size):
        search = search_of(problem(columns, columns[:, 0] + size * columns[:, 1]))
        search.run()
        return search

    def more(size):
        search = searched(size)
        base = first(search)
        return search.additions(base.state, base.names)["effect 1"].gain

    size = brentq(lambda s: more(s) - nats, 0.02, 1.0, xtol=1e-3)
    best = max(searched(size).hypotheses.values(), key=lambda h: h.score)
    assert set(best.names) == {f"effect {k}" for k in range(leads)}


@pytest.mark.parametrize(
    ("place", "form", "further", "known"),
    [
        (ELSEWHERE, "", 0.03, True),
        (ELSEWHERE, "", 0.1, False),
        (ONCE_A_TURN, "one place", 0.05, True),
        (ONCE_A_TURN, "one place", 0.15, False),
        (ONCE_A_TURN, "", 0.12, True),
        (ONCE_A_TURN, "", 0.36, False),
    ],
)
def test_a_cell_that_fits_a_little_better_is_no_better_explanation(place, form, further, known):
    """Of 500 nats, 3 % more than a name elsewhere, 5 % on its course or 12 % at its place are no reason.

    Three times as much is.
    """
    named, rest = 45 * UNIT[:, :1], 45 * UNIT[:, 1:2]
    cell = Cell(joint(3), Driver("angle", 3, form=form), ((),))

    def weighed(share):
        both = named + share * rest
        p = problem(named, both[:, 0])
        search = search_of(p, place)
        search.run()
        pool = Pool((cell,), both, (np.array([0]),), np.array([0]), ROWS)
        found, alone = weigh(search, pool)
        null = search.hypotheses[frozenset()]
        gain = first(search).log_evidence - null.log_evidence
        return found, gain, alone[0].gain / gain

    share = brentq(lambda s: weighed(s)[2] - 1.0 - further, 0.0, 1.2, xtol=1e-3)
    found, gain, _ = weighed(share)
    assert 300 < gain < 700
    score = {w.effects: w.score for w in found}
    assert (score["effect 0",] > score["unknown",]) == known


def test_an_effect_may_be_several_times_larger_than_expected():
    """Eight times as large as its prior standard deviation, it loses less than 2.5 nats by that."""
    column = 30 * UNIT[:, :1]
    p = problem(np.column_stack([column, column / 8]), column[:, 0])
    search = search_of(p)
    state = fit_state(p, (), (), robust=False)
    usual, larger = (search.additions(state, ())[f"effect {k}"].gain for k in (0, 1))
    assert 0.5 < usual - larger < 2.5


def decided(columns, contribution, cell):
    """The decision on a made-up problem with one cell of one column (R, 1), elsewhere than the effects."""
    search = search_of(problem(columns, contribution))
    search.run()
    shape = Cell(joint(3), Driver("angle", 3), ((),))
    return decide(search, Pool((shape,), cell, (np.array([0]),), np.array([0]), ROWS))


@pytest.mark.parametrize(("what", "kind", "names"), [("all", "unknown", 0), ("rest", "named+unexplained", 1)])
def test_a_name_that_an_unmodelled_effect_makes_needless_is_dropped(what, kind, names):
    """A cell that explains what the name explains leaves it nothing; one that explains the rest keeps it."""
    named, rest = 45 * UNIT[:, :1], 20 * UNIT[:, 1:2]
    found = decided(named, (named + rest)[:, 0], named + rest if what == "all" else rest)
    assert found.weighed[0].effects == ("effect 0", "unknown")
    assert (found.kind, [m.effect for m in found.members]) == (kind, ["effect 0"] * names)


@pytest.mark.parametrize(("size", "certain", "named"), [(0.085, False, 1), (0.15, True, 2), (0.35, True, 2)])
def test_only_an_uncertain_effect_of_a_few_percent_of_the_variance_is_a_footnote(size, certain, named):
    """Under 5 % of what the named effects explain is a footnote, unless its probability is above 0.99."""
    columns = 45 * UNIT[:, :2]
    found = decided(columns, columns @ [1.0, size], UNIT[:, 9:10])
    assert set(found.weighed[0].effects) == {"effect 0", "effect 1"}
    assert (found.probability["effect 1"] > 0.99) == certain
    assert [m.effect for m in found.members] == [f"effect {k}" for k in range(named)]
    assert len(found.footnotes) == 2 - named
    assert all(text.startswith("effect 1: RMS 0.1 µm, 1 %") for text in found.footnotes)
