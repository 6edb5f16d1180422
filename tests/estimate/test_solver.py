"""The factor graph against SciPy on the same whitened problem, and what it refuses."""

import sys
from dataclasses import replace
from functools import cached_property

import numpy as np
import pytest
from cases import refused
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.linalg.lapack import dgeqrf
from scipy.optimize import least_squares
from scipy.stats import chi2 as chi2_distribution
from sessions import with_columns

from bayescal.arm.statics import Stance
from bayescal.estimate import calibrated, estimate, linearise, settled, solve, unit_weights
from bayescal.estimate.outliers import freed, rejected, scale, student_weights
from bayescal.estimate.solver import factored, halved, solved
from bayescal.model import FitOptions, Scene, build
from bayescal.simulation import Options, simulate
from factors import graph as graphs

BOTH = ("geometry", "compliance")
WIDE = FitOptions(prior_width=1000.0)


def known_cube(session, faces=None):
    """The session with its true planes stated as known."""
    targets = []
    for t in session.dataset.targets:
        normal, offset = session.planes[t.name]
        known = replace(t, values={"normal": normal, "offset": offset}, u=0.0, u_angle=0.0)
        targets.append(known if faces is None or t.name in faces else t)
    return replace(session.dataset, targets=tuple(targets))


def half_known(session):
    """Two faces known, one of them except for its tilt."""
    dataset = known_cube(session, ("cube.+y", "cube.+z"))
    return replace(dataset, targets=(replace(dataset.targets[0], u=0.0, u_angle=1e-4), *dataset.targets[1:]))


