"""Causes that are in no list: products of quantities, relatives of names, and events."""

import re
import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t as student_t

from bayescal.logs.types import CALIBRATE, TORQUE, VALIDATE
from bayescal.motion import beside as causes
from bayescal.motion.bank import Product
from bayescal.motion.beside import Relative, beside, simplified
from bayescal.motion.diagnose import _place
from bayescal.motion.dynamics import Loads
from bayescal.motion.effects import BODY_ON_IT, DENSE, EFFECTS, Form, Waves
from bayescal.motion.linear import Temporary, joined, normal
from bayescal.motion.noise import noise_of
from bayescal.motion.pool import Pool, Unlisted
from bayescal.motion.quantities import RESPONSES, UNKNOWN, resonated
from bayescal.motion.search import SCALES, Hypothesis, Member, decide
from bayescal.motion.settings import EVENTS, PRODUCTS, RELATIVES, SEARCH
from bayescal.motion.signals import root_mean_square


@pytest.fixture(scope="module")
def pool(null_estimate):
    return Pool.of(null_estimate)


@pytest.fixture(scope="module")
def null_bank(pool):
    return bank_of(pool)


def with_error(pool, error):
    """The pool with an error (M, C) of each part, a function of its signals, in the residuals."""
    parts = tuple(replace(p, residual=p.residual + error(p)) for p in pool.table.parts)
    return replace(pool, table=replace(pool.table, parts=parts))


def search_of(pool):
    return pool.search(normal(pool.table, pool.estimate.noise))


def bank_of(pool):
    return pool.bank(pool.estimate.noise)


def at_joint(values, j, like):
    return values[:, None] * np.eye(like.shape[1])[j]


def best_products(pool, count=3):
    (gains,) = bank_of(pool).gains([search_of(pool).fit()])
    ranked = sorted(gains, key=lambda g: -g[1])
    return [(p.form.site, p.form.driver) for p, _ in ranked[:count]], ranked[0][1]


def test_in_a_null_log_general_functions_gain_little(pool, null_bank):
    (gains,) = null_bank.gains([search_of(pool).fit()])
    nats = np.array([value for _, value in gains])
    assert len(nats) > 500
    assert np.log(np.mean(np.exp(nats))) < 1.0


def test_gains_beside_several_fits_are_those_beside_each(pool, null_bank):
    bank, search = null_bank, search_of(pool)
    members = [Member(form, 1.0) for form, _ in search.forms[:2]]
    fits = [search.fit(members), search.fit(members[:1]), search.fit(members[1:])]
    apart = [bank.gains([fit])[0] for fit in fits]
    for one, other in zip(bank.gains(fits), apart, strict=True):
        np.testing.assert_allclose([v for _, v in one], [v for _, v in other], rtol=1e-9, atol=1e-9)


def test_the_size_of_a_place_is_by_how_much_the_residuals_change(pool):
    """An error of masses that the model has too: what its parameters explain without it is not its size."""
    search, table = search_of(pool), pool.table.of_role(CALIBRATE)
    without = search.fit()
    left = root_mean_square(table.residuals(without.values))
    forms = [form for form in search.terms if form.effect in ("inertia", "payload", "viscous", "armature")]
    assert forms
    for form in forms:
        place = _place(pool, without, search.fit((Member(form, 1.0),)), form, 0.0, "")
        assert place.rms < 0.5 * left[place.joint]
        assert place.kind == TORQUE


def test_a_product_of_two_quantities_is_found_with_its_joint(pool):
    def error(part):
        s = part.signals
        wave = s.kept(np.tanh(s.dq[:, 1] / 0.03)) * np.cos(3.0 * s.kept(s.q[:, 2]))
        return at_joint(0.3 * wave, 1, part.residual)

    forms, nats = best_products(with_error(pool, error))
    assert ("joint 2", "direction times angle of joint 3") in forms
    assert nats > 30.0


def test_an_oscillation_in_several_joints_is_of_what_carries_the_arm_or_of_the_tool(pool):
    def error(part):
        s = part.signals
        return s.kept(resonated(s.ddq[:, :1], 2.8, s.step)) * [0.2, 0.1, 0.0]

    forms, nats = best_products(with_error(pool, error))
    assert forms[0][0] == "base"
    assert forms[0][1].startswith("oscillation, 2.")
    assert nats > 30.0


