"""The study in small: true arms are found as surely as is said, and a false certainty would be seen."""

from dataclasses import fields

import numpy as np
import pytest
from scipy.stats import binom, chi2

from analysis import own_sessions as own
from analysis.calibration_checks import figures as check_figures
from analysis.calibration_checks.designs import DESIGNS, Design
from analysis.calibration_checks.session import Joint, independent
from analysis.calibration_checks.session import run as checked
from analysis.calibration_checks.truth import MODEL, simulated
from analysis.study import figures, session
from bayescal.dataset import Dataset
from bayescal.estimate import calibrated, linearise
from bayescal.model.scene import Scene
from bayescal.posterior import gaussian
from bayescal.simulation import Options, simulate

SEEDS = range(20, 23)


@pytest.fixture(scope="module")
def records() -> list[session.Record]:
    """Three sessions of 120 contacts."""
    small = {"contacts": 120, "later": 24, "repeats": 4, "placements": 1}
    return [session.run(Options(seed=seed, **small)) for seed in SEEDS]


@pytest.fixture(scope="module")
def found(records):
    return figures.of(records)


def sure_of_itself(records: list[session.Record], factor: float) -> list[session.Record]:
    """The same sessions, had the fit stated standard deviations of `factor` times what it did."""
    from scipy.stats import norm

    def narrowed(places):
        # a predictive distribution that is as good as normal, narrowed about its middle
        return norm.cdf(norm.ppf(np.clip(places, 1e-6, 1 - 1e-6)) / factor).tolist()

    out = []
    for r in records:
        wrong = {key: narrowed(r[key]) for key in figures.COVERED.values()}
        z = {key: (np.array(r[key]) / factor).tolist() for key in ("z", "independent_z")}
        out.append(r | wrong | z)
    return out


def within_bands(found) -> bool:
    """The bands of this test: 3 sessions of 26 parameters and 6 distances."""
    z, held = found["z_scores"], {name: c["inside"] for name, c in found["coverage"].items()}
    return (
        abs(z["mean"]) < 0.25
        and 0.8 < z["sd"] < 1.2
        and z["independent"]["ks_p_value"] > 1e-3
        and held["sphere distances"] > 0.85
        and all(value > 0.88 for name, value in held.items() if name != "sphere distances")
    )


def test_the_truth_is_found(records, found):
    assert within_bands(found), found["z_scores"] | found["coverage"]
    assert found["z_scores"]["independent"]["sd"] == pytest.approx(1.0, abs=4 / np.sqrt(2 * 26 * len(SEEDS)))
    assert all(r["least_compliance_urad_per_nm"] > 0 for r in records)
    scales = [r["noise_scale"] for r in records]
    assert np.mean(scales) == pytest.approx(1.0, abs=4 * 0.07 / np.sqrt(len(SEEDS)))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_false_certainty_is_seen(records, factor):
    """Standard deviations of half or twice what they should be fall out of the bands."""
    wrong = figures.of(sure_of_itself(records, factor))
    assert not within_bands(wrong)
    assert not 0.8 < wrong["z_scores"]["sd"] < 1.2
    if factor < 1:
        assert min(c["inside"] for c in wrong["coverage"].values()) < 0.85
        assert wrong["z_scores"]["independent"]["ks_p_value"] < 5e-3


def test_every_quantity_is_identified(found):
    """Compliance and geometry are identifiable together; of d2 and d3 only the sum."""
    told = found["identified"]
    assert {f"compliance J{j}" for j in range(2, 7)} < set(told)
    assert "d2 + d3" in told
    assert "d2" not in told
    assert len(told) == 26
    assert min(told.values()) > 0.9


def test_compliance_reduces_the_error(found):
    median = {level: s["median"] for level, s in found["maximum_distance_mm"].items()}
    assert median["geometry + compliance"] < 0.2 * median["geometry"] < 0.2 * median["nominal"]
    assert found["maximum_distance_mm"]["geometry + compliance"]["most"] < 0.05


