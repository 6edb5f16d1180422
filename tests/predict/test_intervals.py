"""Intervals hold what they say, 95 %."""

import numpy as np
import pytest

from bayescal.predict.crossvalidation import bootstrap_interval95, inside95, interval95


def test_interval_of_draws_is_of_95_percent():
    low, high = interval95(np.linspace(0.0, 1.0, 1001))
    assert (low, high) == (pytest.approx(0.025), pytest.approx(0.975))


def test_interval_of_normal_draws_holds_95_percent_of_new_ones():
    rng = np.random.default_rng(0)
    inside = inside95(rng.standard_normal(4000), rng.standard_normal((4000, 4000)))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)


def test_bootstrap_interval_is_of_95_percent_and_wider_of_few_blocks():
    draws = np.random.default_rng(1).standard_normal(200_000)
    low, high = bootstrap_interval95(0.0, draws, 10_000)
    assert (low, high) == (pytest.approx(-1.96, abs=0.02), pytest.approx(1.96, abs=0.02))
    few = bootstrap_interval95(0.0, draws, 4)
    assert few[1] == pytest.approx(3.182 * np.sqrt(4 / 3), rel=0.02)  # Student t of 3 degrees of freedom
    assert np.isnan(bootstrap_interval95(0.0, draws, 1)).all()