def test_no_prior_makes_an_error_of_a_link_larger_than_the_link(pool):
    m, search, seen = pool.table.parts[0].signals.log.mechanism, search_of(pool), set()
    for (form, names), weights in zip(search.forms, search.scale_priors, strict=True):
        assert np.sum(np.exp(weights)) == pytest.approx(1.0)
        if form.effect == "inertia" and form.site != "log":
            k = int(form.site.split()[1]) - 1
            sd = {t.name: t.sd for t in search.normal.terms}
            largest = np.max(SCALES[np.isfinite(weights)])
            length = max(np.sqrt(np.trace(m.inertia[k]) / (2.0 * m.mass[k])), [0.025, 0.15, 0.0][k])
            mass, *centres = (sd[n] for n in names if not form.setting or " inertia " not in n)
            whole = m.mass[k] if form.setting else 1.0
            for centre in centres[:3]:
                assert 0.3 * length < largest * centre / whole <= length or largest * mass > 0.5 * m.mass[k]
            assert largest * mass <= m.mass[k]
            seen.add(form.setting)
    assert seen == {"", DENSE, BODY_ON_IT}


def loads_of(s):
    m = s.log.mechanism
    return Loads.of(m, (s.q, s.dq, s.ddq), s.log.gravity, m.inertials, s.payload)


def leaning(s, tilt):
    """Torques by a base that is tilted about x and y by angles (N, 2), rad."""
    by = np.array([np.cross(axis, s.log.gravity) for axis in np.eye(3)[:2]])
    columns = np.einsum("ba,anjkp,kp->bnj", by, s.tilted, s.log.mechanism.inertials)
    return np.einsum("nb,bnj->nj", tilt, columns)


def shifted(s, centre):
    """Torques by a payload whose centre of mass is displaced by (N, 3), m."""
    first = s.rigid[:, :, -1, 1:4] * s.payload[:, None, None]
    return np.einsum("nji,ni->nj", first, centre)


BY_MOMENT, BY_ACCELERATION = "moment on the base", "acceleration at the tool"
SITES = {
    f"gravity direction times {BY_MOMENT}": lambda s: leaning(s, 4e-3 * loads_of(s).base[:, 1:2] * [0, 1]),
    f"centre of mass times {BY_ACCELERATION}": lambda s: shifted(s, 8e-3 * loads_of(s).tool * [1, 0, 0]),
    "centre of mass times angle of joint 2": lambda s: shifted(s, np.sin(2.0 * s.q[:, 1:2]) * [0.1, 0.1, 0]),
}


@pytest.mark.parametrize("driver", SITES)
def test_what_varies_at_the_base_or_the_tool_is_found_there(pool, driver):
    forms, nats = best_products(with_error(pool, lambda p: p.signals.kept(SITES[driver](p.signals))), 1)
    assert forms == [("tool" if driver.startswith("centre") else "base", driver)]
    assert nats > 20.0


def test_a_tilt_that_is_half_of_what_is_there_is_no_name(pool):
    """The base leans with its moment, beside a fixed tilt that explains as much."""

    def error(part):
        s = part.signals
        return s.kept(leaning(s, 0.03 * np.array([1.0, 0.5]) + 4e-3 * loads_of(s).base[:, [1, 0]]))

    changed = with_error(pool, error)
    search, noise = search_of(changed), pool.estimate.noise
    hypotheses = search.run()
    alone = max(hypotheses, key=lambda h: h.score if h.names == ("base-tilt",) else -np.inf)
    assert alone.log_evidence > 20.0
    wide, hypotheses = beside(changed, noise, search, hypotheses)
    verdict = decide(wide.search(normal(wide.table, noise)), hypotheses)
    assert verdict.kind in ("unknown", "named+unexplained")
    assert verdict.probability["base-tilt"] < 0.9
    assert ("base", UNKNOWN) in [(m.form.site, m.form.effect) for m in verdict.leading.members]


def test_a_wave_in_proportion_to_a_response_is_found_and_explained(null_estimate):
    j, number = 1, 41.0

    def with_wave(s):
        extra = np.zeros_like(s.torque)
        extra[:, j] = 0.5 * np.sign(s.dq[:, j]) * np.sin(number * s.q[:, j] + 0.7)
        return s.changed(torque=s.torque + extra)

    estimate = replace(null_estimate, parts=tuple(map(with_wave, null_estimate.parts)))
    pool = Pool.of(estimate)
    found = {kind: waves for k, waves, kind in pool.scale.waves.in_proportion if k == j}
    assert found["direction"] == pytest.approx(number, abs=0.5)
    ((site, driver),), nats = best_products(pool, 1)
    assert site == "joint 2"
    assert driver == f"direction times angle of joint 2, {found['direction']:.3g} waves a turn"
    assert nats > 50.0


