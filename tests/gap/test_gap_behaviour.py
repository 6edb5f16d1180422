"""What the search and the verdict make of linear problems whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from gap_problems import Bench, bench_of
from sessions import circumstances, with_columns

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects import EFFECTS, Parameter
from bayescal.effects.common import waves
from bayescal.effects.location import Driver, face, joint
from bayescal.effects.lost_motion import remaining
from bayescal.gap.linear.problem import without_nuisance
from bayescal.gap.linear.state import fit_state, limited
from bayescal.gap.outcome.where import visible
from bayescal.gap.search import verdict
from bayescal.gap.search.beam import Search
from bayescal.gap.search.candidates import ALIASED, candidates, unaliased
from bayescal.gap.search.unknown import with_set
from bayescal.gap.search.verdict import decide

STRONG = 150.0
"""Visible strength, lambda, at which an effect should be named."""
COUNT = 160
NAMED_EFFECTS = {
    "hardening": 0, "bending": 1, "base-compliance": 2, "payload": 3, "eccentricity": 4, "gear-mesh": 6,
    "hysteresis": 8, "encoder-scale": 9, "coupling": 10, "step": 12, "plane-form": 15,
}  # fmt: skip
"""Of the vocabulary except for those of other tests here, and for what these contacts hardly show; seeds."""


@pytest.fixture(scope="module")
def bench(cube):
    return bench_of(cube, 7, COUNT)


@pytest.fixture(scope="module")
def dense(cube):
    """Nearly twice as many contacts: a defect at one place shows at few of them."""
    return bench_of(cube, 7, 300)


def names(decision):
    return [m.effect for m in decision.members]


def test_nothing_is_named_where_there_is_nothing(bench):
    assert not bench.decision(0).members


def test_gross_contacts_name_nothing(bench):
    decision = bench.decision(100, gross=0.03)
    assert decision.kind == "null"
    assert decision.hypothesis.state.gross == pytest.approx(0.03 * COUNT, abs=1.0)


def test_gross_contacts_hide_no_effect(bench):
    """With them in the noise it is too small to be seen; without them it is as sure as without any."""
    decision = bench.decision(5, bench.of_effect("latency", STRONG), gross=0.06)
    assert (decision.kind, names(decision)) == ("named", ["latency"])
    assert decision.probability["null"] < 1e-6


@pytest.mark.parametrize(("effect", "k"), NAMED_EFFECTS.items())
def test_every_effect_is_named(bench, effect, k):
    decision = bench.decision(250 + k, bench.of_effect(effect, STRONG, seed=k))
    assert (decision.kind, names(decision)) == ("named", [effect])
    assert not isinstance(decision.members[0].variant.setting, str)  # none of its other forms
    assert effect in decision.credible
    assert sum(w.probability for w in decision.weighed) == pytest.approx(1.0)


def test_two_effects_at_once_are_both_named(bench):
    for k, pair in enumerate((("backlash", "thermal-drift"), ("lobing", "second-harmonic"))):
        there = sum(bench.of_effect(e, 2 * STRONG, seed=10 * k + i) for i, e in enumerate(pair))
        assert set(names(bench.decision(300 + k, there))) == set(pair)


def test_a_name_is_kept_by_the_stated_margin_over_an_unmodelled_effect(bench, monkeypatch):
    """Just below the nats that it gains over the cell it is named, just above it is not."""
    lagging = bench.of_terms(past(bench.circumstances, 5), strength=80.0, seed=0)
    decision, search = bench.decided(bench.made_up(3, lagging + bench.of_effect("backlash", STRONG)))
    best = decision.weighed[0]
    assert best.effects == ("backlash", "unknown")
    (member,) = best.hypothesis.members
    start = best.hypothesis.state.weight
    full, bare = (
        with_set(h.state, bench.pool, best.cell.best, best.cell.scale, start)
        for h in (best.hypothesis, search.hypotheses[frozenset()])
    )
    margin = full.log_evidence + member.averaging - bare.log_evidence
    anew = search.additions(bare, ())["backlash"].gain  # in any of its forms
    assert 0.0 < abs(anew - margin) < 10.0
    margin = max(margin, anew)
    assert margin > 10.0 > 0.0 > member.averaging
    for less, named in ((0.1, ["backlash"]), (-0.1, [])):
        monkeypatch.setattr(verdict, "VERDICT", replace(verdict.VERDICT, kept=margin - less))
        assert names(decide(search, bench.pool)) == named


def test_a_rare_direction_is_no_outlier(cube):
    """Play in a joint that turns the other way at 4 % of the contacts: the null takes these for outliers."""
    dataset = cube(seed=7, count=240).dataset
    velocity = np.abs(dataset.measurements.velocity)
    rare = np.random.default_rng(4).choice(240, 10, replace=False)
    velocity[rare, 2] *= -1
    bench = Bench.of(with_columns(dataset, velocity=velocity))
    p = bench.made_up(1, bench.of_effect("backlash", 700.0, site="joint 3"))
    decision, search = bench.decided(p)
    null = search.hypotheses[frozenset()].state
    lost = p.rows[p.contact[null.weight[: p.count] == 0]]
    assert len(np.intersect1d(lost, rare)) >= 3  # without the effect some of these do not count
    assert names(decision) == ["backlash"]
    kept = p.rows[p.contact[decision.hypothesis.state.weight[: p.count] > 0]]
    assert len(np.intersect1d(kept, rare)) >= 9


def beyond(c, joint, driver):
    """A hose that is slack up to an angle of one joint, and drags another from there on, softly."""
    angle = c.readings[:, driver - 1]
    drag = 0.05 * np.logaddexp(0.0, (angle - np.quantile(angle, 0.55)) / 0.05)
    return Term(joint, "rz", drag)


def past(c, joint, memory=90.0):
    """A joint that goes on yielding after its load has changed."""
    load, time = c.moments[:, joint, 2], c.time
    kernel = np.exp(-(time[:, None] - time[None]) / memory) * (time[:, None] >= time[None])
    change = np.diff(load, prepend=load[0])
    return Term(joint, "rz", -kernel @ change)


@pytest.mark.parametrize(
    ("term", "site", "driver"),
    [
        (lambda c: beyond(c, 3, 5), "joint 3", "angle 5, beyond one place"),
        (lambda c: past(c, 5), "joint 5", "past torque 5"),
    ],
)
def test_what_sets_in_or_lags_is_unknown_where_it_is(bench, term, site, driver):
    decision = bench.decision(3, bench.of_terms(term(bench.circumstances), strength=200.0, seed=0))
    assert decision.kind == "unknown", decision.probability
    left = next(w for w in bench.places(decision) if not w.explained_by)
    assert (str(left.site), str(left.driver)) == (site, driver)


def test_drift_of_one_joint_is_that_of_the_joint_and_of_all_that_of_the_arm(bench):
    """All sites with widths of their own share out the drift of one, and no part of it is clear."""
    every = bench.known.variants["thermal-drift"]
    assert np.sum(np.exp([v.log_prior for v in every])) == pytest.approx(1.0)
    assert all(v.site == "" for v in every if isinstance(v.setting, str))
    for site in ("joint 4", ""):
        decision = bench.decision(31, bench.of_effect("thermal-drift", STRONG, seed=3, site=site))
        (member,) = decision.members
        assert (member.effect, member.variant.site) == ("thermal-drift", site)
        # of one joint anything slow may do that; of all lengths it is heat
        assert decision.kind == ("class" if site else "named")
        assert (decision.probability["thermal-drift"] > 0.9) == (not site)
        assert (decision.probability["unknown"] > 0.25) == bool(site)
    common, *parts = (w for w in bench.places(decision) if w.explained_by)
    assert str(common.site) == "arm"
    # of all sites, not of the growth of lengths alone
    assert common.log_evidence > max(w.log_evidence for w in parts)


def test_drift_of_one_joint_by_its_temperature_is_thermal(cube):
    """A temperature that falls and rises: no other slow cause follows it."""
    dataset = cube(seed=7, count=180).dataset
    swing = 20.0 + 3.0 * np.cos(np.linspace(0.0, 7.0, len(dataset.measurements.ids)))
    bench = Bench.of(with_columns(dataset, temperature=swing))
    usual = next(v for v in bench.known.variants["thermal-drift"] if (v.site, v.setting) == ("joint 4", None))
    decision = bench.decision(31, bench.visible(bench.problem.pool[:, usual.columns], STRONG, 3))
    assert decision.kind == "named"
    assert decision.probability["thermal-drift"] > 0.9


def test_what_comes_after_a_first_name_is_less_likely(bench):
    """Weak structure that would pass for an effect is less of one where something was named before."""
    p = bench.made_up(21, bench.of_effect("backlash", 20.0, site="joint 3"))
    first, further = Search(p, bench.known), Search(p, bench.known, further=True)
    for search in (first, further):
        search.run()
    one, two = decide(first, bench.pool).probability, decide(further, bench.pool).probability
    assert two["null"] > 3.0 * one["null"]
    assert sum(two[k] for k in two if k != "null") > 0


def test_a_defect_at_one_place_is_unknown_at_its_joint(dense):
    angle = dense.circumstances.q[:, 2]
    bump = np.exp(-0.5 * ((angle - np.quantile(angle, 0.4)) / 0.07) ** 2)
    decision = dense.decision(3, dense.of_terms(Term(3, "rz", bump), strength=300.0, seed=0))
    assert decision.kind in ("unknown", "named+unexplained")
    assert decision.probability["unknown"] > 0.5
    left = next(w for w in dense.places(decision) if not w.explained_by)
    assert left.site == joint(3)
    assert left.family_p_value < 1e-3


def test_places_of_what_is_left_are_told_beside_many_names(bench):
    """Three named effects have nine places; what no name explains still has its own."""
    three = enumerate(("backlash", "eccentricity", "lobing"))
    decision = bench.decision(5, sum(bench.of_effect(e, 500.0, seed=k) for k, e in three))
    assert len(decision.members) >= 2
    found = bench.places(decision)
    assert sum(not w.explained_by for w in found) >= 2
    assert all(w.explained_by in names(decision) for w in found[:2])


def test_gravity_waits_for_compliance(bench):
    """Nothing that acts through the joints' compliance is named as long as the joints are thought rigid."""
    variants = bench.known.variants
    rigid = replace(bench.known, variants=variants | {"compliance": variants["bending"]})
    p = bench.made_up(8, bench.of_effect("payload", STRONG))
    decision, search = replace(bench, known=rigid).decided(p)
    for key in search.hypotheses:
        assert "compliance" in key or not any("compliance" in EFFECTS[name].requires for name in key)
    assert "payload" not in names(decision) or "compliance" in names(decision)


