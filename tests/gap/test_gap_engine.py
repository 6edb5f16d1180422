"""Oracles of the engine: columns, projections, evidences and states against dense linear algebra."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import camera_session
from gap_problems import BASELINE, Bench, bench_of, log_bayes, of_every_kind, unsolved, with_orientations
from rails import moving_session
from scipy.integrate import quad
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import multivariate_normal
from sessions import circumstances, tracker

from bayescal.arm.motion import CONTACT, Term
from bayescal.arm.statics import Stance, gravity_loads
from bayescal.dataset import Noise
from bayescal.effects import EFFECTS, Parameter, parameters_of
from bayescal.effects import gravity as mass_errors
from bayescal.effects.compliance import expected
from bayescal.effects.imaging import without_camera
from bayescal.effects.location import BASE, joint
from bayescal.estimate import STATED_WORTH, linearise
from bayescal.gap.examine import _screened_again
from bayescal.gap.linear import evidence
from bayescal.gap.linear.problem import Driven, Problem, Slopes, of_certificate, problem, without_nuisance
from bayescal.gap.linear.state import fit_state
from bayescal.gap.search.beam import Member, Search
from bayescal.gap.search.candidates import candidates, extended
from bayescal.gap.search.refit import model_name, screened, screening
from bayescal.gap.search.unknown import CellFit
from bayescal.gap.search.verdict import Weighed, _beside
from bayescal.model import ARM, ORIENTATION, with_parameters
from bayescal.model.model import length_blocks


@pytest.fixture(scope="module")
def session(cube):
    return cube(seed=3, count=120).dataset


@pytest.fixture(scope="module")
def mixed(session):
    return of_every_kind(session)


ON_RAILS = {"straightness", "angular-motion", "positioning", "axis-bending"}


def every_candidate(c, baseline):
    """Parameters of every effect that the baseline leaves out, at its usual setting and at one of a scan."""
    out = []
    for effect in EFFECTS.values():
        if effect.name in baseline or effect.missing(c):
            continue
        settings = [None] if effect.scan is None else [None, *effect.scan.values(c)[:1]]
        for value in settings:
            out += [replace(p, name=f"{p.name} {value}") for p in effect.at(c, value)]
    return out


def shared_images():
    """Six images whose corners share errors of the readings, and linear errors of the image."""
    return replace(camera_session(images=6), noise=Noise(pixel=0.2, joint=1e-4, field=1.5, power=1))


@pytest.mark.parametrize("kinds", ["planes", "every kind", "points", "poses", "rail", "images"])
def test_columns_are_those_of_a_model_that_has_the_parameters(kinds, session, mixed, tracker):
    read = tracker(seed=3).dataset
    poses = with_orientations(read)
    every = {"planes": session, "every kind": mixed, "points": read, "poses": poses, "rail": moving_session()}
    dataset = every[kinds] if kinds != "images" else shared_images()
    fitted = unsolved(dataset)
    assert bool(fitted.weights.shared) == (kinds == "images")
    scales = {g: 1.0 + 0.5 * k for k, g in enumerate(fitted.weights.scale)}
    fitted = replace(fitted, weights=replace(fitted.weights, scale=scales))
    model, scene = fitted.model, fitted.model.scene
    extra = every_candidate(circumstances(scene), BASELINE)
    extra += [replace(p, name=f"{p.name} again") for p in model.parameters if p.name.endswith((" rx", " rz"))]
    named = {"step", "bending"} | (ON_RAILS if kinds == "rail" else set())
    if kinds in ("planes", "every kind"):
        named = {name for name, e in EFFECTS.items() if e.missing is not without_camera}
        named -= {*BASELINE, *ON_RAILS}
    assert {p.effect for p in extra} >= named
    found = Slopes.of(fitted, [p for p in extra if of_certificate(p)])

    wide = with_parameters(scene, model.effects, (*model.parameters, *extra))
    own, last = len(model.parameters), len(wide.parameters)
    at_rest = -wide.shift[own:] / wide.sd[own:]
    z = np.concatenate([fitted.z[model.slices[ARM]], at_rest, fitted.z[own:]])
    count = {g: sum(b.residuals for b in model.blocks if b.group == g) for g in scales}
    assert (count.pop(ORIENTATION, 0) > 0) == (kinds == "poses")
    main = max(count, key=count.get)
    weights = replace(fitted.weights, scale={g: s / scales[main] for g, s in scales.items()})
    linear = linearise(wide, z, weights)
    columns = linear.jacobian[:, own:last]
    size = np.max(np.abs(columns), axis=0)
    assert np.all(size > 0)
    np.testing.assert_allclose(found.columns(extra) / size, columns / size, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.residual, linear.residual, rtol=1e-9, atol=1e-9)
    kept = np.r_[0:own, last : wide.size]
    np.testing.assert_allclose(found.jacobian, linear.jacobian[:, kept], rtol=1e-9, atol=1e-9)


def test_lengths_are_in_metres_whatever_the_scales_of_the_noise(mixed, tracker):
    """As the model has them; so is the slope by a displacement along the direction of a contact."""
    for dataset in (mixed, with_orientations(tracker(seed=3).dataset)):
        fitted = unsolved(dataset)
        scales = {g: 3.0 - k for k, g in enumerate(fitted.weights.scale)}
        found = Slopes.of(replace(fitted, weights=replace(fitted.weights, scale=scales)))
        model, count = fitted.model, len(found.sigma)
        values = model.deviations(fitted.z[model.slices[ARM]])
        blocks = [(b, fitted.z[model.slices[b.target]]) for b in length_blocks(model)]
        metres = np.concatenate([b.residual(values, z).ravel() for b, z in blocks])
        np.testing.assert_allclose(found.residual[:count] * found.sigma, metres, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.along(CONTACT, "normal")[:count] * found.sigma, 1.0)


def test_images_are_whitened_by_what_their_corners_share():
    """Products and parts of columns by quantities of a pose and of a corner; metres; random errors."""
    fitted, rng = unsolved(shared_images()), np.random.default_rng(1)
    slopes, (block,) = Slopes.of(fitted), fitted.model.blocks
    apart, size = fitted.weights.decorrelation(block), len(slopes.rows)
    q = circumstances(fitted.model.scene).q[slopes.rows]
    poses = np.unique(q, axis=0, return_inverse=True)[1].ravel()
    drivers = rng.standard_normal(6)[poses], rng.standard_normal(size), rng.standard_normal(6)[poses]
    own = [Parameter("", "rad", (Term(3, "rz", d), Term(0, "tx", d)), 1e-3) for d in drivers]
    along = slopes.along(3, "rz") + slopes.along(0, "tx")
    raw = np.column_stack([1e-3 * np.tile(d, 2) * along for d in drivers])
    wanted, found, left = apart.white(raw), Driven(slopes, poses, own), rng.standard_normal((3, 2 * size))
    assert {kept.shape[1] for _, kept, *_ in found._parts} == {6, size}  # drivers alike in a pose, once
    for rows, columns in ((slice(None), slice(None)), (np.arange(0, 2 * size, 7), [2, 0])):
        np.testing.assert_allclose(found[rows, columns], wanted[rows][:, columns], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(left @ found, left @ wanted, rtol=1e-9)
    p = slopes.problem(fitted.z, own, ())
    values = fitted.model.deviations(fitted.z[fitted.model.slices[ARM]])
    metres = block.residual(values, fitted.z[fitted.model.slices[block.target]]).ravel()
    np.testing.assert_allclose(p.metres(p.residual), metres, rtol=1e-9, atol=1e-12)
    clusters = np.tile(rng.integers(0, 5, size), 2)  # across images
    state = fit_state(p, (), (), robust=False)
    every = apart.white(raw[:, :1] * (clusters[:, None] == np.arange(5))) / state.kappa
    seen = np.sum(every**2, axis=0)[None], (state.residual / state.kappa @ every)[None] ** 2
    found, _ = evidence.weigh_clusters(state, wanted[:, 0], clusters)
    np.testing.assert_allclose(found, evidence._factors_along(state, *seen)[0], rtol=1e-9)


def test_rows_of_a_contact_stay_together(mixed):
    fitted = unsolved(mixed)
    p = problem(fitted, [])
    assert p.pool.shape == (len(p.residual), 0)
    readings = {b.target: b for b in fitted.model.blocks}
    assert p.count == sum(b.residuals for b in fitted.model.blocks)
    three = np.bincount(p.contact) == 3
    asked = {int(r) for name in ("instrument", "fixed-point") for r in readings[name].rows}
    assert set(p.rows[three].tolist()) == asked
    assert sorted(p.rows.tolist()) == list(range(len(mixed.measurements.ids)))


def random_problem(seed=0, rows=60, constraints=4, size=7, pool=6, amplitude=0.0):
    """A problem without a robot: contacts, constraints, a model's columns and a pool of unit size."""
    rng = np.random.default_rng(seed)
    jacobian = 3 * rng.standard_normal((rows + constraints, size))
    columns = rng.standard_normal((rows + constraints, pool)) + 0.2 * jacobian[:, :1]
    residual = 1.3 * rng.standard_normal(rows + constraints) + jacobian @ rng.standard_normal(size)
    residual += amplitude * columns[:, 0]
    z = rng.standard_normal(size)
    return Problem(residual, jacobian, columns, z, np.arange(rows), np.arange(rows), np.full(rows, 1e-6))


