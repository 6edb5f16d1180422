"""Sessions of one arm fitted together: against SciPy, against theory, and against what is true."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2
from sessions import with_columns

from bayescal.assess.agreement import agreement, difference_covariance, known_directions, pair
from bayescal.dataset.join import joined
from bayescal.effects import EFFECTS, parameters_of
from bayescal.effects.location import BASE
from bayescal.errors import BayescalError
from bayescal.estimate import estimate, linearise, unit_weights
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.families import poses
from bayescal.estimate.solver import rescaled_weights
from bayescal.estimate.unexplained import unexplained
from bayescal.model import ARM, FitOptions, Scene, build
from bayescal.simulation import Options, simulate

BOTH = ("geometry", "compliance")
MIDDLE = np.array([0.45, 0.0, 0.15])  # m, of the nominal cube
CUBE = {"contacts": 120, "later": 8, "repeats": 3, "spheres": 0, "placements": 0}


@cache
def session(name, seed=1, arm_seed=1, **options):
    return simulate(Options(name=name, seed=seed, arm_seed=arm_seed, **{**CUBE, **options}))


@cache
def pair_of_one_arm():
    """Two sessions on two cubes; the second is noisier, and says so."""
    a, b = session("A").dataset, session("B", seed=2, noise=8e-6).dataset
    other = tuple(
        replace(c, distance=c.distance and c.distance + 1e-9, u_angle=c.u_angle * 1.001)
        for c in b.certificates
    )
    return a, replace(b, certificates=other)  # papers of another cube


def whitened(model, weights, z):
    """Residuals of blocks and constraints by themselves, not by `linearise`."""
    at = model.slices
    values = model.deviations(z[at[ARM]])
    parts = []
    for b in model.blocks:
        r = b.residual(values, z[at[b.target]]).ravel()
        parts.append(r / (weights.sigma[b.name] * weights.scale[b.group]))
    for constraint in model.constraints:
        parts.append(constraint.function(*(model.block_of[t].state(z[at[t]]) for t in constraint.targets))[0])
    return np.concatenate(parts)


def test_joint_fit_is_the_concatenated_problem():
    """Each session as a model of its own, sharing nothing but the arm's part of z."""
    sessions = pair_of_one_arm()
    together = estimate(build(Scene(joined(sessions)), BOTH), robust=False)
    models = [build(Scene(s), BOTH) for s in sessions]
    arm = len(models[0].parameters)
    sizes = [m.size - arm for m in models]
    scales = [{"contact": together.weights.scale[f"contact of {s.name}"]} for s in sessions]
    unit = [unit_weights(m, np.zeros(m.size)) for m in models]
    weights = [replace(w, scale=scale) for w, scale in zip(unit, scales, strict=True)]

    def residuals(z):
        ends = np.cumsum([arm, *sizes])
        each = zip(models, weights, ends[:-1], ends[1:], strict=True)
        parts = [whitened(m, w, np.concatenate([z[:arm], z[low:high]])) for m, w, low, high in each]
        return np.concatenate([*parts, z])

    begin = 0.9 * together.z  # nearer than nothing, and as far from it as steps of the solver
    found = least_squares(residuals, begin, jac="3-point", x_scale="jac", xtol=1e-10)
    assert together.model.names[:arm] == models[0].names[:arm]
    assert len(found.x) == together.model.size
    assert np.max(np.abs(together.z - found.x) / together.sd) < 1e-3
    sd = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    np.testing.assert_allclose(together.sd, sd, rtol=1e-3)
    # the fit of the first alone is another one: the second does count
    assert np.max(np.abs(estimate(models[0], robust=False).z[:arm] - found.x[:arm]) / sd[:arm]) > 0.5
    # Whitened by the prior, I = C^-1 - 1 of the arm: that of both is the sum of each one's
    arm = len(together.model.parameters)
    information = np.zeros((arm, arm))
    for s in sessions:
        alone = estimate(build(Scene(s), BOTH), robust=False)
        scale = alone.weights.scale["contact"] / together.weights.scale[f"contact of {s.name}"]
        assert scale == pytest.approx(1.0, abs=0.1)
        information += np.linalg.inv(alone.covariance[:arm, :arm]) - np.eye(arm)
        assert np.all(together.sd[:arm] <= 1.1 * alone.sd[:arm])
    expected = np.sqrt(np.diag(np.linalg.inv(information + np.eye(arm))))
    np.testing.assert_allclose(together.sd[:arm], expected, rtol=0.08)
    scales = {g: round(s, 1) for g, s in together.weights.scale.items()}
    assert scales == {"contact of A": 1.0, "contact of B": 1.0}