# --- A local defect looks like a few outliers: excluded contacts support what explains them.

SPOT, WIDTH = np.array([0.22, -0.18]), 0.2
"""Half extents of a face: between the centres that are tried."""


def test_a_dent_is_found_beside_larger_outliers(dense):
    """Of 12 times the noise, in the second face."""
    own = dense.circumstances.faces[1]
    spot = np.exp(-0.5 * np.sum(((own.place - SPOT) / WIDTH) ** 2, axis=1)) * own.rows
    (column,) = dense.slopes.columns([Parameter("", "m", (Term(CONTACT, "normal", spot),), 1e-5)]).T
    there = 12.0 * column / np.max(np.abs(column))
    p = dense.made_up(3, there, gross=0.02)
    null = fit_state(p, (), ())
    hit = np.flatnonzero(np.abs(there[: p.count]) > 4.0)
    assert np.sum(null.weight[hit] == 0) >= 2
    decision, _ = dense.decided(p)
    assert decision.kind == "unknown"
    first = dense.places(decision)[0]
    assert (first.site, first.driver) == (face(own.name), Driver("face", form="one spot"))
    assert first.family_p_value < 1e-3
    # the contacts that it explains count in its size, as far as the model does not absorb it
    bare = fit_state(without_nuisance(p, p.jacobian.shape[1]), (), (), robust=False)
    assert first.rms == pytest.approx(np.sqrt(np.mean(visible(bare, there) ** 2)), rel=0.12)
    assert np.isin(p.rows[p.contact[hit]], first.curve.rows).all()
    assert np.all(own.rows[first.curve.rows])  # its curve is that of the face


