"""The uncertainty budget: its sum is what a fit states, and each contribution is what a refit shows."""

import csv
import json
import re
from dataclasses import replace
from importlib import import_module
from io import StringIO

import numpy as np
import pytest
from cases import cases, terminal_text
from scipy.stats import chi2
from scipy.stats import t as student
from sessions import plain, validating, with_columns

import bayescal as bc
from bayescal.assess.budget import COVERAGE, Budget, Component, budget, correlations, of_distances
from bayescal.assess.budget import usual as budgets
from bayescal.assess.inputs import CERTIFICATE, MASSES, NOISE, PRIOR, PROBING, READINGS, Basis, Input
from bayescal.assess.measurand import Measurand, certified_distances, distance, parameter, readings, volume
from bayescal.calibration import VALIDATION_DRAWS, fit
from bayescal.compensating.position import lost_motion, point
from bayescal.estimate import calibrated, estimate
from bayescal.estimate.discrepancy import stated
from bayescal.fitted.arm import of_fit
from bayescal.fitted.file import open_run, restored
from bayescal.model import FitOptions, Scene, with_parameters
from bayescal.reporting.figures.where import budget_panel
from bayescal.reporting.fit.files import budget_table, measurand_record
from bayescal.simulation import Options, simulate

MODEL = ("geometry", "compliance")


@pytest.fixture(scope="module")
def fitted(usual_draws):
    """Without the compliance of the arm, so that there is a discrepancy and an unexplained error."""
    # noise of contacts and of joint readings, spheres, and an effect that the model lacks
    session = simulate(
        Options(effects=MODEL, contacts=80, later=10, repeats=5, spheres=3, placements=2, joint_noise=2e-5,
                seed=1)
    ).dataset  # fmt: skip
    return fit(session, ("geometry",), FitOptions(seed=1), samples=2500)


def of(inputs, group):
    return sum(p.by @ p.by.T for p in inputs if p.input.group == group)


def test_inputs_add_up_to_the_stated_covariance(fitted):
    """Including the functions of the discrepancy, which this session has."""
    assert fitted.stated.families
    inputs = fitted.basis.propagated
    sd = np.sqrt(np.diag(fitted.stated.wide.covariance))
    total = sum(p.by @ p.by.T for p in inputs)
    covariance = fitted.stated.wide.covariance
    np.testing.assert_allclose(total / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=1e-5)
    assert {NOISE, READINGS, CERTIFICATE, PRIOR, "model discrepancy"} == {p.input.group for p in inputs}
    names = {p.input.name for p in inputs if p.input.group == "model discrepancy"}
    assert names == {f"model discrepancy: {name}" for name in fitted.stated.families}


def test_errors_of_masses_are_an_input_of_a_fit_with_compliance(plain_session):
    """Beside all others, so that the sum is again what is stated."""
    basis = Basis(stated(calibrated(Scene(plain_session, oriented=True), MODEL)))
    covariance = basis.stated.wide.covariance
    sd = np.sqrt(np.diag(covariance))
    total = sum(p.by @ p.by.T for p in basis.propagated)
    np.testing.assert_allclose(total / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=1e-5)
    of_masses = component(budget(basis, parameter(basis, "compliance J3")), MASSES)
    assert of_masses.input.evaluation == "B"
    k = basis.stated.plain.model.names.index("compliance J3")
    u = basis.stated.plain.model.sd[k] * basis.stated.inputs.variances[k] ** 0.5
    assert of_masses.contribution == pytest.approx(u, rel=1e-6)


def test_contributions_add_up(fitted):
    """In quadrature, to the stated variance of a parameter; by targets to each contribution."""
    model = fitted.final.estimate.model
    for name in ("a2", "theta4", "d2"):
        k = model.names.index(name)
        b = budget(fitted.basis, parameter(fitted.basis, name))
        assert b.u == pytest.approx(model.sd[k] * fitted.stated.limited[k, k] ** 0.5, rel=1e-6)
        np.testing.assert_allclose(b.u**2, sum(c.contribution**2 for c in b.components), rtol=1e-6)
        for c in b.components:
            if c.by_target:
                parts = [own**2 for _, own in c.by_target]
                np.testing.assert_allclose(c.contribution**2, sum(parts), rtol=1e-6)