CASES = {
    "loose cube": lambda cube, tracker: (cube(seed=2).dataset, BOTH),
    "known cube": lambda cube, tracker: (known_cube(cube(seed=2)), BOTH),
    "half known": lambda cube, tracker: (half_known(cube(seed=2)), BOTH),
    "tracker": lambda cube, tracker: (tracker(seed=2).dataset, BOTH),
    "arm as drawn": lambda cube, tracker: (cube(seed=2).dataset, ()),
    "faces with form": lambda cube, tracker: (cube(seed=2).dataset, (*BOTH, "plane-form")),
    "wrong paper": lambda cube, tracker: (cube(seed=2).dataset, (*BOTH, "artefact")),
    "wrong paper of known faces": lambda cube, tracker: (known_cube(cube(seed=2)), ("artefact",)),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_same_optimum_and_covariance_as_scipy(case, cube, tracker, tie_residuals):
    model = build(Scene((made := case(cube, tracker))[0]), made[1])
    weights = unit_weights(model, np.zeros(model.size))
    whole = {b.target: weights.row[b.target] * np.linspace(0.2, 1.5, len(b.rows)) for b in model.blocks}
    weights = replace(weights, row=whole, scale=dict.fromkeys(weights.scale, 1.3))
    z, covariance, _ = solve(model, weights, np.zeros(model.size))

    def residuals(z):
        """By blocks and constraints alone, not by `linearise`, which shares its gradients with the graph."""
        parts = []
        for b in model.blocks:
            r = b.residual(model.deviations(z[model.slices["arm"]]), z[model.slices[b.target]]).ravel()
            row = np.tile(weights.row[b.target], b.kind.rows)
            parts.append(r * np.sqrt(row) / (1.3 * weights.sigma[b.target]))
        ties = (tie_residuals(model, constraint, z) for constraint in model.constraints)
        return np.concatenate([*parts, *ties, z])

    def jacobian(z):
        return np.vstack([linearise(model, z, weights).jacobian, np.eye(model.size)])

    by = jacobian(z)
    step = 1e-5 * np.eye(model.size)
    slope = np.array([(residuals(z + s) - residuals(z - s)) / 2e-5 for s in step]).T
    np.testing.assert_allclose(by, slope, rtol=1e-6, atol=1e-6 * np.max(np.abs(by)))
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    found = least_squares(residuals, z + 1e-3, jacobian, method="lm", **tight)
    assert np.max(np.abs(z - found.x)) < 1e-6
    np.testing.assert_allclose(covariance(), np.linalg.inv(found.jac.T @ found.jac), atol=1e-6)


def test_far_start_finds_the_same(cube):
    model = build(Scene(cube(seed=2).dataset), BOTH)
    weights = unit_weights(model, np.zeros(model.size))
    near, _, _ = solve(model, weights, np.zeros(model.size))
    far, _, _ = solve(model, weights, np.random.default_rng(0).standard_normal(model.size) * 0.5)
    np.testing.assert_allclose(far, near, atol=1e-6)


def without(dataset, *kinds):
    return replace(dataset, certificates=tuple(c for c in dataset.certificates if c.kind not in kinds))


def test_no_length_and_nothing_to_fit_are_refused(cube):
    """Wide priors and no certified length: the arm would shrink to a point and report no error."""
    dataset = cube(seed=2).dataset
    bare = without(dataset, "parallel", "perpendicular")
    refused("length", lambda: estimate(build(Scene(bare), BOTH, WIDE)))
    # squareness is no length, nor is a length that may be wrong by centimetres
    refused("length", lambda: estimate(build(Scene(without(dataset, "parallel")), BOTH, WIDE)))
    refused("length", lambda: estimate(build(Scene(dataset), (*BOTH, "artefact"), WIDE)))
    # nothing to fit
    idle = replace(dataset.measurements, role=np.full(len(dataset.measurements.ids), "validate"))
    refused("calibrate", lambda: build(Scene(replace(dataset, measurements=idle)), BOTH))


def test_a_length_is_enough(cube):
    session = cube(seed=2)
    certified = estimate(build(Scene(session.dataset), BOTH, WIDE))
    assert certified.model.constraints
    narrow = estimate(build(Scene(session.dataset), BOTH))
    told = [k for k, name in enumerate(narrow.model.names[:19]) if name not in ("d2", "d3")]
    physical = certified.model.physical(certified.z)[told] - narrow.model.physical(narrow.z)[told]
    sd = narrow.sd[told] * np.array([narrow.model.parameters[k].sd for k in told])
    assert np.max(np.abs(physical) / sd) < 0.5
    # tolerances alone know the arm's length to half a thousandth, known planes their own distance
    assert estimate(build(Scene(without(session.dataset, "parallel")), BOTH)).z.any()
    known = without(known_cube(session), "parallel", "perpendicular")
    assert estimate(build(Scene(known), BOTH, WIDE)).z.any()


def test_an_instrument_knows_lengths(tracker):
    assert estimate(build(Scene(tracker(seed=2).dataset), BOTH, WIDE)).z.any()


def off_by(dataset, degrees):
    """The session with a drawing whose fourth joint's zero is wrong."""
    wrong = replace(dataset.robot, offset=dataset.robot.offset + np.radians([0, 0, 0, degrees, 0, 0]))
    return replace(dataset, robot=wrong)


def test_a_zero_far_off_is_found(cube):
    """A degree is nine times what the prior expects, and far more than what the contacts leave open."""
    found = estimate(build(Scene(off_by(cube(seed=2).dataset, 1.0)), BOTH))
    right = estimate(build(Scene(cube(seed=2).dataset), BOTH))
    k = found.model.names.index("theta4")
    assert found.model.physical(found.z)[k] - right.model.physical(right.z)[k] == pytest.approx(0, abs=2e-4)


def test_a_zero_too_far_off_is_refused(cube):
    """Twenty degrees are no calibration, and the chain's series would not hold."""
    model = build(Scene(off_by(cube(seed=2).dataset, 20.0)), BOTH, FitOptions(prior_width=100.0))
    refused("theta4", lambda: estimate(model, robust=False))


# --- Outliers: clean measurements are lost at the promised rate, whatever their rows and their number.


def solved_robustly(slopes, y, weight, size=1.0):
    """Covariance of weighted least squares, and its residuals; a prior ten times as wide as the truth."""
    gram = np.einsum("cki,c,ckj->ij", slopes, weight, slopes) / size**2
    covariance = np.linalg.inv(gram + np.eye(len(gram)) / 1e4)
    z = covariance @ np.einsum("cki,c,ck->i", slopes, weight, y) / size**2
    return covariance, y - slopes @ z


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_robust_scale_is_that_of_the_noise(rows):
    rng = np.random.default_rng(rows)
    r = 3.0 * rng.standard_normal((20000, rows))
    r[:1000] *= 50.0
    assert scale(np.sum(r**2, axis=1), rows) == pytest.approx(3.0, rel=0.06)
    assert scale(np.sum(r**2, axis=1) / 2, rows, taken=rows * 10000) == pytest.approx(3.0, rel=0.06)
    clean = np.sum(r[1000:] ** 2, axis=1)
    assert scale(clean, rows, share=0.8) == pytest.approx(3.0, rel=0.03)
    # beside measurements of another number of rows
    other = np.sum((3.0 * rng.standard_normal((19000, 6))) ** 2, axis=1)
    both = np.concatenate([clean, other]), np.repeat([rows, 6], 19000)
    assert scale(*both) == pytest.approx(3.0, rel=0.03)
    assert scale(*both, share=0.8) == pytest.approx(3.0, rel=0.03)


def test_a_scale_of_few_degrees_of_freedom_rejects_less():
    chi2 = np.array([20.0, 1.0, 1.0, 1.0])
    assert rejected(chi2, 1).tolist() == [True, False, False, False]
    assert not np.any(rejected(chi2, 1, dof=4.0))
    assert rejected(100 * chi2, 1, dof=4.0)[0]
    assert rejected(100 * chi2, 1, 10.0)[0]
    # nor is anything rejected by a scale that rests on it alone
    assert not np.any(rejected(np.array([1e6, 1.0]), 1, 1e3, 0.5, True))


def test_a_residual_counts_by_the_variance_that_the_fit_predicts_of_it():
    """Of normal data all are chi-square, kept, half-weighted or left out, whatever their leverage."""
    rng = np.random.default_rng(0)
    slopes = rng.standard_normal((12, 2, 8))
    slopes[0] *= 6.0  # of high leverage
    for own in (0.0, 0.4, 1.0):
        weight = np.ones(12)
        weight[:2] = own
        out = []
        for _ in range(1500):
            y = slopes @ rng.standard_normal(8) + rng.standard_normal((12, 2))
            covariance, r = solved_robustly(slopes, y, weight)
            out.append(freed(r, slopes @ covariance @ np.swapaxes(slopes, 1, 2), weight))
        mean = np.mean(out, axis=0)
        # a half-weighted contact has the weight of half a contact in the fit of the others
        np.testing.assert_allclose(mean[:2] if own == 0.4 else mean, 2.0, rtol=0.15 if own == 0.4 else 0.1)
        assert np.quantile(np.array(out)[:, 0], 0.9) == pytest.approx(chi2_distribution.ppf(0.9, 2), rel=0.12)


def test_student_weights_are_those_of_its_likelihood():
    """Of Student t noise, whose likelihood they maximise at its own scale: E w chi2 = rows."""
    rng = np.random.default_rng(1)
    for rows in (1, 2, 3):
        t = rng.standard_normal((100000, rows)) / np.sqrt(rng.chisquare(4.0, (100000, 1)) / 4.0)
        chi2 = np.sum(t**2, axis=1)
        assert np.mean(chi2 * student_weights(chi2, rows, 1.0)) == pytest.approx(rows, rel=0.02)


def test_few_contacts_are_not_fitted_beyond_their_noise():
    """Hardly more rows than unknowns: the median of what is left is no measure of the noise."""
    session = simulate(Options(seed=3, contacts=80, repeats=5, later=0, placements=0)).dataset
    m = session.measurements
    few = with_columns(session, role=np.where(np.arange(80) < 14, m.role, "validate"))
    found = estimate(build(Scene(few), ("geometry", "compliance")))
    assert not len(found.rejected)
    assert 0.6 < found.weights.scale["contact"] < 1.5
    assert found.iterations < 60


def test_stated_noise_that_the_scale_contradicts_does_not_count():
    """An error that the model lacks makes all residuals larger: the largest of twenty is no outlier then."""
    chi2 = 4.0**2 * np.array([8.5, *np.ones(19)])
    assert not np.any(rejected(chi2, 1, 4.0, 20.0, True, worth=8.0))
    chi2[0] = 4.0**2 * 14.0
    assert rejected(chi2, 1, 4.0, 20.0, True, worth=8.0)[0]


# --- Weights pull where an arm stands: a fit that is told so leaves less, and finds the arm.


def pulls(found, simulated):
    """How far off the truth the compliances are, in posterior standard deviations."""
    true = {p["name"]: 1e-6 * p["value_urad_per_nm"] for p in simulated.truth["parameters"]
            if p["effect"] == "compliance"}  # fmt: skip
    at = [k for k, p in enumerate(found.model.parameters) if p.effect == "compliance"]
    off = [(found.model.physical(found.z)[k] - true[found.model.names[k]]) / found.model.sd[k] for k in at]
    return np.array(off) / found.sd[at]


def test_settled_moments_leave_less():
    # a session of exact statics, with two kilograms on half of its contacts
    loaded = simulate(
        Options(seed=2, contacts=160, repeats=0, later=0, placements=0, noise=2e-6, payload=2.0)
    )
    as_drawn = estimate(build(Scene(loaded.dataset), BOTH))
    stands = estimate(build(settled(as_drawn), BOTH), start=as_drawn.z)
    assert as_drawn.weights.scale["contact"] > 1.5  # of 2 um
    assert stands.weights.scale["contact"] < 1.15
    assert np.max(np.abs(pulls(as_drawn, loaded))) > 8
    assert np.max(np.abs(pulls(stands, loaded))) < 4


@pytest.mark.parametrize(("effects", "fits"), [(("joint",), 1), (("geometry",), 1), (BOTH, 3)])
def test_only_a_model_that_gravity_acts_on_is_fitted_again(cube, monkeypatch, effects, fits):
    """The single fit has the settled scene and agrees with a second fit there."""
    count = []

    def counted(*args, **kwargs):
        count.append(args)
        return estimate(*args, **kwargs)

    module = sys.modules["bayescal.estimate.estimate"]  # the package has a function of this name
    monkeypatch.setattr(module, "estimate", counted)
    found = calibrated(Scene(cube().dataset), effects)
    assert len(count) == fits
    assert found.model.scene.stance is not None
    again = estimate(build(found.model.scene, effects), start=found.z)
    assert np.array_equal(again.rejected, found.rejected)
    assert np.allclose(again.z, found.z, atol=2e-3 if fits == 1 else 0.05)


@pytest.mark.parametrize("sag", [0.0, 1e-5])
def test_scenes_of_several_poses_share_only_what_is_equal(cube, sag):
    """Against a scene made afresh, also where the robot file's compliances bend the nominal arm."""
    dataset = cube(seed=1, count=20).dataset
    dataset = replace(dataset, robot=replace(dataset.robot, compliance=np.full(6, sag)))
    scene, rows = Scene(dataset, oriented=True), np.arange(20)
    names = [name for name, value in vars(Scene).items() if isinstance(value, cached_property)]
    assert names
    for name in names:
        getattr(scene, name)
    stance = Stance(*1e-2 * np.random.default_rng(0).standard_normal((2, 20, 8, 6)))
    moved, fresh = scene.posed_at(stance, {"compliance J2": 1e-6}), Scene(dataset, stance, True)
    for name in names:
        a, b = getattr(moved, name), getattr(fresh, name)
        if name == "as_seen":  # a scene; of a session without images its own
            assert a.dataset is b.dataset is dataset
            continue
        np.testing.assert_equal(*(vars(x) if name in ("chain", "loads") else x for x in (a, b)), name)
    a, b = moved.circumstances(rows), fresh.circumstances(rows)
    np.testing.assert_array_equal(a.moments, b.moments)
    np.testing.assert_array_equal(a.q, b.q)
    np.testing.assert_array_equal(a.approach, b.approach)
    assert not np.array_equal(a.moments, scene.circumstances(rows).moments)
    assert np.array_equal(a.q, scene.q) == (sag == 0.0)
    assert (moved.points is scene.points) == (sag == 0.0)
    assert a.stance is stance
    assert a.compliances == {"compliance J2": 1e-6}


# --- Factors that are computed directly are those of SciPy, to the bit.


@pytest.mark.parametrize("size", [1, 4, 40])
def test_as_scipy(size):
    rng = np.random.default_rng(size)
    design = rng.normal(size=(size + 5, size))
    matrix, right = design.T @ design, rng.normal(size=(size, 7))
    own, theirs = factored(matrix), cho_factor(matrix, lower=True)
    np.testing.assert_array_equal(np.tril(own), np.tril(theirs[0]))
    for b in (right, right[:, 0], right.copy(order="F")):
        np.testing.assert_array_equal(solved(own, b), cho_solve(theirs, b))
    half = solve_triangular(theirs[0], right, lower=True)
    np.testing.assert_allclose(halved(own, right), half, rtol=1e-10, atol=1e-10 * np.abs(half).max())


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf])
def test_what_has_no_factor_is_refused(bad):
    matrix = np.eye(3)
    matrix[1, 1] = bad
    with pytest.raises((np.linalg.LinAlgError, ValueError)):
        solved(factored(matrix), np.ones(3))
    if bad != -1.0:
        for solve in (solved, halved):
            with pytest.raises(ValueError, match="not finite"):
                solve(factored(np.eye(3)), np.full((3, 2), bad))


