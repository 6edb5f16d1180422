"""Effective draws a second, by one estimator for all samplers, their turns interleaved."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import emcee
import numpy as np

WANTED = 5000
"""Effective draws for which the whole time is stated."""
Turn = Callable[[], np.ndarray]
"""Continues sampling; returns the new draws (steps, chains, D + 1)."""


@dataclass(frozen=True)
class Speed:
    """How fast a sampler is."""

    tau: float  # largest integrated autocorrelation time, steps that were kept
    taus: float  # how many of them long the run was
    draws: int  # steps that were kept, times chains
    seconds: float  # that all turns took, at the pace of the median one
    ready: float  # s before the first of these draws: compilation, warm-up, burn-in

    @property
    def per_second(self) -> float:
        """Effective draws a second of the slowest parameter."""
        return self.draws / self.tau / self.seconds

    @property
    def whole(self) -> float:
        """Time to `WANTED` effective draws, compilation, warm-up and burn-in counted, s."""
        return self.ready + WANTED / self.per_second


def race(begin: Mapping[str, Callable[[], Turn]], rounds: int = 5) -> dict[str, Speed]:
    """Prepare samplers, let them take turns, then judge each by its slowest parameter.

    The autocorrelation time is emcee's (Sokal's window, autocorrelation averaged over chains), of
    the parameters themselves; below one step where draws alternate, as those of NUTS do.
    """
    turns, ready = {}, {}
    for name, prepare in begin.items():
        start = time.perf_counter()
        turns[name] = prepare()
        ready[name] = time.perf_counter() - start
    draws: dict[str, list[np.ndarray]] = {name: [] for name in turns}
    took: dict[str, list[float]] = {name: [] for name in turns}
    for _ in range(rounds):
        for name, turn in turns.items():
            start = time.perf_counter()
            draws[name].append(turn())
            took[name].append(time.perf_counter() - start)
    out = {}
    for name, parts in draws.items():
        chain = np.concatenate(parts)
        tau = float(np.max(emcee.autocorr.integrated_time(chain, quiet=True, tol=0)))
        steps, chains, _ = chain.shape
        out[name] = Speed(
            tau, steps / tau, steps * chains, rounds * float(np.median(took[name])), ready[name]
        )
    return out