def test_parts_by_target_add_up_for_any_one_of_several_distances(fitted):
    parted = [c for c in budget(fitted.basis, volume(fitted.basis)).components if c.by_target]
    assert parted
    for c in parted:
        np.testing.assert_allclose(c.contribution**2, sum(own**2 for _, own in c.by_target), rtol=1e-6)


def test_sum_is_that_of_the_posterior(fitted):
    """Within 5 %, for every parameter of the arm and every certified distance."""
    model, draws = fitted.final.estimate.model, fitted.draws
    assert draws.acceptance  # sampled, not the Gaussian approximation
    sd = np.std(model.physical(draws.flat), axis=0)
    for k, p in enumerate(model.parameters):
        u = budget(fitted.basis, parameter(fitted.basis, p.name)).u
        assert u == pytest.approx(sd[k], rel=0.05), p.name
    pairs = certified_distances(fitted.basis)
    assert len(pairs) == len(fitted.final.validation.distances) == 6
    for pair, drawn in zip(pairs, fitted.final.validation.distances, strict=True):
        m = distance(fitted.basis, pair)
        assert m.value == pytest.approx(drawn.error)
        assert budget(fitted.basis, m).u == pytest.approx(np.std(drawn.predicted), rel=0.05)


def test_what_is_listed_are_the_largest_correlations_and_errors(fitted):
    arm = fitted.basis.stated.plain.model.slices["arm"]
    covariance = fitted.basis.stated.limited[arm, arm]
    size = np.abs(covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance))))
    listed_sizes = [abs(r) for *_, r in correlations(fitted.basis)]
    largest = np.sort(size[np.triu_indices(len(size), 1)])[::-1]
    assert listed_sizes == pytest.approx(largest[: len(listed_sizes)])
    every = {name: b.measurand.value for name, b in of_distances(fitted.basis).items()}
    own = [abs(b.measurand.value) for b in budgets(fitted.basis) if b.measurand.value is not None]
    assert own == pytest.approx(sorted(map(abs, every.values()))[::-1][: len(own)])
    assert 0 < len(own) < len(every)


def test_volume_is_that_of_the_forecast(fitted):
    """As the summary states it, where a single direction may hold most of the variance: of many draws."""
    space = fitted.forecast.workspace
    assert budget(fitted.basis, volume(fitted.basis)).u == pytest.approx(space.rms, rel=0.05)
    assert budget(fitted.basis, volume(fitted.basis)).u == space.u
    assert len(space.draws) == VALIDATION_DRAWS


def measured(dataset, pair):
    """Distance that the calibrated arm measures, m, and the budget's basis."""
    basis = Basis(stated(calibrated(Scene(dataset, oriented=True), MODEL, FitOptions(robust=False))))
    m = distance(basis, pair)
    return m.value, basis, m


def component(b, text):
    (found,) = [c for c in b.components if text in c.input.name]
    return found


def test_a_large_session_is_summed_in_parts(fitted, monkeypatch):
    of_volume = volume(fitted.basis)
    whole = budget(fitted.basis, of_volume)
    module = import_module("bayescal.assess.budget")  # the package has a function of this name
    monkeypatch.setattr(module, "MOST_VALUES", 7 * len(of_volume.by_z))
    parts = budget(fitted.basis, of_volume)
    assert parts.u == pytest.approx(whole.u, rel=1e-12)
    for one, other in zip(whole.components, parts.components, strict=True):
        assert other.contribution == pytest.approx(one.contribution, rel=1e-12)
        assert dict(other.by_target) == pytest.approx(dict(one.by_target), rel=1e-12)