def test_events_are_found_where_they_are(pool, null_bank, monkeypatch):
    where = {}

    def error(part):
        s = part.signals
        begins = s.time[0] + 2.5
        where[s.name] = begins
        pulse = np.where(s.time < begins, 0.0, np.exp(-(s.time - begins) / 0.3))
        return at_joint(s.kept(pulse) * (0.25 if s.role == CALIBRATE else 0.0), 2, part.residual)

    changed = with_error(pool, error)
    found = causes.events(bank_of(changed), search_of(changed).fit())
    form, nats, columns = max(found, key=lambda e: e[1])
    assert (form.effect, form.site) == (UNKNOWN, "joint 3")
    assert nats > 30.0
    calibrate = [p for p in changed.table.parts if p.signals.role == CALIBRATE]
    assert re.fullmatch(
        rf"{len(calibrate)} of them, the strongest 2\.[4-6] s after the start of motion \d", form.setting
    )
    for part, x in zip(changed.table.parts, columns, strict=True):
        assert list(x) == [2]
        if part.signals.role == CALIBRATE:
            begins = part.signals.kept(part.signals.time)[np.argmax(np.max(np.abs(x[2]()), axis=1) > 0.1)]
            assert begins == pytest.approx(where[part.signals.name], abs=0.15)
    assert not list(causes.events(null_bank, search_of(pool).fit()))
    # in a slow log a short pulse is like a wrong reading
    monkeypatch.setattr(causes, "EVENTS", replace(EVENTS, samples=1.01 / pool.table.parts[0].signals.step))
    assert not list(causes.events(bank_of(changed), search_of(changed).fit()))


@pytest.mark.parametrize("varies", [False, True])
def test_a_name_is_as_sure_as_its_relatives_allow(pool, varies):
    def error(part):
        s = part.signals
        friction = 0.06 * np.abs(pool.estimate.model.load(s)[:, 1]) * np.tanh(s.dq[:, 1] / 0.03)
        by = 1.0 - np.tanh(3.0 * (s.kept(s.q[:, 0]) - 0.2)) if varies else 1.0
        return at_joint(s.kept(friction) * by, 1, part.residual)

    changed = with_error(pool, error)
    search = search_of(changed)
    form = next(f for f, _ in search.forms if (f.effect, f.site) == ("load-friction", "joint 2"))
    member = Member(form, 1.0)
    r = causes.relative(bank_of(changed), search, [member], member)
    if varies:
        assert r.gain > 20.0
        assert r.form.driver == "torque times direction times angle of joint 1"
    else:
        assert r.gain < 0.0


def test_hypotheses_with_further_forms_can_be_fitted(pool):
    noise = pool.estimate.noise
    search = search_of(pool)
    further, hypotheses = beside(pool, noise, search, search.run())
    again = further.search(normal(further.table, noise))
    assert set(further.extra).isdisjoint(pool.forms)
    for h in hypotheses:
        assert np.isfinite(again.fit(h.members).log_evidence)
    # candidates of the search are the same
    assert again.forms == search.forms
    assert again.base == search.base


def test_further_columns_change_the_normal_equations_by_a_border(pool):
    noise = pool.estimate.noise
    form = Form(UNKNOWN, "joint 1", "made")
    terms = (form.term("N m", 0.5, part="a"), form.term("N m", 2.0, part="b"))
    rng, put = np.random.default_rng(0), Temporary().put
    columns = [{c: put(rng.normal(size=(len(p.residual), 2))) for c in (0, 2)} for p in pool.table.parts]
    wide = pool.extended([Unlisted(form, terms, columns)])
    before = normal(pool.table, noise)
    whole, border = normal(wide.table, noise), normal(wide.table, noise, before)
    for name in ("gram", "score", "chi2"):
        assert np.allclose(getattr(border, name), getattr(whole, name))
    one, two = (normal(wide.table.of_role(role), noise) for role in (CALIBRATE, VALIDATE))
    assert np.allclose(joined(one, two).gram, whole.gram)
    # what they explain is interpolated between the rows that are kept
    names = wide.extra[form]
    (_, left), (_, plain) = (next(iter(wide.unfiltered(values))) for values in ({names[0]: 3.0}, {}))
    part = wide.table.of_role(VALIDATE).parts[0]
    k = [t.name for t in wide.table.terms].index(names[0])
    numbers, columns = part.of(0)
    column = columns[:, numbers.tolist().index(k)]
    s = part.signals
    rows = np.searchsorted(s.unfiltered(s.time), s.kept(s.time) - 0.5 * s.step)
    assert (plain - left)[rows, 0] == pytest.approx(3.0 * column, abs=0.02)
    assert not np.any((plain - left)[:, 1])


