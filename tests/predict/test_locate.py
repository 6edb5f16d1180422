"""Targets found from their own rows, draw by draw: where they are, and how sure that is."""

from dataclasses import replace

import numpy as np
import pytest
from cases import EXAMPLE
from scipy.special import polygamma
from sessions import with_columns

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import Dataset, Tool, read_dataset
from bayescal.effects.geometry import LOOSE as tool_LOOSE
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.model import ARM, Scene, build
from bayescal.posterior import gaussian
from bayescal.predict import crossvalidation
from bayescal.predict.errors import CentreDistances
from bayescal.predict.forecast import forecast
from bayescal.predict.locate import Rows, States, _check, locate, robust_rows, search
from bayescal.predict.targets import unknown_tool
from bayescal.predict.validation import Validation, validate
from factors.camera import Instrument
from factors.contacts import Cylinder, Distance, FixedPoint, Sphere

CENTRE, DIAMETER, RADIUS = np.array([0.4, -0.1, 0.2]), 50.8e-3, 3e-3
LOOSE = np.array([0.05, 0.05, 0.05, 1e-3])


def ball(centre, sd=LOOSE, count=11):
    """A sphere of so many contacts, stated at a centre (3,)."""
    return Sphere(np.asarray(centre, float), DIAMETER, np.full(count, RADIUS), sd)


def contacts(rng, count, noise, diameter=DIAMETER):
    """Ball centres (3, count) on the upper half of a sphere that is off its nominal place."""
    true = CENTRE + np.array([1e-3, -2e-3, 0.5e-3])
    u = rng.standard_normal((3, count))
    u[2] = np.abs(u[2])
    u /= np.linalg.norm(u, axis=0)
    return true, true[:, None] + u * (diameter / 2 + RADIUS + noise * rng.standard_normal(count))


def test_sphere_is_found_with_the_spread_that_it_has():
    rng = np.random.default_rng(0)
    kind = ball(CENTRE, count=12)
    sigma, errors, spreads = 5e-6, [], []
    for _ in range(60):
        true, p = contacts(rng, 12, sigma)
        at = search(Rows(kind, p, np.full((1, 12), sigma)), np.zeros((1, 4)))
        noise = sigma * rng.standard_normal((400, 1, 12)) * (p - CENTRE[:, None]) / (DIAMETER / 2 + RADIUS)
        drawn = search(Rows(kind, p - noise, np.full((1, 12), sigma)), np.zeros((400, 4)))
        errors.append(at.x[0, :3] - (true - CENTRE))
        spreads.append(drawn.x[:, :3].std(axis=0))
    assert np.std(np.array(errors) / np.array(spreads)) == pytest.approx(1.0, abs=0.15)


def test_certified_diameter_sharpens_the_centre():
    rng = np.random.default_rng(1)
    _, p = contacts(rng, 12, 5e-6)
    noise = 5e-6 * rng.standard_normal((500, 1, 12)) * (p - CENTRE[:, None]) / (DIAMETER / 2 + RADIUS)
    spread = {}
    for u in (1e-3, 1e-6):
        kind = ball(CENTRE, np.array([0.05, 0.05, 0.05, u]), 12)
        drawn = search(Rows(kind, p - noise, np.full((1, 12), 5e-6)), np.zeros((500, 4)))
        spread[u] = drawn.x[:, 2].std()
    assert spread[1e-6] < 0.7 * spread[1e-3]


def test_instrument_and_reflector_are_found_together():
    rng = np.random.default_rng(2)
    nominal = rigid(rpy_matrix(np.array([0.1, -0.2, 1.0])), np.array([2.0, 0.5, 0.3]))
    true = rigid(rpy_matrix(np.array([0.103, -0.201, 1.002])), np.array([2.004, 0.499, 0.302]))
    count, shift = 20, np.array([1e-3, -2e-3, 0.5e-3])
    turns = rpy_matrix(rng.uniform(-1, 1, (count, 3)))
    flange = np.array([0.4, 0, 0.3]) + rng.uniform(-0.2, 0.2, (count, 3))
    nominal_tool = np.array([0.0, 0.0, 0.1])
    p = (flange + turns @ nominal_tool).T
    xyz = (flange + turns @ (nominal_tool + shift) - true[:3, 3]) @ true[:3, :3]
    kind = Instrument(nominal, np.array([0.4, 0, 0.3]), xyz, np.array([0.2] * 3 + [0.05] * 3))
    shifts = np.moveaxis(turns, 0, -1).swapaxes(0, 1)  # (tool axis, xyz, C)
    found = search(Rows(kind, p, np.full((3, count), 1e-5), shifts, tool_sd=5e-3), np.zeros((1, 6)))
    np.testing.assert_allclose(found.tool[0], shift, atol=2e-8)
    np.testing.assert_allclose(kind.describe(found.x[0])["frame"], true, atol=2e-7)


