"""Gross errors that a fit does not detect: the bound by simulation, its consequence by fits."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.assess.findings import reliability
from bayescal.calibration import fit
from bayescal.estimate import calibrated
from bayescal.estimate.outliers import POWER, detectable, rejected
from bayescal.model import ARM
from bayescal.model.scene import Scene
from bayescal.predict.errors import lengths, slopes
from bayescal.predict.forecast import workspace

FULL = ("geometry", "compliance")


def test_the_noncentrality_of_a_known_noise_is_that_of_baarda():
    """4.13 for a probability of 0.001 of a false rejection and 0.8 of a detection."""
    assert np.sqrt(detectable(1, 1e7, 10)) == pytest.approx(4.13, abs=0.005)


@pytest.mark.parametrize(("rows", "count"), [(1, 30), (3, 15)])
def test_the_rule_for_outliers_detects_such_an_error_with_the_stated_probability(rows, count):
    """Normal residuals that a fit has left alone, and one error of the noncentrality."""
    rng, dof, trials = np.random.default_rng(0), float(rows * count), 4000
    residuals = rng.standard_normal((trials, count, rows))
    residuals[:, 0, 0] += np.sqrt(detectable(rows, dof, count))
    found = 0
    for own in residuals:
        chi2 = np.sum(own**2, axis=1)
        scale = np.sqrt(np.sum(chi2) / dof)
        found += rejected(chi2, rows, scale, dof, True, 8.0)[0]
    assert found / trials == pytest.approx(POWER, abs=0.04)


@pytest.fixture(scope="module")
def points(tracker):
    """A fit to points of an instrument, with its reliability."""
    found = calibrated(Scene(tracker(seed=2, count=30).dataset), FULL)
    return found, reliability(found)


def test_no_error_of_a_point_in_any_direction_does_more(points):
    """Errors of the stated noncentrality in many directions, through the linear fit itself."""
    found, own = points
    block = found.model.blocks[0]
    space = workspace(found)
    by = slopes(found.model, space.motion, space.values, space.pairs)
    jacobian = found.linear.jacobian[found.linear.of_block[block.name]].reshape(3, len(block.rows), -1)
    size = detectable(3, found.dof[block.group], len(block.rows))
    rng, sigma = np.random.default_rng(0), 1.0 / found.weights.whitening(block).reshape(3, -1)
    directions = rng.standard_normal((20_000, 3))
    for c in (0, 7, 29):
        j = jacobian[:, c]
        redundancy = np.eye(3) - j @ found.covariance @ j.T
        errors = (
            directions * np.sqrt(size / np.einsum("ei,ij,ej->e", directions, redundancy, directions))[:, None]
        )
        moved = (errors @ j @ found.covariance)[:, found.model.slices[ARM]] @ by.T
        shifts = np.sqrt(np.mean(moved**2, axis=1))
        most = int(np.argmax(shifts))
        assert shifts[most] == pytest.approx(own.shift[c], rel=1e-3)
        assert shifts[most] <= own.shift[c] * (1 + 1e-9)
        assert np.linalg.norm(errors[most] * sigma[:, c]) == pytest.approx(own.error[c], rel=0.02)


def with_error(found, row, error):
    """The session of a fit with a residual of one row off by an error, m: its readings moved."""
    model = found.model
    block = next(b for b in model.blocks if row in b.rows)
    state = found.z[model.slices[block.target]]
    by = block.by_readings(found.arm, state, model.scene.dataset.robot.link_from_reading)
    slope = by[np.flatnonzero(block.rows == row)[0]]
    session = model.scene.dataset
    readings = session.measurements.readings.copy()
    readings[row] += error * slope / (slope @ slope)
    return replace(session, measurements=replace(session.measurements, readings=readings))


@pytest.mark.parametrize("seed", [6, 7])
def test_an_error_below_the_bound_stays_in_the_fit_and_moves_distances_as_stated(cube, seed):
    """Of the contact with the largest effect: half the bound is kept, twice the bound is rejected."""
    found = calibrated(Scene(cube(seed=seed, count=60).dataset), FULL)
    own, space = reliability(found), workspace(found)
    k = int(np.argmax(own.shift))

    def distances(other):
        return lengths(space.motion.points(other.arm), space.pairs)

    again = calibrated(Scene(with_error(found, own.rows[k], 0.5 * own.error[k])), FULL)
    assert not np.isin(own.rows[k], again.rejected)
    moved = np.sqrt(np.mean((distances(again) - distances(found)) ** 2))
    assert moved == pytest.approx(0.5 * own.shift[k], rel=0.1)
    again = calibrated(Scene(with_error(found, own.rows[k], 2.0 * own.error[k])), FULL)
    assert np.isin(own.rows[k], again.rejected)


def test_a_rejected_row_is_not_judged(cube):
    found = calibrated(Scene(cube(seed=3, count=120, outliers=4).dataset), FULL)
    assert len(found.rejected)
    assert not np.isin(found.rejected, reliability(found).rows).any()


@pytest.mark.parametrize(("count", "told"), [(30, True), (200, False)])
def test_few_contacts_have_the_finding_many_have_not(cube, count, told):
    found = fit(cube(seed=6, count=count).dataset, FULL, samples=0)
    words = [f.text for f in found.findings if f.code == "gross_error_unseen"]
    assert bool(words) == told
    if told:
        assert f"in one of {count} measurements" in words[0]
        assert f"U = {float(f'{1e6 * found.forecast.workspace.expanded:.2g}'):.9g} µm" in words[0]
