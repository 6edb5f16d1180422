"""R-hat and effective sample sizes are those of ArviZ."""

import numpy as np
import pytest
from arviz_line import arviz_ess, arviz_rhat

from bayescal.posterior.sample import convergence, split_rhat


def chains(count: int, seed: int = 0) -> np.ndarray:
    """Independent, tied, slow, alternating and very slow components of four chains."""
    rng = np.random.default_rng(seed)
    x, noise = np.zeros((4, count, 5)), rng.standard_normal((4, count, 5))
    for t in range(1, count):
        x[:, t] = np.array([0.0, 0.3, 0.9, -0.5, 0.99]) * x[:, t - 1] + noise[:, t]
    x[..., 1] = np.round(x[..., 1], 1)  # ties, as steps that were not accepted make them
    return x


@pytest.mark.parametrize("count", [50, 301, 2000])
def test_as_arviz(count):
    x = chains(count)
    found = convergence(x)
    for k in range(x.shape[-1]):
        assert found.ess_bulk[k] == pytest.approx(arviz_ess(x[..., k], "bulk"), rel=1e-6)
        assert found.ess_tail[k] == pytest.approx(arviz_ess(x[..., k], "tail"), rel=1e-6)
        assert found.rhat[k] == pytest.approx(arviz_rhat(x[..., k]), rel=1e-9)


def test_chains_that_differ_are_seen():
    """In place by both R-hats, in width by the folded one alone."""
    x = np.random.default_rng(0).standard_normal((4, 2000, 3))
    assert np.all(convergence(x).rhat < 1.01)
    x[0, :, 1] += 1.0
    x[0, :, 2] *= 3.0
    assert np.all(convergence(x).rhat[1:] > 1.05)
    assert split_rhat(x)[1] > 1.05
    assert split_rhat(x)[2] < 1.01


def test_a_component_that_stands_still_counts_every_draw():
    """As ArviZ has it."""
    x = np.random.default_rng(0).standard_normal((4, 100, 1))
    assert convergence(np.ones_like(x)).ess_bulk[0] == 400