def test_a_slipped_contact_does_not_help_to_find():
    rng = np.random.default_rng(3)
    kind = ball(CENTRE, count=12)
    _, p = contacts(rng, 12, 5e-6)
    clean = robust_rows(Rows(kind, p, np.full((1, 12), 5e-6)), np.zeros((1, 4)))
    p[:, 4] += 0.4e-3 * (p[:, 4] - CENTRE) / np.linalg.norm(p[:, 4] - CENTRE)
    kept = robust_rows(Rows(kind, p, np.full((1, 12), 5e-6)), np.zeros((1, 4)))
    assert clean.sum() >= 11
    assert kept[4] == 0.0
    assert kept.sum() >= 10


def test_known_target_stays_where_it_is():
    kind = FixedPoint(CENTRE, np.zeros(3))
    assert np.all(search(Rows(kind, np.ones((2, 3, 5)), np.ones((3, 5))), np.zeros((2, 3))).x == 0.0)


# --- Targets whose stated place is far off: located all the same, or refused by name.

SIGMA = 5e-6
TRUE = np.array([0.4, -0.1, 0.2])


def touched(directions, noise=0.0, rng=None):
    """Ball centres (3, C) that touch the true sphere from some directions (3, C)."""
    u = directions / np.linalg.norm(directions, axis=0)
    off = noise * rng.standard_normal(u.shape[1]) if noise else 0.0
    return TRUE[:, None] + u * (DIAMETER / 2 + RADIUS + off)


def from_above(rng, count=11, low=0.0):
    u = rng.standard_normal((3, count))
    u[2] = low * np.linalg.norm(u[:2], axis=0) + np.abs(u[2])
    return u


@pytest.fixture(scope="module")
def example():
    """The example's calibration, of its fitted contacts alone: they do not see where a sphere is stated."""
    return calibrated(Scene(read_dataset(EXAMPLE)), ("geometry", "compliance"))


def restated(found, off=(0.0, 0.0, 0.0)):
    """The fit, of data that state one sphere elsewhere by off (3,), m, and no certified diameter."""
    d = found.model.scene.dataset
    targets = {t.name: t for t in d.targets}
    ball = targets["ball.A@1"]
    targets[ball.name] = replace(ball, values=ball.values | {"centre": np.add(ball.values["centre"], off)})
    certificates = tuple(c for c in d.certificates if c.kind != "diameter")
    scene = Scene(replace(d, targets=tuple(targets.values()), certificates=certificates))
    return replace(found, model=replace(found.model, scene=scene))


@pytest.mark.parametrize(("axis", "sign"), [(0, 1.0), (1, -1.0), (2, -1.0), (2, 1.0)])
def test_a_sphere_stated_30_mm_off_is_located(example, axis, sign):
    """With no certified diameter: distances, and what is predicted of them, are as with its true place."""
    h = crossvalidation.validation_errors(restated(example, sign * 0.03 * np.eye(3)[axis])).distances
    known = crossvalidation.validation_errors(restated(example)).distances
    np.testing.assert_allclose(h.error, known.error, atol=0.2e-6)
    np.testing.assert_allclose(h.predicted_sd(), known.predicted_sd(), rtol=0.01)
    assert np.max(np.abs(h.error) / h.predicted_sd()) < 4


def test_fit_locates_it_too(example):
    z = np.tile(example.z, (2, 1))
    scale = np.full((2, 1), example.weights.scale["contact"])
    assert validate(restated(example, (0, 0, -0.03)), z, scale).distance_errors.maximum < 50e-6


