"""Scatter of an estimate over poses, against its definition and simulated estimates."""

import numpy as np
import pytest

from bayescal.estimate.discrepancy.poses import scatter_factor

D, POSES, EACH = 5, 400, 3
POSE = np.repeat(np.arange(POSES), EACH)


def scatter(c, j, e, pose):
    by, of = scatter_factor(c, j, e, pose)
    assert by.shape == (len(c), len(of))
    return by @ by.T


def linear(seed, shared):
    rng = np.random.default_rng(seed)
    j = np.repeat(rng.standard_normal((POSES, D)), EACH, axis=0) + 0.3 * rng.standard_normal(
        (POSES * EACH, D)
    )
    y = rng.standard_normal(len(j)) + shared * rng.standard_normal(POSES)[POSE]
    c = np.linalg.inv(j.T @ j + np.eye(D))
    return j, y - j @ (c @ (j.T @ y)), c, y


def test_it_is_the_sum_over_poses_of_what_each_contributes():
    """By hand, with the matrix root of each pose, and shrunk by the parameters per pose."""
    j, e, c, _ = linear(2, 1.0)
    out = np.zeros((D, D))
    for p in range(POSES):
        own = j[p == POSE]
        values, vectors = np.linalg.eigh(np.eye(EACH) - own @ c @ own.T)
        delta = c @ own.T @ (vectors / np.sqrt(values)) @ vectors.T @ e[p == POSE]
        out += np.outer(delta, delta)
    plain = c @ (j.T @ j) @ c
    share = np.trace(c @ j.T @ j) / POSES
    expected = (1 - share) * out + share * plain * np.trace(out) / np.trace(plain)
    np.testing.assert_allclose(scatter(c, j, e, POSE), expected, rtol=1e-8, atol=1e-12)


def test_it_has_no_bias_where_a_quarter_of_the_rows_is_fitted():
    found, plain = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        j = rng.standard_normal((80, 20))
        c = np.linalg.inv(j.T @ j + 1e-3 * np.eye(20))
        y = rng.standard_normal(80)
        found.append(np.trace(scatter(c, j, y - j @ (c @ (j.T @ y)), np.arange(80))))
        plain.append(np.trace(c @ (j.T @ j) @ c))
    assert np.mean(found) == pytest.approx(np.mean(plain), rel=0.06)


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
