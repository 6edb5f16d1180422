"""Four independent ensembles of emcee, run until every parameter has the requested effective draws.

Steps are independent proposals from the linearised posterior, which converge fast, or differential evolution
(ter Braak 2006), which stays efficient where the model is not linear. If few of the independent proposals
are accepted in the burn-in, half of the steps are of either kind.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.posterior.checkpoint import Checkpoint, Values
from bayescal.posterior.convergence import Convergence, convergence, split_rhat
from bayescal.posterior.density import Density
from bayescal.posterior.draws import CHAINS, Draws, scale_names
from bayescal.posterior.imports import without_scipy_stats
from bayescal.posterior.linearised import Linearised

with without_scipy_stats():
    import emcee

LEAST_SHARE, LARGEST_SHARE = 0.5, 0.9
"""Limits of the share of independent proposals; within them it is their acceptance rate in the burn-in."""
BURN = 15  # discarded steps from overdispersed starts; more while the ensembles still drift
YIELD = 0.75  # assumed effective draws per draw, before it is measured
MARGIN = 1.03  # factor on the predicted number of steps
GROWTH = 1.5  # largest increase of the number of steps between two tests of convergence
TAUS = 10  # smallest length of a run in autocorrelation times, for a reliable estimate of them
MAX_STEPS = 10_000
LARGEST_RHAT = 1.01


class _Counted:
    """A move that counts its accepted proposals."""

    proposed = 0
    accepted = 0

    def propose(self, model: Any, state: Any) -> Any:
        state, accepted = super().propose(model, state)  # type: ignore[misc]
        self.proposed += len(accepted)
        self.accepted += int(np.sum(accepted))
        return state, accepted

    @property
    def rate(self) -> float:
        return self.accepted / max(self.proposed, 1)


class Independence(_Counted, emcee.moves.MHMove):
    """Proposals drawn from the linearised posterior, independent of the current point."""

    def __init__(self, linearised: Linearised) -> None:
        def propose(x: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
            new = linearised.draw(len(x), rng)
            return new, linearised(x) - linearised(new)

        super().__init__(propose)


class Evolution(_Counted, emcee.moves.DEMove):
    """Differential evolution among the walkers."""


def sample(
    estimate: Estimate,
    effective: int = 5000,
    seed: int = 0,
    progress: Callable[[float], None] = lambda fraction: None,
    max_steps: int = MAX_STEPS,
    checkpoint: Checkpoint | None = None,
) -> Draws:
    """Sample until every parameter and noise scale has `effective` effective draws, bulk and tails.

    Parameters
    ----------
    estimate : Estimate
    effective : int
        Requested effective sample size of every component.
    seed : int
        The same seed gives the same result.
    progress : callable
        Called with the completed fraction.
    max_steps : int
        Steps of each ensemble after which the run is declared not converged.
    checkpoint : Checkpoint, optional
        Where the state of a long run is kept; an interrupted run continues.

    Returns
    -------
    Draws
        `converged` is False, with the reason, where the run did not converge.
    """
    if effective < 1:
        raise BayescalError(
            "the number of samples must be positive", "--samples", "0 stops at the Gaussian approximation"
        )
    density = Density(estimate)
    if checkpoint is None:
        return _sample(density, density, effective, seed, progress, max_steps)
    with checkpoint.of(density, effective=effective, seed=seed, max_steps=max_steps) as values:
        return _sample(density, values, effective, seed, progress, max_steps)


def _sample(
    density: Density,
    values: Values,
    effective: int,
    seed: int,
    progress: Callable[[float], None],
    max_steps: int,
) -> Draws:
    """As `sample`; `values` are those of the density."""
    linearised = Linearised.of(density)
    walkers = 2 * (density.size + 1)
    moves = [(Independence(linearised), Evolution()) for _ in range(CHAINS)]
    states = []
    for pair, seeds in zip(moves, np.random.SeedSequence(seed).spawn(CHAINS), strict=True):
        rng = np.random.RandomState(np.random.MT19937(seeds))
        start = emcee.State(linearised.draw(walkers, rng, spread=2.0), random_state=rng.get_state())
        states.append(_ensemble(values, walkers, pair, LEAST_SHARE, start).run_mcmc(start, BURN))
    share = float(np.clip(np.mean([pair[0].rate for pair in moves]), LEAST_SHARE, LARGEST_SHARE))
    samplers = [
        _ensemble(values, walkers, pair, share, state) for pair, state in zip(moves, states, strict=True)
    ]
    for pair in moves:
        for move in pair:
            move.proposed = move.accepted = 0
    steps, first, thin = 0, 0, 1
    more = max(int(np.ceil(effective / (YIELD * CHAINS * walkers))), TAUS)
    while True:
        more = min(more, max_steps - steps)
        for k, sampler in enumerate(samplers):
            states[k] = sampler.run_mcmc(states[k], more)
            progress((steps + (k + 1) / CHAINS * more) / (steps + more))
        steps += more
        chains = np.stack([s.get_chain(discard=first, thin=thin) for s in samplers])  # (M, T, W, D + G)
        ends = _walkers_end_to_end(chains)
        found, drift = convergence(ends), _drift(chains)
        tau = thin * chains[..., 0].size / float(found.ess_bulk.min())
        enough = min(float(found.ess.min()) / effective, (steps - first) / (TAUS * tau))
        if (enough >= 1.0 and drift <= LARGEST_RHAT) or steps >= max_steps:
            break
        if drift > LARGEST_RHAT:
            first = steps // 2
        thin = max(int(tau / 2.0), 1)  # closer draws are nearly identical
        growth = min(MARGIN / enough if enough < 1.0 else GROWTH, GROWTH)
        more = max(int(np.ceil((steps - first) * (growth - 1.0))), first - steps // 2, 1)
    lp = np.stack([s.get_log_prob(discard=first, thin=thin) for s in samplers])
    names, size = (*density.model.names, *scale_names(density.groups)), density.model.size
    complaint = _complaint(names, found, drift, effective, steps, tau)
    acceptance = {
        "independence": float(np.mean([pair[0].rate for pair in moves])),
        "differential evolution": float(np.mean([pair[1].rate for pair in moves])),
    }
    return Draws(
        ends[..., :size], ends[..., size:], _walkers_end_to_end(lp), names,
        found.ess_bulk, found.ess_tail, found.rhat, acceptance,
        f"{100 * share:.0f} % independent proposals from the linearised posterior, the others differential "
        "evolution",
        steps - first, walkers, not complaint, complaint,
    )  # fmt: skip


def _ensemble(
    values: Values, walkers: int, moves: tuple[Independence, Evolution], share: float, state: emcee.State
) -> emcee.EnsembleSampler:
    """A sampler that uses the first of two moves in `share` of its steps, with a given random state."""
    weighed = list(zip(moves, (share, 1.0 - share), strict=True))
    sampler = emcee.EnsembleSampler(walkers, state.coords.shape[1], values, moves=weighed, vectorize=True)
    sampler.log_prob_fn = values  # emcee's wrapper prints every exception, also that of a stop
    # the ensemble uses the generator of the sampler for its proposals: set its state too
    sampler._random.set_state(state.random_state)
    return sampler


def _walkers_end_to_end(chains: np.ndarray) -> np.ndarray:
    """Ensembles (M, T, W, ...) as chains (M, W T, ...): all steps of the first walker, then of the second."""
    return np.swapaxes(chains, 1, 2).reshape(len(chains), -1, *chains.shape[3:])


def _drift(chains: np.ndarray) -> float:
    """Largest R-hat between the first and the second half of the time of ensembles (M, T, W, D)."""
    by_time = chains.reshape(len(chains), -1, chains.shape[-1])
    return float(np.nanmax(split_rhat(by_time)))


def _complaint(
    names: tuple[str, ...], found: Convergence, drift: float, effective: int, steps: int, tau: float
) -> str:
    ess, rhat = found.ess, found.rhat
    if np.nanmax(rhat) > LARGEST_RHAT:
        return f"R-hat of {names[int(np.nanargmax(rhat))]} is {np.nanmax(rhat):.3f}, above {LARGEST_RHAT}"
    if drift > LARGEST_RHAT:
        return f"R-hat between the two halves of the run is {drift:.3f}, above {LARGEST_RHAT}"
    if ess.min() < effective:
        least = f"{names[int(ess.argmin())]} has {ess.min():.0f} effective draws"
        return f"{least} of {effective} after {steps} steps"
    if steps < TAUS * tau:
        return f"{steps} steps are fewer than {TAUS} autocorrelation times of {tau:.0f}"
    return ""
