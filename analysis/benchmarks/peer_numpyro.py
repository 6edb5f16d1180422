"""NumPyro's NUTS with a dense mass matrix on the same posterior in JAX.

Twice: as its users run it, with its own warm-up (`nuts`), and with the covariance of our linearised
posterior handed to it as its mass matrix (`nuts_given`), which is most of the work done for it. The
ratio is against the first. Warm-up and compilation count in the time to 5000 effective draws, not in the
draws a second. Both start at the estimate.

The coordinates of the first are the parameters over their posterior standard deviations, as from a
pilot run. In the prior's coordinates, where these differ ten-thousandfold, it does not adapt: NumPyro
adds 0.005 / (n + 5) to the variances that it estimates from n draws, and after 700 draws of warm-up a
tree still grows to its limit of 1023 leaps. In these it adapts in some 200 draws, and then takes 7 to 9
leaps for an effective draw, after 1000 draws of warm-up as after 2000; the matrix handed over needs 5.
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
from bayescal.posterior.linearised import Linearised

AGREEMENT = 1e-6
WARM_UP = 1000  # draws, for step size and mass matrix
WARM_UP_GIVEN = 500  # for the step size alone


def disagreement(problem: Problem, density: Density, points: int = 8) -> float:
    """Largest difference of the two log densities over draws of the posterior, widened to three times."""
    x = Linearised.of(density).draw(points, np.random.default_rng(3), spread=3.0)
    theirs = np.asarray(jax.vmap(density_function(problem, density))(jnp.asarray(x)))
    return float(np.max(np.abs(theirs - density(x))))


def nuts(problem: Problem, density: Density, steps: int = 1000, warm_up: int = WARM_UP) -> Turn:
    """One chain that has adapted its own dense mass matrix, in parameters over their posterior sd."""
    return _chain(problem, density, steps, warm_up, np.sqrt(np.diag(_covariance(density))))


def nuts_given(problem: Problem, density: Density, steps: int = 1000) -> Turn:
    """One chain whose mass matrix is the linearised posterior's; only its step size is adapted."""
    handed = {"inverse_mass_matrix": jnp.asarray(_covariance(density)), "adapt_mass_matrix": False}
    return _chain(problem, density, steps, WARM_UP_GIVEN, np.ones(density.size), handed)


def _chain(
    problem: Problem,
    density: Density,
    steps: int,
    warm_up: int,
    scale: np.ndarray,
    options: dict[str, Any] | None = None,
) -> Turn:
    """Warm up and compile a chain in the coordinates x / scale; a turn is `steps` draws of x."""
    log_density = density_function(problem, density)
    kernel = NUTS(potential_fn=lambda u: -log_density(u * scale), dense_mass=True, **(options or {}))
    start = np.append(density.estimate.z, np.log(density.kappa)) / scale
    state = kernel.init(jax.random.PRNGKey(0), warm_up, jnp.asarray(start), (), {})

    def step(state: Any, _: None) -> tuple[Any, Any]:
        state = kernel.sample(state, (), {})
        return state, state.z

    run = jax.jit(lambda state: jax.lax.scan(step, state, None, length=steps))
    for _ in range(-(-warm_up // steps)):
        state, _ = run(state)
    now = [jax.block_until_ready(state)]

    def turn() -> np.ndarray:
        now[0], draws = run(now[0])
        return np.asarray(draws)[:, None, :] * scale

    return turn


def _covariance(density: Density) -> np.ndarray:
    """Of the linearised posterior and the logarithm of the noise scale, (D + 1, D + 1)."""
    out = np.zeros((density.size, density.size))
    out[:-1, :-1] = density.estimate.covariance
    out[-1, -1] = 0.5 / density.count[0]
    return out
