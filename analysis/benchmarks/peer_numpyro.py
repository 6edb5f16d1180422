"""NumPyro's NUTS with a dense mass matrix on the same posterior in JAX, without warm-up and compilation.

The mass matrix is that of the linearised posterior, the best that NUTS could find. Left to find its
own it adds 1e-3 to every variance, where certificates make some 1e-9, and the step size collapses:
trees of a thousand leaps for a draw.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpyro.infer import NUTS

from analysis.benchmarks.effective import Turn
from analysis.benchmarks.jax_density import density_function
from analysis.benchmarks.problem import Problem
from bayescal.posterior import Density
from bayescal.posterior.density import Linearised

AGREEMENT = 1e-6
WARM_UP = 500  # for the step size


def disagreement(problem: Problem, density: Density, points: int = 8) -> float:
    """Largest difference of the two log densities over draws of the posterior, widened to three times."""
    x = Linearised.of(density).draw(points, np.random.default_rng(3), spread=3.0)
    theirs = np.asarray(jax.vmap(density_function(problem, density))(jnp.asarray(x)))
    return float(np.max(np.abs(theirs - density(x))))


def nuts(problem: Problem, density: Density, steps: int = 1000) -> Turn:
    """One chain, started at the estimate."""
    assert disagreement(problem, density) < AGREEMENT, "the densities are not the same"
    log_density = density_function(problem, density)
    kernel = NUTS(
        potential_fn=lambda x: -log_density(x),
        dense_mass=True,
        inverse_mass_matrix=_covariance(density),
        adapt_mass_matrix=False,
    )
    start = jnp.asarray(np.append(density.estimate.z, np.log(density.kappa)))
    state = kernel.init(jax.random.PRNGKey(0), WARM_UP, start, (), {})

    def step(state: Any, _: None) -> tuple[Any, Any]:
        state = kernel.sample(state, (), {})
        return state, state.z

    run = jax.jit(lambda state: jax.lax.scan(step, state, None, length=steps))
    for _ in range(-(-WARM_UP // steps) + 1):
        state, _ = run(state)
    now = [jax.block_until_ready(state)]

    def turn() -> np.ndarray:
        now[0], draws = run(now[0])
        return np.asarray(draws)[:, None, :]

    return turn


def _covariance(density: Density) -> jax.Array:
    size = density.size
    out = np.zeros((size, size))
    out[:-1, :-1] = density.estimate.covariance
    out[-1, -1] = 0.5 / density.count
    return jnp.asarray(out)
