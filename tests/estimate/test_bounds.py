"""Positive parameters at their bound: against an independent solver, and what is left as it is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import refused
from scipy.optimize import lsq_linear
from scipy.stats import chi2
from sessions import circumstances, with_columns, with_rows

import bayescal as bc
from bayescal.arm.statics import torques_on_links
from bayescal.assess.acceptance import not_physical
from bayescal.dataset import Noise, read_dataset, write_dataset
from bayescal.dataset.join import joined
from bayescal.effects.gravity import masses
from bayescal.errors import BayescalError
from bayescal.estimate import Weights, calibrated, estimate
from bayescal.estimate.bounds import UNCHANGED, bounded, negative
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.unexplained import Unexplained, repeat_scatter, scatter, unexplained
from bayescal.gap.candidate_contacts import widened
from bayescal.gap.search.cells import cells
from bayescal.model import FitOptions, Scene, build
from bayescal.posterior import approximate
from bayescal.simulation import Options, simulate, touch

MODEL = ("geometry", "compliance")


@pytest.fixture(scope="module")
def free():
    """The fit without bounds of a rigid arm: some of its compliances are negative."""
    session = bc.simulate(effects="geometry", contacts=60, later=0, repeats=0, spheres=0, seed=1, noise=2e-5)
    return calibrated(Scene(session.dataset, oriented=True), MODEL)


@pytest.fixture(scope="module")
def held(free):
    """With bounds."""
    return bounded(free)


def physical(found):
    return dict(zip(found.model.names, found.model.physical(found.z), strict=True))


def test_nothing_is_negative_and_what_was_is_zero(free, held):
    out, rigid = held
    before, after = physical(free), physical(out)
    names = [p.name for p in free.model.parameters if p.positive]
    assert min(before[n] for n in names) < 0
    assert min(after[n] for n in names) >= -1e-12
    assert out.held == tuple(n.parameter for n in rigid.parameters) != ()
    assert all(abs(after[n.parameter]) < 1e-12 and n.value == before[n.parameter] for n in rigid.parameters)
    assert 0 < rigid.distance_rms < rigid.distance_max < 1e-3
    assert rigid.words.startswith(f"set to rigid, because not distinguishable from 0: {out.held[0]} -")


def test_the_optimum_is_that_of_an_independent_solver(free, held):
    """Bounded least squares of the linearised problem, with the prior as rows (scipy's trust region)."""
    model, size = free.model, free.model.size
    rows = np.vstack([free.linear.jacobian, np.eye(size)])
    right = np.concatenate([free.linear.jacobian @ free.z - free.linear.residual, np.zeros(size)])
    low = np.full(size, -np.inf)
    for k, p in enumerate(model.parameters):
        if p.positive:
            low[k] = -p.centre / p.sd
    best = lsq_linear(rows, right, (low, np.full(size, np.inf)), tol=1e-12).x
    assert np.max(np.abs(held[0].z - best) / free.sd) < 0.05
    assert np.max(np.abs(best - free.z) / free.sd) > 0.3  # the bound matters here


def test_the_uncertainty_stays(free, held):
    """About the bound, u is that of the fit without it."""
    ratio = held[0].sd / free.sd
    assert np.all((ratio > 0.9) & (ratio < 1.1))


def test_draws_are_about_the_bounded_estimate(free, held):
    z, _ = approximate(held[0], 1, 4000)
    assert np.max(np.abs(np.mean(z, axis=0) - held[0].z) / held[0].sd) < 0.1
    z, _ = approximate(free, 1, 4000)
    assert np.max(np.abs(np.mean(z, axis=0) - free.z) / free.sd) < 0.1


def test_significant_values_are_left():
    """Of an arm whose gravity is stated upside down: its joints seem to turn against their torques."""
    session = bc.simulate(contacts=60, later=0, repeats=0, spheres=0, seed=1).dataset
    out, rigid = bounded(calibrated(Scene(replace(session, gravity=-session.gravity), oriented=True), MODEL))
    u = np.sqrt(np.diag(stated(out).limited)[: len(out.arm)]) * out.model.sd
    below = negative(out.model.parameters, out.arm, u)
    assert {"compliance J2", "compliance J3"} <= {n.parameter for n in below if n.significant}
    assert {n.parameter for n in below}.isdisjoint({n.parameter for n in rigid.parameters})
    assert below[0].limit == pytest.approx(2.61, abs=0.01)  # of five compliances
    (fault,) = not_physical(out, stated(out).limited)
    assert fault.words.count("compliance J") == 2
    assert fault.words.endswith("the model lacks an effect, or masses are wrong: run bayescal gap")


def test_a_fit_without_negative_values_is_unchanged(free):
    z = free.z.copy()
    for k, p in enumerate(free.model.parameters):
        if p.positive:
            z[k] = 0.0
    good = replace(free, z=z)
    assert bounded(good) == (good, UNCHANGED)


def test_values_that_are_negative_together_are_left(free, held):
    """Each within its u, but all of them at 1.9 u below zero by chance are less probable than one at 2 u."""
    out, names = held[0], [p.name for p in free.model.parameters if p.positive]
    z = out.z.copy()
    for k, p in enumerate(out.model.parameters):
        if p.positive:
            z[k] = (-1.9 * out.sd[k] * p.sd - p.centre) / p.sd
    apart = np.diag(np.diag(out.covariance))
    (fault,) = not_physical(replace(out, z=z), apart)
    assert fault.words.startswith("negative together beyond their u")
    assert fault.p_value == pytest.approx(chi2.sf(len(names) * 1.9**2, len(names)), rel=1e-6)
    assert fault.p_value < fault.level
    assert fault.value > fault.limit
    assert not_physical(out, out.covariance) == ()


# --- Measured joint torques in place of computed ones: an oracle of a load that the masses do not state.

BOTH = ("geometry", "compliance")
NOISE = 2e-6  # m


@pytest.fixture(scope="module")
def pulled():
    """A session with up to three kilograms on the flange that its table does not state; torques measured."""
    s = simulate(Options(seed=2, contacts=160, repeats=0, later=0, placements=0, noise=NOISE))
    count = len(s.exact.measurements.ids)
    heavier = with_columns(s.exact, payload=np.random.default_rng(0).uniform(0.0, 3.0, count))
    exact = touch(s.world, heavier, s.shift)
    on_links = s.world.model(exact).scene.moments[:, 1:, 2]
    signs = np.sign(np.diag(exact.robot.link_from_reading))
    table = replace(exact.measurements, payload=None, torque=on_links * signs)
    return replace(exact, measurements=table, torques="measured")


def scale(dataset):
    """Noise of contacts, as a multiple of the stated one."""
    return calibrated(Scene(dataset), BOTH, FitOptions(robust=False)).weights.scale["contact"]


def test_a_load_that_only_the_torques_show(pulled):
    assert scale(pulled) < 1.15
    assert scale(replace(pulled, torques="computed")) > 10


def test_no_masses_are_needed(pulled):
    assert scale(replace(pulled, robot=replace(pulled.robot, masses=None, centres_of_mass=None))) < 1.15


def test_torques_drive_effects_and_cells(pulled):
    c = circumstances(pulled)
    np.testing.assert_array_equal(c.torques, torques_on_links(pulled.robot, pulled.measurements.torque))
    assert not np.allclose(c.torques, c.moments[:, 1:, 2], atol=1.0)
    without = circumstances(replace(pulled, robot=replace(pulled.robot, masses=None, centres_of_mass=None)))
    wanted = {str(cell.driver) for cell in cells(without) if cell.driver.kind == "torque"}
    assert {"torque 3", "past torque 3", "torque 3, by its angle"} <= wanted
    # Measured torques contain every mass: no error of a mass turns a joint; no payload is a candidate
    assert not masses(c)
    assert masses(circumstances(replace(pulled, torques="computed")))
    scene = Scene(pulled)
    _, choices = widened(scene, scene.rows("calibrate")[:5])
    assert not any("payload" in choice.what for choice in choices)


def test_torques_of_coupled_axes(pulled):
    """By the power: a linkage adds the torque of the forearm to J2, a display does not."""
    robot = pulled.robot
    torque, rate = np.random.default_rng(1).standard_normal((2, 5, robot.n))
    linked = torques_on_links(replace(robot, coupling="mechanical"), torque)
    power = np.sum(torque * rate, axis=1)
    np.testing.assert_allclose(np.sum(linked * (rate @ robot.link_from_reading.T), axis=1), power)
    shown = torques_on_links(replace(robot, coupling="display"), torque)
    np.testing.assert_array_equal(np.abs(shown), np.abs(torque))


def test_files_state_them(pulled, tmp_path):
    write_dataset(pulled, tmp_path / "session")
    back = read_dataset(tmp_path / "session")
    assert back.torques == "measured"
    np.testing.assert_allclose(back.measurements.torque, pulled.measurements.torque, atol=1e-6)
    with pytest.raises(BayescalError, match=r"`torques` is computed, .* it is measured"):
        joined([pulled, replace(pulled, name="other", torques="computed")])


@pytest.mark.parametrize(("torque", "words"), [
    (lambda t: None, "no columns `j1_nm`"), (lambda t: -t, "`j2_nm`.*: opposite in sign"),
])  # fmt: skip
def test_torques_that_are_missing_or_opposed(pulled, torque, words, tmp_path):
    table = replace(pulled.measurements, torque=torque(pulled.measurements.torque))
    write_dataset(replace(pulled, measurements=table), tmp_path / "session")
    assert "dataset.yaml" in str(refused(words, lambda: read_dataset(tmp_path / "session")))


# --- What a fit leaves beyond the noise: what is called noise, and from when on an excess is claimed.

UNEXPLAINED_NOISE, VALIDATE = 6e-6, 60


def fit_that_leaves(ratio: float, dof: float, stated: float = 5e-6):
    """A fit of contacts without repeats whose residuals are `ratio` times as large as stated."""
    scene = SimpleNamespace(dataset=SimpleNamespace(measurements=SimpleNamespace(repeat=None)))
    block = SimpleNamespace(name="face", group="contact")
    weights = Weights({"face": np.full(30, stated)}, {"face": np.ones(30)}, {"contact": ratio})
    model = SimpleNamespace(scene=scene, blocks=(block,))
    return SimpleNamespace(model=model, weights=weights, dof={"contact": dof})


@pytest.mark.parametrize(("ratio", "dof", "excess"), [
    (1.3, 1e5, 0.0),  # a stated noise may be 1.4 times too small
    (2.0, 1e3, np.sqrt(3.0)),  # the difference of squares
    (1.45, 20.0, 0.0),  # noise leaves that much in every third such fit
    (1.8, 20.0, 0.0),  # and that much in 2 of 100
    (1.95, 20.0, np.sqrt(1.95**2 - 1)),  # and that in 3 of 1000
    (0.5, 1e3, 0.0),
])  # fmt: skip
def test_an_excess_is_what_no_noise_explains(ratio, dof, excess):
    found = unexplained(fit_that_leaves(ratio, dof))
    assert found.excess == pytest.approx(excess * 5e-6)
    assert found.fitted == pytest.approx(ratio * 5e-6)
    assert found.floor == 5e-6
    assert (found.fitted / found.stated > found.limit(1e-2)) == (excess > 0)


def test_degrees_of_freedom_of_an_excess_are_those_of_drawn_differences():
    """Of two estimated variances: the square of the mean over half the variance, of their difference."""
    rng = np.random.default_rng(0)
    for repeats, of in ((None, 1), (5e-6, 6)):
        own = Unexplained("contact", 5e-6, repeats, of, 8e-6, 0.0, 0.0, 20.0)
        square = own.fitted**2 * rng.chisquare(20.0, 20_000) / 20.0 - own.floor**2
        if repeats:
            square += own.floor**2 - own.floor**2 * rng.chisquare(of, 20_000) / of
        assert own.excess_dof == pytest.approx(2 * np.mean(square) ** 2 / np.var(square), rel=0.1)


@pytest.fixture(scope="module")
def fitted(cube):
    """300 contacts whose noise is twice as large as stated, the last kept back."""
    d = cube(seed=4, count=300, noise=UNEXPLAINED_NOISE, stated=UNEXPLAINED_NOISE / 2).dataset
    role = np.where(np.arange(300) < 300 - VALIDATE, "calibrate", "validate")
    return estimate(build(Scene(with_columns(d, role=role)), ("geometry", "compliance")))


def in_pairs(fitted, roles):
    """The session with contacts of the same face and role said to repeat each other, two and two."""
    d = fitted.model.scene.dataset
    m = d.measurements
    repeat, pairs = np.full(len(m.ids), "", dtype="<U20"), 0
    for role in roles:
        for target in range(4):
            rows = np.flatnonzero((m.role == role) & (m.target == target))
            rows = rows[: len(rows) // 2 * 2]
            repeat[rows] = [f"{role}{k // 2}" for k in range(len(rows))]
            pairs += len(rows) // 2
    return with_columns(d, repeat=repeat), pairs


def test_the_scatter_of_pairs_is_the_noise_of_one_contact(fitted):
    """A pair deviates from its own mean by 1 / sqrt(2) of it."""
    session, pairs = in_pairs(fitted, ("calibrate", "validate"))
    scatter, dof = repeat_scatter(Scene(session), fitted)
    assert dof == pairs
    assert pairs > 140
    assert scatter == pytest.approx(UNEXPLAINED_NOISE, rel=0.12)


def test_repeats_of_validation_rows_count_and_a_slip_does_not(fitted):
    session, pairs = in_pairs(fitted, ("validate",))
    m = session.measurements
    clean, dof = repeat_scatter(Scene(session), fitted)
    assert dof == pairs
    assert clean == pytest.approx(UNEXPLAINED_NOISE, rel=0.3)
    readings = m.readings.copy()
    readings[np.flatnonzero(m.repeat == "validate0")[0], :3] += 1e-3
    slipped, _ = repeat_scatter(Scene(with_columns(session, readings=readings)), fitted)
    assert slipped == pytest.approx(clean, rel=0.1)


def test_repeated_points_tell_noise_that_is_larger_than_stated(tracker):
    """Sessions of noise above the stated one were refused, although points read again showed it."""
    whole = tracker(seed=5, count=60, noise=1.6e-5)
    rows, rng = np.r_[np.arange(60), np.repeat(np.arange(8), 3)], np.random.default_rng(0)
    session = with_rows(whole.dataset, rows, tuple(f"m{k}" for k in range(len(rows))))
    xyz = session.measurements.xyz.copy()
    xyz[60:] = whole.exact[rows[60:]] + 1.6e-5 * rng.standard_normal((24, 3))
    again = np.where((np.arange(84) < 8) | (np.arange(84) >= 60), rows.astype("<U20"), "")
    session = with_columns(session, xyz=xyz, repeat=again)
    stated = {s: replace(session, noise=Noise(point=s)) for s in (8e-6, 3e-5)}
    found = {s: unexplained(calibrated(Scene(d, oriented=True), MODEL)) for s, d in stated.items()}
    assert found[8e-6].repeats == pytest.approx(1.6e-5, rel=0.2)
    assert found[8e-6].repeats_dof == 3 * 24
    assert found[8e-6].excess == 0.0
    assert "the scatter of repeated points" in found[8e-6].words
    assert found[3e-5].repeats is None  # an arm that stands still does not show how well it comes back
    alone = replace(stated[8e-6], measurements=replace(stated[8e-6].measurements, repeat=None))
    assert unexplained(calibrated(Scene(alone, oriented=True), MODEL)).p_value < 0.01


def test_few_repeats_of_normal_noise_lose_none():
    """Of 500 sessions with five pairs; a limit of four robust standard deviations lost some in 27 of them."""
    rng, lost = np.random.default_rng(0), 0
    for _ in range(500):
        groups = list(rng.standard_normal((5, 2)))
        size = np.sqrt(2.0 * np.mean([(g - g.mean()) ** 2 for g in groups]))
        lost += scatter(groups)[0] < size - 1e-9
    assert lost <= 5


def test_a_row_weight_divides_the_variance():
    block = SimpleNamespace(name="face", group="contact", kind=SimpleNamespace(rows=3))
    weights = Weights({"face": np.full(6, 2.0)}, {"face": np.array([1.0, 0.25])}, {"contact": 5.0})
    np.testing.assert_allclose(weights.whitening(block), np.tile([0.1, 0.05], 3))
