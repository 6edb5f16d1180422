"""The ladder's gains, and margins that find where the residuals stand out."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_problems import unsolved
from made_up_errors import NOISE, held
from scipy.stats import chi2
from sessions import circumstances, kept_back, misread, with_columns

from bayescal.effects.gravity import masses
from bayescal.estimate import estimate
from bayescal.estimate.families import with_compliances
from bayescal.gap.linear.problem import problem
from bayescal.gap.linear.state import fit_state
from bayescal.gap.outcome import magnitude
from bayescal.gap.outcome.margins import holm, margins, residuals_in_time
from bayescal.gap.outcome.statements import wrong_masses
from bayescal.gap.search.verdict import Decision
from bayescal.model import build, with_parameters
from bayescal.model.scene import Scene
from bayescal.predict import crossvalidation
from bayescal.predict.crossvalidation import LEFT_OUT, VALIDATED, validation_errors
from bayescal.predict.errors import CentreDistances

FULL = ("geometry", "compliance")


@pytest.fixture(scope="module")
def rungs(cube):
    """Nominal, geometry, geometry and compliance, of one session with rows kept back."""
    scene = Scene(kept_back(cube(seed=5, count=200).dataset, 50))
    out = [level((), estimate(with_parameters(scene, (), ())))]
    return [*out, *(level(FULL[: k + 1], estimate(build(scene, FULL[: k + 1]))) for k in range(2))]


def level(model, fitted):
    return magnitude.Level(model, fitted, validation_errors(fitted))


def test_ladder_goes_down_and_gains(rungs):
    steps = magnitude.model_levels(rungs)
    assert [s.model for s in steps] == [(), FULL[:1], FULL]
    assert (steps[0].delta_elpd, steps[0].delta_elpd_se) == (0.0, 0.0)
    rms = [s.validation_rms for s in steps]
    assert rms[0] > 5 * rms[1] > 5 * rms[2]
    held = validation_errors(rungs[2].fitted)
    assert rms[2] == pytest.approx(np.sqrt(np.mean(held.residual**2)))
    assert 0.001 < chi2.sf(np.sum((held.residual / held.sd) ** 2), 50) < 0.999
    assert np.sqrt(np.mean(held.sd**2)) == pytest.approx(5e-6, rel=0.1)
    for s in steps[1:]:
        assert s.delta_elpd > 4 * s.delta_elpd_se > 0
        assert np.isnan(s.distance_rms)
        assert np.isnan(s.point_rms)
    _, again = magnitude.model_levels([rungs[-1], rungs[-1]])  # the same model gains nothing
    assert (again.delta_elpd, again.delta_elpd_se) == (0.0, 0.0)


@pytest.mark.parametrize("shift", [0.0, 3.0, -5.0])
def test_errors_of_masses_that_explain_residuals_are_stated(rungs, shift):
    """They were part of noise only in silence: "the model explains these data"."""
    fitted = rungs[2].fitted
    of = masses(with_compliances(circumstances(fitted.model.scene), fitted))
    p = problem(fitted, (), of)
    k = [q.name for q in of].index("centre of load x")
    by = p.jacobian[:, fitted.model.size + k] * shift
    rng = np.random.default_rng(1)
    p = replace(p, residual=rng.standard_normal(len(p.residual)) - by)
    said = wrong_masses(fit_state(p, (), ()), of)
    if not shift:
        assert said == ""
        return
    value, u = map(float, re.search(r"one of (\S+) ± (\S+) mm: centre of load x", said).groups())
    assert abs(value - 1e3 * of[k].sd * shift) < 3 * u + 0.1  # two digits
    assert u < abs(value) / 3
    before, after, nats = map(float, re.search(r"of (\S+) µm RMS are (\S+), (\d+) nats", said).groups())
    assert before > 1.1 * after
    assert after == pytest.approx(4.2, rel=0.15)  # 5 µm, of fewer degrees of freedom
    count = p.count
    gained = count * np.log(before / after)
    assert nats == pytest.approx(gained, abs=0.2 * gained + 10)


def test_density_is_that_of_a_normal_and_a_slip_costs_little(rungs):
    h = validation_errors(rungs[-1].fitted)
    density, block = magnitude.log_predictive(h)
    assert density.shape == block.shape == (50,)
    normal = -0.5 * (h.residual / h.sd) ** 2 - np.log(np.sqrt(2 * np.pi) * h.sd)
    quiet = np.abs(h.residual) < 2 * h.sd
    np.testing.assert_allclose(density[quiet], normal[quiet], atol=0.03)
    slipped = h.residual.copy()
    slipped[0] = 1e-2
    assert density[0] - magnitude.log_predictive(replace(h, residual=slipped))[0][0] < 13
    assert magnitude.difference(np.ones(6), np.arange(6)) == (6.0, 0.0)
    drawn, rng = [], np.random.default_rng(0)
    for _ in range(500):  # sums of twelve blocks of five
        shared, own = rng.standard_normal(12), rng.standard_normal(60)
        drawn.append(magnitude.difference(np.repeat(shared, 5) + own, np.repeat(np.arange(12), 5)))
    gain, se = np.array(drawn).T
    assert np.sqrt(np.mean(se**2)) == pytest.approx(np.std(gain), rel=0.12)


def test_points_have_a_rung_too(tracker):
    scene = Scene(tracker(seed=0, count=60).dataset)
    nominal, last = estimate(with_parameters(scene, (), ())), estimate(build(scene, FULL))
    steps = magnitude.model_levels([level((), nominal), level(FULL, last)])
    assert steps[1].point_rms == steps[1].validation_rms < 0.1 * steps[0].point_rms
    assert steps[1].delta_elpd > 0
    found = margins(last, validation_errors(last))
    assert [m.label for m in found["direction"][:3]] == ["along x", "along y", "along z"]
    assert all(m.count == 60 for m in found["direction"][:3])


def bins_of(dataset):
    fitted = estimate(build(Scene(dataset), FULL))
    return margins(fitted, validation_errors(fitted))


def test_clean_sessions_have_no_deviant_bin(cube):
    smallest = []
    for seed in range(20, 32):
        bins = bins_of(kept_back(cube(seed=seed, count=160).dataset, 40))
        smallest.append(min(m.p_value for each in bins.values() for m in each))
    assert np.sum(np.array(smallest) < 0.05) <= 3
    assert min(smallest) > 1e-4


def test_margins_find_a_wrong_face(cube):
    """Contacts of one face that scatter."""
    d = cube(seed=6, count=300).dataset
    wrong = np.flatnonzero(d.measurements.target == 1)
    bins = bins_of(misread(d, 1, 5e-5 * np.random.default_rng(0).standard_normal(len(wrong)), wrong))
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
    bins = bins_of(misread(d, 1, 6e-5, late))
    assert min(bins["time"], key=lambda m: m.p_value).label.startswith("44 to")
    assert min(m.p_value for m in bins["time"]) < 1e-6
    velocity = np.abs(d.measurements.velocity)
    rare = np.arange(10, 300, 24)
    velocity[rare, 2] *= -1
    d = with_columns(d, velocity=velocity)
    bins = bins_of(misread(d, 1, 4e-4, rare))  # rejected as outliers, one and all
    worst = min(bins["direction"], key=lambda m: m.p_value)
    assert worst.label == "direction of motion of J3, negative"
    assert worst.p_value < 1e-6
    assert worst.count == len(rare)


def test_missing_columns_leave_a_margin_empty(cube):
    d = cube(seed=8).dataset
    bins = bins_of(with_columns(d, time=None, velocity=None))
    assert bins["time"] == ()
    assert list(bins) == ["target", "joint", "region", "time", "direction"]
    assert all(m.label.startswith("touched") for m in bins["direction"])
    assert len(bins["joint"]) == 12
    assert all(" deg" in m.label for m in bins["joint"])
    assert all(m.label.endswith(" mm") for m in bins["region"])


def test_holm():
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.5])), [0.04, 0.09, 0.09, 0.5])


# --- The fraction of the gap that went: known cases, coverage of its interval, and what is not claimed.

INFINITE = float("inf")


def test_a_gap_that_is_taken_away_and_half_of_one():
    rng = np.random.default_rng(0)
    noise, effect = NOISE * rng.standard_normal(1000), 20e-6 * rng.standard_normal(1000)
    (whole,) = magnitude.shrinkage(held(noise + effect), held(noise), NOISE)
    assert (whole.what, whole.count) == ("planes", 1000)
    assert whole.removed == pytest.approx(1.0, abs=0.02)
    assert whole.before == pytest.approx(np.hypot(20e-6, 5e-6), rel=0.05)
    assert whole.floor == pytest.approx(NOISE)
    assert whole.claimed
    (half,) = magnitude.shrinkage(held(noise + effect), held(noise + np.sqrt(0.5) * effect), NOISE)
    assert half.removed == pytest.approx(0.5, abs=0.05)
    assert half.removed_interval95[0] < 0.5 < half.removed_interval95[1]


@pytest.mark.parametrize(("blocks", "per_block"), [(40, 1), (20, 3), (5, 3)])
def test_interval_covers_the_truth(blocks, per_block):
    """Half of a gap whose size differs from block to block goes; the interval holds that share."""
    rng = np.random.default_rng(blocks)
    count, inside, finite = blocks * per_block, 0, 0
    block = np.repeat(np.arange(blocks), per_block)
    for _ in range(200):
        effect = 20e-6 * np.repeat(rng.standard_normal(blocks), per_block) * rng.choice([-1, 1], count)
        noise = NOISE * rng.standard_normal(count)
        before, after = (noise + share * effect for share in (1.0, np.sqrt(0.5)))
        squares = np.stack([before**2, after**2, np.full(count, NOISE**2), np.zeros(count)])
        found = magnitude.of_blocks("planes", count, squares, block, (NOISE, NOISE), INFINITE, rng)
        finite += np.isfinite(found.removed)
        inside += found.removed_interval95[0] <= 0.5 <= found.removed_interval95[1]
    assert finite > 180
    assert inside / finite > 0.9


def test_without_a_gap_there_is_no_ratio_and_no_claim():
    rng = np.random.default_rng(1)
    wrong = np.zeros(2)
    for _ in range(100):
        noise = NOISE * rng.standard_normal(60)
        other = noise + 0.5e-6 * rng.standard_normal(60)
        (found,) = magnitude.shrinkage(held(noise), held(other), NOISE, noise_dof=45)
        wrong += np.isfinite(found.removed), found.claimed
    assert np.all(wrong <= 10)


def test_worse_distances_are_not_claimed():
    rng = np.random.default_rng(2)
    noise = NOISE * rng.standard_normal(60)
    big = 34e-6 * rng.choice([-1, 1], 12)
    before = held(noise + 20e-6, distances=big)
    planes, distances = magnitude.shrinkage(before, held(noise, distances=3 * big), NOISE)
    assert planes.claimed
    assert (distances.what, distances.count, distances.claimed) == ("distances", 12, False)
    assert distances.removed < 0
    unsure = magnitude.shrinkage(before, held(noise, distances=big / 10, distance_sd=100e-6), NOISE)[1]
    assert not unsure.claimed
    assert unsure.predicted == pytest.approx(100e-6)
    good = magnitude.shrinkage(before, held(noise, distances=big / 10), NOISE)[1]
    assert good.claimed
    assert good.removed > 0.95


def test_predicted_shrinkage_rests_on_fitted_rows_alone():
    """It is right where the refitted model is, and held-out noise of another draw does not move it."""
    rng = np.random.default_rng(6)
    effect, off = 20e-6 * rng.standard_normal(2000), 3e-6 * rng.standard_normal(2000)
    told = []
    for _ in range(2):
        noise = NOISE * rng.standard_normal(2000)
        after = held(noise + off, sd=np.hypot(NOISE, 3e-6))
        (found,) = magnitude.shrinkage(held(noise + off + effect), after, NOISE)
        assert found.predicted_before == pytest.approx(found.before, rel=0.05)
        assert found.predicted == pytest.approx(found.after, rel=0.05)
        told.append((found.predicted_before, found.predicted))
    assert told[0] == pytest.approx(told[1], rel=1e-9)
    expected = magnitude.expects(*np.array([[7.0, -1.0], [3.0, -1.0], [1.0, 1.0]]))
    assert expected == pytest.approx((3.0, 1.0))


def test_a_slip_does_not_count():
    rng = np.random.default_rng(3)
    noise = NOISE * rng.standard_normal(60)
    slipped = noise.copy()
    slipped[7] = 300e-6
    (clean,) = magnitude.shrinkage(held(noise + 15e-6), held(noise), NOISE)
    (spoilt,) = magnitude.shrinkage(held(slipped + 15e-6), held(slipped), NOISE)
    assert spoilt.count == clean.count - 1
    assert spoilt.after == pytest.approx(clean.after, rel=0.1)


def test_a_contact_is_gross_where_noise_exceeds_it_in_one_session_of_a_hundred():
    """With 60 contacts beyond 3.76 standard deviations; further out where the noise itself is uncertain."""
    residual = 0.7 * NOISE * np.random.default_rng(3).standard_normal(60).clip(-2.5, 2.5)
    residual[[6, 7, 8]] = 3.6 * NOISE, 4.8 * NOISE, -8.0 * NOISE
    h = held(residual)
    assert np.flatnonzero(h.gross).tolist() == [7, 8]
    assert np.flatnonzero(replace(h, dof={h.main: 12.0}).gross).tolist() == [8]


def test_the_coordinates_of_a_point_are_judged_together():
    """4.2 standard deviations in each of three coordinates, and the same where these vary together."""
    residual = NOISE * np.random.default_rng(3).standard_normal(60).clip(-2.5, 2.5)
    residual[30:33] = 4.2 * NOISE
    points = replace(held(residual), rows=np.arange(60) // 3, block=np.arange(60) // 3)
    assert np.flatnonzero(points.gross).tolist() == [30, 31, 32]
    loose = replace(points, by_parameters=np.full((60, 1), 2 * NOISE))
    assert not loose.gross.any()
    together = np.tile(NOISE**2 * (np.eye(3) + 4.0), (20, 1))
    sd = np.full(60, np.sqrt(5.0) * NOISE)
    same = replace(points, by_parameters=np.zeros((60, 0)), noise=sd, noise_covariance=together)
    np.testing.assert_allclose(same.joint.chi2, loose.joint.chi2)
    np.testing.assert_allclose(same.joint.logdet, loose.joint.logdet)


def test_one_seed_one_result():
    rng = np.random.default_rng(4)
    noise = NOISE * rng.standard_normal(60)
    first, again = (magnitude.shrinkage(held(3 * noise), held(noise), NOISE, seed=5) for _ in range(2))
    assert first == again
    three = replace(held(noise), block=np.arange(60) // 20)
    (wide,) = magnitude.shrinkage(replace(held(3 * noise), block=np.arange(60) // 20), three, NOISE)
    assert wide.removed == pytest.approx(first[0].removed)


def test_bootstrap_moves_blocks_as_one():
    rng = np.random.default_rng(5)
    block = np.repeat(np.arange(30), 10)
    shared = rng.standard_normal(30)[block]
    means = crossvalidation.resampled(block, np.stack([shared, shared + 1.0]), rng)
    np.testing.assert_allclose(means[:, 1] - means[:, 0], 1.0)
    assert means[:, 0].std() == pytest.approx(shared.std() / np.sqrt(30), rel=0.1)


def centres_of(rng, spheres, kept, own):
    """Errors by two models of all distances between spheres whose centres err by 20 um, (1 - kept^2) less."""
    first, second = np.triu_indices(spheres, 1)
    place = rng.standard_normal((spheres, 3))
    along = place[first] - place[second]
    along /= np.linalg.norm(along, axis=1)[:, None]
    error, other = 20e-6 * rng.standard_normal((2, spheres, 3))
    noise = 0.5 * NOISE * rng.standard_normal((spheres, 3))
    names = tuple((f"{i}", f"{j}") for i, j in zip(first, second, strict=True))
    count = len(names)
    out = []
    for centre in (error + noise, kept * error + own * other + noise):
        off = np.sum(along * (centre[first] - centre[second]), axis=1)
        d = CentreDistances(names, off, *[np.zeros((count, 1))] * 3, along)
        out.append(replace(d, by_noise=0.5 * NOISE * d.by_centres))
    return out


@pytest.mark.parametrize("spheres", [3, 5])
def test_interval_of_distances_that_share_spheres_covers_the_truth(spheres):
    """Two thirds of the excess of all distances between few spheres go; as if independent, it held .83."""
    rng = np.random.default_rng(spheres)
    inside, naive, finite = 0, 0, 0
    for _ in range(150):
        before, after = centres_of(rng, spheres, 0.3, 0.5)
        found = magnitude.of_distances(before, after, INFINITE, rng)
        if not np.isfinite(found.removed):
            continue
        count = len(before.error)
        floor = after.predicted_sd() ** 2
        squares = np.stack([before.error**2, after.error**2, floor, np.zeros(count)])
        rows = np.arange(count)
        as_rows = magnitude.of_blocks("distances", count, squares, rows, (0.0, 0.0), INFINITE, rng)
        low, high = found.removed_interval95
        inside += low <= 1 - 0.3**2 - 0.5**2 <= high
        low, high = as_rows.removed_interval95
        naive += low <= 1 - 0.3**2 - 0.5**2 <= high
        finite += 1
    assert finite > 140
    assert inside / finite > 0.89
    assert inside > naive


def test_spheres_in_common_make_distances_worth_fewer():
    rng = np.random.default_rng(0)
    shared, _ = centres_of(rng, 6, 0.5, 0.0)
    apart = replace(shared, names=tuple((f"a{k}", f"b{k}") for k in range(15)))
    assert crossvalidation.independent_distances(apart) == pytest.approx(15)
    assert crossvalidation.independent_distances(shared) < 9


def test_an_uncertain_noise_widens_the_interval():
    """By its degrees of freedom: for contacts as for distances."""
    rng = np.random.default_rng(7)
    noise, effect = NOISE * rng.standard_normal(1000), 12e-6 * rng.standard_normal(1000)
    before, after = held(noise + effect), held(noise + 0.7 * effect)
    (sharp,), (loose,) = (magnitude.shrinkage(before, after, NOISE, noise_dof=dof) for dof in (1e6, 6.0))
    assert np.ptp(loose.removed_interval95) > 1.5 * np.ptp(sharp.removed_interval95)
    assert sharp.removed == loose.removed
    # the part of the parameters in what is expected has no such uncertainty
    before, after = held(noise + effect, sd=8e-6), held(noise + 0.7 * effect, sd=8e-6)
    noiseless = [replace(h, noise=0.1 * h.noise) for h in (before, after)]
    (sharp,), (loose,) = (magnitude.shrinkage(*noiseless, 0.1 * NOISE, noise_dof=dof) for dof in (1e6, 6.0))
    assert np.ptp(loose.removed_interval95) == pytest.approx(np.ptp(sharp.removed_interval95), rel=0.1)
    old, new = centres_of(rng, 8, 0.8, 0.0)
    far, near = (magnitude.of_distances(old, new, dof, np.random.default_rng(0)) for dof in (3.0, 1e6))
    assert np.ptp(far.removed_interval95) > np.ptp(near.removed_interval95)


def test_the_floor_is_that_of_the_refitted_model():
    """Contacts and distances: what a right model would leave, whatever the baseline expected."""
    rng = np.random.default_rng(8)
    noise, off = NOISE * rng.standard_normal(500), 10e-6 * rng.standard_normal(12)
    before = held(noise + 20e-6, sd=40e-6, distances=5 * off, distance_sd=70e-6)
    after = held(noise, sd=np.hypot(NOISE, 3e-6), distances=off, distance_sd=10e-6)
    planes, distances = magnitude.shrinkage(before, after, NOISE)
    assert planes.floor == pytest.approx(np.hypot(NOISE, 3e-6))
    assert distances.floor == pytest.approx(10e-6)


# --- The RMS to expect of a correct model, as a diagnosis states it.


@pytest.mark.parametrize("dof", [3.0, 12.0, 400.0])
def test_the_interval_of_the_noise_covers_it_in_95_of_100_sessions(dof):
    """As often above it as below; draws of it, by which the excess has its interval, are within as often."""
    estimates = NOISE * np.sqrt(np.random.default_rng(1).chisquare(dof, 4000) / dof)
    low, high = np.array([magnitude.NoiseFloor(sd, dof, "repeats").interval95 for sd in estimates]).T
    assert np.mean(low > NOISE) == pytest.approx(0.025, abs=0.008)
    assert np.mean(high < NOISE) == pytest.approx(0.025, abs=0.008)
    own = magnitude.NoiseFloor(NOISE, dof, "repeats")
    drawn, (low, high) = own.draws(np.random.default_rng(2)), own.interval95
    assert np.mean((drawn > low) & (drawn < high)) == pytest.approx(0.95, abs=0.015)


def test_the_expected_rms_is_that_of_a_fit():
    """A root mean square, not a median: errors with a common cause are skewed, and U = 2 RMS."""
    found = magnitude._measured("sphere distances", 3, np.ones(3), np.array([1.0, 1.0, 4.0]))
    assert found.predicted_rms == pytest.approx(np.sqrt(6.0))
    assert found.predicted_interval95[0] >= 1.0


# --- The size of a gap and what a model expects: of errors that were drawn, part by part.

COUNT, KNOWN = 1000, 1e6
"""Validation measurements, and degrees of freedom of a noise that is known."""
PARTS = {"noise": NOISE, "parameters": 4e-6, "error": 8e-6}
"""m, of contacts."""
FACTORS = {"by_parameters": 3e-6, "by_noise": 5e-6, "by_certificates": 6e-6}
"""m, of what moves a certified distance."""


def drawn(parts, distances=None, seed=0):
    """Contacts and distances that leave errors of some parts; the model has the noise and the parameters."""
    rng = np.random.default_rng(seed)
    errors = sum(size * rng.standard_normal(COUNT) for size in parts.values())
    sizes = dict.fromkeys(FACTORS, 0.0) | (distances or {})
    count = 30 if distances is not None else 0
    made = held(errors, np.hypot(NOISE, parts.get("parameters", 0.0)), np.zeros(count))
    each = {key: size * np.eye(count) for key, size in sizes.items()}
    return replace(made, distances=replace(made.distances, **each))


@pytest.fixture
def measured(monkeypatch):
    """The size of a gap by errors, with a noise that is known."""
    floor = magnitude.NoiseFloor(NOISE, KNOWN, "stated")
    monkeypatch.setattr(magnitude, "noise_floor", lambda final, group: floor)
    monkeypatch.setattr(magnitude, "stated_noise", lambda fitted, group: NOISE)
    estimate = SimpleNamespace(weights=SimpleNamespace(scale={"contact": 1.0}))
    return lambda errors: magnitude.magnitude(estimate, estimate, errors)


@pytest.mark.parametrize("how", [VALIDATED, LEFT_OUT])
@pytest.mark.parametrize("error", [0.0, 8e-6, 20e-6])
def test_the_excess_is_what_neither_noise_nor_parameters_explain(measured, error, how):
    errors = drawn(PARTS | {"error": error})
    if how == LEFT_OUT:  # the noise of a contact that was left out has that of the parameters
        wide = np.full(COUNT, np.hypot(NOISE, PARTS["parameters"]))
        errors = replace(errors, how=how, noise=wide, by_parameters=0.0 * errors.by_parameters)
    found = measured(errors)
    low, high = found.excess_interval95
    assert low <= error <= high
    assert found.excess == pytest.approx(error, rel=0.1, abs=2e-6)
    every = np.linalg.norm([NOISE, PARTS["parameters"], error])
    assert found.validation_rms == pytest.approx(every, rel=0.05)


def test_blurred_measurements_are_no_excess(measured):
    errors = drawn({"noise": NOISE})
    blur = np.where(np.arange(COUNT) % 5 == 0, 4.0, 1.0)
    blurred = replace(errors, residual=blur * errors.residual, noise=blur * errors.noise)
    assert measured(blurred).excess_interval95[0] == 0.0


def test_the_expected_errors_of_contacts_are_those_of_noise_and_parameters(measured):
    (contacts,) = measured(drawn(PARTS)).measured
    assert contacts.count == COUNT
    low, high = contacts.predicted_interval95
    assert low < contacts.predicted_rms < high
    expected = np.hypot(NOISE, PARTS["parameters"])
    assert contacts.predicted_rms == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("without", ["", *FACTORS])
def test_the_expected_errors_of_distances_have_every_part(measured, without):
    parts = {key: size for key, size in FACTORS.items() if key != without}
    found = measured(drawn(PARTS, parts)).measured[-1]
    assert (found.what, found.count) == ("sphere distances", 30)
    assert found.predicted_rms == pytest.approx(np.linalg.norm([*parts.values()]), rel=0.05)


# --- Residuals of the figures are in the order of time, whatever the targets and the order of the file.


@pytest.mark.parametrize("timed", [False, True])
def test_residuals_are_in_the_order_of_time(cube, timed):
    dataset = cube(seed=1).dataset
    count = len(dataset.measurements.ids)
    clock = np.random.default_rng(2).permutation(count).astype(float) if timed else None
    fitted = unsolved(with_columns(dataset, time=clock))
    rows, before, after = residuals_in_time(fitted, fitted)
    assert np.all(np.diff(rows if clock is None else clock[rows]) > 0)
    np.testing.assert_array_equal(before, after)
    by_row = np.full(count, np.nan)
    for b in fitted.model.blocks:
        by_row[b.rows] = fitted.residuals(b)[0]
    np.testing.assert_array_equal(before, by_row[rows])


def test_an_effect_loses_what_the_best_set_without_it_lacks():
    """The best set without an effect, wherever it stands in the list."""
    sets = [(("a", "b"), 9.0), (("a",), 7.0), (("b",), 2.0), (("c",), 5.0), ((), 0.0)]
    found = SimpleNamespace(weighed=[SimpleNamespace(effects=e, score=s) for e, s in sets])
    assert Decision.lost(found, "a") == 9.0 - 5.0
    assert Decision.lost(found, "b") == 9.0 - 7.0
    assert Decision.lost(SimpleNamespace(weighed=found.weighed[:2]), "a") == np.inf