def test_quantities_sum_what_goes_together():
    told = session.Quantities.of(("a1", "d2", "a2", "d3"))
    assert told.names == ("a1", "d2 + d3", "a2")
    np.testing.assert_array_equal(told.matrix @ [1.0, 2.0, 3.0, 4.0], [1.0, 6.0, 3.0])


def test_bands():
    """A coverage band knows that the trials of a session hang together."""
    rng = np.random.default_rng(1)
    alone = rng.uniform(size=(200, 10))
    together = np.repeat(rng.uniform(size=(200, 1)), 10, axis=1)
    width = {}
    for name, places in (("alone", alone), ("together", together)):
        c = figures.coverage(places.tolist(), 0.5)
        assert c["band95"][0] < 0.5 < c["band95"][1]
        width[name] = np.ptp(c["band95"])
        assert np.ptp(c["binomial95_if_independent"]) == pytest.approx(4 * 0.5 / np.sqrt(2000), rel=0.1)
    assert width["together"] == pytest.approx(np.sqrt(10) * width["alone"], rel=0.25)


def test_a_session_that_cannot_be_is_said_to_be_refused():
    record = session.run(Options(seed=3, contacts=16, repeats=0, later=0, spheres=8, sphere_contacts=4))
    assert record["seed"] == 3
    assert "sphere" in record["refused"]


# --- Simulation-based calibration in small: a right posterior passes, 0.7 of its covariance does not.

SMALL = Design("small", "40 contacts", 40, 0, 1)
CHECK_SEEDS = range(1, 6)
ALARM = 1e-3
"""Chance that a test of this module would fail a right posterior, were the seeds drawn anew."""


@pytest.fixture(scope="module")
def sessions():
    """The true unknowns and their posterior draws, of five arms drawn from the prior."""
    out = []
    for seed in CHECK_SEEDS:
        made = simulated(SMALL, seed)
        found = calibrated(Scene(made.dataset, oriented=True), MODEL)
        out.append((made.z(found.model), gaussian(found, seed, 2000).flat, made, found))
    return out


def narrowed(draws, factor):
    """Draws with `factor` times their covariance."""
    middle = draws.mean(axis=0)
    return middle + np.sqrt(factor) * (draws - middle)


def passes(pairs) -> bool:
    """Decorrelated scores of all unknowns against the chi-square and, in 80 % intervals, the binomial law."""
    scores = np.concatenate([independent(truth, draws) for truth, draws in pairs])
    size = chi2.sf(np.sum(scores**2), len(scores))
    hits = np.sum(np.abs(scores) < 1.2816)
    low, high = binom.ppf((ALARM / 4, 1 - ALARM / 4), len(scores), 0.8)
    return bool(ALARM / 4 < size < 1 - ALARM / 4 and low <= hits <= high)


def test_the_truth_is_where_the_posterior_says(sessions):
    pairs = [(truth, draws) for truth, draws, *_ in sessions]
    assert passes(pairs)
    assert not passes([(truth, narrowed(draws, 0.7)) for truth, draws in pairs])
    assert not passes([(truth, narrowed(draws, 2.0)) for truth, draws in pairs])


def test_the_truth_fits_its_session(sessions):
    """At the truth the contacts have the noise that was drawn, and the certificates their uncertainty."""
    for truth, _, made, found in sessions:
        linear = linearise(found.model, truth, found.weights)
        count = sum(len(b.rows) for b in found.model.blocks)
        contacts, certified = linear.residual[:count], linear.residual[count:]
        scale = np.sqrt(np.mean(contacts**2)) * found.weights.scale["contact"]
        assert scale == pytest.approx(made.scales["contact"], rel=4 / np.sqrt(2 * count))
        assert np.sum(certified**2) < chi2.isf(ALARM / 5, len(certified))


def test_points_of_an_instrument_and_gross_contacts_are_as_drawn():
    made = simulated(Design("all", "", 16, 0, 0, points=12, gross=0.1, masses=True), 1)
    assert len(np.flatnonzero(np.all(np.isfinite(made.dataset.measurements.xyz), axis=1))) == 12
    assert len(made.gross) == 2
    assert set(made.scales) == {"contact", "point"}
    found = calibrated(Scene(made.dataset, oriented=True), MODEL)
    r = found.residuals(found.model.block_of["tracker"], made.z(found.model))
    # the masses are in error: the arm deflects by some µm more than its model
    assert np.sqrt(np.mean(r**2)) < 3 * made.scales["point"] * 30e-6