def augmented(state):
    """Whitened rows of a state's fit and of its prior: design, and residuals where it was linearised."""
    p = state.problem
    whiten = np.sqrt(state.weight)
    whiten[: p.count] /= state.kappa
    pull = np.concatenate([p.z, np.zeros(len(state.columns))])
    design = np.vstack([state.design * whiten[:, None], np.eye(state.design.shape[1])])
    return design, np.concatenate([p.residual * whiten, pull]), whiten


@pytest.fixture
def state():
    p = random_problem()
    start = np.ones(len(p.residual))
    start[[3, 17]] = 0.0
    return fit_state(p, [5], [0.5], start, robust=False)


def test_projection_is_that_of_the_augmented_normal_equations(state):
    design, residual, whiten = augmented(state)
    pool = np.vstack([state.problem.pool * whiten[:, None], np.zeros((design.shape[1], 6))])
    free = np.eye(len(design)) - design @ np.linalg.solve(design.T @ design, design.T)
    seen = evidence.project(state, state.problem.pool)
    every = np.arange(6)
    np.testing.assert_allclose(seen.information(every), pool.T @ free @ pool, atol=1e-9)
    np.testing.assert_allclose(seen.information(every[2:4]), (pool.T @ free @ pool)[2:4, 2:4], atol=1e-9)
    np.testing.assert_allclose(seen.score, -pool.T @ free @ residual, atol=1e-9)


