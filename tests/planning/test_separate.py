"""Selection for the gap against dense linear algebra, and against trials of every candidate."""

import numpy as np
import pytest
from gap_pools import nominal, pool

from bayescal.errors import BayescalError
from bayescal.gap.result import Pair, Suspect
from bayescal.model.block import parts_of
from bayescal.planning.contrasts import Contrast, Contrasts, contrasts, of_effects
from bayescal.planning.projection import CandidateColumns, Projection, Vocabulary
from bayescal.planning.separate import choose, repeated

BENDING = "bending at link 3"
COMPLIANCE = "compliance at joint 3"


def made_up(seed: int = 0, each: int = 2) -> CandidateColumns:
    """Candidates with several residuals."""
    rng = np.random.default_rng(seed)
    count, unknowns, columns = 15, 6, 5
    return CandidateColumns(
        rng.normal(size=(each * count, unknowns)) * 3,
        rng.normal(size=(each * count, columns)),
        np.repeat(np.arange(count), each),
        rng.normal(size=(3, unknowns)),
        rng.normal(size=(3, columns)),
    )


def noncentrality(linear: CandidateColumns, chosen, truth, rivals) -> float:
    """Of the columns `truth` beside the model and rivals: X'(I - J inv(I + J'J) J')X, summed."""
    rows = np.concatenate([np.flatnonzero(linear.candidate == k) for k in chosen])
    design = np.concatenate([linear.known_design, linear.design[rows]])
    columns = np.concatenate([linear.known_columns, linear.columns[rows]])
    j, x = np.column_stack([design, columns[:, rivals]]), columns[:, truth]
    left = np.eye(len(j)) - j @ np.linalg.inv(np.eye(j.shape[1]) + j.T @ j) @ j.T
    return float(np.trace(x.T @ left @ x))


def of(linear: CandidateColumns, items) -> Contrasts:
    return Contrasts.of(Vocabulary((), (), {}, linear), items)


PAIRED = (
    Contrast(np.array([0, 1]), np.array([2]), 0),
    Contrast(np.array([2]), np.array([0, 1]), 0),
    Contrast(np.array([3]), np.empty(0, int), 1),
    Contrast(np.array([3, 4]), np.array([2]), 2, np.array([[0.5], [2.0]])),
)


def test_adding_and_removing_equals_a_new_projection() -> None:
    linear = made_up()
    moved = Projection(linear, [1])
    for candidate in (3, 5, 5):
        moved.add(candidate)
    for candidate in (1, 5):
        moved.remove(candidate)
    fresh = Projection(linear, [3, 5])
    for name in ("error", "variance", "information", "covariance"):
        np.testing.assert_allclose(getattr(moved, name), getattr(fresh, name), rtol=1e-9, atol=1e-10)


def test_lambda_equals_the_dense_noncentrality() -> None:
    linear = made_up()
    chosen = [0, 4, 7, 4]
    strengths = of(linear, PAIRED).strengths(Projection(linear, chosen))
    for item, strength in zip(PAIRED[:3], strengths, strict=False):
        assert strength == pytest.approx(noncentrality(linear, chosen, item.truth, item.rivals), rel=1e-9)
    single = CandidateColumns(
        linear.design,
        np.column_stack([linear.columns, linear.columns[:, [3, 4]] @ [0.5, 2.0]]),
        linear.candidate,
        linear.known_design,
        np.column_stack([linear.known_columns, linear.known_columns[:, [3, 4]] @ [0.5, 2.0]]),
    )
    assert strengths[3] == pytest.approx(noncentrality(single, chosen, [5], [2]), rel=1e-9)


def test_a_greedy_step_equals_a_trial_of_every_candidate() -> None:
    linear = made_up(each=1)
    c, chosen, every = of(linear, PAIRED), [2, 3, 8, 9, 11], np.arange(15)
    p = Projection(linear, chosen)
    added = [c.objective(c.strengths(Projection(linear, [*chosen, k]))) for k in every]
    np.testing.assert_allclose(c.changed(p, every, 1.0), added, rtol=1e-9)
    without = [c.objective(c.strengths(Projection(linear, [i for i in chosen if i != k]))) for k in chosen]
    np.testing.assert_allclose(c.changed(p, np.array(chosen), -1.0), without, rtol=1e-9)


def test_real_columns_are_those_of_a_diagnosis() -> None:
    """All candidates chosen: the detectability is that by the state of a fit of the same contacts."""
    from bayescal.effects.masses import masses
    from bayescal.estimate.families import with_compliances
    from bayescal.gap.design.blind_spots import seats
    from bayescal.gap.linear.problem import problem
    from bayescal.gap.search.candidates import candidates

    fitted = nominal()
    c = contrasts(pool(), fitted)
    scene = fitted.model.scene
    around = with_compliances(scene.circumstances(scene.rows("calibrate")), fitted)
    known = candidates(around, fitted.model.effects)
    p = problem(fitted, known.pool, masses(around))
    left = np.linalg.inv(np.eye(p.jacobian.shape[1]) + p.jacobian.T @ p.jacobian)
    every = Projection(c.columns, np.arange(150))
    strength = dict(zip(range(len(c.items)), c.strengths(every), strict=True))
    of_seat = {tuple(i.truth): strength[k] for k, i in enumerate(c.items) if not len(i.rivals)}
    for seat, mine in zip(seats(known), c.vocabulary.seats, strict=False):
        x = p.pool[:, seat.columns]
        across = p.jacobian.T @ x
        expected = np.trace(x.T @ x - across.T @ left @ across)
        assert of_seat[tuple(mine.columns)] == pytest.approx(expected, rel=1e-6)


