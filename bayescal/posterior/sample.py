"""Four independent ensembles of emcee, run until every parameter has the draws that were asked for.

Half of the steps are independent proposals from the linearised posterior, half are differential
evolution (ter Braak 2006): the first make it fast, the second keep it right where the model bends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import emcee
import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.posterior.density import Density, Linearised

ENSEMBLES = 4
FIRST = 100  # steps before convergence is looked at, and by how much more steps each time after
GROWTH = 1.4
BURN = 30  # steps thrown away, of overdispersed starts
TAUS = 50  # emcee's rule: so many autocorrelation times make a trustworthy one
MAX_STEPS = 10_000
LARGEST_RHAT = 1.01


@dataclass(frozen=True)
class Draws:
    """Draws of the posterior, four chains, and how they were come by.

    A chain is an ensemble, thinned by its autocorrelation time and its walkers laid end to end.
    """

    z: np.ndarray  # (chains, draws, D)
    log_kappa: np.ndarray  # (chains, draws), noise scale over the stated noise
    log_density: np.ndarray  # (chains, draws)
    names: tuple[str, ...]  # of the D components and the noise scale
    ess: np.ndarray  # (D + 1,) effective draws
    rhat: np.ndarray  # (D + 1,) split R-hat across the ensembles, nan where not sampled
    acceptance: dict[str, float]  # by move
    moves: str
    steps: int  # of each ensemble after burn-in
    walkers: int
    converged: bool
    complaint: str  # why not, in words

    @property
    def flat(self) -> np.ndarray:
        """All draws of z, (chains * draws, D)."""
        return self.z.reshape(-1, self.z.shape[-1])

    @property
    def kappa(self) -> np.ndarray:
        """Noise scales of `flat`, (chains * draws,)."""
        return np.exp(self.log_kappa.ravel())


class _Counted:
    """A move that keeps count of what was accepted."""

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
    """Proposals drawn from the linearised posterior, whatever the present point."""

    def __init__(self, linearised: Linearised) -> None:
        def propose(x: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
            new = linearised.draw(len(x), rng)
            return new, linearised(x) - linearised(new)

        super().__init__(propose)


class Evolution(_Counted, emcee.moves.DEMove):
    """Differential evolution among the walkers."""


def autocorrelation_times(chain: np.ndarray) -> np.ndarray:
    """Integrated autocorrelation times (D,), in steps, of an ensemble's chain (T, W, D).

    The mean over walkers of the autocorrelation function, summed up to Sokal's window of 5 times: the
    estimator of emcee, for all components at once. Infinite where nothing moved.
    """
    steps = len(chain)
    spectrum = rfft(chain - chain.mean(axis=0), n=next_fast_len(2 * steps), axis=0)
    correlation = irfft(spectrum.real**2 + spectrum.imag**2, axis=0)[:steps]
    with np.errstate(invalid="ignore"):
        correlation = np.mean(correlation / correlation[0], axis=1)
    times = 2.0 * np.cumsum(correlation, axis=0) - 1.0
    out = [column[emcee.autocorr.auto_window(column, 5.0)] for column in times.T]
    return np.maximum(np.nan_to_num(np.array(out), nan=np.inf), 1.0)


def split_rhat(chains: np.ndarray) -> np.ndarray:
    """Split R-hat (Gelman et al., BDA3, 11.4) of chains (M, T, D), each cut in two halves: (D,)."""
    half = chains.shape[1] // 2
    parts = np.concatenate([chains[:, :half], chains[:, -half:]])
    within = parts.var(axis=1, ddof=1).mean(axis=0)
    between = parts.mean(axis=1).var(axis=0, ddof=1)
    return np.sqrt((half - 1) / half + between / within)


def gaussian(estimate: Estimate, seed: int, count: int = 4000) -> Draws:
    """Draws of the linearised posterior: the Gaussian approximation, with the noise scale unknown."""
    density = Density(estimate)
    x = Linearised.of(density).draw(count, np.random.default_rng(seed))
    x = x.reshape(ENSEMBLES, -1, density.size)
    lp = np.stack([density(part) for part in x])
    return Draws(
        x[..., :-1], x[..., -1], lp, (*estimate.model.names, "noise scale"),
        np.full(density.size, float(count)), np.full(density.size, np.nan), {},
        "none: independent draws of the linearised posterior", count, 1, True, "",
    )  # fmt: skip


def sample(
    estimate: Estimate,
    effective: int = 5000,
    seed: int = 0,
    progress: Callable[[float], None] = lambda fraction: None,
    max_steps: int = MAX_STEPS,
) -> Draws:
    """Sample until every parameter and the noise scale have `effective` effective draws.

    Parameters
    ----------
    estimate : Estimate
    effective : int
        Wanted effective sample size of every component.
    seed : int
        One seed, one result.
    progress : callable
        Told the fraction done.
    max_steps : int
        Steps of each ensemble after which the run is declared not converged.

    Returns
    -------
    Draws
        `converged` False, with the reason, where the run fell short.
    """
    if effective < 1:
        raise BayescalError(
            "the number of samples must be positive", "--samples", "0 stops at the Gaussian approximation"
        )
    density = Density(estimate)
    linearised = Linearised.of(density)
    walkers = 2 * (density.size + 1)
    moves = [(Independence(linearised), Evolution()) for _ in range(ENSEMBLES)]
    samplers, states = [], []
    for k, seeds in enumerate(np.random.SeedSequence(seed).spawn(ENSEMBLES)):
        rng = np.random.RandomState(np.random.MT19937(seeds))
        sampler = emcee.EnsembleSampler(
            walkers, density.size, density, moves=[(move, 0.5) for move in moves[k]], vectorize=True
        )
        start = linearised.draw(walkers, rng, spread=2.0)
        # the ensemble draws its own proposals from the sampler's generator: seed that one too
        sampler._random.set_state(rng.get_state())
        states.append(sampler.run_mcmc(emcee.State(start, random_state=rng.get_state()), BURN, store=False))
        samplers.append(sampler)
    for pair in moves:
        for move in pair:
            move.proposed = move.accepted = 0
    steps, tau, ess = 0, np.inf, np.zeros(density.size)
    fraction, aim = 0.0, 0.5
    while steps < max_steps:
        more = min(max(FIRST, int(steps * (GROWTH - 1.0))), max_steps - steps)
        for k, sampler in enumerate(samplers):
            states[k] = sampler.run_mcmc(states[k], more)
            progress(min(fraction + (k + 1) / ENSEMBLES * (aim - fraction), 1.0))
        steps += more
        taus = np.stack([autocorrelation_times(s.get_chain()) for s in samplers])
        tau = float(np.max(taus.mean(axis=0)))
        ess = np.sum(walkers * steps / taus, axis=0)
        fraction = min(float(ess.min()) / effective, steps / (TAUS * tau))
        aim = fraction * GROWTH
        if fraction >= 1.0:
            break
    thin = max(int(np.ceil(tau)), 1) if np.isfinite(tau) else 1
    chains = np.stack([s.get_chain(thin=thin) for s in samplers])  # (M, T, W, D + 1)
    flat = chains.reshape(ENSEMBLES, -1, density.size)
    lp = np.stack([s.get_log_prob(thin=thin) for s in samplers]).reshape(ENSEMBLES, -1)
    rhat = split_rhat(flat)
    names = (*estimate.model.names, "noise scale")
    complaint = _complaint(names, ess, rhat, effective, steps, tau)
    acceptance = {
        "independence": float(np.mean([pair[0].rate for pair in moves])),
        "differential evolution": float(np.mean([pair[1].rate for pair in moves])),
    }
    return Draws(
        flat[..., :-1], flat[..., -1], lp, names, ess, rhat, acceptance,
        "half independent proposals from the linearised posterior, half differential evolution",
        steps, walkers, not complaint, complaint,
    )  # fmt: skip


def _complaint(
    names: tuple[str, ...], ess: np.ndarray, rhat: np.ndarray, effective: int, steps: int, tau: float
) -> str:
    if np.nanmax(rhat) > LARGEST_RHAT:
        return f"R-hat of {names[int(np.nanargmax(rhat))]} is {np.nanmax(rhat):.3f}, above {LARGEST_RHAT}"
    if ess.min() < effective:
        least = f"{names[int(ess.argmin())]} has {ess.min():.0f} effective draws"
        return f"{least} of {effective} after {steps} steps"
    if steps < TAUS * tau:
        return f"{steps} steps are fewer than {TAUS} autocorrelation times of {tau:.0f}"
    return ""