def covariance_of(state, columns, scale):
    """Prior covariance of the whitened residuals with further columns, and the residuals less their mean."""
    p = state.problem
    design, _, whiten = augmented(state)
    keep = whiten > 0
    by = design[: len(whiten)][keep]
    pull = np.concatenate([p.z, np.zeros(len(state.columns))])
    y = (p.residual * whiten)[keep] - by @ pull
    x = (p.pool[:, columns] * whiten[:, None])[keep] * scale
    return y, by @ by.T + x @ x.T, by @ by.T


@pytest.mark.parametrize("columns", [[0], [1, 2], [0, 3, 4]])
def test_evidence_at_one_noise_is_the_ratio_of_two_normal_densities(state, columns):
    seen = evidence.project(state, state.problem.pool)
    values, vectors = np.linalg.eigh(seen.information(np.array(columns)))
    along = (vectors.T @ seen.score[columns]) ** 2
    for scale in evidence.SCALES:
        found = evidence.gain(values, along, scale**2, 0.0)
        y, with_it, without = covariance_of(state, columns, scale)
        unit = np.eye(len(y))
        more, less = (multivariate_normal.logpdf(y, cov=unit + cov) for cov in (with_it, without))
        assert found == pytest.approx(more - less, abs=1e-8)


def test_state_is_the_linear_fit_of_the_rows_that_it_kept():
    p = random_problem(amplitude=2.0)
    bad = np.array([4, 20, 41])
    residual = p.residual.copy()
    residual[bad] += [40.0, -25.0, 90.0]
    p = replace(p, residual=residual)
    found = fit_state(p, [0, 1], [1.0, 0.5])
    np.testing.assert_array_equal(np.flatnonzero(found.weight == 0), bad)
    assert found.gross == 3
    design, residual, whiten = augmented(found)
    step = np.linalg.lstsq(design, -residual, rcond=None)[0]
    np.testing.assert_allclose(found.step, step, atol=1e-8)
    np.testing.assert_allclose(found.residual, p.residual + found.design @ step, atol=1e-7)
    np.testing.assert_allclose(found.amplitudes, step[-2:] * [1.0, 0.5], atol=1e-8)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(design.T @ design), atol=1e-9)
    contacts = design[: p.count][found.weight[: p.count] > 0]
    taken = np.trace(contacts @ found.covariance @ contacts.T)
    assert found.effective_dof == pytest.approx(taken, abs=1e-6)
    chi2 = np.sum((found.residual * (whiten > 0))[: p.count] ** 2)
    dof = 60 - 3 - taken + STATED_WORTH
    assert found.dof == pytest.approx(dof, abs=1e-6)
    assert found.kappa == pytest.approx(np.sqrt((chi2 + STATED_WORTH) / dof), rel=1e-3)


