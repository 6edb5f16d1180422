"""Contacts that show effects: T-optimal selection, greedy and then by exchange.

A contact with the error e and the variance v of its prediction adds e^2 / (1 + v) to the detectability of an
effect (Atkinson and Fedorov, Biometrika 62 (1975) 57: T-optimal designs; in closed form for linear models).
A model that is not determined yet predicts nothing, and no first contact shows an effect. Therefore contacts
with the largest variance (D-optimal) come first, until the model has as many contacts as unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayescal.planning.contrasts import Contrasts
from bayescal.planning.projection import Projection

BETTER = 1e-6
"""Least increase of the objective by an exchange (rounding)."""
TRIED = 1200
"""Candidates among which the next is looked for, drawn at random (cost: of 5,000, the best of these is among
the best 0.1 % with a probability of 0.7; stochastic greedy: Mirzasoleiman et al., AAAI 2015)."""
SHARE = 0.5
"""Share of the contacts that are D-optimal at most (assumed)."""


def choose(
    contrasts: Contrasts,
    count: int,
    rng: np.random.Generator,
    start: Sequence[int] | np.ndarray = (),
    allowed: np.ndarray | None = None,
    exchanges: int | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> np.ndarray:
    """Candidates that increase the objective of the contrasts most, beside those of `start`.

    Parameters
    ----------
    contrasts : Contrasts
    count : int
        Number of candidates, without those of `start`.
    rng : np.random.Generator
        Of the candidates that are tried.
    start : sequence of int
        Candidates that are in the plan already, and stay.
    allowed : np.ndarray of bool, shape (candidates,), optional
        Candidates that may be chosen.
    exchanges : int, optional
        Exchanges at most: each drops the candidate that contributes least and adds the best; default `count`.
    progress : callable
        Called with the completed fraction.

    Returns
    -------
    np.ndarray of int, shape (count,)
        Numbers of candidates, those of `start` not included; fewer if the pool has no more.
    """
    p = Projection(contrasts.columns, start)
    free = np.ones(contrasts.columns.count, bool) if allowed is None else allowed.copy()
    free[np.asarray(start, int)] = False
    count = min(count, int(np.sum(free)))
    exchanges = count if exchanges is None else exchanges
    chosen: list[int] = []
    for done in range(count):
        best = _next(contrasts, p, free, rng, _undetermined(contrasts, len(start) + done, done, count))
        p.add(best)
        free[best] = False
        chosen.append(best)
        progress(done / (count + exchanges))
    value = float(contrasts.objective(contrasts.strengths(p)))
    for done in range(exchanges if count else 0):
        every = np.sort(chosen)
        worst = int(every[np.argmax(contrasts.changed(p, every, -1.0))])
        p.remove(worst)
        free[worst] = True
        best = _next(contrasts, p, free, rng)
        p.add(best)
        after = float(contrasts.objective(contrasts.strengths(p)))
        if best == worst or after < value + BETTER:
            break
        free[best] = False
        chosen[chosen.index(worst)], value = best, after
        progress((count + done) / (count + exchanges))
    progress(1.0)
    return np.array(chosen, int)


def repeated(
    contrasts: Contrasts, chosen: Sequence[int] | np.ndarray, rng: np.random.Generator, count: int = 10
) -> np.ndarray:
    """Chosen candidates to be measured once more, (count,): those that show most, each repeated once."""
    p = Projection(contrasts.columns, chosen)
    free = np.zeros(contrasts.columns.count, bool)
    free[np.asarray(chosen, int)] = True
    out: list[int] = []
    for _ in range(min(count, int(np.sum(free)))):
        out.append(_next(contrasts, p, free, rng))
        p.add(out[-1])
        free[out[-1]] = False
    return np.array(out, int)


def _undetermined(contrasts: Contrasts, before: int, done: int, count: int) -> bool:
    """Whether the model has fewer residuals than unknowns, as long as effects still have their share."""
    known = len(contrasts.columns.known_design)
    return done < SHARE * count and known + before < contrasts.columns.design.shape[1]


def _next(
    contrasts: Contrasts,
    p: Projection,
    free: np.ndarray,
    rng: np.random.Generator,
    undetermined: bool = False,
) -> int:
    """The best of the candidates that are `free`: by the variance of its prediction, or by the objective."""
    at = np.flatnonzero(free)
    if undetermined:
        return int(at[np.argmax(p.variance_of_candidates()[at])])
    if len(at) > TRIED:
        at = np.sort(rng.choice(at, TRIED, replace=False))
    return int(at[np.argmax(contrasts.changed(p, at, 1.0))])