@pytest.fixture(scope="module")
def plain_session():
    few = Options(contacts=90, later=4, repeats=2, spheres=2, placements=1, noise=2e-6, seed=7)
    return simulate(few).dataset


def test_a_certificate_in_error_by_its_u_moves_the_distance_by_its_contribution(plain_session):
    pair = ("ball.A@1", "ball.B@1")
    before, basis, m = measured(plain_session, pair)
    b = budget(basis, m)
    for text in ("distance cube", "diameter ball.A@1"):
        own = component(b, f"certificate: {text}")
        assert own.sensitivity * own.input.u == pytest.approx(np.sign(own.sensitivity) * own.contribution)
    own = component(b, "certificate: distance cube")
    k = next(k for k, c in enumerate(plain_session.certificates) if c.kind == "parallel")
    entry = plain_session.certificates[k]
    step = 0.2 * own.input.u
    entries = list(plain_session.certificates)
    entries[k] = replace(entry, distance=entry.distance + step)
    after, _, _ = measured(replace(plain_session, certificates=tuple(entries)), pair)
    # a longer certified distance makes the arm longer
    assert after - before == pytest.approx(abs(own.sensitivity) * step, rel=0.02)


def test_a_prior_value_off_by_its_u_moves_a_parameter_by_its_contribution(plain_session):
    """d2 and d3 of parallel axes: only their sum is identifiable, the rest is from the robot file."""
    found = stated(calibrated(Scene(plain_session, oriented=True), MODEL, FitOptions(robust=False)))
    m = parameter(Basis(found), "d2")
    own = component(budget(Basis(found), m), "prior value of d2")
    step = 0.1 * own.input.u
    robot = plain_session.robot
    d = robot.d.copy()
    d[1] += step
    moved = replace(plain_session, robot=replace(robot, d=d))
    again = parameter(
        Basis(stated(calibrated(Scene(moved, oriented=True), MODEL, FitOptions(robust=False)))), "d2"
    )
    assert again.value - m.value == pytest.approx(own.sensitivity * step, rel=0.02)
    assert own.contribution == pytest.approx(abs(own.sensitivity) * own.input.u)


def test_noise_by_monte_carlo(tracker):
    """JCGM 101: the measurement repeated with other noise, and fitted each time."""
    dataset, u = tracker(0, 30).dataset, 10e-6
    some = calibrated(Scene(dataset), ("joint",)).model.parameters
    model = with_parameters(Scene(dataset), ("joint",), some)
    block, state = model.blocks[0], np.zeros(6)
    # what the instrument reads of the arm as the model has it
    p = block.seen(model.deviations(np.zeros(len(some))))
    exact = replace(block.kind, xyz=0.0 * block.kind.xyz).residual(block.state(state), p).T

    def fitted_to(xyz):
        again = with_columns(dataset, xyz=xyz)
        return estimate(with_parameters(Scene(again), ("joint",), some), robust=False)

    noise = u * np.random.default_rng(5).standard_normal((100, *exact.shape))
    values = [fitted_to(exact + own).arm for own in noise]
    one = fitted_to(exact + noise[0])
    plain = one.covariance @ one.linear.jacobian.T
    basis = Basis(replace(stated(one), noise=plain, noise_rows=np.tile(block.rows, 3)))
    for name, sd in zip(model.names, np.std(values, axis=0), strict=False):
        own = component(budget(basis, parameter(basis, name)), "noise of points")
        assert own.contribution * u / own.input.u == pytest.approx(sd, rel=0.25), name


def of_size(contributions, any_of=False, count=1):
    """A budget of components (contribution, degrees of freedom) of independent estimates."""
    m = Measurand("distance", "d", "m", 0.0, np.zeros((count, 1)), (), any_of)
    each = tuple(
        Component(Input(NOISE, f"n{k}", "A", "m", 0.0, c, dof), c, 1.0)
        for k, (c, dof) in enumerate(contributions)
    )
    u = np.sqrt(sum(c**2 for c, _ in contributions))
    return Budget(m, each, np.full(count, u if any_of else u / np.sqrt(count)), ())