@pytest.mark.parametrize(("name", "seed"), [("few", 9), ("two groups", 3)])
def test_a_clean_session_loses_no_contact(name, seed):
    """With 30 contacts for 39 unknowns, of twice the stated noise; and 16 contacts beside points."""
    (design,) = (d for d in DESIGNS if d.name == name)
    assert len(calibrated(Scene(simulated(design, seed).dataset, oriented=True), MODEL).rejected) == 0


def pairs_of(factor, size=12, count=60, seed=0):
    """Truths and draws of normals of very different scales, with `factor` times the variance."""
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-4, 0, size)
    for _ in range(count):
        mean = rng.standard_normal(size)
        truth = scale * (mean + rng.standard_normal(size))
        yield truth, scale * (mean + np.sqrt(factor) * rng.standard_normal((300, size)))


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.5])
def test_joint_coverage_of_a_normal(factor):
    rng = np.random.default_rng(3)
    found = [Joint.of(truth, draws, rng) for truth, draws in pairs_of(factor)]
    inside = np.array([j.ellipsoid for j in found])
    records = [{"tarp": {"plain": j.tarp}} for j in found]
    covered = check_figures.tarp(records, "plain")["expected_coverage"]["0.5"]
    if factor == 1.0:
        assert check_figures.ecdf_p(inside) > 0.01
        assert covered[1] < 0.5 < covered[2]
    else:
        assert check_figures.ecdf_p(inside) < 0.01
        assert (np.mean(inside) > 0.5) == (factor < 1.0)


def test_probabilities_of_uniform_places_are_uniform():
    rng = np.random.default_rng(1)
    for p in (check_figures.ecdf_p, check_figures.chi2_p):
        found = np.array([p(rng.uniform(size=40)) for _ in range(400)])
        assert np.mean(found < 0.1) == pytest.approx(0.1, abs=0.05)
        assert p(rng.beta(0.5, 0.5, size=40)) < 0.05
    assert check_figures.ecdf_p(np.full(20, 0.5)) < 1e-3


def test_correction_for_the_number_of_tests():
    """Step by step, as in Holm 1979."""
    np.testing.assert_allclose(check_figures.holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(check_figures.holm([0.6, 0.7]), [1.0, 1.0])


def test_intervals_of_one_session_count_together():
    rng = np.random.default_rng(2)
    alone = rng.uniform(size=(100, 8))
    together = np.repeat(rng.uniform(size=(100, 1)), 8, axis=1)
    found = [check_figures.coverage(p.tolist(), 0.8) for p in (alone, together)]
    assert found[0]["independent"] > 500
    assert found[1]["independent"] < 150
    for c in found:
        assert c["low"] < c["covered"] < c["high"]
        assert c["count"] == 800


# --- The study of sessions of our own in small: what they state wrongly.


def test_what_is_stated_is_wrong_and_nothing_else():
    seed = 1010000
    dataset = simulate(Options(seed=seed, contacts=60, repeats=0, placements=0)).dataset
    changed = own.wrongly_stated(dataset, seed, stated=0.75, masses=0.15)
    assert changed.noise.contact == pytest.approx(0.75 * dataset.noise.contact)
    assert 0.02 < abs(changed.robot.masses / dataset.robot.masses - 1).max() <= 0.15
    same = own.wrongly_stated(dataset, seed)
    assert all(getattr(same, f.name) is getattr(dataset, f.name) for f in fields(Dataset))


def test_a_session_of_the_calibration_checks_is_compared_with_its_truth():
    record = checked(next(d for d in DESIGNS if d.name == "few"), 4)
    assert (record["design"], record["seed"]) == ("few", 4)
    assert len(record["names"]) == len(record["plain"]) == len(record["stated"])
    assert all(0.0 <= place <= 1.0 for place in record["plain"])
    assert 0.0 < np.mean(record["plain"]) < 1.0
