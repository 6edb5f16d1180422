"""An ensemble of emcee with its two moves, whose state can be kept and restored.

emcee without `scipy.stats`, whose import takes half a second and which only an unused move needs.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

from bayescal.posterior.linearised import Linearised


@contextmanager
def without_scipy_stats() -> Iterator[None]:
    """Within, `from scipy.stats import gaussian_kde` gives a function that imports it when it is called."""
    if "scipy.stats" in sys.modules:
        yield
        return
    later = ModuleType("scipy.stats")
    later.gaussian_kde = _gaussian_kde  # type: ignore[attr-defined]
    sys.modules["scipy.stats"] = later
    try:
        yield
    finally:
        del sys.modules["scipy.stats"]


def _gaussian_kde(*args: Any, **options: Any) -> Any:
    from scipy.stats import gaussian_kde

    return gaussian_kde(*args, **options)


with without_scipy_stats():
    import emcee

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
            self.state = state
            yield

    def chain(self, first: int = 0, thin: int = 1) -> np.ndarray:
        """Points (T, W, D) after each step."""
        return np.asarray(self._sampler.get_chain(discard=first, thin=thin))

    def log_density(self, first: int = 0, thin: int = 1) -> np.ndarray:
        """Log densities (T, W) of `chain`."""
        return np.asarray(self._sampler.get_log_prob(discard=first, thin=thin))

    def kept(self, first: int) -> dict[str, np.ndarray]:
        """Steps from one on, and the present state: what `restore` needs."""
        _, key, *places, gauss = self.state.random_state
        points = self.chain(first)
        moved = np.ones(points.shape[:2], dtype=bool)
        moved[1:] = np.any(points[1:] != points[:-1], axis=2)  # a rejected proposal repeats a point
        return {
            "moved": moved,
            "points": points[moved],
            "log_density": self.log_density(first),
            "key": key,
            "places": np.array(places),
            "gauss": np.array(gauss),
            "counts": np.array([(move.proposed, move.accepted) for move in self.moves]),
        }

    def restore(self, kept: Mapping[str, np.ndarray]) -> None:
        """Take over steps and state of another ensemble, as `kept` returned them."""
        place, has_gauss = map(int, kept["places"])
        random = ("MT19937", kept["key"], place, has_gauss, float(kept["gauss"]))
        moved = kept["moved"]
        row = np.where(moved, np.cumsum(moved).reshape(moved.shape) - 1, 0)
        points = kept["points"][np.maximum.accumulate(row)]
        self._sampler.backend.grow(len(points), None)
        for x, lp in zip(points, kept["log_density"], strict=True):
            state = emcee.State(x, log_prob=lp, random_state=random)
            self._sampler.backend.save_step(state, np.zeros(len(x), dtype=bool))
        self.state = emcee.State(state, copy=True)
        for move, (proposed, accepted) in zip(self.moves, kept["counts"], strict=True):
            move.proposed, move.accepted = int(proposed), int(accepted)
