"""Our moves and emcee's default stretch move, on the same density by the same kernel.

The stretch move's run is some 50 of its autocorrelation times long, emcee's own rule. That still
estimates them a tenth too short, in its favour: they settle near 970 steps in a run of twice the length.
"""

from __future__ import annotations

from collections.abc import Sequence

import emcee
import numpy as np

from analysis.benchmarks.effective import Turn
from bayescal.posterior import Density
from bayescal.posterior.checkpoint import Evolution, Independence
from bayescal.posterior.linearised import Linearised

THIN = 10  # of the stretch move's steps one is kept: its chains are long


def _ensemble(
    density: Density, start: np.ndarray, moves: Sequence, steps: int, burn: int, thin: int = 1
) -> Turn:
    sampler = emcee.EnsembleSampler(len(start), density.size, density, moves=moves, vectorize=True)
    state = [sampler.run_mcmc(emcee.State(start), burn, store=False)]

    def turn() -> np.ndarray:
        sampler.reset()
        state[0] = sampler.run_mcmc(state[0], steps // thin, thin_by=thin)
        return sampler.get_chain()

    return turn


def ours(density: Density, steps: int = 1000) -> Turn:
    """One ensemble with the moves and the number of walkers of `bayescal.posterior.sample`."""
    linearised = Linearised.of(density)
    start = linearised.draw(2 * (density.size + 1), np.random.default_rng(1), spread=2.0)
    return _ensemble(density, start, [(Independence(linearised), 0.5), (Evolution(), 0.5)], steps, 100)


def stretch(density: Density, steps: int = 9000) -> Turn:
    """The default of emcee, started in the posterior: it need not find it first. Every THINth step."""
    start = Linearised.of(density).draw(2 * (density.size + 1), np.random.default_rng(2))
    return _ensemble(density, start, [(emcee.moves.StretchMove(), 1.0)], steps, 500, THIN)