def test_chosen_contacts_show_more_than_random_ones_and_are_distinct() -> None:
    c = contrasts(pool(), nominal())
    rng = np.random.default_rng(0)
    chosen = choose(c, 60, rng, start=[4, 5])
    assert len(np.unique(np.append(chosen, [4, 5]))) == 62
    value = c.objective(c.strengths(Projection(c.columns, [4, 5, *chosen])))
    others = [
        c.objective(c.strengths(Projection(c.columns, rng.choice(150, 62, replace=False)))) for _ in range(20)
    ]
    assert value > max(others) + 3.0


def test_exchange_improves_on_the_greedy_choice() -> None:
    c = contrasts(pool(), nominal())
    greedy, exchanged = (choose(c, 50, np.random.default_rng(0), exchanges=n) for n in (0, 50))
    value = [c.objective(c.strengths(Projection(c.columns, k))) for k in (greedy, exchanged)]
    assert value[1] > value[0]


def test_payloads_separate_compliance_from_bending() -> None:
    without = (COMPLIANCE,)
    pair = Pair((Suspect(COMPLIANCE),), (Suspect(BENDING),))
    c = contrasts(pool(), nominal(without), [pair], parts_of(without, ("geometry", "compliance")))
    load = pool().session.measurements.payload
    rng = np.random.default_rng(0)
    start = rng.choice(np.flatnonzero(load == 0), 60, replace=False)
    chosen = choose(c, 15, rng, start)
    assert np.mean(load[chosen] > 0) > 0.6
    unloaded = choose(c, 15, rng, start, allowed=load == 0)
    with_it, without_it = (min(c.strengths(Projection(c.columns, [*start, *k]))) for k in (chosen, unloaded))
    assert with_it > 2.0 * without_it


def test_repeats_are_of_chosen_contacts_each_once() -> None:
    c = contrasts(pool(), nominal())
    chosen = np.arange(40)
    again = repeated(c, chosen, np.random.default_rng(0), 10)
    assert len(np.unique(again)) == 10
    assert np.isin(again, chosen).all()


def test_an_effect_with_stated_amplitudes_and_setting() -> None:
    suspect = Suspect("hysteresis@0.02 at joint 2", {"hysteresis J2": 5e-5})
    other = Suspect("hardening at joint 2")
    c = contrasts(pool(), nominal(), [Pair((suspect,), (other,))])
    doubled = Suspect("hysteresis@0.02 at joint 2", {"hysteresis J2": 1e-4})
    d = contrasts(pool(), nominal(), [Pair((doubled,), (other,))])
    chosen = np.arange(0, 150, 3)
    a, b = (x.strengths(Projection(x.columns, chosen)) for x in (c, d))
    assert b[0] == pytest.approx(4.0 * a[0])
    assert b[1] == pytest.approx(a[1])


def test_an_effect_that_the_session_cannot_show_is_refused() -> None:
    with pytest.raises(BayescalError, match="no parameters at `joint 9`"):
        contrasts(pool(), nominal(), [Pair((Suspect("backlash at joint 9"),))])


def test_effects_count_by_their_probability_as_much_as_the_pairs() -> None:
    pair = Pair((Suspect(BENDING),), (Suspect("coupling"),))
    probability = {"backlash": 0.3, "lobing": 0.1, "null": 0.6}
    alone = contrasts(pool(), nominal(), (), (), probability)
    assert alone.weight.sum() == pytest.approx(0.4)
    c = contrasts(pool(), nominal(), [pair], (), probability)
    assert c.weight.sum() == pytest.approx(2.0)
    assert c.weight[0] == pytest.approx(1.0)
    by_effect = {
        name: sum(
            c.weight[item.group] for item in c.items[2:] if np.isin(item.truth, c.vocabulary.of(name)).all()
        )
        for name in ("backlash", "lobing", "payload")
    }
    assert by_effect == pytest.approx({"backlash": 0.75, "lobing": 0.25, "payload": 0.0})
    p = Projection(c.columns, np.arange(60))
    strengths = c.strengths(p)
    least = {k: min(s for s, i in zip(strengths, c.items, strict=True) if i.group == k) for k in range(2)}
    value = sum(
        w * np.log1p(least.get(k, s))
        for k, (w, s) in enumerate(zip(c.weight, np.r_[0.0, strengths[2:]], strict=True))
    )
    assert c.objective(strengths) == pytest.approx(value)


def test_effects_have_equal_weights() -> None:
    c = of_effects(contrasts(pool(), nominal()).vocabulary)
    assert c.weight.sum() == pytest.approx(len(c.vocabulary.names))