@pytest.mark.parametrize("rows", [100, 5000, 50000])
@pytest.mark.parametrize("amplitude", [0.0, 0.1, 2.5, 6.0])
def test_evidence_is_the_integral_over_the_noise_however_many_contacts(rows, amplitude):
    """By a fine grid around the mode: to 0.05 nats of up to tens of thousands."""
    p = random_problem(rows=rows, constraints=0, amplitude=amplitude)
    state = fit_state(p, (), (), robust=False)
    seen, columns = evidence.project(state, p.pool), np.array([0, 3])
    (table,) = log_bayes(seen, [columns])
    values, vectors = np.linalg.eigh(seen.information(columns))
    along = (vectors.T @ seen.score[columns]) ** 2
    chi2 = (np.sum(state.residual**2) + STATED_WORTH) / state.kappa**2

    without, *exact = (
        exact_integral(values, along, square, state.dof, chi2) for square in (0.0, *evidence.SCALES**2)
    )
    np.testing.assert_allclose(table, np.array(exact) - without, rtol=0, atol=0.05)


def without_rows(p, gone):
    """A problem of contacts of one row each without some of them."""
    keep = np.setdiff1d(np.arange(len(p.residual)), gone)
    count = p.count - len(gone)
    at = np.arange(count)
    by = {name: getattr(p, name)[keep] for name in ("residual", "jacobian", "pool")}
    return replace(p, **by, contact=at, rows=at, sigma=p.sigma[:count])


def test_contacts_left_out_count_as_if_they_were_not_there(state):
    """Except for what an outlier costs: as much as a good contact just not rejected, once in 100 sessions."""
    gone = np.flatnonzero(state.weight == 0)
    rest = fit_state(without_rows(state.problem, gone), state.columns, state.scales, robust=False)
    assert state.kappa == pytest.approx(rest.kappa, rel=1e-9)
    sets = [np.array([0]), np.array([1, 2])]
    found, exact = (log_bayes(evidence.project(s, s.problem.pool), sets) for s in (state, rest))
    np.testing.assert_allclose(found, exact, atol=1e-7)
    cost = -0.5 * chi2_distribution.isf(0.01 / state.problem.count, 1)
    assert state.log_evidence - rest.log_evidence == pytest.approx(len(gone) * cost, abs=1e-6)


def test_many_columns_lose_by_the_noise_that_they_leave_unknown():
    """Evidences of a state of few and of many parameters differ by the integrals over the noise."""
    p = random_problem(rows=40, constraints=0, size=2, pool=20)
    few, many = (fit_state(p, range(k), np.ones(k), robust=False) for k in (0, 20))

    def density(log_noise, values, square, at):
        noise = np.exp(log_noise)
        own = -0.5 * np.sum(np.log(values + noise**2) + square / (values + noise**2))
        return np.exp(own - STATED_WORTH * log_noise - 0.5 * STATED_WORTH / noise**2 - at)

    exact = []
    for state in (few, many):
        values, vectors = np.linalg.eigh(state.design @ state.design.T)
        square = (vectors.T @ (p.residual - p.jacobian @ p.z)) ** 2
        at = np.log(density(np.log(state.kappa), values, square, 0.0))
        exact.append(at + np.log(quad(density, -2.0, 2.0, args=(values, square, at))[0]))
    assert many.log_evidence - few.log_evidence == pytest.approx(exact[1] - exact[0], abs=0.08)