@pytest.mark.parametrize("seed", range(3))
def test_any_start_leads_to_the_same_place(seed):
    """Spheres stated up to 50 mm off, touched from above, with an unknown diameter."""
    rng = np.random.default_rng(seed)
    stated = TRUE + 0.05 * rng.uniform(-1, 1, 3)
    kind = ball(stated)
    at, keep = locate("ball", Rows(kind, touched(from_above(rng), SIGMA, rng), np.full((1, 11), SIGMA)))
    assert keep.sum() >= 10
    sd = LOOSE * np.sqrt(np.diag(np.linalg.inv(at.information[0])))
    assert np.all(np.abs(stated + at.x[0, :3] - TRUE) < 5 * sd[:3])
    assert np.all(sd[:3] < 0.1e-3)


def test_two_mirrored_places_are_refused_by_name():
    """Contacts round one circle do not say on which side of it the centre lies; a close enough place does."""
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.full(12, 0.6)])
    p, height = touched(ring), 0.6 / np.hypot(1, 0.6) * (DIAMETER / 2 + RADIUS)
    stated = np.add(TRUE, [0, 0, height])  # in the plane of the circle
    kind = ball(stated, np.append(LOOSE[:3], 1e-6), 12)
    with pytest.raises(BayescalError, match=r"ball\.A@1.* two places .*u_mm"):
        locate("ball.A@1", Rows(kind, p, np.full((1, 12), SIGMA)))
    # a model level that only serves for comparison takes one of the two
    at, _ = locate("ball.A@1", Rows(kind, p, np.full((1, 12), SIGMA)), strict=False)
    away = np.linalg.norm(stated + at.x[0, :3] - TRUE)
    assert away == pytest.approx(2 * height, abs=1e-5) or away < 1e-5
    near = replace(kind, centre=np.add(TRUE, [0, 0, 2e-3]), sd=np.array([2e-3, 2e-3, 2e-3, 1e-6]))
    at, _ = locate("ball.A@1", Rows(near, p, np.full((1, 12), SIGMA)))
    np.testing.assert_allclose(near.centre + at.x[0, :3], TRUE, atol=1e-5)


def test_what_does_not_converge_is_refused_by_name(monkeypatch):
    rng = np.random.default_rng(3)
    kind = ball(TRUE + 0.04)
    monkeypatch.setattr("bayescal.predict.locate.ITERATIONS", 1)
    monkeypatch.setattr("bayescal.predict.locate.starts", lambda kind, p: np.zeros((1, 4)))
    with pytest.raises(BayescalError, match=r"target ball\.B@2 .*did not reach an optimum.*; state its pos"):
        locate("ball.B@2", Rows(kind, touched(from_above(rng)), np.full((1, 11), SIGMA)))


def test_a_slip_and_a_wrong_place_at_once():
    rng = np.random.default_rng(5)
    p = touched(from_above(rng), SIGMA, rng)
    p[:, 4] += 0.5e-3 * (p[:, 4] - TRUE) / np.linalg.norm(p[:, 4] - TRUE)
    kind = ball(np.add(TRUE, [0.03, 0, 0.02]))
    at, keep = locate("ball", Rows(kind, p, np.full((1, 11), SIGMA)))
    assert keep[4] == 0.0
    assert np.linalg.norm(kind.centre + at.x[0, :3] - TRUE) < 0.1e-3


def test_an_instrument_stated_with_its_axes_turned():
    """By 0.5 rad, 0.3 m off: far beyond its prior, and back by what it read."""
    rng = np.random.default_rng(2)
    nominal = rigid(rpy_matrix(np.array([0.1, -0.2, 1.0])), np.array([2.0, 0.5, 0.3]))
    true = rigid(rpy_matrix(np.array([0.4, 0.1, 1.3])), np.array([2.2, 0.3, 0.4]))
    p = np.array([0.4, 0, 0.3]) + rng.uniform(-0.2, 0.2, (12, 3))
    xyz = (p - true[:3, 3]) @ true[:3, :3]
    kind = Instrument(nominal, p.mean(axis=0), xyz, np.array([0.2] * 3 + [0.05] * 3))
    at, keep = locate("tracker", Rows(kind, p.T, np.full((3, 12), 1e-5)))
    assert keep.all()
    np.testing.assert_allclose(kind.describe(at.x[0])["frame"], true, atol=1e-5)


