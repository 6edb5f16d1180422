"""The verdict: from weighed hypotheses to what is named, and what stays credible."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import cases
from gap_problems import BASELINE, unsolved
from made_up_errors import NOISE as SIGMA
from made_up_errors import held
from scipy.optimize import brentq
from sessions import circumstances

from bayescal.effects import EFFECTS, Parameter, confusable, parameters_of
from bayescal.effects.location import PROBE, TOOL, Driver, Site, joint, length, magnitude, phase, propagated
from bayescal.effects.vocabulary import same_terms
from bayescal.gap.concluded import _causes, hypotheticals
from bayescal.gap.linear.problem import Problem
from bayescal.gap.linear.state import fit_state
from bayescal.gap.outcome.statements import amplitudes, displaced, increased, phase_shown, play_or_late
from bayescal.gap.result import OTHER, Amplitude, Named
from bayescal.gap.search import verdict
from bayescal.gap.search.beam import Hypothesis, Member, Search
from bayescal.gap.search.candidates import Candidates, Variant, candidates
from bayescal.gap.search.makers import Cell
from bayescal.gap.search.refit import model_name, still_without
from bayescal.gap.search.unknown import CellFit, Pool
from bayescal.model import ARM
from bayescal.model.options import parts_of
from bayescal.reporting.gap import amplitude_of
from bayescal.reporting.gap.causes import amplitude_records, line, lines, stated
from bayescal.reporting.gap.phrases import named
from bayescal.reporting.text import measured

ALIKE = ("hardening", "hysteresis")


def variant(name, *places, columns=(), sites=()):
    """A form of an effect that acts at some places."""
    return Variant(name, None, sites, np.array(columns, int), 0.0, places)


def weighed(*names, probability=0.0, score=0.0, cell=False):
    """A set of effects without a fit, perhaps with an unmodelled effect."""
    forms = [variant(n, (TOOL if n == "step" else PROBE, Driver(n))) for n in names]
    members = tuple(Member(form, 1.0, 0.0) for form in forms)
    found = CellFit(0, 1.0, 0, 1.0) if cell else None
    return verdict.Weighed(Hypothesis(members, None, 0.0, 0.0), found, 0.0, score, probability)


def related(plain, probability):
    """The same with a relative in place of its first name."""
    relative = verdict.Related(plain.hypothesis.members[0], Driver("torque", 2), 9.0)
    return replace(plain, probability=probability, related=relative)


@pytest.mark.parametrize(
    ("other", "kind", "members"),
    [
        (Driver("angle", 3, order=1.0), "class", {"encoder-scale", "eccentricity", OTHER}),
        (Driver("angle", 4, order=1.0), "named", set()),
    ],
)
def test_two_effects_along_one_coordinate_of_a_site_are_a_class(other, kind, members):
    """Together they fit any error by it, whatever their probabilities."""
    scale = variant("encoder-scale", (joint(3), Driver("angle", 3)), sites=(joint(3),))
    wave = variant("eccentricity", (joint(other.joint), other), sites=(joint(other.joint),))
    both = Hypothesis(tuple(Member(v, 1.0, 0.0) for v in (scale, wave)), None, 0.0, 0.0)
    best = replace(weighed(probability=0.99), hypothesis=both)
    p = verdict.probabilities([best], best.names)
    found, names = verdict.verdict_of([best], p)
    assert (found, names) == (kind, best.names)
    d = SimpleNamespace(weighed=(best,))
    assert kind == "named" or set(_causes(d, p).members) == members


def test_an_effect_too_small_to_be_seen_is_the_set_without_it():
    """Of the lobing 3/4 would not show, of the step beside it nothing, of what is beside that all."""
    sets = [((), 0.2, 0.0), (("lobing",), 0.4, 0.75), (("lobing", "step"), 0.3, 0.0)]
    each = [replace(weighed(*names, score=np.log(p)), unseen=share) for names, p, share in sets]
    each.append(replace(weighed("lobing", "step", score=np.log(0.1), cell=True), unseen=1.0))
    found = {w.effects: np.exp(w.score) for w in verdict.seen(each)}
    wanted = {(): 0.5, ("lobing",): 0.1, ("lobing", "step"): 0.4, ("lobing", "step", "unknown"): 0.0}
    assert found == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize(("sets", "kind", "names"), cases("names_of_sets"))
def test_a_verdict_names_what_is_more_likely_than_not(sets, kind, names):
    own = {of: [n for n in of.split(" + ") if n not in ("unknown", "noise only")] for of in sets}
    found = [weighed(*own[of], probability=p, cell="unknown" in of) for of, p in sets.items()]
    effects = sorted({n for of in own.values() for n in of})
    assert verdict.verdict_of(found, verdict.probabilities(found, effects)) == (kind, tuple(names))


def test_a_relative_of_a_name_is_an_unmodelled_effect_in_its_place():
    """The other names of the set stay, and the verdict is a class."""
    plain, other = weighed("lobing", "step", probability=0.2), weighed("lobing", probability=0.1)
    sets = [related(plain, 0.7), plain, other]
    assert sets[0].effects == ("step", "unknown")
    p = verdict.probabilities(sets, ["lobing", "step"])
    assert (p["lobing"], p["step"], p["unknown"]) == pytest.approx((0.3, 0.9, 0.7))
    assert verdict.verdict_of(sets, p) == ("class", ("step",))


def test_a_set_of_effects_is_listed_once():
    """A cell beside noise only, and a relative in place of an effect, both are an unmodelled effect alone."""
    plain = weighed("lobing", probability=0.2)
    cell = replace(weighed(probability=0.5, cell=True), log_evidence=40.0)
    found = hypotheticals([cell, related(plain, 0.3), plain])
    assert [h.effects for h in found] == [("unknown",), ("lobing",)]
    assert [h.probability for h in found] == pytest.approx([0.8, 0.2])
    assert found[0].log_evidence == 40.0


@pytest.mark.parametrize(
    ("credible", "elsewhere", "noted"),
    [
        (("unknown",), 0.0, True),
        (("unknown",), 98.0, False),
        (("backlash", "unknown"), 98.0, True),
        ((), 0.0, False),
    ],
)
def test_an_unmodelled_effect_elsewhere_is_not_called_backlash(credible, elsewhere, noted):
    """The note stated backlash of joint 1 where another location explains more."""
    sign, speed, other = Driver("direction", 1), Driver("joint speed", 1), Driver("time")
    sites = (Site("joint", 1), Site("joint", 1), Site("probe"))
    cells = [SimpleNamespace(site=s, driver=d) for s, d in zip(sites, (sign, speed, other), strict=True)]
    alone = tuple(CellFit(k, gain, k, 1.0) for k, gain in enumerate((90.0, 10.0, elsewhere)))
    note = play_or_late(alone, SimpleNamespace(cells=cells), credible)
    assert bool(note) == noted
    assert all("its sign fits 80 nats better than its speed: backlash" in words for words in note)


def test_the_credible_set_holds_nine_tenths_and_what_is_confusable_close_behind():
    three = (("lobing", 0.7), ("step", 0.22), ("latency", 0.08))
    found = [weighed(n, probability=p, score=-10.0 * k) for k, (n, p) in enumerate(three)]
    assert verdict.credible_set(found) == ("lobing", "step")
    assert confusable(*ALIKE)
    for behind, kept in ((3.0, True), (6.0, False)):
        pair = [weighed(ALIKE[0], probability=0.95), weighed(ALIKE[1], probability=0.04, score=-behind)]
        assert (ALIKE[1] in verdict.credible_set(pair)) == kept


def test_noise_only_is_a_member_of_the_credible_set_like_any_other():
    """It is listed where its probability is needed for nine tenths, and alone where nothing else is."""
    for sets, credible in (
        ({("lobing",): 0.6, (): 0.35, ("step",): 0.05}, ("lobing", "null")),
        ({(): 0.95, ("step",): 0.05}, ("null",)),
        ({("lobing",): 0.95, (): 0.05}, ("lobing",)),
    ):
        each = [weighed(*own, probability=p, score=p) for own, p in sets.items()]
        assert verdict.credible_set(each) == credible


def test_structure_at_the_site_of_a_name_contradicts_it():
    """Of the best set alone, and from the nats on that right names never leave."""
    best, other = weighed("lobing", probability=0.9), weighed("step", probability=0.1)
    for sets, nats, found in ((best, 6.0, True), (best, 4.0, False), (other, 6.0, False)):
        assert verdict.contradicted([best, other, replace(sets, at_names=nats)]) == found


def test_only_confusable_effects_come_closer():
    """Of ten nats by which the leader fits better, six count against a confusable effect."""
    sets = [weighed(ALIKE[0], score=5.0), weighed(ALIKE[1], score=-5.0), weighed("lobing", score=-5.0)]
    leader, alike, other = (w.score for w in verdict.softened(sets))
    assert (leader, other) == (5.0, -5.0)
    assert leader - alike == pytest.approx(6.0)


@pytest.mark.parametrize(("behind", "expected"), [(0.0, 0.15), (4.0, 0.15), (5.0, 0.04), (50.0, 0.04)])
def test_an_effect_of_an_improbable_hypothesis_is_no_rival_of_a_cell(behind, expected):
    """A cell gives away nats to an effect at its place, but not to one of odds below 1 to 100."""
    place = (joint(3), Driver("torque", 3))
    elsewhere = variant("eccentricity", (joint(3), Driver("angle", 3)), sites=(joint(3),))
    each = ((elsewhere, 60.0), (variant("hardening", place, sites=(joint(3),)), 60.0 - behind))
    ranked = [Hypothesis((Member(v, 1.0, 0.0),), None, nats, 0.0) for v, nats in each]
    assert verdict.given_away(Cell(*place, ()), ranked) == expected


# --- Amplitudes of named effects: their values and uncertainties against sampling, and which are told.


@pytest.mark.parametrize(("of", "count"), [(magnitude, 1), (length, 2), (length, 3), (phase, 2)])
def test_uncertainties_are_those_of_samples(of, count):
    rng = np.random.default_rng(count)
    x, root = rng.standard_normal(count), 0.01 * rng.standard_normal((count, count))
    value, u = propagated(of, x, root @ root.T)
    drawn = np.array([of(x + root @ z)[0] for z in rng.standard_normal((4000, count))])
    assert np.mean(drawn) == pytest.approx(value, abs=0.1 * u + 1e-4)
    assert np.std(drawn) == pytest.approx(u, rel=0.06)


@pytest.mark.parametrize(
    ("rows", "offset"), [(np.eye(2), -np.pi / 2), (np.diag([1.0, -1.0]), 0.7), ([[1, 0], [1, -1]], 0.7)]
)
@pytest.mark.parametrize("order", [1.0, 2.0, 50.0])
def test_the_phase_of_a_wave_is_of_the_reading(rows, offset, order):
    a, b = -0.3, 0.4
    law, offsets, slides = np.asarray(rows, float), np.array([0, offset]), np.zeros(2, bool)
    robot = SimpleNamespace(link_from_reading=law, offset=offsets, slides=slides)
    x, c = np.array([a, b]), 1e-4 * np.eye(2)
    shown, u = phase_shown(phase, x, c, Driver("angle", 2, order), robot)
    readings = np.column_stack([np.linspace(-1, 2, 40), np.linspace(-3, 3, 40)])
    link = (readings @ law.T)[:, 1]
    turns = order * (link + offset)
    sense = -1.0 if not law[1, 0] and law[1, 1] < 0 else 1.0
    further = sense * (a * np.sin(turns) + b * np.cos(turns))
    np.testing.assert_allclose(0.5 * np.sin(order * sense * link + shown), further, atol=1e-9)
    assert u == pytest.approx(0.02)


@pytest.mark.parametrize(("value", "words"), [(-0.0432, "older"), (0.0432, "later")])
def test_late_readings_are_stated_as_older_or_later_than_the_measurement(value, words):
    size = EFFECTS["latency"].sizes["s"].what
    a = Amplitude(
        "latency", PROBE, Driver("contact speed"), ("latency",), size, value, 0.016, "s", None, True
    )
    assert line(a, [a]) == f"latency of the probe: readings {words} than the measurement by 43(16) ms"
    record = {"what": size, "value": 1e3 * value, "u": 16.0, "unit": "ms", "significant": True}
    assert amplitude_of(record) == f"readings {words} than the measurement by 43(16) ms"


SET_EFFECTS = {"eccentricity": "eccentricity at joint 2", "backlash": "backlash", "step": "step@40"}


@pytest.fixture(scope="module")
def found(cube):
    """Amplitudes of a model whose parameters are set, with independent u of 0.05 prior sds."""
    fitted = unsolved(cube(seed=1).dataset, (*BASELINE, *SET_EFFECTS.values()), off=0.0)
    names = fitted.model.names
    z = np.zeros(len(names))
    z[names.index("eccentricity J2 sin")], z[names.index("eccentricity J2 cos")] = 3.0, -4.0
    z[names.index("backlash J3")] = -2.0
    z[names.index("step x")], z[names.index("step z")] = 6.0, 8.0
    fitted = replace(fitted, z=z, covariance=0.05**2 * np.eye(len(z)))
    each = [Named(name, model, (), "", 1.0, 0.0) for name, model in SET_EFFECTS.items()]
    return gap_of(amplitudes(fitted, fitted.covariance, each)), each


def gap_of(own, where=()):
    """A diagnosis with these amplitudes."""
    return SimpleNamespace(amplitudes=own, where=where, dataset=None)


def test_values_of_parameters_that_are_set(found):
    gap, _ = found
    own = {(a.effect, str(a.site), a.unit): a for a in gap.amplitudes}
    wave = own["eccentricity", "joint 2", "rad"]
    assert (wave.value, wave.u) == pytest.approx((5e-4, 5e-6))
    by_reading = np.arctan2(-4.0, 3.0) - np.pi / 2  # theta2 is -90 deg
    assert wave.phase == pytest.approx((by_reading, 0.01))
    lag = own["backlash", "joint 3", "rad"]
    assert (lag.value, lag.u, lag.significant) == (pytest.approx(1.6e-4), pytest.approx(4e-6), True)
    shift = own["step", "base", "m"]
    assert (shift.value, shift.u, shift.significant) == (pytest.approx(5e-4), pytest.approx(2.5e-6), True)
    assert not own["step", "base", "rad"].significant
    assert sum(a.effect == "backlash" for a in gap.amplitudes) == 6


def test_only_what_is_significant_is_told(found):
    gap, each = found
    assert lines(gap) == [
        "eccentricity of J2: amplitude 0.02865(29) deg, phase -143.13(57) deg",
        "backlash of J3: half-width 0.00917(23) deg",
        "step of the base: shift 500.0(2.5) µm",
    ]
    assert named(each[1], gap).startswith("joint 3 has lost motion on reversal (backlash,")
    # every joint only where all are significant

    def said(*joints):
        own = [replace(a, significant=a.site in map(joint, joints)) for a in gap.amplitudes]
        return named(each[1], gap_of(own))

    each_has = "backlash in joints 2, 3 and 5 (each has lost motion on reversal; probability"
    assert said(2, 3, 5).startswith(each_has)
    assert said(1, 2, 3, 4, 5, 6).startswith("every joint has lost motion")
    assert said().startswith("at least one joint has lost motion")
    none = gap_of([replace(a, significant=False) for a in gap.amplitudes])
    assert [str(a.site) for a in stated(none, "backlash")] == ["joint 3"]
    assert lines(none)[1].endswith("deg, not significant alone")
    own = [a for a in none.amplitudes if a.effect == "backlash"]
    explained = (*3 * ("backlash",), "eccentricity", "", "")
    none.where = [
        SimpleNamespace(site=a.site, driver=a.driver, explained_by=name, rms=rms)
        for a, name, rms in zip(own, explained, (1.0, 3.0, 2.0, 9.0, 9.0, 9.0), strict=True)
    ]
    assert [str(a.site) for a in stated(none, "backlash")] == ["joint 2"]  # the largest one of the effect


def test_a_size_has_the_value_that_the_robot_file_states(cube):
    session = cube(seed=1).dataset
    robot = replace(session.robot, compliance=np.full(6, 2e-6))
    fitted = unsolved(replace(session, robot=robot), BASELINE, off=0.0)
    each = [Named("compliance", "compliance", (), "", 1.0, 0.0)]
    for a in amplitudes(fitted, 1e-4 * np.eye(len(fitted.z)), each):
        assert a.value == pytest.approx(2e-6)


def test_a_sum_is_told_whose_parts_are_not_significant(cube):
    """Every joint 2.4 u off: the displacement of all together, by finite differences of the positions."""
    fitted = unsolved(cube(seed=1).dataset, (*BASELINE, "backlash"), off=0.0)
    model, z = fitted.model, np.zeros(len(fitted.z))
    own = [k for k, name in enumerate(model.names) if name.startswith("backlash")]
    z[own] = 0.12
    fitted = replace(fitted, z=z, covariance=0.05**2 * np.eye(len(z)))
    each = [Named("backlash", "backlash", (), "", 1.0, 0.0)]
    *parts, whole = amplitudes(fitted, fitted.covariance, each)
    assert not any(a.significant for a in parts)
    assert whole.significant
    motion = model.motion(np.unique(np.concatenate([b.rows for b in model.blocks])))

    def there(x):
        return motion.points(model.deviations(x[: len(model.parameters)]))

    def moved(x):
        return float(np.sqrt(np.mean(np.sum((there(x) - there(0.0 * x)) ** 2, axis=0))))

    ways = [moved(z + 0.01 * np.eye(len(z))[k]) - moved(z - 0.01 * np.eye(len(z))[k]) for k in own]
    u = 0.05 * np.linalg.norm(np.array(ways) / 0.02)
    assert (whole.value, whole.u) == pytest.approx((moved(z), u), rel=1e-3)
    gap = gap_of((*parts, whole))
    assert lines(gap)[0].startswith("backlash of the arm: displacement of the TCP by all of its parts, RMS ")
    assert named(each[0], gap).startswith("at least one joint has lost motion")
    fitted = replace(fitted, z=0.1 * z)
    assert not any(a.significant for a in amplitudes(fitted, fitted.covariance, each))


def test_entries_of_amplitudes_have_the_numbers_of_their_lines(found):
    """In the units of their keys: gap.json beside the terminal."""
    gap = SimpleNamespace(amplitudes=found[0].amplitudes, levels=(), verdict=SimpleNamespace(named=()))
    said, entries = lines(gap), amplitude_records(gap)
    assert len(said) == len(entries)
    for text, a in zip(said, entries, strict=True):
        assert f"{a['what']} {measured(a['value'], a['u'], a['unit'])}" in text
        assert ("phase" in text) == (a["phase_deg"] is not None)
        if "phase" in text:
            assert f"phase {measured(a['phase_deg'], a['u_phase_deg'], 'deg')}" in text


# --- What prior probabilities and shares make of made-up linear problems: which set of effects leads.

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
    count = p.pool.shape[1]
    variants = {f"effect {k}": (variant(f"effect {k}", place, columns=[k]),) for k in range(count)}
    pool = (Parameter("", "m", (), 1.0),) * count
    return Search(p, Candidates(pool, variants, {}), robust=False)


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
        pool = Pool(both, (np.array([0]),), ROWS, cells=(cell,), owner=np.array([0]))
        found, alone = verdict.weigh(search, pool)
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


def decided(columns, contribution, cell, orders=()):
    """The decision on a made-up problem with one cell of one column (R, 1), elsewhere than the effects.

    These are waves of so many `orders` of one angle.
    """
    search = search_of(problem(columns, contribution))
    for k, order in enumerate(orders):
        (v,) = search.candidates.variants[f"effect {k}"]
        wave = ((joint(2), Driver("angle", 2, order)),)
        search.candidates.variants[f"effect {k}"] = (replace(v, places=wave),)
    search.run()
    shape = Cell(joint(3), Driver("angle", 3), ((),))
    return verdict.decide(search, Pool(cell, (np.array([0]),), ROWS, cells=(shape,), owner=np.array([0])))


@pytest.mark.parametrize(("what", "kind", "names"), [("all", "unknown", 0), ("rest", "named+unexplained", 1)])
def test_a_name_that_an_unmodelled_effect_makes_needless_is_dropped(what, kind, names):
    """A cell that explains what the name explains leaves it nothing; one that explains the rest keeps it."""
    named, rest = 45 * UNIT[:, :1], 20 * UNIT[:, 1:2]
    found = decided(named, (named + rest)[:, 0], named + rest if what == "all" else rest)
    assert found.weighed[0].effects == ("effect 0", "unknown")
    assert (found.kind, [m.effect for m in found.members]) == (kind, ["effect 0"] * names)


@pytest.mark.parametrize(("orders", "terms"), [((1.0, 2.0), True), ((1.0, 100.0), False)])
def test_waves_of_an_angle_are_terms_of_a_function_but_for_many_a_turn(orders, terms):
    """An encoder scale beside a gear mesh of the same joint was a class of the two."""
    columns = 45 * UNIT[:, :2]
    found = decided(columns, columns.sum(axis=1), UNIT[:, 9:10], orders)
    assert (found.kind, len(found.members)) == ("class" if terms else "named", 2)
    one, other = found.members
    assert found.hypothesis.terms_with(one) == ((other,) if terms else ())


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


# --- The name that a diagnosis prints is the model that it fitted: parameters, priors and numbers.


@pytest.mark.parametrize("baseline", [BASELINE, ("geometry",)])
@pytest.mark.parametrize(("scale", "partial"), [(0.125, False), (1.0, False), (4.0, True)])
def test_every_variant_has_a_name_that_is_its_parameters(cube, baseline, scale, partial):
    """Also where only some of the effect's parameters are assessed."""
    c = circumstances(cube(seed=1, count=48).dataset)
    known = candidates(c, baseline)
    names = set()
    for v in (v for own in known.variants.values() for v in own):
        listed = replace(v, partial=partial and not v.together)
        name = model_name(Member(listed, scale, 0.0), known)
        own = [p for p in parameters_of((name,), c) if p.effect == v.effect]
        pool = [known.pool[k] for k in v.columns]
        assert [p.name for p in own] == [p.name for p in pool], name
        assert [p.centre for p in own] == [p.nominal for p in pool], name
        assert [p.sd for p in own] == pytest.approx([scale * p.sd for p in pool]), name
        assert all(same_terms(p.terms, q.terms, np.array_equal) for p, q in zip(own, pool, strict=True)), name
        names.add(name)
    assert len(names) == sum(map(len, known.variants.values()))