@pytest.mark.parametrize(
    ("dof", "k"), [(1, 13.97), (5, 2.65), (10, 2.28), (20, 2.13), (50, 2.05), (np.inf, 2.0)]
)
def test_coverage_factor_is_that_of_the_guide(dof, k):
    """JCGM 100, table G.2, p = 95.45 %."""
    assert round(of_size([(1e-6, dof)]).k, 2) == k
    assert round(of_size([(1e-6, dof)], any_of=True, count=3).k, 2) == k


def test_effective_degrees_of_freedom():
    """JCGM 100, G.4.1, with the figures of its example: u = 1 and 2 of 5 and 10 degrees of freedom."""
    b = of_size([(1.0, 5), (2.0, 10), (3.0, np.inf)])
    assert b.dof == pytest.approx(14.0**2 / (1 / 5 + 16 / 10))
    assert b.k == pytest.approx(student.ppf(0.5 + COVERAGE / 2, b.dof))


def test_length_of_a_vector():
    """Three equal coordinates: chi of three degrees of freedom."""
    assert of_size([(1.0, np.inf)], count=3).k == pytest.approx(np.sqrt(chi2.ppf(COVERAGE, 3) / 3), rel=1e-5)


def test_inputs_with_one_estimate_of_their_size_count_once():
    """Two halves of a component have the degrees of freedom of the whole."""
    whole = of_size([(5.0, 8)])
    halves = of_size([(3.0, 8), (4.0, 8)])
    shared = tuple(replace(c, input=replace(c.input, scale="contact")) for c in halves.components)
    assert replace(halves, components=shared).dof == pytest.approx(whole.dof)
    assert halves.dof > whole.dof


def test_the_table_states_the_sensitivities_of_the_record():
    """A contribution of 2 um by an angle of 0.01 deg and by a length of 4 um."""
    m = Measurand("parameter", "x", "m", 1e-4, np.ones((1, 1)))
    angle = Input(PRIOR, "angle", "B", "rad", 0.0, np.radians(0.01), np.inf)
    length = Input(PRIOR, "length", "B", "m", 0.0, 4e-6, np.inf)
    each = tuple(Component(source, 2e-6, 2e-6 / source.u) for source in (angle, length))
    b = Budget(m, each, np.full(1, np.sqrt(8e-12)), ())
    components = measurand_record(b)["components"]
    assert [c["sensitivity"] for c in components] == pytest.approx([0.2, 0.5])  # mm/deg, mm/mm
    lines = terminal_text(budget_table(b), 120).splitlines()
    for name, words in (("angle", " 0.2 mm/"), ("length", " 0.5 ")):
        assert any(line.startswith(name) and words in line for line in lines), lines


def test_the_table_states_the_share_of_each_variance():
    """3 and 4 um are 36 and 64 % of 25 um^2."""
    text = terminal_text(budget_table(of_size([(3e-6, 8), (4e-6, 9)])), 120)
    assert dict(re.findall(r"^(n\d) .* (\d+) %$", text, re.MULTILINE)) == {"n0": "36", "n1": "64"}


def test_components_that_are_not_shown_are_stated_together():
    """Their variances add; on the figure, too, the shares of all are 100 %."""
    small = 5e-7
    b = of_size([(8e-6, 9), *[(small / 3, 9)] * 9, (6e-6, 9)])
    text = terminal_text(budget_table(b), 120)
    said = re.search(r"^9 smaller components +(\S+) ", text, re.MULTILINE)
    assert float(said[1]) == pytest.approx(1e6 * small)
    drawn = [bar.text for bar in bars_of(measurand_record(of_size([(8e-6, 9), (6e-6, 9)])))]
    assert drawn == ["8 µm, 64 %", "6 µm, 36 %"]