def test_a_ball_bar_and_a_pin_stated_far_off():
    rng = np.random.default_rng(4)
    u = rng.standard_normal((3, 20))
    u /= np.linalg.norm(u, axis=0)
    u[2] = np.abs(u[2])
    bar = Distance(np.add(TRUE, [0.04, -0.03, 0.02]), np.full(20, 0.3), np.full(3, 0.05))
    at, _ = locate("bar", Rows(bar, TRUE[:, None] + 0.3 * u, np.full((1, 20), SIGMA)))
    np.testing.assert_allclose(bar.centre + at.x[0], TRUE, atol=1e-6)
    turn, height = rng.uniform(-2, 2, 20), rng.uniform(-0.03, 0.03, 20)
    p = TRUE[:, None] + np.stack([13e-3 * np.cos(turn), 13e-3 * np.sin(turn), height])
    sd = np.array([0.2, 0.2, 0.05, 0.05, 1e-3])
    pin = Cylinder(np.add(TRUE, [0.03, 0.02, 0]), np.array([0, 0, 1.0]), 20e-3, np.full(20, RADIUS), sd)
    at, _ = locate("pin", Rows(pin, p, np.full((1, 20), SIGMA)))
    np.testing.assert_allclose(pin.describe(at.x[0])["point"][:2], TRUE[:2], atol=1e-5)


def test_a_closely_stated_place_has_no_rivals(monkeypatch):
    """Other starts count only where the prior lets a second place compete; all are searched from at once."""
    rng, counted = np.random.default_rng(7), []
    p, sigma = touched(from_above(rng), SIGMA, rng), np.full((1, 11), SIGMA)

    def check(name, found, *others):
        counted.append(len(found.x))

    monkeypatch.setattr("bayescal.predict.locate._check", check)
    for prior in (np.full(4, 1e-4), LOOSE):
        at, _ = locate("ball", Rows(ball(TRUE + 5e-5, prior, 11), p, sigma))
        assert np.linalg.norm(TRUE + 5e-5 + at.x[0, :3] - TRUE) < 0.1e-3
    assert counted[0] == 1 < counted[1]


# --- What is predicted of rows of a located target: linear propagation against draws, and what counts how.


@pytest.fixture(scope="module")
def arm_alone(tracker):
    """The arm as fitted to an instrument, and its session with other roles, as if no row was fitted."""
    session = tracker(seed=1, count=45).dataset
    found = estimate(build(Scene(session), ("geometry",)), robust=False)
    own = found.model.slices[ARM]

    def of(role: np.ndarray):
        scene = Scene(with_columns(session, role=role))
        return replace(
            found,
            model=replace(found.model, scene=scene, blocks=(), constraints=()),
            z=found.z[own],
            covariance=100.0 * found.covariance[own, own],  # far more uncertain than the noise
            weights=replace(found.weights, scale={}),
        )

    return of


@pytest.mark.parametrize("located_by", ["other rows", "the same rows"])
def test_rows_of_a_located_instrument_scatter_as_predicted(arm_alone, located_by):
    """The instrument follows the arm, and is drawn towards the noise of the rows that located it."""
    role = np.where(np.arange(45) < (12 if located_by == "other rows" else 0), "locate", "validate")
    found = arm_alone(role)
    z = np.random.default_rng(0).multivariate_normal(found.z, found.covariance, 4000, method="eigh")
    (points,) = validate(found, z, np.ones(4000)).points
    h = crossvalidation.validation_errors(found)
    spread = {row: [] for row in h.rows}
    for row, drawn in zip(found.model.scene.rows("validate"), points.predicted.std(axis=0).T, strict=True):
        spread[row] = list(drawn)
    for row, sd in spread.items():
        np.testing.assert_allclose(np.sort(h.sd[h.rows == row]), np.sort(sd), rtol=0.08)
    noise = found.model.scene.dataset.noise.point
    if located_by == "the same rows":  # 45 x 3 coordinates, which determine the instrument and its reflector
        np.testing.assert_allclose(np.mean(h.noise**2), noise**2 * (1 - (6 + 3) / (3 * 45)), rtol=1e-3)
    else:
        np.testing.assert_allclose(h.noise, noise)


