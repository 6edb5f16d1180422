"""Errors of masses in the stated uncertainty: against fits with other masses, and their second moment."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from chances import least, most
from sessions import misread

import bayescal.estimate.moments as size_module
from bayescal.assess.agreement import pair
from bayescal.assess.inputs import NOISE
from bayescal.calibration import basis_of
from bayescal.dataset.join import joined
from bayescal.estimate import calibrated, linearise
from bayescal.estimate.discrepancy import LEAST_WHITE, Inputs, families, inputs, mixed, stated
from bayescal.estimate.families import COURSES, EFFECT
from bayescal.estimate.moments import (
    UNSEEN,
    by_chance,
    complement,
    degrees_of_freedom,
    scatter_factor,
    variances,
    within_poses,
)
from bayescal.fitted.unmodelled import Unmodelled
from bayescal.model import FitOptions, Scene
from bayescal.posterior import gaussian
from bayescal.statistics import rms

FULL = ("geometry", "compliance")


@pytest.fixture(scope="module")
def session(cube):
    return cube(seed=7, noise=1e-6).dataset


@pytest.fixture(scope="module")
def found(session):
    return stated(calibrated(Scene(session), FULL, FitOptions(robust=False)))


@pytest.mark.parametrize("name", ["mass of link 3", "centre of link 4 y", "centre of load z"])
def test_an_error_of_a_mass_moves_the_fit_as_stated(session, found, name):
    """A fit with another mass, compared with its bias by a standard uncertainty of it."""
    k = found.inputs.names.index(name)
    robot, (tool,), *where = session.robot, session.tools, *name.split()
    p = next(p for p in inputs(found.plain) if p.name == name)
    if where[0] == "mass":
        masses = robot.masses.copy()
        masses[int(where[3]) - 1] *= 1 + p.sd
        other = replace(session, robot=replace(robot, masses=masses))
    elif where[2] == "link":
        centres = robot.centres_of_mass.copy()
        centres[int(where[3]) - 1, "xyz".index(where[-1])] += p.sd
        other = replace(session, robot=replace(robot, centres_of_mass=centres))
    else:
        shift = p.sd * np.eye(3)["xyz".index(where[-1])]
        other = replace(session, tools=(replace(tool, centre_of_mass=tool.centre_of_mass + shift),))
    moved = (calibrated(Scene(other), FULL, FitOptions(robust=False)).z - found.plain.z) / found.plain.sd
    # the true mass is less than this fit states
    expected = -found.inputs.slopes[:, k] / found.plain.sd
    assert np.max(np.abs(expected)) > 0.3
    np.testing.assert_allclose(moved, expected, atol=0.2 * np.max(np.abs(expected)))


def test_residuals_that_show_an_error_state_it():
    """Second moment of the errors: by the prior where nothing is seen, else by what the residuals say."""
    rng = np.random.default_rng(0)
    h = rng.standard_normal((400, 3)) * [0.0, 1.0, 1.0]
    f = np.array([0.0, 0.0, 0.8])
    seen = Inputs.of("abc", np.eye(3), h, h @ f + 0.02 * rng.standard_normal(400))
    np.testing.assert_allclose(np.sqrt(seen.variances), [1.0, 0.05, 0.8], atol=0.02)
    assert seen.dof == pytest.approx(2.0, abs=0.02)
    # an effect that no model has is no error of masses of ten standard uncertainties
    assert np.max(Inputs.of("abc", np.eye(3), h, 10.0 * h @ f).variances) == pytest.approx(6.0, rel=0.02)


def test_masses_take_degrees_of_freedom_from_the_residuals(found, monkeypatch):
    """What errors of masses by their prior leave of residuals has the mean square of the rest of these."""
    rng = np.random.default_rng(1)
    h = rng.standard_normal((60, 5)) * [0.01, 0.1, 0.2, 0.5, 3.0]
    left = []
    for _ in range(400):
        e = h @ rng.standard_normal(5) + rng.standard_normal(60)
        seen = Inputs.of("abcde", np.eye(5), h, e)
        left.append(np.sum(seen.without(np.zeros((60, 0)), h, e)[1] ** 2))
    assert 1.5 < seen.dof < 4.0
    assert np.mean(left) == pytest.approx(60 - seen.dof, abs=1.0)
    told = []
    monkeypatch.setattr(size_module, "variances", lambda *given: told.append(given[4]) or variances(*given))
    again = stated(found.plain)
    rows = sum(len(b.rows) * b.kind.rows for b in found.plain.model.blocks)
    j = found.plain.linear.jacobian[:rows]
    assert again.inputs.dof > 0.5
    expected = rows - np.trace(j @ found.plain.covariance @ j.T) - again.inputs.dof
    assert told == [pytest.approx(expected, rel=1e-9)]


def test_stated_compliances_contain_the_uncertainty_of_masses(found):
    """Some 5 % of masses whose torques a compliance is divided by, that no residual shows."""
    names = found.plain.model.names
    more = np.sqrt(np.diag(found.covariance)) / found.plain.sd
    assert more[names.index("compliance J3")] > 2.0
    assert np.median(more) < 1.2
    assert found.parameter_shares["masses"] > 0.02


def test_a_model_without_compliance_has_no_errors_of_masses(session, found):
    assert inputs(calibrated(Scene(session), ("geometry",), FitOptions(robust=False))) == []
    weightless = replace(session, robot=replace(session.robot, masses=None, centres_of_mass=None))
    assert stated(calibrated(Scene(weightless), ("geometry",), FitOptions(robust=False))).inputs.names == ()


def test_mixed_errors_move_as_their_sum(found):
    own = inputs(found.plain)
    mixing = np.random.default_rng(0).standard_normal((len(own), 2))
    one, _ = mixed(own, mixing)
    total = {}
    for weight, p in zip(mixing[:, 0], own, strict=True):
        for t in p.terms:
            total[t.frame, t.axis] = total.get((t.frame, t.axis), 0.0) + weight * p.sd * t.driver
    for t in one.terms:
        np.testing.assert_allclose(t.driver, total[t.frame, t.axis], rtol=1e-9, atol=1e-15)


def test_sessions_of_one_arm_have_its_masses_in_common(found):
    """A difference that only different masses could explain is one, unless the tools differ."""
    k = found.plain.model.names.index("compliance J3")
    off = np.zeros(len(found.plain.z))
    off[k] = 1.5 * np.sqrt(found.inputs.variances[k])
    other = replace(found, plain=replace(found.plain, z=found.plain.z + off))
    names = ("compliance J3",)
    same = pair(("A", "B"), (found, other), names)
    model = found.plain.model
    dataset = model.scene.dataset
    heavier = replace(dataset, tools=(replace(dataset.tools[0], mass=9.0),))
    loaded = replace(model, scene=replace(model.scene, dataset=heavier))
    unequal = replace(other, plain=replace(other.plain, model=loaded))
    assert abs(same.apart[0]) > 1.5 * abs(pair(("A", "B"), (found, unequal), names).apart[0])


# --- Scatter of an estimate over poses, against its definition and simulated estimates.

D, POSES, EACH = 5, 400, 3
POSE = np.repeat(np.arange(POSES), EACH)


def scatter(c, j, e, pose):
    by, of = scatter_factor(c, j, e, pose)
    assert by.shape == (len(c), len(of))
    return by @ by.T


def linear(seed, shared, uneven=False):
    """Rows of poses with an error in common; `uneven`: in proportion to the slope of the first unknown."""
    rng = np.random.default_rng(seed)
    j = np.repeat(rng.standard_normal((POSES, D)), EACH, axis=0)
    j += 0.3 * rng.standard_normal(j.shape)
    error = rng.choice([-1.0, 1.0], POSES)[POSE] * j[:, 0] if uneven else rng.standard_normal(POSES)[POSE]
    y = rng.standard_normal(len(j)) + shared * error
    c = np.linalg.inv(j.T @ j + np.eye(D))
    return j, y - j @ (c @ (j.T @ y)), c, y


def test_it_is_the_sum_over_poses_of_what_each_contributes():
    """By hand, with the matrix root of each pose, and shrunk by the parameters per pose."""
    j, e, c, _ = linear(2, 2.0, uneven=True)
    deltas = []
    for p in range(POSES):
        own = j[p == POSE]
        values, vectors = np.linalg.eigh(np.eye(EACH) - own @ c @ own.T)
        deltas.append(c @ own.T @ (vectors / np.sqrt(values)) @ vectors.T @ e[p == POSE])
    out, plain = sum(np.outer(d, d) for d in deltas), c @ (j.T @ j) @ c
    share = np.trace(c @ j.T @ j) / POSES
    expected = (1 - share) * out + share * plain * np.trace(out) / np.trace(plain)
    np.testing.assert_allclose(scatter(c, j, e, POSE), expected, rtol=1e-8, atol=1e-12)


def test_without_a_shared_error_the_scatter_is_that_of_independent_residuals():
    """Deviations of the scatter by chance do not count: they made some uncertainties a fifth too small."""
    found, shown = [], []
    for seed in range(20):
        j, e, c, _ = linear(seed, 0.0)
        plain = c @ (j.T @ j) @ c
        found.append(np.sqrt(np.diag(scatter(c, j, e, POSE)) / np.diag(plain)))
        shown.append([not by_chance(_deltas(*linear(seed, s, s > 0)[:3]), j @ c) for s in (0.0, 2.0)])
    assert np.mean(found) == pytest.approx(1.0, abs=0.03)
    assert np.sum(shown, axis=0).tolist() == [pytest.approx(0, abs=3), 20]
    assert np.sum(np.std(found, axis=1) < 1e-6) >= 17


def _deltas(j, e, c):
    return np.sum((j @ c * e[:, None]).reshape(POSES, EACH, D), axis=1)


def test_the_complement_raises_a_covariance_where_it_is_too_small():
    by = np.random.default_rng(0).standard_normal((40, 4))
    by[:, 3] = 0.0  # an unknown of which the residuals say nothing
    plain = by.T @ by
    small = 0.5 * plain
    more = complement(by, small)
    assert more.shape == (4, 40)
    np.testing.assert_allclose(small + more @ more.T, plain, atol=1e-9)
    np.testing.assert_allclose(complement(by, 2.0 * plain), 0.0, atol=1e-9)
    one = np.diag([0.0, 1e3, 1e3, 0.0])
    total = one + complement(by, one) @ complement(by, one).T
    assert np.min(np.linalg.eigvalsh(total - plain)) > -1e-9
    assert total[1, 1] == pytest.approx(1e3, rel=1e-2)


def test_it_has_hardly_a_bias_where_a_quarter_of_the_rows_is_fitted():
    found, plain = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        j = rng.standard_normal((80, 20))
        c = np.linalg.inv(j.T @ j + 1e-3 * np.eye(20))
        y = rng.standard_normal(80)
        found.append(np.trace(scatter(c, j, y - j @ (c @ (j.T @ y)), np.arange(80))))
        plain.append(np.trace(c @ (j.T @ j) @ c))
    assert 0.97 < np.mean(found) / np.mean(plain) < 1.1


def test_it_is_the_true_covariance_where_rows_of_a_pose_share_an_error():
    found, estimates = [], []
    for seed in range(60):
        j, e, c, y = linear(seed, 2.0)
        found.append(np.trace(scatter(c, j, e, POSE)))
        estimates.append(c @ (j.T @ y))
    true = np.mean(np.sum(np.array(estimates) ** 2, axis=1))
    assert np.mean(found) == pytest.approx(true, rel=0.25)


def test_a_pose_that_alone_determines_a_direction_has_no_influence():
    j = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    c = np.linalg.inv(j.T @ j + 1e-12 * np.eye(2))
    e = np.array([0.0, 1.0, -1.0, 0.0])
    assert np.all(np.isfinite(scatter(c, j, e, np.arange(4))))
    assert np.all(np.linalg.eigvalsh(scatter(c, j, e, np.arange(4))) > 0)


# --- Variances of families from residuals of a made linear problem with a known discrepancy.

ROWS, FIRST, SECOND = 600, 12, 8
FAMILY = np.repeat([0, 1], [FIRST, SECOND])


def problem(seed, size, pose=None, shared=0.0):
    """Columns and residuals of a fit by 20 parameters: functions of variances `size` and noise of one."""
    rng = np.random.default_rng(seed)
    pose = np.arange(ROWS) if pose is None else pose
    t = rng.uniform(-1, 1, (ROWS, 2))
    orders = ((k, axis) for axis, count in ((0, FIRST), (1, SECOND)) for k in range(1, count + 1))
    g = np.column_stack([np.cos(np.pi * k * t[:, [axis]]) for k, axis in orders])
    j = rng.standard_normal((ROWS, 20))
    d = rng.standard_normal(FIRST + SECOND) * np.sqrt(np.asarray(size)[FAMILY])
    noise = rng.standard_normal(ROWS) + shared * rng.standard_normal(pose.max() + 1)[pose]
    project = np.eye(ROWS) - j @ np.linalg.pinv(j)
    return project @ g, project @ (g @ d + noise), pose


def sizes(size, **how):
    found = [variances(*problem(seed, size, **how), FAMILY, ROWS - 20, 0.025)[0] for seed in range(40)]
    return np.array(found)


def test_the_variances_of_two_families_are_found_on_average():
    found = sizes([0.5, 0.2])
    assert np.mean(found[:, 0]) == pytest.approx(0.5, rel=0.15)
    assert np.mean(found[:, 1]) == pytest.approx(0.2, rel=0.25)


def test_an_error_that_the_rows_of_a_pose_share_is_no_discrepancy():
    assert np.mean(sizes([0.0, 0.0], pose=np.repeat(np.arange(ROWS // 6), 6), shared=2.0) > 0) < 0.08


def test_products_within_poses_of_any_size_are_summed():
    rng = np.random.default_rng(1)
    h, pose = rng.standard_normal((30, 4)), np.sort(rng.integers(0, 12, 30))
    pose = np.unique(pose, return_inverse=True)[1]
    by_hand = sum((h[pose == p].T @ h[pose == p]) ** 2 for p in np.unique(pose))
    np.testing.assert_allclose(within_poses(h, pose), by_hand)


@pytest.mark.parametrize("at_once", [1, 7])
def test_poses_in_parts_give_the_same_variances(at_once, monkeypatch):
    pose = np.unique(np.random.default_rng(2).integers(0, 300, ROWS), return_inverse=True)[1]
    given = (*problem(0, [0.5, 0.2], pose=pose), FAMILY, ROWS - 20, 0.025)
    whole = variances(*given)
    assert np.all(whole[0] > 0)
    monkeypatch.setattr(size_module, "AT_ONCE", at_once)
    np.testing.assert_allclose(variances(*given), whole, rtol=1e-9)


def few_poses(seed, size):
    """Six functions at sixteen poses of three rows each, a quarter of which the fit takes up."""
    rng, pose = np.random.default_rng(seed), np.repeat(np.arange(16), 3)
    t, j = np.repeat(rng.uniform(0, 1, 16), 3), rng.standard_normal((48, 12))
    g, project = np.cos(np.pi * np.outer(t, np.arange(1, 7))), np.eye(48) - j @ np.linalg.pinv(j)
    e = project @ (g @ (np.sqrt(size) * rng.standard_normal(6)) + rng.standard_normal(48))
    return project @ g, e, pose


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_the_moment_equation_counts_poses_not_rows(size):
    found = [variances(*few_poses(seed, size), np.zeros(6, int), 36, 1.0)[0][0] for seed in range(400)]
    assert 0.75 < np.mean(found) / size < 1.05


def test_noise_has_a_family_as_often_as_its_level():
    """The chance holds with few degrees of freedom too: of 48 residuals the fit takes up 12."""
    each = [variances(*few_poses(seed, 0.0), np.zeros(6, int), 36, 0.3) for seed in range(400)]
    size, chance = np.array(each)[..., 0].T
    assert least(400, 0.25) <= np.sum(size > 0) <= most(400, 0.3)
    assert np.all((chance < 0.3) >= (size > 0))
    assert np.sum(chance < 0.02) <= most(400, 0.02)


def test_degrees_of_freedom_are_those_of_drawn_scores():
    h, _, _ = few_poses(0, 1.0)
    square = np.sum((h.T @ h @ np.random.default_rng(0).standard_normal((6, 20_000))) ** 2, axis=0)
    assert degrees_of_freedom(h) == pytest.approx(2.0 * np.mean(square) ** 2 / np.var(square), rel=0.07)


# --- The stated uncertainty of simulated sessions: near the plain one without an effect, true with one.


@pytest.fixture(scope="module")
def clean(cube):
    return stated(calibrated(Scene(cube(seed=4).dataset), FULL))


def bent(cube, seed=4):
    """A session whose first link turns by a function of the two next readings that no model has."""
    made = cube(seed=seed).dataset
    return misread(made, 1, 1e-3 * np.sin(made.measurements.readings[:, 1:3].sum(axis=1)))


@pytest.fixture(scope="module")
def sick(cube):
    return stated(calibrated(Scene(bent(cube)), FULL))


def test_without_a_discrepancy_the_uncertainty_is_the_plain_one(clean):
    """Except for the errors of masses, of which most unknowns have little."""
    ratio = np.sqrt(np.diag(clean.covariance) - clean.inputs.variances) / clean.plain.sd
    assert clean.families == ()
    assert clean.white == 1.0
    assert np.min(ratio) > 1.0 - 1e-9
    assert np.max(ratio) < 1.1


def test_no_stated_uncertainty_is_smaller_than_the_plain_one(sick):
    """Also where the discrepancy explains most of the residual variance, of any combination of unknowns."""
    more = sick.covariance - sick.plain.covariance
    assert np.min(np.linalg.eigvalsh(more)) > -1e-9 * np.max(np.linalg.eigvalsh(sick.covariance))


def test_an_exported_arm_has_the_noise_of_the_budget(sick):
    """Without the share of the residuals that the discrepancy explains."""
    basis = basis_of(sick.plain)
    exported, contacts = Unmodelled.of(basis).noise, sick.plain.model.blocks[0]
    noise = next(p.input for p in basis.propagated if p.input.group == NOISE)
    assert noise.u == pytest.approx(exported[contacts.group] * rms(contacts.sigma))


def test_an_effect_that_no_model_has_widens_the_parameters_that_it_biases(clean, sick):
    assert sick.families
    assert sick.white < 0.9
    moved = np.abs(sick.plain.z - clean.plain.z)[: len(sick.plain.model.parameters)]
    plain, wide = (np.mean((moved / sd[: len(moved)]) ** 2) for sd in (sick.plain.sd, sick.sd))
    assert plain > 4.0
    assert wide < 2.0


def test_residuals_above_the_noise_lower_the_gate(cube):
    """A family is then found that the gate alone would miss, in a session of 150 rows."""
    made = cube(seed=4).dataset
    scene = Scene(misread(made, 2, 1e-3 * np.cos(1.5 * made.measurements.readings[:, 1])))
    assert stated(calibrated(scene, FULL)).families
    loud = replace(scene.dataset, noise=replace(scene.dataset.noise, contact=1e-4))
    assert not stated(calibrated(Scene(loud), FULL)).families


def test_draws_have_the_covariance_that_is_stated(sick):
    drawn = sick.draws(gaussian(sick.plain, 0, 4000).flat, np.random.default_rng(0))
    got = np.cov(drawn.T) / np.sqrt(np.outer(*2 * (np.diag(sick.wide.covariance),)))
    want = sick.wide.covariance / np.sqrt(np.outer(*2 * (np.diag(sick.wide.covariance),)))
    assert np.max(np.abs(got - want)) < 0.05
    np.testing.assert_allclose(np.std(sick.reported(drawn), axis=0), sick.sd, rtol=0.01)


def test_no_parameter_is_less_certain_than_its_prior(sick):
    assert np.all(sick.sd <= 1.0 + 1e-9)


def test_functions_of_the_whole_session_serve_its_parts(cube):
    scene = Scene(cube(seed=4).dataset)
    own = families(scene.circumstances(scene.rows("calibrate")))
    assert [f.name for f in own][:3] == ["angle of joints", "angle of other joints", "torque of joints"]
    found = stated(calibrated(scene, ("geometry",)), own)
    assert found.families  # compliance is missing
    assert found.parameter_shares.keys() == set(found.families)  # nor masses


@pytest.mark.parametrize("seed", [0, 1])
def test_a_family_explains_what_the_residual_variance_loses(tracker, seed):
    """The share that is no noise: of the functions by their variance, over all residuals, three a pose."""
    made = tracker(seed, 60).dataset
    scene = Scene(misread(made, 2, 1e-4 * np.cos(3 * made.measurements.readings[:, 1])))
    found = stated(calibrated(scene, FULL))
    j = linearise(found.wide.model, found.wide.z, found.wide.weights).jacobian
    (block,) = found.plain.model.blocks
    j = j[np.tile(found.plain.weights.row[block.name], 3) > 0]
    g = j[:, [k for k, p in enumerate(found.wide.model.parameters) if p.effect == EFFECT]]
    j = j[:, found.index]
    h = g - j @ (found.plain.covariance @ (j.T @ g))
    assert 1.0 - found.white == pytest.approx(np.sum(h**2) / UNSEEN / len(h), rel=0.12)  # without masses
    assert LEAST_WHITE < found.white < 0.95
    assert 0.0 < sum(found.parameter_shares.values()) < 1.0


def test_without_functions_the_uncertainty_is_that_of_the_poses(clean):
    found = stated(clean.plain, [])
    assert found.families == ()
    np.testing.assert_allclose(found.sd, clean.sd, rtol=1e-9)


def test_functions_of_time_end_with_their_session(cube):
    """The second of two joined sessions is not the later part of the first."""
    made = [replace(cube(seed=seed).dataset, name=name) for seed, name in ((4, "A"), (5, "B"))]
    scene = Scene(joined(made))
    found = {f.name: f.parameters for f in families(scene.circumstances(scene.rows("calibrate")))}
    first = np.arange(len(scene.q)) < len(made[0].measurements.ids)
    drivers = [np.asarray(p.terms[0].driver) for p in found["time of joints"]]
    assert len(drivers) == 2 * COURSES * scene.chain.n
    for d in drivers:
        assert not (np.any(d[first]) and np.any(d[~first]))
        own = d[first] if np.any(d[first]) else d[~first]
        assert np.max(own) > 0.3 * np.max(np.abs(own)) > 0
        assert np.min(own) < 0


def test_functions_of_a_large_session_are_linearised_in_parts(clean, monkeypatch):
    """The model of all functions at once took most of the memory of a session of 100,000 rows."""
    module, size = import_module("bayescal.estimate.families"), []

    def watched(model, z, weights):
        size.append(model.size)
        return linearise(model, z, weights)

    monkeypatch.setattr(module, "linearise", watched)
    monkeypatch.setattr(module, "MOST_VALUES", 10 * len(clean.plain.model.scene.dataset.measurements.ids))
    again = stated(clean.plain)
    assert len(size) > 1
    assert max(size) <= len(clean.plain.z) + 20
    np.testing.assert_allclose(again.covariance, clean.covariance, rtol=1e-9, atol=1e-12)
    assert again.variances == pytest.approx(clean.variances)
