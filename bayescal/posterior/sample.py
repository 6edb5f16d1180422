"""Four independent ensembles of emcee, run until every parameter has the requested effective draws.

Steps are independent proposals from the linearised posterior, which converge fast, or differential evolution
(ter Braak 2006), which stays efficient where the model is not linear. If few of the independent proposals
are accepted in the burn-in, half of the steps are of either kind.

Convergence of chains as ArviZ computes it: rank-normalised split R-hat, bulk and tail ESS.

Vehtari, Gelman, Simpson, Carpenter, Buerkner (2021), Rank-normalization, folding, and localization: an
improved R-hat, Bayesian Analysis 16, 667. ArviZ itself takes seconds to import and works on one component at
a time; tests compare the results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from itertools import chain

import emcee
import numpy as np
from scipy.special import ndtri

from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.posterior.checkpoint import Checkpoint, Ensemble, Evolution, Independence, Results
from bayescal.posterior.density import Density
from bayescal.posterior.linearised import CHAINS, Convergence, Draws, Linearised, scale_names

TAILS = (0.05, 0.95)
"""Quantiles whose indicators measure the tails."""


def convergence(chains: np.ndarray) -> Convergence:
    """Effective sample sizes and R-hat of chains.

    Parameters
    ----------
    chains : np.ndarray, shape (M, N, D)
        M chains of N draws (8 or more) of D components.
    """
    halves = _split(chains)
    normal = _rank_normalised(halves)
    folded = _rank_normalised(np.abs(halves - np.median(halves, axis=(0, 1))))
    tails = [_ess(_split(chains <= np.quantile(chains, q, axis=(0, 1))).astype(float)) for q in TAILS]
    return Convergence(_ess(normal), np.minimum(*tails), np.maximum(_rhat(normal), _rhat(folded)))


def _split(chains: np.ndarray) -> np.ndarray:
    """Each chain cut in two halves: (2 M, N // 2, D)."""
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, -half:]])


def _rank_normalised(chains: np.ndarray) -> np.ndarray:
    """Normal scores of the ranks over all chains (Blom), ties at their mean rank."""
    flat = chains.reshape(-1, chains.shape[-1])
    out = np.empty_like(flat)
    for k, column in enumerate(flat.T):
        _, which, count = np.unique(column, return_inverse=True, return_counts=True)
        rank = np.cumsum(count) - 0.5 * (count - 1)
        out[:, k] = ndtri((rank - 0.375) / (len(column) + 0.25))[which]
    return out.reshape(chains.shape)


def _rhat(chains: np.ndarray) -> np.ndarray:
    """R-hat (D,) of chains (M, N, D)."""
    count = chains.shape[1]
    within = chains.var(axis=1, ddof=1).mean(axis=0)
    between = chains.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sqrt((count - 1) / count + between / within)


def _ess(chains: np.ndarray) -> np.ndarray:
    """Effective sample size (D,) of chains (M, N, D), by Geyer's initial monotone sequence."""
    m, n, size = chains.shape
    long = 1 << (2 * n - 1).bit_length()  # a power of two; `scipy.fft` is slow to import
    spectrum = np.fft.rfft(chains - chains.mean(axis=1, keepdims=True), n=long, axis=1)
    power = np.mean(spectrum.real**2 + spectrum.imag**2, axis=0)
    covariance = np.fft.irfft(power, n=long, axis=0)[:n] / n
    within = covariance[0] * n / (n - 1.0)
    variance = covariance[0] + (chains.mean(axis=1).var(axis=0, ddof=1) if m > 1 else 0.0)
    still = np.ptp(chains, axis=(0, 1)) < np.finfo(float).resolution
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = 1.0 - (within - covariance) / variance
    rho[0] = 1.0
    out = np.full(size, float(m * n))
    for k in np.flatnonzero(~still):
        out[k] /= max(_time(rho[:, k]), 1.0 / np.log10(m * n))
    return out


