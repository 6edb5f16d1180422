"""Scatter of an estimate over poses, against its definition and simulated estimates."""

import numpy as np
import pytest

from bayescal.estimate.moments import by_chance, complement, scatter_factor

D, POSES, EACH = 5, 400, 3
POSE = np.repeat(np.arange(POSES), EACH)


def scatter(c, j, e, pose):
    by, of = scatter_factor(c, j, e, pose)
    assert by.shape == (len(c), len(of))
    return by @ by.T


def linear(seed, shared, uneven=False):
    """Rows of poses with an error in common; `uneven`: in proportion to the slope of the first unknown."""
    rng = np.random.default_rng(seed)
    j = np.repeat(rng.standard_normal((POSES, D)), EACH, axis=0) + 0.3 * rng.standard_normal(
        (POSES * EACH, D)
    )
    error = rng.choice([-1.0, 1.0], POSES)[POSE] * j[:, 0] if uneven else rng.standard_normal(POSES)[POSE]
    y = rng.standard_normal(len(j)) + shared * error
    c = np.linalg.inv(j.T @ j + np.eye(D))
    return j, y - j @ (c @ (j.T @ y)), c, y


def test_it_is_the_sum_over_poses_of_what_each_contributes():
    """By hand, with the matrix root of each pose, and shrunk by the parameters per pose."""
    j, e, c, _ = linear(2, 2.0, uneven=True)
    deltas = []
    for p in range(POSES):
        own = j[p == POSE]
        values, vectors = np.linalg.eigh(np.eye(EACH) - own @ c @ own.T)
        delta = c @ own.T @ (vectors / np.sqrt(values)) @ vectors.T @ e[p == POSE]
        deltas.append(delta)
    out, plain = sum(np.outer(d, d) for d in deltas), c @ (j.T @ j) @ c
    share = np.trace(c @ j.T @ j) / POSES
    expected = (1 - share) * out + share * plain * np.trace(out) / np.trace(plain)
    np.testing.assert_allclose(scatter(c, j, e, POSE), expected, rtol=1e-8, atol=1e-12)


def test_without_a_shared_error_the_scatter_is_that_of_independent_residuals():
    """Deviations of the scatter by chance do not count: they made some uncertainties a fifth too small."""
    found, shown = [], []
    for seed in range(20):
        j, e, c, _ = linear(seed, 0.0)
        plain = c @ (j.T @ j) @ c
        found.append(np.sqrt(np.diag(scatter(c, j, e, POSE)) / np.diag(plain)))
        shown.append([not by_chance(_deltas(*linear(seed, s, s > 0)[:3]), j @ c) for s in (0.0, 2.0)])
    assert np.mean(found) == pytest.approx(1.0, abs=0.03)
    assert np.sum(shown, axis=0).tolist() == [pytest.approx(0, abs=3), 20]
    even = np.std(found, axis=1) < 1e-6
    assert np.sum(even) >= 17


def _deltas(j, e, c):
    return np.sum((j @ c * e[:, None]).reshape(POSES, EACH, D), axis=1)


def test_the_complement_raises_a_covariance_where_it_is_too_small():
    rng = np.random.default_rng(0)
    by = rng.standard_normal((40, 4))
    by[:, 3] = 0.0  # an unknown of which the residuals say nothing
    plain = by.T @ by
    small = 0.5 * plain
    more = complement(by, small)
    assert more.shape == (4, 40)
    np.testing.assert_allclose(small + more @ more.T, plain, atol=1e-9)
    np.testing.assert_allclose(complement(by, 2.0 * plain), 0.0, atol=1e-9)
    one = np.diag([0.0, 1e3, 1e3, 0.0])
    total = one + complement(by, one) @ complement(by, one).T
    assert np.min(np.linalg.eigvalsh(total - plain)) > -1e-9
    assert total[1, 1] == pytest.approx(1e3, rel=1e-2)


def test_it_has_hardly_a_bias_where_a_quarter_of_the_rows_is_fitted():
    found, plain = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        j = rng.standard_normal((80, 20))
        c = np.linalg.inv(j.T @ j + 1e-3 * np.eye(20))
        y = rng.standard_normal(80)
        found.append(np.trace(scatter(c, j, y - j @ (c @ (j.T @ y)), np.arange(80))))
        plain.append(np.trace(c @ (j.T @ j) @ c))
    assert 0.97 < np.mean(found) / np.mean(plain) < 1.1


@pytest.mark.parametrize("shared", [0.0, 2.0])
def test_it_is_the_true_covariance_where_rows_of_a_pose_share_an_error(shared):
    found, estimates = [], []
    for seed in range(60):
        j, e, c, y = linear(seed, shared)
        found.append(np.trace(scatter(c, j, e, POSE)))
        estimates.append(c @ (j.T @ y))
    true = np.mean(np.sum(np.array(estimates) ** 2, axis=1))
    assert np.mean(found) == pytest.approx(true, rel=0.25)


def test_a_pose_that_alone_determines_a_direction_has_no_influence():
    j = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    c = np.linalg.inv(j.T @ j + 1e-12 * np.eye(2))
    e = np.array([0.0, 1.0, -1.0, 0.0])
    assert np.all(np.isfinite(scatter(c, j, e, np.arange(4))))
    assert np.all(np.linalg.eigvalsh(scatter(c, j, e, np.arange(4))) > 0)