def bars_of(record):
    """The bars of a figure of a budget, by their rows."""
    with pytest.MonkeyPatch.context() as m:
        m.setattr("bayescal.reporting.figures.where.bars_panel", lambda bars, *_: bars)
        return budget_panel(record)


def test_a_payload_is_part_of_the_point_that_is_asked_for(run):
    """Of an arm that yields."""
    bare, loaded = (bc.budget(run, point=COMMAND_READINGS, payload_kg=kg) for kg in (0.0, 5.0))
    assert np.linalg.norm(loaded.data.measurand.position - bare.data.measurand.position) > 1e-6


def test_readings_of_an_instrument(tracker):
    """Distances between validation readings, as the forecast draws them."""
    found = fit(validating(tracker(1, 90).dataset, 3), ("geometry",), samples=0)
    m = readings(found.basis)
    read = found.forecast.checked[0]
    assert read.over == "readings of the instrument"
    assert len(m.by_z) == read.count
    b = budget(found.basis, m)
    assert b.u == pytest.approx(np.sqrt(np.mean(np.var(read.errors, axis=0))), rel=0.05)
    np.testing.assert_allclose(b.spread, np.std(read.errors, axis=0), rtol=0.2)
    noise = [c.input.u for c in b.components if c.input.group == PROBING and c.input.unit == "m"]
    assert noise == pytest.approx([found.final.unexplained.fitted], rel=0.3)  # of one coordinate


# --- `bayescal budget` on run folders: the numbers of the fit, without a new fit.

OPTIONS = {"contacts": 60, "later": 10, "repeats": 5, "spheres": 2, "placements": 1, "seed": 1}
COMMAND_READINGS = np.array([10.0, 20.0, -30.0, 40.0, 50.0, 60.0])


@pytest.fixture(scope="module")
def command_fit():
    """Other priors than the default, and an effect that depends on the direction of motion."""
    session = bc.simulate(effects="geometry, compliance, backlash", joint_noise=1e-5, **OPTIONS)
    return bc.fit(session, "geometry, compliance, backlash at joint 2", samples=0, prior_width=1.5)