def test_columns_are_in_a_file():
    """An hour of log has more of them than fit into the memory of a small machine."""
    put, x = Temporary().put, np.random.default_rng(0).normal(size=(400, 3000))[:, ::2]
    tracemalloc.start()
    blocks = [put(x) for x in (x[:0], x[:, :0], x, x.T)]
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert held < 0.01 * x.nbytes
    for block, values in zip(blocks, (x[:0], x[:, :0], x, x.T), strict=True):
        assert np.array_equal(block(), values.astype(np.float32))
    assert Temporary().put(x[:0])().shape == (0, 1500)  # of a log in which nothing moves


def test_noise_of_repeats_counts_where_it_is_clearly_smaller():
    rng = np.random.default_rng(1)
    noise = [rng.normal(size=(300, 2)) for _ in range(3)]
    shared = np.zeros((300, 2))
    shared[:, 0] = 2.0 * np.sin(np.arange(300) / 9.0)  # an error of the model, alike in all repeats
    found = noise_of([shared + x for x in noise], same=["1", "1", "1"])
    assert found.sd == pytest.approx([1.0, 1.0], rel=0.1)
    # not by chance: a few slow rows have few degrees of freedom
    slow = np.cumsum(rng.normal(size=(3, 40, 1)), axis=1)
    chance = [slow[0], 1.4 * slow[0] + 0.8 * slow[1], slow[2]]
    assert noise_of(chance, same=["1", "1", "3"]).sd == noise_of(chance).sd


def test_a_general_function_must_explain_more_than_the_name_in_whose_place_it_is():
    def hypothesis(nats, *effects):
        return Hypothesis(tuple(Member(Form(e, "joint 1", "time"), 1.0) for e in effects), nats, 0.0)

    null, name, other = hypothesis(0.0), hypothesis(900.0, "torque-drift"), hypothesis(5.0, "payload")
    cell, beside_it = hypothesis(905.0, UNKNOWN), hypothesis(920.0, "torque-drift", UNKNOWN)
    every = (null, name, other, cell, beside_it)
    less = causes.in_place_of_a_name(cell, every).log_evidence
    assert less == pytest.approx(905.0 - SEARCH.instead * 900.0)
    # of two names there is none whose place it takes
    assert [causes.in_place_of_a_name(h, every) for h in (null, name, beside_it)] == [null, name, beside_it]
    both = hypothesis(940.0, "payload", "torque-drift")
    less = causes.in_place_of_a_name(beside_it, (*every, both)).log_evidence
    assert less == pytest.approx(920.0 - SEARCH.instead * 40.0)


def test_a_row_that_is_far_off_is_as_surprising_as_the_tails_of_all_rows_make_it():
    rng = np.random.default_rng(3)
    normal, heavy = rng.standard_normal(20_000), student_t(4).rvs(20_000, random_state=rng) / np.sqrt(2.0)
    far = np.array([0.1, 8.0])
    assert causes.surprise(normal)(far) == pytest.approx(0.5 * far**2, rel=0.1)
    assert causes.surprise(heavy)(far)[1] == pytest.approx(-2.5 * -np.log1p(8.0**2 / 2.0), rel=0.1)


def test_names_that_no_longer_pay_for_their_prior_beside_an_unknown_cause_are_left_out():
    gains = {"payload": 1.0, "ripple": 30.0}

    class Gained:
        def scaled(self, h):
            return h

        def additions(self, h):
            missing = set(gains) - {m.form.effect for m in h.members}
            return {name: (Member(Form(name, "tool", ""), 1.0), gains[name]) for name in missing}

        def prior(self, effects):
            return -3.0 * len(effects)

    def of(*names):
        return tuple(Member(Form(name, "tool", ""), 1.0) for name in names)

    whole = Hypothesis(of("payload", "ripple", UNKNOWN), 100.0, -9.0)
    other = Hypothesis(of("payload", "ripple"), 80.0, -6.0)
    best, *rest = simplified(Gained(), (whole, other))
    assert (best.members, best.log_evidence, best.log_prior) == (of("ripple", UNKNOWN), 99.0, -6.0)
    assert rest == [whole, other]
    gains["payload"] = 4.0
    assert simplified(Gained(), (whole, other)) == (whole, other)
    assert simplified(Gained(), (other, whole)) == (other, whole)