def test_a_tool_is_unknown_where_no_fitted_row_used_it(cube):
    """Its prior is the uncertainty that is stated of it; loose where none is."""
    d = cube(seed=1, count=60).dataset
    m = d.measurements
    apart = np.flatnonzero(m.target == m.target[-1])  # a face that is not fitted
    role, tool = np.full(60, "calibrate", object).astype("<U9"), np.zeros(60, int)
    role[apart] = "validate"
    first, second = np.array_split(apart, 2)
    tool[second] = 1
    for u, expected in ((1e-3, 1e-3), (0.0, 0.0), (None, tool_LOOSE)):
        tools = (d.tools[0], Tool("second", np.array([0.0, 0.0, 0.1]), 3e-3, u=u))
        scene = Scene(replace(d, tools=tools, measurements=replace(m, role=role, tool=tool)))
        assert unknown_tool(scene, second) == expected
        assert unknown_tool(scene, first) == 0.0  # of the tool that was fitted
        assert unknown_tool(scene, apart) == 0.0  # of both
        role[first] = "calibrate"
        fitted = Scene(replace(d, tools=tools, measurements=replace(m, role=role, tool=tool)))
        assert fitted.tools_predicted(fitted.rows("calibrate")) == (1,)
        assert unknown_tool(fitted, second) == 0.0  # the arm has it, with this prior
        role[first] = "validate"


@pytest.mark.parametrize(("alike", "refused"), [(0.999, False), (0.0, True)])
def test_two_places_that_the_tool_makes_up_for_are_one(alike, refused):
    """Apart are solutions by the uncertainty that an unknown tool leaves to the target."""
    size = 100.0  # posterior standard deviations of one unknown with all others known: 0.01
    information = size**2 * np.block([[np.eye(3), alike * np.eye(3)], [alike * np.eye(3), np.eye(3)]])
    x = np.array([[0.0, 0.0, 0.0], [0.08, 0.0, 0.0]])  # 8 of these standard deviations apart, or 0.4
    found = States(x, np.zeros((2, 3)), np.zeros(2), np.zeros(2), np.stack([information] * 2))
    kind = FixedPoint(np.zeros(3), np.ones(3))
    if refused:
        with pytest.raises(BayescalError, match=r"two places 80 mm apart"):
            _check("socket", found, found.some([0]), kind, strict=True)
    else:
        _check("socket", found, found.some([0]), kind, strict=True)
    _check("socket", found, found.some([0]), kind, strict=False)  # a level that only serves for comparison


# --- Resampled mean squares: blocks of any size, and distances as the model that is simulated expects them.


def distances(error, by_noise, u):
    """Distances without a centre in common."""
    count = len(error)
    names = tuple((f"a{k}", f"b{k}") for k in range(count))
    along = np.tile([0.0, 0.6, 0.8], (count, 1))
    nothing = np.zeros((count, 1))
    return CentreDistances(names, error, nothing, by_noise * np.eye(count), u * np.eye(count), along)


def test_rows_of_one_pose_are_one_block_whatever_they_touch(cube):
    """Three rows of one stop, two of equal readings, the others in blocks of neighbours in time."""
    made = cube(seed=4).dataset
    m = made.measurements
    stop, readings = np.full(len(m.ids), "", object), m.readings.copy()
    stop[[3, 40, 90]] = "s"
    readings[60] = readings[10]
    at = np.arange(len(m.ids))
    found = crossvalidation.blocks(Scene(with_columns(made, stop=stop, readings=readings, repeat=None)), at)
    assert len({found[3], found[40], found[90]}) == len({found[10], found[60]}) == 1
    assert np.sum(found == found[3]) == 3
    assert np.sum(found == found[10]) == 2
    rest = np.delete(found, [3, 10, 40, 60, 90])
    assert len(np.unique(rest)) == crossvalidation.BLOCKS
    assert np.all(np.diff(rest) >= 0)


def test_a_mean_over_blocks_of_any_size_is_a_mean():
    rng = np.random.default_rng(0)
    block = np.repeat(np.arange(12), np.arange(1, 13))
    ones, value = np.ones(len(block)), rng.uniform(size=len(block))
    means = crossvalidation.resampled(block, np.stack([ones, value]), rng)
    np.testing.assert_allclose(means[:, 0], 1.0)
    assert value.min() < means[:, 1].min() < value.mean() < means[:, 1].max() < value.max()


