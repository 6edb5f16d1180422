"""NumPyro's NUTS with a dense mass matrix on the same posterior in JAX; neither warm-up nor compilation counts."""

from __future__ import annotations

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
WARM_UP = 1000


def disagreement(problem: Problem, density: Density, points: int = 8) -> float:
    """Largest difference of the two log densities over draws of the posterior, widened to three times."""
    x = Linearised.of(density).draw(points, np.random.default_rng(3), spread=3.0)
    theirs = np.asarray(jax.vmap(density_function(problem, density))(jnp.asarray(x)))
    return float(np.max(np.abs(theirs - density(x))))


def nuts(problem: Problem, density: Density, steps: int = 1000) -> Turn:
    """One chain, warmed up from the estimate and its covariance."""
    assert disagreement(problem, density) < AGREEMENT, "the densities are not the same"
    log_density = density_function(problem, density)
    kernel = NUTS(potential_fn=lambda x: -log_density(x), dense_mass=True, inverse_mass_matrix=_covariance(density))
    start = jnp.asarray(np.append(density.estimate.z, np.log(density.kappa)))
    state = kernel.init(jax.random.PRNGKey(0), WARM_UP, start, (), {})

    def step(state, _):  # type: ignore[no-untyped-def]
        state = kernel.sample(state, (), {})
        return state, state.z

    run = jax.jit(lambda state: jax.lax.scan(step, state, None, length=steps))
    for _ in range(-(-WARM_UP // steps) + 1):
        state, _ = run(state)
    now = [state]

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