def test_an_outlier_of_any_size_counts_as_one_at_the_limit(dense):
    p = dense.made_up(5)
    found = []
    for size in (30.0, 3000.0):
        off = np.zeros(len(p.residual))
        off[40] = size
        state = fit_state(replace(p, residual=p.residual + off), (), ())
        assert state.gross == 1
        found.append(limited(state))
    for one in found:
        assert one.gross == 0
        assert one.kappa == pytest.approx(found[0].kappa, rel=1e-6)
        np.testing.assert_allclose(one.residual, found[0].residual, atol=1e-4)
        assert abs(one.residual[40]) == np.max(np.abs(one.residual[: p.count]))
        assert 3.0 < abs(one.residual[40]) < 5.0


# --- Ripples and the raster of the poses: the sampling theorem, and what the candidates make of it.


@pytest.fixture(scope="module")
def c(cube):
    return circumstances(cube(seed=5, count=120).dataset)


def at_angles(c, joint, degrees):
    """The session with other angles of a joint, (N,)."""
    q = c.q.copy()
    q[:, joint - 1] = np.radians(degrees)
    return replace(c, q=q)


RASTER = 5.0 * (np.arange(120) % 47)


@pytest.mark.parametrize(
    ("degrees", "order", "seen"),
    [
        (RASTER, 72, False),  # one period from each angle to the next: a constant
        (RASTER, 73, False),  # once per revolution
        (RASTER, 142, False),  # twice
        (RASTER, 100, True),  # 28 times
        (20.0 * (np.arange(120) % 5), 100, False),  # five angles show nothing but a slow function
        (4.0 * np.linspace(0, 1, 120), 20, False),  # a quarter of a period
        (90.0 * np.linspace(0, 1, 120), 20, True),
        (RASTER, 2, True),  # no ripple
    ],
)
def test_angles_on_a_raster_alias_ripples(c, degrees, order, seen):
    moved = at_angles(c, 3, degrees)
    every = waves(moved, "gear-mesh {}", np.array([[float(order)]]), 5e-5)
    assert unaliased([p for p in every if p.site == joint(3)], moved) == [seen, seen]