def test_planes_keep_their_own_poses():
    """The cube is put down anew: its faces stand elsewhere, and each is found where it truly is.

    How far its faces have moved is taken from the ground truth, at the middle of the nominal cube.
    """
    made = [session("A"), session("B", seed=2)]
    together = estimate(build(Scene(joined([m.dataset for m in made])), BOTH))
    model, moved = together.model, []
    for one in made:
        for t in one.world.targets:
            block = model.block_of[f"{one.dataset.name}:{t.name}"]
            normal, offset = block.kind.normal_and_offset(block.state(together.z[model.slices[block.target]]))
            points = model.scene.points[block.rows]
            found, true = points @ normal - offset, points @ t.values["normal"] - t.values["offset"]
            moved.append(t.values["normal"] @ MIDDLE - t.values["offset"])
            assert np.max(np.abs(found - true)) < 60e-6
    assert np.max(np.abs(np.array(moved[:4]) - moved[4:])) > 10 * 60e-6


def test_sessions_of_one_arm_agree_and_of_two_do_not():
    a, b = pair_of_one_arm()
    other = session("C", seed=3, arm_seed=9).dataset
    same = agreement(estimate(build(Scene(joined((a, b))), BOTH)), BOTH)
    assert "theta4" in same.names
    assert "ball x" in same.names
    assert not any(p.disagree for p in same.pairs)
    assert same.pairs[0].directions > 20
    first, second = (same.alone[name][0] for name in same.pairs[0].sessions)
    assert np.all((second - first) * same.pairs[0].apart >= 0)
    assert np.any(second != first)
    assert same.furthest.max() < 5
    # stated uncertainties: with the scatter of the poses, which is itself uncertain
    assert np.median(same.together[1] / np.min([sd for _, sd in same.alone.values()], axis=0)) < 0.95
    three = agreement(estimate(build(Scene(joined((a, b, other))), BOTH)), BOTH)
    apart = {p.sessions: p.disagree for p in three.pairs}
    assert apart == {("A", "B"): False, ("A", "C"): True, ("B", "C"): True}
    assert three.furthest.max() > 20


def test_a_tool_taken_off_is_seen_and_told_apart():
    a, b = pair_of_one_arm()
    moved = b.measurements.readings + np.radians([0, 0, 0, 0, 0, 0.5])  # the tool, turned on its flange
    turned = with_columns(b, readings=moved)

    def compared(**mounting):
        model = build(Scene(joined((a, turned), **mounting)), BOTH)
        return agreement(estimate(model, robust=False), BOTH, FitOptions(robust=False))

    shared = compared()
    assert shared.pairs[0].disagree
    assert shared.names[int(np.argmax(shared.furthest))].startswith("ball")
    own = compared(remounted=True)
    assert not any(name.startswith("ball") for name in own.names)
    assert not own.pairs[0].disagree


def test_a_session_that_cannot_be_fitted_alone_says_why():
    a, b = pair_of_one_arm()
    idle = replace(b.measurements, role=np.full(len(b.measurements.ids), "validate"))
    found = agreement(estimate(build(Scene(joined((a, replace(b, measurements=idle)))), BOTH)), BOTH)
    assert list(found.alone) == ["A"]
    assert "no row has the role calibrate" in found.refused["B"]
    assert found.pairs == ()
    assert np.all(found.furthest == 0)


def test_difference_of_two_estimates_has_the_covariance_it_is_said_to_have():
    """Many truths drawn from the prior, each told by two linear experiments that know different things."""
    rng = np.random.default_rng(0)
    count, size = 20000, 4
    jacobians = [rng.normal(size=(6, size)) * scale for scale in ([30, 30, 1, 1e-3], [20, 1, 20, 1e-3])]
    truth = rng.normal(size=(count, size))
    c = [np.linalg.inv(j.T @ j + np.eye(size)) for j in jacobians]
    z = [(truth @ j.T + rng.normal(size=(count, 6))) @ j @ cov for j, cov in zip(jacobians, c, strict=True)]
    difference = z[1] - z[0]
    spread = difference_covariance(*c)
    sd = np.sqrt(np.diag(spread))
    np.testing.assert_allclose(np.cov(difference.T) / np.outer(sd, sd), spread / np.outer(sd, sd), atol=0.04)
    along = known_directions(*c)
    assert along.shape == (size, 3)  # nobody knows the fourth
    assert np.max(np.abs(along[3])) < 1e-3
    d = difference @ along
    chi2 = np.einsum("nk,nk->n", d @ np.linalg.inv(along.T @ spread @ along), d)
    assert np.mean(chi2) == pytest.approx(3, abs=0.08)
    assert np.var(chi2) == pytest.approx(6, rel=0.1)


