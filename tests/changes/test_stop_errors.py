"""What measurements of one stop share: its covariance by brute force, and two sessions of one arm."""

from dataclasses import replace

import numpy as np
import pytest
from sessions import reflectors

from bayescal.changes import changed
from bayescal.changes.stops import KIND, Covariance, Stops
from bayescal.public.changes import ChangedResult


def covariance():
    """Of eleven residuals: four at stop 1 of session 0, five at stop 2 of session 1, two at none."""
    rng = np.random.default_rng(0)
    stop = np.array([1, 2, 0, 1, 1, 2, 2, 0, 2, 2, 1])
    columns = np.where(stop[:, None] > 0, rng.standard_normal((11, 6)), 0.0)
    stops = Stops(columns, stop, np.array([0, 0, 1]))
    return Covariance(stops, rng.uniform(0.5, 2.0, 11), np.array([[0.4, 1.5], [2.0, 0.7]]))


def dense(c):
    """M, and H (R, 6) of each session."""
    h = c.stops.matrix.toarray().reshape(11, 3, 6)[:, 1:]
    return np.diag(c.kappa**2) + np.einsum("rsi,si,tsi->rt", h, c.size[:, KIND], h), h


def test_residuals_are_weighted_by_the_inverse_covariance():
    c, x = covariance(), np.random.default_rng(1).standard_normal((11, 3))
    inverse = np.linalg.inv(dense(c)[0])
    assert c.weighted(x) == pytest.approx(inverse @ x)
    assert c.diagonal == pytest.approx(np.diag(inverse))


def test_the_update_of_a_variance_is_zero_where_the_evidence_is_stationary():
    """Of log p(e) = -(e'Pe + log det M + log det X'M^-1X) / 2, by differences."""
    rng = np.random.default_rng(2)
    c, x, e = covariance(), rng.standard_normal((11, 3)), 2.0 * rng.standard_normal(11)

    def solved(c):
        weighted = c.weighted(x)
        inner = np.linalg.inv(x.T @ weighted)
        u = -inner @ (weighted.T @ e)
        return c.weighted((e + x @ u)[:, None])[:, 0], weighted, inner

    def log_evidence(size):
        wide = replace(c, size=size)
        left, _, inner = solved(wide)
        return -0.5 * (e @ left + np.linalg.slogdet(dense(wide)[0])[1] - np.linalg.slogdet(inner)[1])

    square, known = c.sizes(*solved(c))
    for at in np.ndindex(2, 2):
        step = np.zeros((2, 2))
        step[at] = 1e-5
        slope = (log_evidence(c.size + step) - log_evidence(c.size - step)) / 2e-5
        assert (square[at] / c.size[at] - known[at]) / (2 * c.size[at]) == pytest.approx(slope, rel=1e-5)


def test_a_stop_with_several_measurements_makes_its_session_one_with_stops():
    m, rows = reflectors(0.0, 2, stops=3).measurements, np.repeat(np.arange(9), 3)
    columns = np.ones((27, 6))
    stops = Stops.of(m, rows, np.zeros(27, int), columns)
    assert np.unique(stops.stop, return_counts=True)[1].tolist() == [9, 9, 9]
    assert stops.session[1:].tolist() == [0, 0, 0]
    assert not Stops.of(m, rows[::9], np.zeros(3, int), columns[:3]).matrix.toarray().any()


def test_reflectors_of_a_stop_are_not_taken_as_independent():
    """With independent measurements, an error of the stops is a change with a probability near 1."""
    sessions = [replace(reflectors(60e-6, seed), name=f"{seed}", sha256=f"{seed}") for seed in (2, 3)]
    found = changed(sessions, ("geometry",))
    assert found.verdict == "same"
    assert found.of_stops == pytest.approx((6.0, 6.0), rel=0.35)
    assert "of one stop share an error" in str(ChangedResult(found))
