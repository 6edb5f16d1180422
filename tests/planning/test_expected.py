"""Expected uncertainties against simulated estimates, and their parts against each other."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sessions import with_columns
from simulated_pools import MODEL, gap_pool, linear, nominal, pool, pool_of

from bayescal.errors import BayescalError
from bayescal.estimate import root
from bayescal.gap.advise import undecided
from bayescal.gap.linear.problem import problem
from bayescal.gap.result import Pair, Suspect
from bayescal.gap.search.beam import Member, Search
from bayescal.gap.search.candidates import candidates
from bayescal.gap.settings import DESIGN
from bayescal.model.options import parts_of
from bayescal.planning import separate
from bayescal.planning.contrasts import Contrast, Contrasts, contrasts, of_effects
from bayescal.planning.exchange import select
from bayescal.planning.goals import goals
from bayescal.planning.plan import continuation, continued
from bayescal.planning.pool import linearised
from bayescal.planning.projection import CandidateColumns, Projection, Vocabulary
from bayescal.planning.result import Random, curves, equals_random, expected, parameters, u_of
from bayescal.reporting.gap.record import undecided_records


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
        scatter = np.mean(((estimate - true) @ goal.slopes.T) ** 2) + goal.fixed_variance
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
    load = np.where(np.arange(len(d.measurements.role)) % 2 == 1, 2.0, 0.0)
    loaded = pool_of(with_columns(d, payload=load))
    (chosen,) = Random(loaded).selections(100, 1)
    assert np.all(load[loaded.candidates[chosen]] == 0)
    assert len(Random(loaded).selections(500, 1)[0]) == 500


def test_equal_number_of_random_contacts(plan):
    found, of, chosen = plan
    random = Random(pool())
    assert equals_random(found, of[1], random.u(found, of[1], 200), random) == pytest.approx(200, rel=0.03)
    assert equals_random(found, of[0], u_of(found, of[0], chosen), random) > 90
    assert equals_random(found, of[0], 0.9 * random.u(found, of[0], 600), random) == np.inf
    assert equals_random(found, of[0], 1.0, random) == pytest.approx(8)


def test_curves(plan):
    found, of, chosen = plan
    got = curves(found, of, chosen, Random(pool()))
    counts, u = np.array(got.curve).T
    assert 60 in counts
    assert counts[0] > found.model.size
    assert counts[-1] == 120
    assert np.all(np.diff(u) < 0)
    assert dict(got.curve)[60] == pytest.approx(u_of(found, of[0], chosen))
    assert dict(got.curve)[120] < got.next_u < dict(got.curve)[60]
    assert all(a < b for (_, a), (_, b) in zip(got.curve, got.curve_random, strict=True))
    last = curves(found, of, np.arange(590), Random(pool()))
    assert last.next_u < u_of(found, of[0], np.arange(590))  # ten candidates are left


# --- What a plan shows: amplitudes at the stated detectability, pairs at plausible amplitudes, interventions.

RNG = np.random.default_rng(0)
CHOSEN = np.arange(0, 150, 2)


def test_the_smallest_amplitude_has_the_stated_detectability() -> None:
    c = contrasts(gap_pool(), nominal())
    plan = Projection(c.columns, CHOSEN)
    random = [Projection(c.columns, np.arange(k)) for k in (60, 75, 90)]
    found = {(d.effect, str(d.site)): d for d in separate.detectable(c.vocabulary, plan, random)}
    backlash = found["backlash", "joint 3"]
    ball = found["ball-radius", "probe"]
    assert ball.smallest > 20.0 * ball.plausible  # planes alone hardly show it
    for amplitude, p in ((backlash.smallest, plan), (backlash.smallest_random, random[1])):
        suspect = Suspect("backlash at joint 3", {"backlash J3": amplitude})
        one = contrasts(gap_pool(), nominal(), [Pair((suspect,))])
        at = {id(plan): CHOSEN, id(random[1]): np.arange(75)}[id(p)]
        assert one.strengths(Projection(one.columns, at))[0] == pytest.approx(DESIGN.named, rel=1e-6)


def test_confusable_effects_are_those_of_the_vocabulary_at_their_weakest_site() -> None:
    c = contrasts(gap_pool(), nominal())
    plan, bare = (Projection(c.columns, k) for k in (CHOSEN, CHOSEN[:60]))
    found = separate.confusable(c.vocabulary, plan, [bare])
    of_harmonics = [x for _, x in found if {p.split(" at ")[0] for p in x.pair} == {
        "eccentricity", "second-harmonic"
    }]  # fmt: skip
    assert len(of_harmonics) == 1
    harmonics = ("eccentricity", "second-harmonic")
    pairs = [
        Pair((Suspect(f"{own} at joint {joint}"),), rival)
        for own, other in (harmonics, harmonics[::-1])
        for joint in range(1, 7)
        for rival in ((), (Suspect(other),))
    ]
    every = contrasts(gap_pool(), nominal(), pairs)
    own = [k for k, item in enumerate(every.items) if len(item.truth) == 2]  # the sites, not the whole effect
    alone, beside = every.strengths(Projection(every.columns, CHOSEN))[own].reshape(-1, 2).T
    assert of_harmonics[0].after == pytest.approx(min(beside[alone >= DESIGN.named]), rel=1e-6)
    assert all(x.before < x.after for _, x in found)


def test_a_payload_is_the_intervention_for_compliance_beside_bending() -> None:
    without = ("compliance at joint 3",)
    parts = parts_of(without, MODEL)
    unloaded = np.flatnonzero(gap_pool().session.measurements.payload == 0)
    bent = Suspect("bending at link 3", {"bending J3 bearing": 4e-5})
    pair = Pair((bent,), (Suspect("compliance at joint 3"),))
    c = contrasts(gap_pool(), nominal(without), [pair], parts)
    plan = Projection(c.columns, unloaded)
    ((weakest, found),) = separate.confusable(c.vocabulary, plan, [Projection(c.columns)], [pair])
    assert found.before < found.after < separate.SEPARATED
    (judged,) = separate.with_levers(gap_pool(), MODEL, unloaded, [(weakest, found)], RNG, parts)
    assert "payload" in judged.intervention


def test_effects_that_no_intervention_separates() -> None:
    c = contrasts(gap_pool(), nominal(), [Pair((Suspect("ball-radius"),))])
    ball = Pair((Suspect("ball-radius"),), ())
    found = separate.confusable(c.vocabulary, Projection(c.columns, CHOSEN), [Projection(c.columns)], [ball])
    assert separate.with_levers(gap_pool(), MODEL, CHOSEN, found, RNG)[0].intervention == separate.NO_LEVER


# --- Selection for the gap against dense linear algebra, and against trials of every candidate.

BENDING = "bending at link 3"
COMPLIANCE = "compliance at joint 3"


def made_up(seed: int = 0, each: int = 2) -> CandidateColumns:
    """Candidates with several residuals."""
    rng = np.random.default_rng(seed)
    count, unknowns, columns = 15, 6, 5
    design, own = (rng.normal(size=(each * count, n)) for n in (unknowns, columns))
    known = (rng.normal(size=(3, n)) for n in (unknowns, columns))
    return CandidateColumns(design * 3, own, np.repeat(np.arange(count), each), *known)


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
        moved.change(candidate, 1.0)
    for candidate in (1, 5):
        moved.change(candidate, -1.0)
    fresh = Projection(linear, [3, 5])
    for name in ("error", "variance", "information", "covariance"):
        np.testing.assert_allclose(getattr(moved, name), getattr(fresh, name), rtol=1e-9, atol=1e-10)


def test_lambda_equals_the_dense_noncentrality() -> None:
    linear = made_up()
    chosen = [0, 4, 7, 4]
    strengths = of(linear, PAIRED).strengths(Projection(linear, chosen))
    for item, strength in zip(PAIRED[:3], strengths, strict=False):
        assert strength == pytest.approx(noncentrality(linear, chosen, item.truth, item.rivals), rel=1e-9)
    both = (linear.columns, linear.known_columns)
    columns, known = (np.column_stack([own, own[:, [3, 4]] @ [0.5, 2.0]]) for own in both)
    single = replace(linear, columns=columns, known_columns=known)
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
    from bayescal.effects.gravity import masses
    from bayescal.estimate.families import with_compliances
    from bayescal.gap.advise import seats
    from bayescal.gap.linear.problem import problem
    from bayescal.gap.search.candidates import candidates

    fitted = nominal()
    c = contrasts(gap_pool(), fitted)
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
    c = contrasts(gap_pool(), nominal())
    rng = np.random.default_rng(0)
    chosen = separate.choose(c, 60, rng, start=[4, 5])
    assert len(np.unique(np.append(chosen, [4, 5]))) == 62
    value = c.objective(c.strengths(Projection(c.columns, [4, 5, *chosen])))
    some = [rng.choice(150, 62, replace=False) for _ in range(20)]
    assert value > max([c.objective(c.strengths(Projection(c.columns, k))) for k in some]) + 3.0


def test_exchange_improves_on_the_greedy_choice() -> None:
    c = contrasts(gap_pool(), nominal())
    greedy, exchanged = (separate.choose(c, 50, np.random.default_rng(0), exchanges=n) for n in (0, 50))
    value = [c.objective(c.strengths(Projection(c.columns, k))) for k in (greedy, exchanged)]
    assert value[1] > value[0]


def test_payloads_separate_compliance_from_bending() -> None:
    without = (COMPLIANCE,)
    pair = Pair((Suspect(COMPLIANCE),), (Suspect(BENDING),))
    c = contrasts(gap_pool(), nominal(without), [pair], parts_of(without, ("geometry", "compliance")))
    load = gap_pool().session.measurements.payload
    rng = np.random.default_rng(0)
    start = rng.choice(np.flatnonzero(load == 0), 60, replace=False)
    chosen = separate.choose(c, 15, rng, start)
    assert np.mean(load[chosen] > 0) > 0.6
    unloaded = separate.choose(c, 15, rng, start, allowed=load == 0)
    with_it, without_it = (min(c.strengths(Projection(c.columns, [*start, *k]))) for k in (chosen, unloaded))
    assert with_it > 2.0 * without_it


def test_repeats_are_of_chosen_contacts_each_once() -> None:
    c = contrasts(gap_pool(), nominal())
    chosen = np.arange(40)
    again = separate.repeated(c, chosen, np.random.default_rng(0), 10)
    assert len(np.unique(again)) == 10
    assert np.isin(again, chosen).all()


def test_an_effect_with_stated_amplitudes_and_setting() -> None:
    suspect = Suspect("hysteresis@0.02 at joint 2", {"hysteresis J2": 5e-5})
    other = Suspect("hardening at joint 2")
    c = contrasts(gap_pool(), nominal(), [Pair((suspect,), (other,))])
    doubled = Suspect("hysteresis@0.02 at joint 2", {"hysteresis J2": 1e-4})
    d = contrasts(gap_pool(), nominal(), [Pair((doubled,), (other,))])
    chosen = np.arange(0, 150, 3)
    a, b = (x.strengths(Projection(x.columns, chosen)) for x in (c, d))
    assert b[0] == pytest.approx(4.0 * a[0])
    assert b[1] == pytest.approx(a[1])


def test_an_effect_that_the_session_cannot_show_is_refused() -> None:
    with pytest.raises(BayescalError, match="no parameters at `joint 9`"):
        contrasts(gap_pool(), nominal(), [Pair((Suspect("backlash at joint 9"),))])


def test_effects_count_by_their_probability_as_much_as_the_pairs() -> None:
    pair = Pair((Suspect(BENDING),), (Suspect("coupling"),))
    probability = {"backlash": 0.3, "lobing": 0.1, "null": 0.6}
    assert contrasts(gap_pool(), nominal(), (), (), probability).weight.sum() == pytest.approx(0.4)
    c = contrasts(gap_pool(), nominal(), [pair], (), probability)
    assert c.weight.sum() == pytest.approx(2.0)
    assert c.weight[0] == pytest.approx(1.0)
    by_effect = {
        name: sum(
            c.weight[item.group] for item in c.items[2:] if np.isin(item.truth, c.vocabulary.of(name)).all()
        )
        for name in ("backlash", "lobing", "payload")
    }
    assert by_effect == pytest.approx({"backlash": 0.75, "lobing": 0.25, "payload": 0.0})
    strengths = c.strengths(Projection(c.columns, np.arange(60)))
    least = {k: min(s for s, i in zip(strengths, c.items, strict=True) if i.group == k) for k in range(2)}
    weighed = enumerate(zip(c.weight, np.r_[0.0, strengths[2:]], strict=True))
    value = sum(w * np.log1p(least.get(k, s)) for k, (w, s) in weighed)
    assert c.objective(strengths) == pytest.approx(value)


def test_effects_have_equal_weights() -> None:
    c = of_effects(contrasts(gap_pool(), nominal()).vocabulary)
    assert c.weight.sum() == pytest.approx(len(c.vocabulary.names))


# --- What a diagnosis leaves open: from its hypotheses to gap.json, and back to the pairs of a plan.

RECORD = {"schema": "bayescal-gap/1", "dataset": {"sha256": "a"}, "baseline": list(MODEL), "without": []}
RECORD |= {"noise_scale": {}, "named": [], "probability": {"null": 0.5, "backlash": 0.2}, "undecided": []}


def examined(*sets: tuple[tuple[str, str], ...], unclaimed: tuple[str, ...] = (), probability: float = 0.3):
    """An examined baseline with hypotheses of effects at sites, the most probable first."""
    fitted = nominal()
    scene = fitted.model.scene
    known = candidates(scene.circumstances(scene.rows("calibrate")), MODEL)
    search = Search(problem(fitted, known.pool), known)
    search.problem.residual[:] = np.random.default_rng(0).normal(size=len(search.problem.residual))

    def member(effect: str, site: str) -> Member:
        return Member(next(v for v in known.variants[effect] if v.site == site), 1.0, 0.0)

    found = [search.hypothesis([member(*one) for one in own]) for own in sets]
    usual = {"cell": None, "unmodelled": False, "probability": probability}
    weighed = [SimpleNamespace(hypothesis=h, **usual) for h in found]
    sets = {"unclaimed": frozenset(unclaimed), "withheld": frozenset()}
    decision = SimpleNamespace(weighed=weighed, hypothesis=found[0], **sets)
    return SimpleNamespace(decision=decision, candidates=known)


def test_two_explanations_are_a_pair_with_their_fitted_parameters() -> None:
    hardening, hysteresis, lobing = ("hardening", "joint 2"), ("hysteresis", "joint 2"), ("lobing", "")
    e = examined((lobing, hardening), (lobing, hysteresis))
    (pair,) = undecided(e)
    (own,), (other,), (common,) = pair.a, pair.b, pair.common
    assert own.model.startswith("hardening")
    assert "at joint 2" in own.model
    assert other.selection.effect == "hysteresis"
    assert common.selection.effect == "lobing"
    state = e.decision.weighed[0].hypothesis.state
    fitted = dict(zip((e.candidates.pool[k].name for k in state.columns), state.amplitudes, strict=True))
    sd = {e.candidates.pool[k].name: e.candidates.pool[k].sd for k in state.columns}
    assert own.values == pytest.approx({"hardening J2": fitted["hardening J2"] * sd["hardening J2"]})
    assert set(common.values) == {name for name in fitted if name.startswith("lobing")}


def test_improbable_alternatives_are_no_pairs_and_unconfirmed_names_are() -> None:
    sets = (("backlash", "joint 3"),), (("latency", ""),)
    assert undecided(examined(*sets, probability=0.01)) == ()
    (pair,) = undecided(examined(*sets, unclaimed=("backlash",), probability=0.01))
    assert pair.a[0].selection.effect == "backlash"
    assert pair.b == pair.common == ()
    names = ("lobing", "hysteresis", "hardening", "backlash")
    several = tuple((name, "" if name == "lobing" else "joint 3") for name in names)
    pairs = undecided(examined(several, unclaimed=names, probability=0.01))
    assert [p.a[0].selection.effect for p in pairs] == sorted(names)


def test_pairs_survive_gap_json_and_become_contrasts() -> None:
    pairs = undecided(examined((("hardening", "joint 2"),), (("hysteresis", "joint 2"),)))
    text = json.dumps(RECORD | {"undecided": undecided_records(SimpleNamespace(undecided=pairs))})
    read = continued(json.loads(text), "gap.json")
    assert read.effects == MODEL
    for old, new in zip(pairs, read.pairs, strict=True):
        for a, b in zip((*old.a, *old.b), (*new.a, *new.b), strict=True):
            assert a.model == b.model
            assert b.values == pytest.approx(a.values)
    c = contrasts(gap_pool(), nominal(), read.pairs)
    assert np.all(c.strengths(Projection(c.columns, np.arange(150))) > 0)


def test_effects_are_separated_beside_compliance_that_a_diagnosis_added() -> None:
    entry = {"a": [{"model": "lobing", "values": []}], "b": [], "common": []}
    record = RECORD | {"baseline": ["geometry"], "named": [{"effect": "compliance"}], "undecided": [entry]}
    read = continued(record, "gap.json")
    assert read.effects == ("geometry", "compliance")
    assert read.pairs == (Pair((Suspect("lobing"),)),)


@pytest.mark.parametrize(("text", "match"), [
    ("no json", "invalid JSON"),
    ('{"schema": "bayescal-fit/1"}', "the schema is bayescal-fit/1"),
    (json.dumps(RECORD | {"dataset": {"sha256": "other"}}), "no diagnosis of the present files"),
    (json.dumps(RECORD | {"dataset": "a"}), "no diagnosis of the present files"),
    (json.dumps({k: v for k, v in RECORD.items() if k != "undecided"}), "it lacks 'undecided'"),
    (json.dumps(RECORD | {"probability": {"backlash": "high"}}), "incomplete: could not convert"),
    (json.dumps(RECORD | {"probability": 0.5}), "incomplete"),
])  # fmt: skip
def test_other_files_are_refused(tmp_path, text: str, match: str) -> None:
    (tmp_path / "gap.json").write_text(text)
    with pytest.raises(BayescalError, match=match):
        continuation(SimpleNamespace(name="session", sha256="a", folder=tmp_path), tmp_path)
    with pytest.raises(BayescalError, match="no such file"):
        continuation(SimpleNamespace(name="session", sha256="a", folder=tmp_path), tmp_path / "absent.json")
