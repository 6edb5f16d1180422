"""An ensemble of emcee with its two moves, whose chain can be stored and taken over."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import emcee
import numpy as np

from bayescal.posterior.linearised import Linearised

Values = Callable[[np.ndarray], np.ndarray]
"""Log density (W,) of points (W, D)."""


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


class Ensemble:
    """Walkers that take steps of two kinds.

    Parameters
    ----------
    values : callable
    moves : Independence, Evolution
    share : float
        Of the steps that are of the first kind.
    state : emcee.State
        Points (W, D) and the state of the random generator. Log densities are computed where it has none.
    """

    def __init__(
        self, values: Values, moves: tuple[Independence, Evolution], share: float, state: emcee.State
    ) -> None:
        weighed = list(zip(moves, (share, 1.0 - share), strict=True))
        walkers, size = state.coords.shape
        self._sampler = emcee.EnsembleSampler(walkers, size, values, moves=weighed, vectorize=True)
        self._sampler.log_prob_fn = values  # emcee's wrapper prints every exception, also that of a stop
        # the ensemble uses the generator of the sampler for its proposals: set its state too
        self._sampler._random.set_state(state.random_state)
        if state.log_prob is None:
            state.log_prob = self._sampler.compute_log_prob(state.coords)[0]
        self.moves, self.state = moves, state
        self.counts = self._counts()

    def _counts(self) -> list[tuple[int, int]]:
        """Proposals of each move after the last step, and those that were accepted."""
        return [(move.proposed, move.accepted) for move in self.moves]

    @property
    def walkers(self) -> int:
        """Number of walkers, W."""
        return len(self.state.coords)

    def __len__(self) -> int:
        """Steps taken."""
        return int(self._sampler.backend.iteration)

    def run(self, steps: int) -> Iterator[None]:
        """Take steps; control returns after each."""
        for state in self._sampler.sample(
            self.state, iterations=steps, skip_initial_state_check=len(self) > 0
        ):
            self.state, self.counts = state, self._counts()
            yield

    def chain(self, first: int = 0, thin: int = 1) -> np.ndarray:
        """Points (T, W, D) after each step."""
        return np.asarray(self._sampler.get_chain(discard=first, thin=thin))

    def log_density(self, first: int = 0, thin: int = 1) -> np.ndarray:
        """Log densities (T, W) of `chain`."""
        return np.asarray(self._sampler.get_log_prob(discard=first, thin=thin))

    def add_to(self, store: emcee.backends.Backend) -> None:
        """Add the steps that a store lacks, with the state of the random generator after the last."""
        if not store.initialized:
            store.reset(*self.state.coords.shape)
        first = store.iteration
        if first == len(self):
            return
        store.grow(len(self) - first, None)
        for x, lp in zip(self.chain(first), self.log_density(first), strict=True):
            state = emcee.State(x, log_prob=lp, random_state=self.state.random_state)
            store.save_step(state, np.zeros(len(x), dtype=bool))

    def take(self, store: emcee.backends.Backend, end: int, counts: Sequence[Sequence[int]]) -> None:
        """Take over the steps of a store before the step `end`; `counts` are those after its last."""
        first, end = len(self), min(end, store.iteration)
        if end <= first:
            return
        self._sampler.backend.grow(end - first, None)
        chain, log_density = store.get_chain(discard=first), store.get_log_prob(discard=first)
        random_state = store.random_state
        for x, lp in zip(chain[: end - first], log_density[: end - first], strict=True):
            self.state = emcee.State(x, log_prob=lp, random_state=random_state)
            self._sampler.backend.save_step(self.state, np.zeros(len(x), dtype=bool))
        for move, (proposed, accepted) in zip(self.moves, counts, strict=True):
            move.proposed, move.accepted = proposed, accepted
        self.counts = self._counts()
