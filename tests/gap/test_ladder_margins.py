"""The ladder's gains, and margins that find where the residuals stand out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from bayescal.estimate import estimate
from bayescal.gap.outcome.magnitude import difference, log_predictive, model_levels
from bayescal.gap.outcome.margins import holm, margins
from bayescal.model import build, with_parameters
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import validation_errors

FULL = ("geometry", "compliance")


def kept_back(dataset, count):
    role = dataset.measurements.role.copy()
    role[-count:] = "validate"
    return replace(dataset, measurements=replace(dataset.measurements, role=role))


@pytest.fixture(scope="module")
def rungs(cube):
    """Nominal, geometry, geometry and compliance, of one session with rows kept back."""
    scene = Scene(kept_back(cube(seed=5, count=200).dataset, 50))
    out = [((), estimate(with_parameters(scene, (), ())))]
    return [*out, *((FULL[: k + 1], estimate(build(scene, FULL[: k + 1]))) for k in range(2))]


def test_ladder_goes_down_and_gains(rungs):
    steps = model_levels(rungs)
    assert [s.model for s in steps] == [(), FULL[:1], FULL]
    assert (steps[0].delta_elpd, steps[0].delta_elpd_se) == (0.0, 0.0)
    rms = [s.validation_rms for s in steps]
    assert rms[0] > 5 * rms[1] > 5 * rms[2]
    held = validation_errors(rungs[2][1])
    assert rms[2] == pytest.approx(np.sqrt(np.mean(held.residual**2)))
    assert 0.001 < chi2.sf(np.sum((held.residual / held.sd) ** 2), 50) < 0.999
    assert np.sqrt(np.mean(held.sd**2)) == pytest.approx(5e-6, rel=0.1)
    for s in steps[1:]:
        assert s.delta_elpd > 4 * s.delta_elpd_se > 0
        assert np.isnan(s.distance_rms)
        assert np.isnan(s.point_rms)


def test_the_same_model_again_gains_nothing(rungs):
    last = rungs[-1]
    _, again = model_levels([last, last])
    assert (again.delta_elpd, again.delta_elpd_se) == (0.0, 0.0)


def test_ladder_takes_what_is_known_already(rungs):
    assert str(model_levels(rungs)) == str(model_levels(rungs, [validation_errors(e) for _, e in rungs]))


def test_density_is_that_of_a_normal_and_a_slip_costs_little(rungs):
    h = validation_errors(rungs[-1][1])
    density, block = log_predictive(h)
    assert density.shape == block.shape == (50,)
    normal = -0.5 * (h.residual / h.sd) ** 2 - np.log(np.sqrt(2 * np.pi) * h.sd)
    quiet = np.abs(h.residual) < 2 * h.sd
    np.testing.assert_allclose(density[quiet], normal[quiet], atol=0.03)
    slipped = h.residual.copy()
    slipped[0] = 1e-2
    assert density[0] - log_predictive(replace(h, residual=slipped))[0][0] < 13
    assert difference(np.ones(6), np.arange(6)) == (6.0, 0.0)
    drawn, rng = [], np.random.default_rng(0)
    for _ in range(500):  # sums of twelve blocks of five
        shared, own = rng.standard_normal(12), rng.standard_normal(60)
        drawn.append(difference(np.repeat(shared, 5) + own, np.repeat(np.arange(12), 5)))
    gain, se = np.array(drawn).T
    assert np.sqrt(np.mean(se**2)) == pytest.approx(np.std(gain), rel=0.12)


def test_points_have_a_rung_too(tracker):
    scene = Scene(tracker(seed=0, count=60).dataset)
    nominal, last = estimate(with_parameters(scene, (), ())), estimate(build(scene, FULL))
    steps = model_levels([((), nominal), (FULL, last)])
    assert steps[1].point_rms == steps[1].validation_rms < 0.1 * steps[0].point_rms
    assert steps[1].delta_elpd > 0
    found = margins(last, validation_errors(last))
    assert [m.label for m in found["direction"][:3]] == ["along x", "along y", "along z"]
    assert all(m.count == 60 for m in found["direction"][:3])


def test_clean_sessions_have_no_deviant_bin(cube):
    smallest = []
    for seed in range(20, 32):
        found = estimate(build(Scene(kept_back(cube(seed=seed, count=160).dataset, 40)), FULL))
        smallest.append(
            min(m.p_value for bins in margins(found, validation_errors(found)).values() for m in bins)
        )
    assert np.sum(np.array(smallest) < 0.05) <= 3
    assert min(smallest) > 1e-4


def shifted(dataset, rows, by):
    """Readings of some rows a little wrong: joint 1 turned, which moves the ball sideways."""
    readings = dataset.measurements.readings.copy()
    readings[rows, 0] += by
    return replace(dataset, measurements=replace(dataset.measurements, readings=readings))


def test_margins_find_a_wrong_face(cube):
    """Contacts of one face that scatter."""
    d = cube(seed=6, count=300).dataset
    wrong = np.flatnonzero(d.measurements.target == 1)
    d = shifted(d, wrong, 5e-5 * np.random.default_rng(0).standard_normal(len(wrong)))
    found = estimate(build(Scene(d), FULL))
    bins = margins(found, validation_errors(found))
    name = d.targets[1].name
    worst = min(bins["target"], key=lambda m: m.p_value)
    assert worst.label == name
    assert worst.p_value < 1e-4
    assert worst.rms > 1.5 * max(m.rms for m in bins["target"] if m.label != name)
    side = {"y": "touched from -y", "x": "touched from -x"}["y" if "y" in name else "x"]
    assert min(bins["direction"], key=lambda m: m.p_value).label == side


def test_margins_find_a_moment_and_a_rare_direction(cube):
    d = cube(seed=7, count=300).dataset
    late = np.arange(270, 300)
    bins = _bins(shifted(d, late, 6e-5))
    assert min(bins["time"], key=lambda m: m.p_value).label.startswith("44 to")
    assert min(m.p_value for m in bins["time"]) < 1e-6
    velocity = np.abs(d.measurements.velocity)
    rare = np.arange(10, 300, 24)
    velocity[rare, 2] *= -1
    d = replace(d, measurements=replace(d.measurements, velocity=velocity))
    bins = _bins(shifted(d, rare, 4e-4))  # rejected as outliers, one and all
    worst = min(bins["direction"], key=lambda m: m.p_value)
    assert worst.label == "direction of motion of J3, negative"
    assert worst.p_value < 1e-6
    assert worst.count == len(rare)


def _bins(dataset):
    found = estimate(build(Scene(dataset), FULL))
    return margins(found, validation_errors(found))


def test_missing_columns_leave_a_margin_empty(cube):
    d = cube(seed=8).dataset
    bins = _bins(replace(d, measurements=replace(d.measurements, time=None, velocity=None)))
    assert bins["time"] == ()
    assert list(bins) == ["target", "joint", "region", "time", "direction"]
    assert all(m.label.startswith("touched") for m in bins["direction"])
    assert len(bins["joint"]) == 12
    assert all(" deg" in m.label for m in bins["joint"])
    assert all(m.label.endswith(" mm") for m in bins["region"])


def test_holm():
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.5])), [0.04, 0.09, 0.09, 0.5])