def test_a_contact_of_three_rows_is_left_out_as_one():
    p = random_problem()
    residual = p.residual.copy()
    residual[10] += 60.0
    p = replace(p, residual=residual, contact=np.arange(60) // 3, rows=np.arange(20))
    found = fit_state(p, (), ())
    np.testing.assert_array_equal(np.flatnonzero(found.weight == 0), [9, 10, 11])
    assert found.gross == 1


def test_columns_of_masses_are_differences_of_gravity_moments(cube):
    dataset = cube(seed=3, count=24).dataset
    robot = dataset.robot
    delta = 1e-3 * np.random.default_rng(0).standard_normal((24, 8, 6))
    stance = Stance(delta, 0.0 * delta)
    known = {f"compliance {name}": 2e-5 for name in robot.joint_names}
    c = replace(circumstances(dataset), stance=stance, compliances=known)

    def torque(masses=robot.masses, centres=robot.centres_of_mass, load=c.load_mass, at=c.load_centre):
        changed = replace(robot, masses=masses, centres_of_mass=centres)
        return gravity_loads(changed, c.chain, c.q, c.gravity, load, at, stance).moments[:, 1:, 2]

    before, found = torque(), {p.name: p for p in mass_errors.masses(c)}
    assert len(found) > 10
    for name, p in found.items():
        words = name.split()
        axis = "xyz".find(words[-1])
        if words[2] == "load" and axis < 0:
            after = torque(load=c.load_mass * (1 + mass_errors.LOAD_SHARE))
        elif words[2] == "load":
            after = torque(at=c.load_centre + 4e-3 * np.eye(3)[axis])  # as well as a tool is drawn
        else:
            i = int(words[3]) - 1
            masses, centres = robot.masses.copy(), robot.centres_of_mass.copy()
            if axis < 0:
                masses[i] *= 1 + mass_errors.MASS_SHARE
            else:
                centres[i, axis] += mass_errors.MASS_SHARE * abs(centres[i, axis]) + mass_errors.CENTRE_OFF
            after = torque(masses, centres)
        turns = np.zeros((24, 6))
        for term in p.terms:
            turns[:, term.frame - 1] += term.driver * p.sd
        np.testing.assert_allclose(turns, 2e-5 * (after - before), atol=2e-11, err_msg=name)
    assert np.all(expected(robot) >= 0)


def test_nuisance_columns_come_last_and_can_be_taken_off(session):
    fitted = unsolved(session)
    masses = mass_errors.masses(circumstances(fitted.model.scene))
    wide = problem(fitted, [], masses)
    plain = without_nuisance(wide, fitted.model.size)
    np.testing.assert_array_equal(plain.jacobian, problem(fitted, []).jacobian)
    assert wide.jacobian.shape[1] == plain.jacobian.shape[1] + len(masses)


def test_a_shift_is_searched_beside_the_leading_effect():
    """Over noise only, a drift made other rows lead: the row of the shift was not tried."""
    bench, row = bench_of(tracker, 3, 110), 55.0
    c, step = bench.circumstances, EFFECTS["step"]
    own = [q for q in step.at(c, row) if q.site == BASE]
    p = bench.made_up(1, bench.of_effect("thermal-drift", 300.0, 2))
    p = replace(p, residual=p.residual + bench.visible(bench.slopes.columns(own), 80.0, 3))
    before = {"step": screening(step, bench.slopes, [fit_state(p, (), ())], c)}
    assert row not in before["step"].settings

    def decided(screenings):
        known = screened(candidates(c, BASELINE), screenings, c)
        found = replace(bench, known=known).decided(replace(p, pool=bench.slopes.columns(known.pool)))
        return SimpleNamespace(decision=found[0], search=found[1], pool=bench.pool, circumstances=c)

    first = decided(before)
    assert [m.effect for m in first.decision.members] == ["thermal-drift"]
    more = _screened_again(first, before, bench.slopes)
    assert row in more["step"].settings
    drift, shift = decided(before | more).decision.members
    assert (drift.effect, shift.effect) == ("thermal-drift", "step")
    assert abs(shift.variant.setting - row) <= 1.0


def test_a_shift_stays_where_others_beside_it_stood_for_an_unmodelled_effect():
    """Three shifts paid for three rows, and all were lost: two explained what a generic cell does."""
    bench, row = bench_of(tracker, 3, 110), 55.0
    own = [q for q in EFFECTS["step"].at(bench.circumstances, row) if q.site == BASE]
    known = extended(bench.known, EFFECTS["step"], [20.0, row, 90.0], bench.circumstances)
    cell = next(k for k, of in enumerate(bench.pool.cells) if of.site == joint(3) and len(of.sets[0]) > 3)
    index = int(np.flatnonzero(bench.pool.owner == cell)[0])
    p = bench.made_up(1, bench.visible(bench.columns(cell), 2000.0, 2))
    p = replace(p, residual=p.residual + bench.visible(bench.slopes.columns(own), 60.0, 3))
    search = Search(replace(p, pool=bench.slopes.columns(known.pool)), known)
    of_base = [v for v in known.variants["step"] if {site for site, _ in v.places} == {BASE}]
    one = next(v for v in of_base if v.setting == row)
    three = replace(one, setting=(), columns=np.concatenate([v.columns for v in of_base]))
    for variant, averaging, setting in ((one, -7.0, row), (three, 0.0, ()), (three, -25.0, row)):
        alone = search.hypothesis([Member(variant, 0.125, averaging)])
        best = Weighed(alone, CellFit(cell, 0.0, index, 1.0), 0.0, 0.0)
        member = _beside(search, best, bench.pool, best.hypothesis.members[0])
        assert member is not None
        assert member.variant.setting == setting


def with_gears(bench, p):
    """The bench and the problem with the ratios of gears that a screening over noise only leaves."""
    gear_mesh, c = EFFECTS["gear-mesh"], bench.circumstances
    screenings = {"gear-mesh": screening(gear_mesh, bench.slopes, [fit_state(p, (), ())], c)}
    known = screened(bench.known, screenings, c)
    return replace(bench, known=known), replace(p, pool=bench.slopes.columns(known.pool))


def test_screening_finds_the_ratios_of_gears(session):
    bench = Bench.of(replace(session, robot=replace(session.robot, reductions=None)))
    c = bench.circumstances
    assert "gear-mesh" not in candidates(c, BASELINE).variants
    own = [p for p in EFFECTS["gear-mesh"].at(c, 77.0) if p.site == joint(3)]
    p = bench.made_up(1, bench.visible(bench.slopes.columns(own), 150.0, 2))
    geared, p = with_gears(bench, p)
    settings = {v.setting for v in geared.known.variants["gear-mesh"]}
    assert 77.0 in settings
    assert len(settings) < 20
    (member,) = geared.decided(p)[0].members
    assert (member.effect, member.variant.setting, member.variant.site) == ("gear-mesh", 77.0, "joint 3")
    # Three gears: the screening finds the ratio of each, and `--model` takes what is found
    truth = {3: 77.0, 5: 50.0, 1: 121.0}
    p = bench.made_up(1)
    for j, ratio in truth.items():
        own = [q for q in EFFECTS["gear-mesh"].at(c, ratio) if (q.site, q.driver.order) == (joint(j), ratio)]
        p = replace(p, residual=p.residual + bench.visible(bench.slopes.columns(own), 120.0, j))
    geared, p = with_gears(bench, p)
    assert sum(np.exp(v.log_prior) for v in geared.known.variants["gear-mesh"]) <= 1.0
    decision, _ = geared.decided(p)
    (member,) = decision.members
    own = [geared.known.pool[k] for k in member.variant.columns]
    orders = {q.site.number: q.driver.order for q in own}
    assert (decision.kind, member.effect, orders) == ("named", "gear-mesh", truth)
    name = model_name(member, geared.known)
    again = [q.name for q in parameters_of((name,), c) if q.effect == "gear-mesh"]
    assert again == [q.name for q in own], name


@pytest.mark.parametrize("rows", [100, 5000])
def test_columns_explain_no_more_than_the_residuals(rows):
    """An effect 40 times the noise, of which the model's prior holds a part: the evidence stays bounded."""
    state = fit_state(random_problem(rows=rows, constraints=0, amplitude=40.0), (), (), robust=False)
    found = log_bayes(evidence.project(state, state.problem.pool), [np.array([0])])[0]
    chi2 = float(np.sum(state.residual[:rows] ** 2)) + STATED_WORTH
    assert np.all(found < 0.5 * state.dof * np.log(chi2 / STATED_WORTH))


# --- The compiled integral over the noise against a fine grid.


def exact_integral(values, along, square, dof, chi2):
    """Log of the integral over the noise's log precision, at a squared prior scale."""

    def density(log_precision):
        y = np.exp(log_precision)
        out = 0.5 * (dof * log_precision - chi2 * y)
        for b, a in zip(square * values, square * along, strict=True):
            out += 0.5 * (a * y**2 / (1 + b * y) - np.log1p(b * y))
        return out

    grid = np.linspace(-6.0, 6.0, 1201)
    grid = grid[np.argmax(density(grid))] + np.linspace(-12.0, 12.0, 4001) / np.sqrt(dof / 2)
    most = np.max(density(grid))
    return most + np.log(np.trapezoid(np.exp(density(grid) - most), grid))


def drawn(seed, count, k):
    """Information and squared scores of sets (count, k), from none to 1e5 times the noise."""
    rng = np.random.default_rng(seed)
    values = 10.0 ** rng.uniform(-3, 9, (count, k))
    values[::7, -1] = 0.0
    values[5:6] = 0.0
    along = values * rng.chisquare(1, (count, k)) * 10.0 ** rng.uniform(-3, 2.5, (count, 1))
    return values, along


NOISES = ((180, 175.0, 1e-6), (8, 30.0, 2e-3), (90, 3.0, 1e-6))
"""Degrees of freedom and chi-square of the noise, and error of the integral, nats."""


@pytest.mark.parametrize(("k", "dof", "chi2", "error"), [
    (k, *noise) for noise in NOISES for k in (1, 2, 6, 20) if k < noise[0]
])  # fmt: skip
def test_the_compiled_integral_is_that_of_a_fine_grid(k, dof, chi2, error):
    """Columns explain at most what the stated noise leaves of chi2."""
    (values, along), worth = drawn(k, 40, k), 5.0
    squares = evidence.SCALES**2
    found = evidence.integrated(
        values, along, squares, dof, chi2, worth, evidence.NODES, evidence.LOG_WEIGHTS
    )
    explained = np.sum(np.divide(along, values, where=values > 0, out=np.zeros_like(along)), axis=1)
    limited = along * np.minimum(1.0, max(chi2 - worth, 0.0) / np.maximum(explained, 1e-300))[:, None]
    for each, own, scores in zip(found, values, limited, strict=True):
        exact = [exact_integral(own, scores, square, dof, chi2) for square in squares]
        np.testing.assert_allclose(each, exact, rtol=0, atol=error)


def test_slopes_are_derivatives_of_a_gain():
    (values,), (along,) = drawn(6, 1, 4)
    for square in evidence.SCALES**2:
        less, here, more = (evidence.gain(values, along, square, 0.3 + step) for step in (-1e-3, 0.0, 1e-3))
        differences = (more - less) / 2e-3, (more - 2 * here + less) / 1e-6
        assert evidence._slopes(values, along, square, 0.3) == pytest.approx(differences, rel=1e-4)


def test_a_gain_is_right_where_a_product_overflows():
    (values,), (along,) = drawn(3, 1, 2000)
    for square in evidence.SCALES**2:
        by = square * np.exp(0.3)
        wanted = 0.5 * np.sum(along * by * np.exp(0.3) / (1 + by * values) - np.log1p(by * values))
        assert evidence.gain(values, along, square, 0.3) == pytest.approx(wanted, rel=1e-10)