def test_a_form_in_all_joints_is_no_addition_to_one_of_its_joints(pool):
    search = search_of(pool)
    every = next(f for f in search.terms if f.effect == "torque-constant" and f.of_each)
    single = replace(every, site="joint 2", setting=every.setting.removesuffix(", in all joints"))
    single = replace(single, setting="" if single.of_each else single.setting)
    assert search.terms[single][0] in search.terms[every]
    for taken in (every, single):
        member, _ = search.additions(Hypothesis((Member(taken, 1.0),), 0.0, 0.0))["torque-constant"]
        assert not set(search.terms[member.form]) & set(search.terms[taken])
    assert all(len(search.terms[f]) == pool.table.parts[0].signals.log.n for f in search.terms if f.of_each)
    place = {form: k for k, (form, _) in enumerate(search.forms)}
    dearer = search.form_priors[place[every]] - search.form_priors[place[single]]
    assert dearer == pytest.approx(2.0 * np.log(SEARCH.again))  # as at two further joints


def test_free_relatives_of_a_name_are_weighed_among_those_of_its_joint():
    """Products of other joints, or with another response, change nothing; the same ones twice neither."""
    every = tuple(RESPONSES)
    kinds = [("joint 1", every), ("joint 1", PRODUCTS.with_memory), ("joint 2", every), ("log", ("",))]
    bank = SimpleNamespace(
        first=[SimpleNamespace(site=site, times=times, log_prior=0.0) for site, times in kinds]
    )

    def product(site, argument, driver):
        return Product(Form(UNKNOWN, site, driver), "", argument, (0,), (False,))

    own = [(product("joint 1", 0, "a"), 3.0), (product("joint 1", 0, "b"), 5.0)]
    others = [(product(f"joint {k}", i, "c"), 9.0) for k, i in ((1, 1), (1, 2), (2, 2), (2, 0))]
    member = Member(Form("ripple", "joint 1", "motor angle"), 1.0)
    best, nats = causes._free(bank, member, own)
    assert best.form.driver == "b"
    for gains in (own + others, 2 * own, others + own):
        found, same = causes._free(bank, member, gains)
        assert found.form == best.form
        assert same == pytest.approx(nats)
    assert causes._free(bank, member, others) is None


def test_no_harmonic_of_a_ripple_is_expected_to_be_larger_than_the_first(pool):
    """Nor a ripple larger than the friction that it is a part of."""
    s = pool.table.parts[0].signals
    scale = replace(pool.scale, waves=Waves(((0, 30.0), (2, 50.0))))
    forms = {}
    for form, term, column in EFFECTS["ripple"].forms(s, pool.estimate.model, scale):
        rate = np.std(np.diff(column)) / np.std(column)
        forms.setdefault(form, []).append((rate, term.sd, term.channel))
    assert len(forms) >= 4
    for terms in forms.values():
        rates, sds, channels = map(np.array, zip(*sorted(terms), strict=True))
        assert np.all(np.diff(sds) <= 0.0)
        assert np.all(np.linalg.norm(sds[rates < 1.2 * rates[0]]) <= scale.friction[channels[0]])


@pytest.mark.parametrize("replaces", [True, False])
def test_a_relative_is_fitted_as_it_was_weighed(pool, monkeypatch, replaces):
    """In place of a name as large as that, beside it as a share of it."""
    search = search_of(pool)
    member = Member(next(f for f, _ in search.forms if f.site == "joint 2"), 1.0)
    form = replace(member.form, effect=UNKNOWN, driver="made up")
    put = Temporary().put
    columns = [{1: put(np.ones((len(p.residual), 1)))} for p in pool.table.parts]
    other = Hypothesis((Member(Form(UNKNOWN, "joint 1", "time"), 1.0),), -50.0, 0.0)
    monkeypatch.setattr("bayescal.motion.beside.relative", lambda *_: Relative(form, 3.0, columns, replaces))
    monkeypatch.setattr("bayescal.motion.beside._unknown", lambda *_: (other, None))
    best = Hypothesis((member,), 20.0, -1.0)
    wide, hypotheses = beside(pool, pool.estimate.noise, search, (best, Hypothesis((), 0.0, 0.0)))
    (name,) = wide.extra[form]
    (sd,) = [t.sd for t in wide.table.terms if t.name == name]
    assert sd == (1.0 if replaces else RELATIVES.share)
    (own,) = [h for h in hypotheses if form in [m.form for m in h.members]]
    assert (member in own.members) == (not replaces)
    assert (own.log_evidence, own.log_prior) == (best.log_evidence + 3.0, best.log_prior)