def test_each_session_drifts_its_own_way():
    drifting = (*BOTH, "thermal-drift")
    options = {"contacts": 160, "effects": drifting, "error_scale": 3.0}
    made = [session(name, seed=seed, **options) for name, seed in (("A", 1), ("B", 2))]
    model = build(Scene(joined([m.dataset for m in made])), drifting, FitOptions(prior_width=3.0))
    half = len(made[0].dataset.measurements.ids)
    own = [p for p in model.parameters if p.effect == "thermal-drift"]
    assert len(own) == 2 * (1 + 3 + 6)
    for p in own:
        outside = slice(half, None) if p.name.startswith("A:") else slice(0, half)
        for term in p.terms:
            assert np.all(term.driver[outside] == 0)
            assert np.any(term.driver != 0)
    found = estimate(model)
    values = dict(zip(model.names, model.physical(found.z), strict=True))
    units = np.concatenate([model.sd, *(b.sd for b in model.states)])
    sd = dict(zip(model.names, found.sd * units, strict=True))
    entries = [
        (m.dataset.name, p) for m in made for p in m.truth["parameters"] if p["effect"] == "thermal-drift"
    ]
    true = {f"{name}:{p['name']}": np.radians(p["value_deg"]) for name, p in entries if "value_deg" in p}
    score = np.array([(values[name] - true[name]) / sd[name] for name in true])
    assert np.max(np.abs(score)) < 4.5
    told = [name for name in true if sd[name] < 0.2 * abs(true[name])]
    assert len(told) > 3, "drifts that the contacts decide"


@pytest.fixture(scope="module")
def circumstances():
    scene = Scene(joined(pair_of_one_arm()))
    return scene.circumstances(scene.rows("calibrate"))


def test_a_step_ends_with_its_session(circumstances):
    c, rows = circumstances, circumstances.sessions
    names = [p.name for p in parameters_of(("step",), c) if p.effect == "step"]
    assert [n.split()[0] for n in names] == ["A:step"] * 6 + ["B:step"] * 6
    first = int(np.argmax(rows[1].rows))
    for at, s in ((10, rows[0]), (first + 11, rows[1])):
        steps = [p for p in parameters_of((f"step@{at}",), c) if p.effect == "step"]
        assert {p.name.split(":")[0] for p in steps} == {s.name}
        after = np.flatnonzero(steps[0].terms[0].driver)
        np.testing.assert_array_equal(after, np.arange(at - 1, np.flatnonzero(s.rows)[-1] + 1))
    moments = EFFECTS["step"].scan.values(c)
    assert np.all(np.isin(moments - 1, c.fitted))
    starts = [c.fitted[s.rows[c.fitted]][0] + 1 for s in rows]
    assert not set(starts) & set(moments), "nothing is before the first row of a session"


def test_a_drift_by_time_needs_one_session_with_a_clock(circumstances):
    still = replace(circumstances, temperature=None)
    time = np.where(still.sessions[0].rows, still.time, still.time[-1])
    names = {p.name for p in parameters_of(("thermal-drift",), replace(still, time=time))}
    assert "A:thermal-drift J2 by time" in names
    assert not any(n.startswith("B:") for n in names)
    assert {p.name for p in parameters_of(("thermal-drift@600",), replace(still, time=time))} == names
    with pytest.raises(BayescalError, match="no temperature_c"):
        parameters_of(("thermal-drift",), replace(still, time=np.zeros(len(time))))


