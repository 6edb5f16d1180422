"""Tails against `scipy.stats`, at the edges too."""

import numpy as np
import pytest
from scipy import stats

from bayescal import statistics as d

RNG = np.random.default_rng(0)
DOF, BELOW = RNG.uniform(0.5, 400, (2, 300))
X, P = RNG.uniform(0, 600, 300), RNG.uniform(1e-12, 1, 300)
K = np.append(RNG.integers(0, 600, 299), -1).astype(float)


@pytest.mark.parametrize(("ours", "theirs"), [
    (d.chi2_sf(X, DOF), stats.chi2.sf(X, DOF)),
    (d.chi2_isf(P, DOF), stats.chi2.isf(P, DOF)),
    (d.f_sf(X / 100, DOF, BELOW), stats.f.sf(X / 100, DOF, BELOW)),
    (d.f_isf(P, DOF, BELOW), stats.f.isf(P, DOF, BELOW)),
    (d.t_sf(X / 50 - 6, DOF), stats.t.sf(X / 50 - 6, DOF)),
    (d.t_ppf(P, DOF), stats.t.ppf(P, DOF)),
    (d.poisson_sf(K, DOF), stats.poisson.sf(K, DOF)),
])  # fmt: skip
def test_tails(ours, theirs):
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_noncentrality():
    """F with it exceeds the value with the probability."""
    dof, below = np.array([1.0, 3.0, 1.0, 6.0]), np.array([8.0, 40.0, 3e4, 9.0])
    found = d.f_noncentrality(0.8, dof, below, 12.0)
    np.testing.assert_allclose(stats.ncf.sf(12.0, dof, below, found), 0.8, rtol=1e-4)


def test_edges():
    """Rounding below zero exceeds nothing; no degrees of freedom, no probability."""
    assert d.chi2_sf(-1e-20, 3) == d.f_sf(-1e-20, 3, 4) == 1.0
    assert np.isnan(d.chi2_sf(1.0, 0))
    assert np.isnan(d.f_sf(1.0, 0, 3))
    assert np.isnan(d.t_ppf(0.975, 0))


def test_hypergeometric():
    """At least so many of the chosen rows are in a group; impossible numbers too."""
    sizes, total, count = np.array([1, 4, 30, 95, 99]), 12, 100
    theirs = np.array([stats.hypergeom.logsf(np.arange(-1, total), count, s, total) for s in sizes])
    np.testing.assert_allclose(d.hypergeometric_log_sf(sizes, total, count), theirs, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("size", [1, 7])
def test_balanced_draws_have_their_moments(size):
    beside = np.random.default_rng(3).standard_normal((60, 4)) @ np.ones((4, 4)) + 5.0  # of rank 1
    x = d.balanced_normals(np.random.default_rng(2), 60, size, beside)
    assert x.mean(axis=0) == pytest.approx(np.zeros(size), abs=1e-12)
    np.testing.assert_allclose(x.T @ x / 60, np.eye(size), atol=1e-12)
    np.testing.assert_allclose(x.T @ (beside - beside.mean(axis=0)), 0.0, atol=1e-10)
    assert np.corrcoef(x[:, 0], np.random.default_rng(2).standard_normal((60, size))[:, 0])[0, 1] > 0.8
    few = d.balanced_normals(np.random.default_rng(2), 10, 7, beside[:10])
    np.testing.assert_array_equal(few, np.random.default_rng(2).standard_normal((10, 7)))
