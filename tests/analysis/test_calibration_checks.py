"""Simulation-based calibration in small: a right posterior passes, 0.7 of its covariance does not."""

import json

import numpy as np
import pytest
from scipy.stats import binom, chi2

from analysis.calibration_checks import figures, page, run
from analysis.calibration_checks.designs import DESIGNS, Design
from analysis.calibration_checks.session import Joint, independent
from analysis.calibration_checks.truth import MODEL, simulated
from bayescal.estimate import calibrated, linearise
from bayescal.model.scene import Scene
from bayescal.posterior import gaussian

SMALL = Design("small", "40 contacts", 40, 0, 1)
SEEDS = range(1, 6)
ALARM = 1e-3
"""Chance that a test of this module would fail a right posterior, were the seeds drawn anew."""


@pytest.fixture(scope="module")
def sessions():
    """The true unknowns and their posterior draws, of five arms drawn from the prior."""
    out = []
    for seed in SEEDS:
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
    design = Design("all", "", 16, 0, 0, points=12, gross=0.1, masses=True)
    made = simulated(design, 1)
    m = made.dataset.measurements
    read = np.flatnonzero(np.all(np.isfinite(m.xyz), axis=1))
    assert len(read) == 12
    assert len(made.gross) == 2
    assert set(made.scales) == {"contact", "point"}
    found = calibrated(Scene(made.dataset, oriented=True), MODEL)
    truth = made.z(found.model)
    block = found.model.block_of["tracker"]
    r = found.residuals(block, truth)
    # the masses are in error: the arm deflects by some µm more than its model
    assert np.sqrt(np.mean(r**2)) < 3 * made.scales["point"] * 30e-6


@pytest.mark.parametrize(("name", "seed"), [("few", 9), ("two groups", 3)])
def test_a_clean_session_loses_no_contact(name, seed):
    """With 30 contacts for 39 unknowns, of twice the stated noise; and 16 contacts beside points."""
    (design,) = (d for d in DESIGNS if d.name == name)
    made = simulated(design, seed)
    assert len(calibrated(Scene(made.dataset, oriented=True), MODEL).rejected) == 0


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
    covered = figures.tarp(records, "plain")["expected_coverage"]["0.5"]
    if factor == 1.0:
        assert figures.ecdf_p(inside) > 0.01
        assert covered[1] < 0.5 < covered[2]
    else:
        assert figures.ecdf_p(inside) < 0.01
        assert (np.mean(inside) > 0.5) == (factor < 1.0)


def test_probabilities_of_uniform_places_are_uniform():
    rng = np.random.default_rng(1)
    for p in (figures.ecdf_p, figures.chi2_p):
        found = np.array([p(rng.uniform(size=40)) for _ in range(400)])
        assert np.mean(found < 0.1) == pytest.approx(0.1, abs=0.05)
        assert p(rng.beta(0.5, 0.5, size=40)) < 0.05
    assert figures.ecdf_p(np.full(20, 0.5)) < 1e-3


def test_correction_for_the_number_of_tests():
    """Step by step, as in Holm 1979."""
    np.testing.assert_allclose(figures.holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(figures.holm([0.6, 0.7]), [1.0, 1.0])


def test_intervals_of_one_session_count_together():
    rng = np.random.default_rng(2)
    alone = rng.uniform(size=(100, 8))
    together = np.repeat(rng.uniform(size=(100, 1)), 8, axis=1)
    found = [figures.coverage(p.tolist(), 0.8) for p in (alone, together)]
    assert found[0]["independent"] > 500
    assert found[1]["independent"] < 150
    for c in found:
        assert c["low"] < c["covered"] < c["high"]
        assert c["count"] == 800


def record(design, seed):
    """A record of a right posterior, without a session."""
    rng = np.random.default_rng(seed)
    u = lambda count: rng.uniform(size=count).tolist()  # noqa: E731
    return {
        "design": design, "seed": seed, "names": ["a", "b"], "plain": u(2), "stated": u(2),
        "ellipsoid": {"plain": u(1)[0], "stated": u(1)[0]}, "tarp": {"plain": u(8), "stated": u(8)},
        "independent": rng.standard_normal(2).tolist(), "noise": {"contact": u(1)[0]},
        "distances": u(3), "diameters": u(3), "contacts": u(5), "workspace": u(4), "workspace_stated": u(4),
        "sd_ratio": [1.0, 1.1], "families": [], "excess_um": 0.0, "explains": True,
        "gross": 2, "gross_rejected": 1, "good_rejected": 0,
    }  # fmt: skip


def test_page_and_table(tmp_path, capsys, renewed):
    name = DESIGNS[0].name
    lines = [record(name, seed) for seed in range(1, 21)] + [{"design": name, "seed": 21, "refused": "no"}]
    raw = tmp_path / run.RAW
    raw.write_text("".join(json.dumps(r) + "\n" for r in lines), encoding="utf-8")
    renewed(page, lambda path: run.main(["--again", "--out", str(tmp_path), "--page", str(path)]))
    assert f"| {name} | {DESIGNS[0].summary} | 20 | 1 to 21 | 1 |" in capsys.readouterr().out
    table = (tmp_path / "page.csv").read_text(encoding="utf-8").splitlines()
    assert table[0] == "design,figure,of,level,value,low,high"
    assert any(line.startswith(f'{name},coverage,"parameters, stated",0.95,') for line in table)


def test_sessions_that_are_there_are_not_run_again(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(run.session, "run", lambda d, s: asked.append((d.name, s)) or record(d.name, s))
    raw = tmp_path / run.RAW
    run.add(raw, DESIGNS[:2], range(1, 3))
    run.add(raw, DESIGNS[:2], range(1, 4))
    assert asked[4:] == [(d.name, 3) for d in DESIGNS[:2]]
    assert len(run.read(raw)) == 6