def test_every_tied_session_stands_on_a_base_of_its_own():
    a, b = pair_of_one_arm()
    known = replace(a, targets=tuple(replace(t, u=1e-5, u_angle=1e-5) for t in a.targets))
    placed = replace(b, targets=tuple(replace(t, u=1e-5, u_angle=1e-5) for t in b.targets))
    pairs = {"none": (a, b), "first": (known, b), "both": (known, placed)}
    models = {label: build(Scene(joined(pair)), BOTH) for label, pair in pairs.items()}
    bases = {label: [p.name for p in m.parameters if p.site == BASE] for label, m in models.items()}
    assert bases["none"] == []
    assert [n.split(":")[0] for n in bases["first"]] == ["A"] * 6
    assert [n.split(":")[0] for n in bases["both"]] == ["A"] * 6 + ["B"] * 6


def test_noise_of_several_sessions_is_told_in_one_figure():
    a, b = pair_of_one_arm()
    found = estimate(build(Scene(joined((a, b))), BOTH))
    left = unexplained(found)
    assert left.group == "contact"
    assert left.stated == pytest.approx(np.sqrt((5e-6**2 + 8e-6**2) / 2), rel=1e-3)
    assert left.fitted == pytest.approx(left.stated, rel=0.12)
    assert left.excess == 0
    count = sum(len(b.rows) for b in found.model.blocks)
    assert count - found.model.size < left.dof < count


def test_estimates_of_the_same_session_are_not_apart():
    found = stated(estimate(build(Scene(session("A").dataset), BOTH)))
    same = pair(("A", "A"), (found, found), ("theta4", "a2"))
    assert np.all(same.apart == 0)
    assert same.p_value == 1.0


def test_planes_of_one_session_and_points_of_another_are_one_arm(cube, tracker):
    """Of other kinds, with other noise stated, and the arm's true values in reach of both together."""
    planes, points = cube(seed=3), tracker(seed=3)
    assert planes.arm.values == pytest.approx(points.arm.values)
    found = estimate(build(Scene(joined((planes.dataset, points.dataset))), BOTH))
    groups = {f"contact of {planes.dataset.name}", f"point of {points.dataset.name}"}
    assert set(found.weights.scale) == groups
    compared = agreement(found, BOTH)
    assert not compared.pairs[0].disagree
    assert compared.pairs[0].directions > 15
    two = compared.pairs[0]
    assert two.p_value == pytest.approx(chi2.sf(two.chi2, two.directions), rel=1e-6)
    each, true = zip(compared.names, *compared.together, strict=True), planes.arm.values
    score = [(value - true[name]) / sd for name, value, sd in each if name in true]
    assert len(score) > 20
    assert np.max(np.abs(score)) < 4.5
    assert np.all(compared.together[1] < 1.1 * np.min([sd for _, sd in compared.alone.values()], axis=0))


# --- Which rows share a pose.


def test_rows_of_one_stop_one_repeat_or_equal_readings_are_of_one_pose(cube):
    m = cube(seed=3, count=24).dataset.measurements
    n = len(m.ids)
    rows = np.arange(n)
    assert len(np.unique(poses(replace(m, stop=None, repeat=None), rows))) == n

    readings = m.readings.copy()
    readings[4] = readings[3]
    stop, repeat = np.full(n, ""), np.full(n, "")
    stop[[4, 5]], repeat[[5, 9]] = "s", "r"
    linked = replace(m, readings=readings, stop=stop, repeat=repeat)
    found = poses(linked, rows)
    assert len(set(found[[3, 4, 5, 9]])) == 1  # a chain of three different reasons
    assert len(np.unique(found)) == n - 3
    # of other rows of the session the same, and rows may be given more than once
    assert len(np.unique(poses(linked, np.array([9, 3, 3, 7])))) == 3


# --- The noise scale of a fit, between its residuals and what was stated.


def test_stated_noise_counts_as_eight_contacts_more(cube):
    """The scale is the RMS of all residuals and of eight more of the stated noise."""
    count = 60
    model = build(Scene(cube(seed=1, count=count).dataset), ())
    z = np.zeros(model.size)
    weights = unit_weights(model, z)
    linear, nothing = linearise(model, z, weights), np.zeros((model.size, model.size))
    size = np.ones_like(linear.residual)
    for factor in (0.0, 1.0, 2.0):
        found, dof = rescaled_weights(model, weights, replace(linear, residual=factor * size), nothing)
        (group,) = dof
        assert dof[group] == pytest.approx(count)
        every = np.concatenate([np.full(count, factor), np.ones(8)])
        assert found.scale[group] == pytest.approx(np.sqrt(np.mean(every**2)))
