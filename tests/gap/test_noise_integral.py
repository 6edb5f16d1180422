"""The compiled integral over the noise against NumPy, and against quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from bayescal.gap.linear.evidence import LOG_WEIGHTS, NEWTON, NODES, SCALES, TRIED, gain, integrated, log_sum


def gain_at(values, along, log_precision):
    """Log Bayes factors (B, scales, U) of columns at log precisions of the noise (B or 1, scales or 1, U)."""
    y = np.exp(log_precision)[..., None]
    by = (SCALES**2)[:, None, None] * y
    with_it = 1.0 + by * values[:, :, None]
    return 0.5 * np.sum(along[:, :, None] * by * y / with_it - np.log(with_it), axis=-1)


def slopes(values, along, at):
    """First and second derivative of `gain_at` by the log precision, (B, scales, 1) each."""
    y = np.exp(at)
    by = (SCALES**2)[:, None] * y
    p = by * values
    h = along * by * y * (2.0 + p) / (1.0 + p) ** 2
    first = np.sum(h - p / (1.0 + p), axis=-1, keepdims=True)
    second = np.sum(
        h * (2.0 + p / (2.0 + p) - 2.0 * p / (1.0 + p)) - p / (1.0 + p) ** 2, axis=-1, keepdims=True
    )
    return 0.5 * first, 0.5 * second


def in_numpy(values, along, dof, chi2, worth):
    """What `integrated` returns, for all sets at once."""
    values, along = values[:, None], along[:, None]
    seen = values > 1e-12 * np.max(values, axis=2, keepdims=True, initial=1e-300)
    explained = np.sum(np.divide(along, values, where=seen, out=np.zeros_like(along)), axis=2)
    most = chi2 - min(worth, chi2)
    along = along * np.minimum(1.0, most / np.maximum(explained, 1e-300))[..., None]
    explained = np.minimum(explained, most)
    lowest = np.log(dof / chi2)
    highest = np.log(dof / np.maximum(chi2 - explained, min(worth, chi2)))
    tried = lowest + (highest - lowest)[..., None] * np.linspace(0.0, 1.0, TRIED)
    density = 0.5 * (dof * tried - chi2 * np.exp(tried)) + gain_at(values, along, tried)
    mode = np.take_along_axis(tried + np.zeros_like(density), np.argmax(density, axis=-1)[..., None], -1)
    for _ in range(NEWTON):
        slope, bend = slopes(values, along, mode)
        slope, bend = slope + 0.5 * (dof - chi2 * np.exp(mode)), bend - 0.5 * chi2 * np.exp(mode)
        mode = mode + np.clip(slope / np.maximum(np.abs(bend), 1e-3 * dof), -0.5, 0.5)
    bend = 0.5 * chi2 * np.exp(mode) - slopes(values, along, mode)[1]
    width = 1.0 / np.sqrt(np.maximum(bend, 1e-3 * dof))
    nodes = mode + np.sqrt(2.0) * width * NODES
    density = 0.5 * (dof * nodes - chi2 * np.exp(nodes)) + gain_at(values, along, nodes)
    return log_sum(density + NODES**2 + LOG_WEIGHTS, axis=-1) + np.log(np.sqrt(2.0) * width[..., 0])


def drawn(seed, count, k):
    """Information and squared scores of sets (count, k), from none to 1e5 times the noise."""
    rng = np.random.default_rng(seed)
    values = 10.0 ** rng.uniform(-3, 9, (count, k))
    values[::7, -1] = 0.0
    values[5:6] = 0.0
    along = values * rng.chisquare(1, (count, k)) * 10.0 ** rng.uniform(-3, 2.5, (count, 1))
    return values, along


@pytest.mark.parametrize("k", [1, 2, 6, 400])
@pytest.mark.parametrize(("dof", "chi2", "worth"), [(180.0, 175.0, 5.0), (8.0, 30.0, 5.0), (90.0, 3.0, 5.0)])
def test_compiled_is_numpy(k, dof, chi2, worth):
    values, along = drawn(k, 40, k)
    found = integrated(values, along, SCALES**2, dof, chi2, worth, NODES, LOG_WEIGHTS)
    np.testing.assert_allclose(found, in_numpy(values, along, dof, chi2, worth), rtol=1e-9, atol=1e-9)


def test_gain_is_that_of_numpy_where_a_product_overflows():
    values, along = drawn(3, 1, 2000)
    table = gain_at(values[:, None], along[:, None], np.full((1, 1, 1), 0.3))[0, :, 0]
    found = [gain(values[0], along[0], square, 0.3) for square in SCALES**2]
    assert np.all(np.isfinite(found))
    np.testing.assert_allclose(found, table, rtol=1e-10)


def test_integral_is_that_of_quadrature():
    values, along = np.array([[40.0, 3.0]]), np.array([[600.0, 20.0]])
    dof, chi2 = 150.0, 160.0
    found = integrated(values, along, SCALES**2, dof, chi2, 5.0, NODES, LOG_WEIGHTS)[0]

    def density(log_precision, square):
        own = gain(values[0], along[0], square, log_precision)
        return np.exp(0.5 * (dof * log_precision - chi2 * np.exp(log_precision)) + own + 0.5 * chi2)

    for square, log_integral in zip(SCALES**2, found, strict=True):
        exact = np.log(quad(density, -2.0, 2.0, args=(square,))[0]) - 0.5 * chi2
        assert log_integral == pytest.approx(exact, abs=1e-4)
