"""Resampled mean squares: blocks of any size, and distances as the model that is simulated expects them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import polygamma

from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import BLOCKS, blocks, resampled, resampled_distances
from bayescal.predict.errors import CentreDistances


def distances(error, by_noise, u):
    """Distances without a centre in common."""
    count = len(error)
    names = tuple((f"a{k}", f"b{k}") for k in range(count))
    along = np.tile([0.0, 0.6, 0.8], (count, 1))
    return CentreDistances(
        names, error, np.zeros((count, 1)), by_noise * np.eye(count), u * np.ones(count), along
    )


def test_rows_of_one_pose_are_one_block_whatever_they_touch(cube):
    """Three rows of one stop, two of equal readings, the others in blocks of neighbours in time."""
    made = cube(seed=4).dataset
    m = made.measurements
    stop, readings = np.full(len(m.ids), "", object), m.readings.copy()
    stop[[3, 40, 90]] = "s"
    readings[60] = readings[10]
    at = np.arange(len(m.ids))
    found = blocks(
        Scene(replace(made, measurements=replace(m, stop=stop, readings=readings, repeat=None))), at
    )
    assert len({found[3], found[40], found[90]}) == len({found[10], found[60]}) == 1
    assert np.sum(found == found[3]) == 3
    assert np.sum(found == found[10]) == 2
    rest = np.delete(found, [3, 10, 40, 60, 90])
    assert len(np.unique(rest)) == BLOCKS
    assert np.all(np.diff(rest) >= 0)


def test_a_mean_over_blocks_of_any_size_is_a_mean():
    rng = np.random.default_rng(0)
    block = np.repeat(np.arange(12), np.arange(1, 13))
    ones, value = np.ones(len(block)), rng.uniform(size=len(block))
    means = resampled(block, np.stack([ones, value]), rng)
    np.testing.assert_allclose(means[:, 0], 1.0)
    assert value.min() < means[:, 1].min() < value.mean() < means[:, 1].max() < value.max()


@pytest.mark.parametrize(("by_noise", "u"), [(3e-6, 0.0), (0.0, 3e-6)])
def test_many_distances_are_drawn_about_the_measured_mean_square(by_noise, u):
    """What is simulated has the mean square that is expected of it: from centres, noise and certificates."""
    rng = np.random.default_rng(1)
    noise = 3e-6 * rng.standard_normal(120)
    before, after = (distances(size * rng.standard_normal(120) + noise, by_noise, u) for size in (5e-6, 2e-6))
    draws = resampled_distances(before, after, rng)
    measured = np.mean(np.stack([before.error, after.error]) ** 2, axis=1)
    np.testing.assert_allclose(np.median(draws, axis=0), measured, rtol=0.05)


def test_few_distances_widen_the_draws():
    """A variance that was estimated from n values has a logarithm sqrt(n / (n - 1)) times as uncertain."""
    found = distances(1e-5 * np.array([1.0, -1.2, 0.8]), 1e-8, 0.0)
    draws = resampled_distances(found, found, np.random.default_rng(2))
    of_chi_square = np.sqrt(polygamma(1, 3 / 2))
    assert np.std(np.log(draws[:, 0])) == pytest.approx(np.sqrt(3 / 2) * of_chi_square, rel=0.06)
