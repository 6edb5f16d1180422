"""Factors and quantiles that are computed directly are those of SciPy and NumPy, to the bit."""

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from bayescal.estimate.outliers import quantile
from bayescal.estimate.solver import factored, halved, solved


@pytest.mark.parametrize("size", [1, 4, 40])
def test_as_scipy(size):
    rng = np.random.default_rng(size)
    design = rng.normal(size=(size + 5, size))
    matrix, right = design.T @ design, rng.normal(size=(size, 7))
    own, theirs = factored(matrix), cho_factor(matrix, lower=True)
    np.testing.assert_array_equal(np.tril(own), np.tril(theirs[0]))
    for b in (right, right[:, 0], right.copy(order="F")):
        np.testing.assert_array_equal(solved(own, b), cho_solve(theirs, b))
    np.testing.assert_array_equal(halved(own, right), solve_triangular(theirs[0], right, lower=True))


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


@pytest.mark.parametrize("count", [1, 2, 3, 100, 101])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_as_numpy(count, share):
    x = np.random.default_rng(count).exponential(size=count)
    assert quantile(x, share) == np.quantile(x, share)
    x[count // 2] = np.nan
    assert np.isnan(quantile(x, share))