def _time(rho: np.ndarray) -> float:
    """Autocorrelation time from autocorrelations (N,): pairs of lags while positive, made monotone."""
    n = len(rho)
    pairs = rho[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    most = max((n - 3) // 2, 0)  # as in ArviZ
    ends = np.flatnonzero(pairs[: most + 1] <= 0)
    end = int(ends[0]) if len(ends) else most
    return float(-1.0 + 2.0 * np.sum(np.minimum.accumulate(pairs[:end])) + max(rho[2 * end], 0.0))


LEAST_SHARE, LARGEST_SHARE = 0.5, 0.9
"""Limits of the share of independent proposals; within them it is their acceptance rate in the burn-in."""
BURN = 15  # discarded steps from overdispersed starts; more while the ensembles still drift
YIELD = 0.75  # assumed effective draws per draw, before it is measured
MARGIN = 1.03  # factor on the predicted number of steps
GROWTH = 1.5  # largest increase of the number of steps between two tests of convergence
TAUS = 10  # smallest length of a run in autocorrelation times, for a reliable estimate of them
MAX_STEPS = 10_000
LARGEST_RHAT = 1.01
NEARLY = 0.99  # the largest progress before the last test of convergence


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
    linearised = Linearised.of(density)
    walkers = 2 * (density.size + 1)
    moves = [(Independence(linearised), Evolution()) for _ in range(CHAINS)]
    burning = []
    for pair, seeds in zip(moves, np.random.SeedSequence(seed).spawn(CHAINS), strict=True):
        rng = np.random.RandomState(np.random.MT19937(seeds))
        start = emcee.State(linearised.draw(walkers, rng, spread=2.0), random_state=rng.get_state())
        burning.append(Ensemble(density, pair, LEAST_SHARE, start))
    if checkpoint is None:
        return _sample(
            density, burning, effective, progress, max_steps, Ensemble.run, lambda compute: compute()
        )
    with checkpoint.of(burning, effective=effective, seed=seed, max_steps=max_steps) as record:
        return _sample(density, burning, effective, progress, max_steps, record.advance, record.once)


def _sample(
    density: Density,
    burning: Sequence[Ensemble],
    effective: int,
    progress: Callable[[float], None],
    max_steps: int,
    advance: Callable[[Ensemble, int], Iterator[None]],
    once: Callable[[Callable[[], Results]], Results],
) -> Draws:
    """As `sample`, from ensembles at their starts; `advance` takes steps, `once` computes results."""
    expected = more = max(int(np.ceil(effective / (YIELD * CHAINS * burning[0].walkers))), TAUS)

    def advance_all(ensembles: Sequence[Ensemble], count: int, before: int) -> None:
        """Advance each of the ensembles; `before`: steps that earlier ones have taken."""
        for ensemble in ensembles:
            for _ in advance(ensemble, count):
                done = before + sum(map(len, ensembles)) / CHAINS
                progress(min(done / (BURN + expected), NEARLY))

    advance_all(burning, BURN, 0)
    moves = [ensemble.moves for ensemble in burning]
    share = float(np.clip(np.mean([pair[0].rate for pair in moves]), LEAST_SHARE, LARGEST_SHARE))
    for move in chain.from_iterable(moves):
        move.proposed = move.accepted = 0
    ensembles = [Ensemble(density, e.moves, share, e.state) for e in burning]
    steps, first, thin = 0, 0, 1
    while True:
        more = min(more, max_steps - steps)
        advance_all(ensembles, more, BURN)
        steps += more
        chains = np.stack([e.chain(first, thin) for e in ensembles])  # (M, T, W, D + G)
        ends = _walkers_end_to_end(chains)
        tests = once(lambda: vars(convergence(ends)) | {"drift": np.array(_drift(chains))})  # noqa: B023
        drift = float(tests["drift"])
        diagnostics = Convergence(*(tests[f.name] for f in fields(Convergence)))
        tau = thin * chains[..., 0].size / float(diagnostics.ess_bulk.min())
        enough = min(float(diagnostics.ess.min()) / effective, (steps - first) / (TAUS * tau))
        if (enough >= 1.0 and drift <= LARGEST_RHAT) or steps >= max_steps:
            break
        if drift > LARGEST_RHAT:
            first = steps // 2
        thin = max(int(tau / 2.0), 1)  # closer draws are nearly identical
        growth = min(MARGIN / enough if enough < 1.0 else GROWTH, GROWTH)
        more = max(int(np.ceil((steps - first) * (growth - 1.0))), first - steps // 2, 1)
        expected = min(max(first + int((steps - first) * MARGIN / enough), steps + more), max_steps)
    progress(1.0)
    lp = np.stack([e.log_density(first, thin) for e in ensembles])
    names, size = (*density.model.names, *scale_names(density.groups)), density.model.size
    complaint = _complaint(names, diagnostics, drift, effective, steps, tau)
    acceptance = {
        "independence": float(np.mean([pair[0].rate for pair in moves])),
        "differential evolution": float(np.mean([pair[1].rate for pair in moves])),
    }
    return Draws(
        diagnostics.ess_bulk, diagnostics.ess_tail, diagnostics.rhat,
        ends[..., :size] + density.estimate.from_free, ends[..., size:],
        _walkers_end_to_end(lp), names, acceptance,
        f"{100 * share:.0f} % independent proposals from the linearised posterior, the others differential "
        "evolution",
        steps - first, burning[0].walkers, not complaint, complaint,
    )  # fmt: skip


def _walkers_end_to_end(chains: np.ndarray) -> np.ndarray:
    """Ensembles (M, T, W, ...) as chains (M, W T, ...): all steps of the first walker, then of the second."""
    return np.swapaxes(chains, 1, 2).reshape(len(chains), -1, *chains.shape[3:])


def _drift(chains: np.ndarray) -> float:
    """Largest R-hat between the first and the second half of the time of ensembles (M, T, W, D)."""
    by_time = chains.reshape(len(chains), -1, chains.shape[-1])
    return float(np.nanmax(_rhat(_split(by_time))))


def _complaint(
    names: tuple[str, ...], diagnostics: Convergence, drift: float, effective: int, steps: int, tau: float
) -> str:
    ess, rhat = diagnostics.ess, diagnostics.rhat
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
