"""The share of correct answers of the study of plans for the gap, against its limits and a simulation."""

import numpy as np
import pytest

from analysis.separation import evidence, right

A, B = np.array([0]), np.array([1])


def test_equal_columns_are_guessed_and_different_ones_are_known() -> None:
    rng = np.random.default_rng(0)
    same = 400.0 * np.ones((2, 2))
    assert right(same, A, B, 1.0, rng, fixed=True) == pytest.approx(0.5, abs=0.03)
    assert right(400.0 * np.eye(2), A, B, 1.0, rng, fixed=True) > 0.999
    assert right(1e-6 * np.eye(2), A, B, 1.0, rng) == pytest.approx(0.5, abs=0.03)


def test_evidence_is_that_of_normal_amplitudes(monkeypatch) -> None:
    """Of residuals with the covariance 1 + s^2 x x'."""
    import analysis.separation as study

    monkeypatch.setattr(study, "SCALES", np.array([2.0]))
    monkeypatch.setattr(study, "SCALE_PRIOR", np.array([0.0]))
    rng = np.random.default_rng(1)
    x, r = rng.normal(size=(30, 2)), rng.normal(size=(5, 30)) * 1.5
    covariance = np.eye(30) + 4.0 * x @ x.T
    inverse = np.linalg.inv(covariance)
    expected = 0.5 * (np.sum(r**2, axis=1) - np.einsum("ni,ij,nj->n", r, inverse, r))
    expected -= 0.5 * np.linalg.slogdet(covariance)[1]
    np.testing.assert_allclose(evidence(r @ x, x.T @ x), expected, rtol=1e-9)