@pytest.mark.parametrize("rank", [4, 3])
@pytest.mark.parametrize("rows", [20, 400])
def test_a_factor_of_many_rows_is_solved_as_one_of_few(rows, rank, monkeypatch):
    """By a triangle with its products: of all directions, or where one is not measured."""
    rng, tried = np.random.default_rng(rows), []
    x = rng.standard_normal((rows, 4))
    x[:, rank:] = 0.0
    y = x @ [1.0, -2.0, 0.5, 3.0] + rng.standard_normal(rows)
    monkeypatch.setattr(graphs, "dgeqrf", lambda a, **way: tried.append(a.shape) or dgeqrf(a, **way))
    graph = graphs.Graph()
    for name in "ab":
        graph.variable(name, 2)
    graph.factor("ab", rows, lambda a, b: (x @ np.append(a, b) - y, [x[:, :2], x[:, 2:]]))
    found, _ = graph.solve({name: np.zeros(2) for name in "ab"})
    information = x.T @ x + np.eye(4)
    expected = np.linalg.solve(information, x.T @ y)
    np.testing.assert_allclose(np.append(found["a"], found["b"]), expected, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(graph.covariance("ab"), np.linalg.inv(information), rtol=1e-8, atol=1e-12)
    assert bool(tried) == (rows == 400 and rank == 3)


def test_a_pair_is_freed_as_any_set_is():
    rng = np.random.default_rng(5)
    r, half = rng.standard_normal((6, 2)), rng.uniform(-0.4, 0.4, (6, 2, 2))
    leverage = half @ np.swapaxes(half, 1, 2)
    leverage[0] = 0.3 * np.eye(2)  # both directions alike
    weight = np.array([1.0, 1.0, 0.5, 0.0, 1.0, 0.2])
    wide = np.zeros((6, 3, 3))
    wide[:, :2, :2] = leverage
    expected = freed(np.append(r, np.zeros((6, 1)), axis=1), wide, weight)
    np.testing.assert_allclose(freed(r, leverage, weight), expected, rtol=1e-10)