@pytest.mark.parametrize(("by_noise", "u"), [(3e-6, 0.0), (0.0, 3e-6)])
def test_many_distances_are_drawn_about_the_measured_mean_square(by_noise, u):
    """What is simulated has the mean square that is expected of it: from centres, noise and certificates."""
    rng = np.random.default_rng(1)
    noise = 3e-6 * rng.standard_normal(120)
    before, after = (distances(size * rng.standard_normal(120) + noise, by_noise, u) for size in (5e-6, 2e-6))
    draws = crossvalidation.resampled_distances(before, after, rng)
    measured = np.mean(np.stack([before.error, after.error]) ** 2, axis=1)
    np.testing.assert_allclose(np.median(draws, axis=0), measured, rtol=0.05)


def test_few_distances_widen_the_draws():
    """A variance that was estimated from n values has a logarithm sqrt(n / (n - 1)) times as uncertain."""
    found = distances(1e-5 * np.array([1.0, -1.2, 0.8]), 1e-8, 0.0)
    draws = crossvalidation.resampled_distances(found, found, np.random.default_rng(2))
    of_chi_square = np.sqrt(polygamma(1, 3 / 2))
    assert np.std(np.log(draws[:, 0])) == pytest.approx(np.sqrt(3 / 2) * of_chi_square, rel=0.06)


# --- Predicted distance errors of the workspace: between which points, and what each part adds.

NO_CHECKS = Validation((), (), (), (), ())


def with_two_tools(d: Dataset) -> Dataset:
    """The session with a tool of the same place, but another name, in the second half of its rows."""
    tools = (*d.tools, replace(d.tools[0], name="second"))
    tool = (np.arange(len(d.measurements.ids)) >= len(d.measurements.ids) // 2).astype(int)
    return replace(d, tools=tools, measurements=replace(d.measurements, tool=tool))


@pytest.fixture(scope="module")
def fitted(cube) -> Estimate:
    data = with_two_tools(cube(seed=6, count=60).dataset)
    return estimate(build(Scene(data), ("geometry",)), robust=False)


@pytest.fixture(scope="module")
def draws(fitted) -> np.ndarray:
    return gaussian(fitted, 0, 400).flat


def test_pairs_are_of_one_tool_and_no_shorter_than_a_fifth_of_the_longest(fitted, draws):
    found = forecast(fitted, draws, NO_CHECKS, 0.0).workspace
    assert 100 < found.count <= 2 * (20 * 19 // 2)  # 40 rows, 20 of each tool
    assert found.shortest > 0.2 * found.longest


def test_an_unexplained_error_adds_twice_its_square_to_the_variance(fitted, draws):
    """It moves both ends of a distance; its share is of the sum of all parts."""
    plain = forecast(fitted, draws, NO_CHECKS, 0.0)
    assert plain.unexplained_share == 0.0
    excess = plain.workspace.rms / np.sqrt(2.0)
    found = forecast(fitted, draws, NO_CHECKS, excess)
    assert found.workspace.rms == pytest.approx(np.sqrt(2.0) * plain.workspace.rms, rel=0.08)
    assert found.unexplained_share == pytest.approx(0.5, abs=0.08)
    assert found.prior_share == pytest.approx((1 - found.unexplained_share) * plain.prior_share)
    assert found.prior_rms == plain.prior_rms


# --- Intervals hold what they say, 95 %.


def test_interval_of_draws_is_of_95_percent():
    low, high = crossvalidation.interval95(np.linspace(0.0, 1.0, 1001))
    assert (low, high) == (pytest.approx(0.025), pytest.approx(0.975))


def test_interval_of_normal_draws_holds_95_percent_of_new_ones():
    rng = np.random.default_rng(0)
    inside = crossvalidation.inside95(rng.standard_normal(4000), rng.standard_normal((4000, 4000)))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)


def test_bootstrap_interval_is_of_95_percent_and_wider_of_few_blocks():
    draws = np.random.default_rng(1).standard_normal(200_000)
    low, high = crossvalidation.bootstrap_interval95(0.0, draws, 10_000)
    assert (low, high) == (pytest.approx(-1.96, abs=0.02), pytest.approx(1.96, abs=0.02))
    few = crossvalidation.bootstrap_interval95(0.0, draws, 4)
    assert few[1] == pytest.approx(3.182 * np.sqrt(4 / 3), rel=0.02)  # Student t of 3 degrees of freedom
    assert np.isnan(crossvalidation.bootstrap_interval95(0.0, draws, 1)).all()