def test_an_aliased_ripple_is_not_assessed(c):
    """A gear of 73 at a raster of 5 degrees: at joint 3 alone, and at every joint."""
    geared = replace(c, robot=replace(c.robot, reductions=np.full(6, 73.0)))
    one = candidates(at_angles(geared, 3, RASTER), ("geometry",))
    assert one.missing["gear-mesh at joint 3"] == ALIASED
    assert {v.site for v in one.variants["gear-mesh"]} == {"", *(f"joint {j}" for j in (1, 2, 4, 5, 6))}
    for j in range(1, 7):
        geared = at_angles(geared, j, RASTER)
    every = candidates(geared, ("geometry",))
    assert every.missing["gear-mesh"] == ALIASED
    assert "gear-mesh" not in every.variants
    assert {"eccentricity", "second-harmonic"} <= set(every.variants)
    assert len(EFFECTS["gear-mesh"].at(geared)) == 24  # a model may still contain it


# --- Readings before standstill are named `unsettled`, not backlash; backlash stays backlash.


def moving(dataset, seed=0):
    """The session with commands ahead of the readings, by a random part of 30 ms of the motion."""
    m = dataset.measurements
    left = np.random.default_rng(seed).uniform(0.0, 0.03, (len(m.ids), 1)) * m.velocity
    return with_columns(dataset, command=m.readings + left)


def test_each_is_named_as_what_it_is(cube, bench):
    """By commands, and by speeds alone."""
    commanded = Bench.of(moving(cube(seed=5, count=COUNT).dataset))
    for by, effect in ((commanded, "unsettled"), (commanded, "backlash"), (bench, "unsettled")):
        assert names(by.decision(1, by.of_effect(effect, 300.0, seed=1))) == [effect]


def test_what_remains_of_the_motion(cube):
    """Commands where they differ from the readings, else the speeds; nothing of a session at rest."""
    dataset = cube(seed=1, count=24).dataset
    c = circumstances(dataset)
    assert remaining(c) is None  # commands that equal the readings
    assert {p.unit for p in EFFECTS["unsettled"].at(c)} == {"s"}
    c = circumstances(moving(dataset))
    left = c.command - c.readings
    first = EFFECTS["unsettled"].at(c)[0]
    assert first.unit == "1"
    (term,) = first.terms
    np.testing.assert_allclose(term.driver, left[:, 0])
    assert str(first.driver) == "remaining motion 1"
    assert first.driver.coordinate(first.site, c).name == "remaining motion of joint 1"
    at_rest = with_columns(dataset, velocity=None, command=None)
    assert "j1_command_deg" in EFFECTS["unsettled"].missing(circumstances(at_rest))