@pytest.fixture(scope="module")
def run(command_fit, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "fit"
    command_fit.save(folder, pictures=False)
    return folder


def test_what_a_folder_restores_is_the_fit(command_fit, run):
    found, fit = restored(open_run(run)), command_fit.data.final.estimate
    np.testing.assert_allclose(found.z, fit.z, atol=1e-9)
    assert found.weights.scale == pytest.approx(fit.weights.scale, rel=1e-3)
    np.testing.assert_allclose(found.sd, fit.sd, rtol=1e-3)


@pytest.mark.parametrize("asked", [
    {}, {"parameter": "a2"}, {"distance": ("ball.A@1", "ball.B@1")}, {"point": COMMAND_READINGS},
], ids=["headline", "parameter", "distance", "point"])  # fmt: skip
def test_a_folder_has_the_budgets_of_its_fit(command_fit, run, asked):
    of_folder, of_result = bc.budget(run, **asked), bc.budget(command_fit, **asked)
    assert pytest.approx(of_result.U, rel=2e-3) == of_folder.U
    assert list(of_folder.components.index) == list(of_result.components.index)


def test_the_command(command_fit, run, output_of):
    text = output_of("budget", run, "--to", "json")
    record, written = json.loads(text), json.loads((run / "budget.json").read_text())
    assert record["measurand"] == written["measurand"] == written["budgets"][0]["measurand"]
    assert record["U_um"] == pytest.approx(written["U_um"], rel=2e-3)
    for name in ("schema", "measurand", "components", "u_um", "U_um", "k", "coverage"):
        assert name in written
    keys = {"name", "type", "distribution", "value", "u", "unit", "sensitivity", "contribution_um"}
    assert all(keys <= c.keys() for c in written["components"])
    total = sum(c["contribution_um"] ** 2 for c in written["components"]) ** 0.5
    assert total == pytest.approx(written["u_um"])
    assert written["U_um"] == pytest.approx(written["k"] * written["u_um"])
    text = output_of("budget", run, "--parameter", "theta4")
    assert "U = k u" not in text
    assert "parameter theta4" in text
    assert max(map(len, text.splitlines())) <= 80
    shares = [int(n) for n in re.findall(r"(\d+) %$", text.partition("smaller components")[0], re.MULTILINE)]
    assert shares == sorted(shares, reverse=True)  # the largest first
    assert len(shares) > 2


def test_csv_has_all_components_and_the_sum(run, output_of):
    rows = list(csv.DictReader(StringIO(output_of("budget", run, "--parameter", "a2", "--to", "csv"))))
    total = next(r for r in rows if r["group"] == "u")
    expanded = next(r for r in rows if r["group"] == "U")  # U = k u: k in the place of a sensitivity
    assert total["sensitivity"] == ""
    factor = float(expanded["contribution"]) / float(total["contribution"])
    assert float(expanded["sensitivity"]) == pytest.approx(factor)
    own = [float(r["contribution"]) for r in rows if r["group"] not in ("u", "U")]
    assert np.sqrt(np.sum(np.square(own))) == pytest.approx(float(total["contribution"]))


@pytest.mark.parametrize(("arguments", "message"), cases("budget_refusals"))
def test_refusals(run, error_of, arguments, message):
    errors = error_of("budget", run, *arguments)
    assert message in errors
    assert errors.count("\n") == 1


def test_a_folder_that_was_changed_is_refused(run, tmp_path, error_of):
    import shutil

    other = tmp_path / "run"
    shutil.copytree(run, other)
    record = json.loads((other / "arm.json").read_text())
    record["covariance_si"] = (1.2 * np.array(record["covariance_si"])).tolist()
    (other / "arm.json").write_text(json.dumps(record))
    errors = error_of("budget", other, "--parameter", "a2")
    assert "arm.json was changed or removed after the run had written it" in errors
    (other / ".bayescal-files.json").unlink()
    assert "times that of arm.json" in error_of("budget", other, "--parameter", "a2")


def test_covariance_of_a_point_is_that_of_the_arm(command_fit):
    """Without a discrepancy: by the parameters, as `compensate` states it, and by the lost motion."""
    arm = of_fit(command_fit.data)
    basis = command_fit.data.basis
    assert not basis.stated.families
    q = np.radians(COMMAND_READINGS)
    m = point(arm, replace(basis, excess=3e-6), q)
    pose = arm.at(q)
    np.testing.assert_allclose(m.position, pose.points[0], atol=1e-12)
    covariance = m.by_z @ basis.stated.wide.covariance @ m.by_z.T
    np.testing.assert_allclose(covariance, pose.covariance[0], rtol=1e-4, atol=1e-16)
    off = lost_motion(pose, np.zeros((1, 6)))[0]
    assert np.any(off[1])
    assert not np.any(off[2])
    b = budget(replace(basis, excess=3e-6), m)
    np.testing.assert_allclose(b.u**2, np.trace(covariance) + np.sum(off**2) + 3 * 3e-6**2, rtol=1e-4)


def test_a_diagnosis_has_budgets_too(tmp_path):
    session = bc.simulate(effects="geometry", **(OPTIONS | {"spheres": 0}))
    gap = bc.diagnose(plain(session.dataset), model="geometry")
    gap.save(tmp_path / "gap", pictures=False)
    found = bc.budget(tmp_path / "gap", parameter="a2")
    k = gap.data.arm.model.names.index("a2")
    sd = gap.data.arm.model.sd[k] * gap.data.covariance[k, k] ** 0.5
    assert found.data.u == pytest.approx(sd, rel=0.01)
    assert found.data.u == pytest.approx(budget(found.basis, parameter(found.basis, "a2")).u)