def test_parts_that_are_not_named_stay_nominal():
    member = SimpleNamespace(effect="geometry", variant=SimpleNamespace(sites=(joint(4),)))
    parts = parts_of(("geometry at joint 4", "geometry at link 3", "compliance at joint 4"), BASELINE)
    assert still_without(parts, [member]) == parts[1:]


# --- Warnings of a diagnosis say what the validation errors show.

SCATTER = np.random.default_rng(2).standard_normal(60)
UNSURE = np.arange(60) < 6


def errors(sure, unsure):
    """Rows with errors of these sizes, in units of the noise; six have 20 times the uncertainty."""
    found = held(SIGMA * SCATTER * np.where(UNSURE, unsure, sure))
    return replace(found, by_parameters=np.where(UNSURE, 20 * SIGMA, 0.0)[:, None])


def test_what_is_said_of_errors_that_increase():
    assert not list(increased(errors(3.0, 20.0), errors(1.0, 20.0)))
    # errors that increase where they are less probable
    (told,) = increased(errors(1.0, 1.0), errors(3.0, 1.0))
    assert told.endswith("calibration rows only, and the arm is without them")
    one_block = [replace(errors(x, 1.0), block=np.zeros(60, int)) for x in (1.0, 3.0)]  # without a scatter
    assert [*increased(*one_block)] == [told]
    # The RMS increases and so does the log density: no contradiction, and no reason to drop the effects
    (told,) = increased(errors(3.0, 10.0), errors(1.0, 20.0))
    assert "but so does their log density" in told
    assert "the arm is without" not in told
    # Errors of other rows by other amounts, in the sum a little larger
    change = np.where(np.arange(60) % 2, 1.4, 0.7)
    more = replace(errors(1.0, 1.0), residual=errors(1.0, 1.0).residual * change)
    (told,) = increased(errors(1.0, 1.0), more)
    assert told.startswith("validation errors do not decrease with the named effects (from ")
    assert "within its uncertainty" in told
    assert "the arm is without" not in told


def test_what_a_name_that_is_left_out_displaces_is_in_units_of_the_stated_uncertainty():
    def fitted(a2, theta3, *further):
        parameters = (SimpleNamespace(name="a2", unit="m"), SimpleNamespace(name="theta3", unit="rad"))
        z = np.array([a2 / 1e-3, theta3 / 1e-2, *further])
        scales = np.array([1e-3, 1e-2, *np.ones(len(further))])
        model = SimpleNamespace(
            parameters=parameters, names=("a2", "theta3", *("backlash" for _ in further)),
            slices={ARM: slice(0, 2)}, sd=scales[:2], physical=lambda z: z * scales,
        )  # fmt: skip
        return SimpleNamespace(model=model, z=z)

    arm, complete = fitted(2e-3, 0.01), fitted(-5e-3, 0.012, 3.0)
    covariance = np.diag([0.05, 0.04]) ** 2  # u 50 um and 0.4 mrad
    assert displaced(arm, complete, covariance) == ("a2 by -7 mm, 140 standard uncertainties",)
    assert displaced(arm, complete, 25.0**2 * covariance) == ()
    assert displaced(arm, arm, covariance) == displaced(arm, complete, None) == ()
