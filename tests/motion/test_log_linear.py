"""Noise, fits and evidence against closed forms."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from bayescal.motion.linear import Normal, fitted, gains
from bayescal.motion.noise import noise_of
from bayescal.motion.terms import Term


def problem(seed=0, rows=40, size=6):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(rows, size)), rng.normal(size=rows)
    terms = tuple(Term(f"t{k}", "1", 1.0) for k in range(size))
    return x, y, Normal(terms, x.T @ x, x.T @ y, np.array([y @ y]), np.array([float(rows)]))


def log_evidence(x, y):
    return multivariate_normal(np.zeros(len(y)), np.eye(len(y)) + x @ x.T).logpdf(y)


def test_a_fit_is_the_posterior_mean():
    x, y, p = problem()
    f = fitted(p, [0, 2, 3], np.array([1.0, 0.5, 2.0]))
    wide = x[:, [0, 2, 3]] * [1.0, 0.5, 2.0]
    covariance = np.linalg.inv(wide.T @ wide + np.eye(3))
    assert f.covariance == pytest.approx(covariance)
    assert list(f.values.values()) == pytest.approx(covariance @ wide.T @ y * [1.0, 0.5, 2.0])
    assert list(f.u.values()) == pytest.approx(np.sqrt(np.diag(covariance)) * [1.0, 0.5, 2.0])
    left = y - wide @ (covariance @ wide.T @ y)
    assert f.chi2() == pytest.approx(left @ left)


def test_gains_are_ratios_of_evidences():
    x, y, p = problem(1)
    base = fitted(p, [0, 1])
    scales, sets = np.array([0.5, 2.0]), [np.array([2]), np.array([3, 4]), np.array([5])]
    table, trace = gains(base, sets, scales)
    for i, chosen in enumerate(sets):
        for k, scale in enumerate(scales):
            wide = np.column_stack([x[:, :2], scale * x[:, chosen]])
            assert table[i, k] == pytest.approx(log_evidence(wide, y) - log_evidence(x[:, :2], y))
    more = fitted(p, [0, 1, 2])
    assert more.log_evidence - base.log_evidence == pytest.approx(
        log_evidence(x[:, :3], y) - log_evidence(x[:, :2], y)
    )
    within = np.linalg.inv(np.eye(40) + x[:, :2] @ x[:, :2].T)
    assert trace[0] == pytest.approx(x[:, 2] @ within @ x[:, 2])


def test_noise_is_whitened():
    rng = np.random.default_rng(0)
    parts = [lfilter([1.0], [1.0, -0.8], rng.normal(size=(3000, 2)), axis=0) * [1.0, 5.0] for _ in range(3)]
    noise = noise_of(parts, 0.0)
    assert noise.lag1 == pytest.approx(0.8, abs=0.03)
    assert noise.sd[1] / noise.sd[0] == pytest.approx(5.0, rel=0.1)
    white = noise.whitened(parts[0][:, 1], 1)
    assert np.corrcoef(white[1:], white[:-1])[0, 1] == pytest.approx(0.0, abs=0.05)
    assert 0.8 < white.std() <= 1.01  # 1 % of white noise is added to the model


def test_degrees_of_freedom_of_a_fit_enlarge_the_noise():
    parts = [np.random.default_rng(1).normal(size=(200, 1))]
    assert noise_of(parts, 100.0).sd == pytest.approx(np.sqrt(2.0) * noise_of(parts, 0.0).sd)


def test_what_repeats_share_is_no_noise():
    rng = np.random.default_rng(2)
    parts = [rng.normal(size=(400, 1)) for _ in range(4)]
    shared = 5.0 * np.sin(np.arange(400) / 7.0)[:, None]
    some = [r + shared for r in parts]
    assert noise_of(some, 0.0).sd > 3.0
    assert noise_of(some, 0.0, ["a", "a", "a", "b"]).sd == pytest.approx(1.0, rel=0.06)
