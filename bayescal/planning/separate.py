"""Contacts that show effects: T-optimal selection, greedy and then by exchange.

A contact with the error e and the variance v of its prediction adds e^2 / (1 + v) to the detectability of an
effect (Atkinson and Fedorov, Biometrika 62 (1975) 57: T-optimal designs; in closed form for linear models).
A model that is not determined yet predicts nothing, and no first contact shows an effect. Therefore contacts
with the largest variance (D-optimal) come first, until the model has as many contacts as unknowns.

Of a plan: the smallest detectable amplitude of every effect, and for pairs of effects that it cannot separate
the intervention that would: its contacts repeated under other conditions (`gap.candidate_contacts`).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from bayescal.dataset.write import taken
from bayescal.gap.candidate_contacts import widened
from bayescal.gap.result import Pair, Side, Suspect
from bayescal.gap.settings import DESIGN
from bayescal.model import Scene
from bayescal.model.options import Part
from bayescal.planning.contrasts import NONE, Contrast, Contrasts, beside, contrasts
from bayescal.planning.pool import Pool
from bayescal.planning.projection import Projection, Vocabulary, nominal
from bayescal.planning.result import Confusable, Detectable

SEPARATED = 30.0
"""Lambda from which on two effects are separated (in the blind check 9 of 10 names are right from it on)."""
NOISE = "noise only"
ROUNDING = 1e-6
"""Lambda up to which the contacts do not show an effect at all."""


def detectable(
    vocabulary: Vocabulary, chosen: Projection, random: Sequence[Projection]
) -> tuple[Detectable, ...]:
    """Smallest detectable amplitude of every effect at every site.

    Parameters
    ----------
    vocabulary : Vocabulary
    chosen, random : Projection
        With the contacts of the plan, and of random selections of the same size; the median of these counts.

    Notes
    -----
    The amplitude has a detectability lambda of `DESIGN.named`. Amplitudes are root mean squares over the
    parameters of a site; an effect that the contacts cannot show has an infinite one.
    """
    each = Contrasts.of(vocabulary, [Contrast(s.columns, NONE, k) for k, s in enumerate(vocabulary.seats)])
    smallest, by_chance = (_smallest(x) for x in (each.strengths(chosen), _median(each, random)))
    square = np.array([p.sd**2 for p in vocabulary.parameters])
    plausible = [np.sqrt(np.mean(square[s.columns])) for s in vocabulary.seats]
    return tuple(
        Detectable(s.effect, s.site, s.unit, float(a * sd), float(b * sd), float(sd))
        for s, a, b, sd in zip(vocabulary.seats, smallest, by_chance, plausible, strict=True)
    )


def confusable(
    vocabulary: Vocabulary, chosen: Projection, before: Sequence[Projection], pairs: Sequence[Pair] = ()
) -> tuple[tuple[Pair, Confusable], ...]:
    """Pairs of effects, and lambda of one beside the other, before and after.

    Parameters
    ----------
    vocabulary : Vocabulary
    chosen : Projection
        With the contacts of the plan.
    before : sequence of Projection
        With random selections, of which the median counts, or one with the rows that were measured already.
    pairs : sequence of Pair
        What the plan shall decide; default: all effects that are confusable, each at its plausible amplitude.

    Returns
    -------
    tuple of (Pair, Confusable)
        Of confusable effects one entry: the effect at the site with the smallest lambda beside the other, of
        those sites at which it is detectable. Elsewhere it need not be separated.
    """
    out = []
    for options in [[p, p.reversed] for p in pairs] or _plausible(vocabulary, chosen):
        shown = [(p, x) for k, p in enumerate(options) if (x := beside(vocabulary, p, k)) is not None]
        if not shown:
            continue
        c = Contrasts.of(vocabulary, [item for _, item in shown])
        old, new = _median(c, before), c.strengths(chosen)
        weakest = int(np.argmin(new))
        pair = shown[weakest][0]
        names = words(pair.a), words(pair.b)
        out.append((pair, Confusable(names, float(old[weakest]), float(new[weakest]))))
    return tuple(sorted(out, key=lambda x: x[1].after))


def words(side: Side) -> str:
    """An explanation as text."""
    return " and ".join(one.model for one in side) or NOISE


def _plausible(vocabulary: Vocabulary, chosen: Projection) -> list[list[Pair]]:
    """Of every pair of confusable effects, each at each site where it is detectable, beside the other."""
    pairs = {frozenset((a, b)): (a, b) for a in vocabulary.names for b in vocabulary.confusable(a)}
    seats = {a: _detected(vocabulary, a, chosen) for a in vocabulary.names}
    return [
        [Pair((Suspect(site),), (Suspect(y),)) for x, y in ((a, b), (b, a)) for site in seats[x]]
        for a, b in pairs.values()
    ]


def _detected(vocabulary: Vocabulary, effect: str, chosen: Projection) -> list[str]:
    """An effect at each site where it is detectable at its plausible amplitude, as text."""
    texts = dict.fromkeys(f"{effect} at {s.site}" for s in vocabulary.seats if s.effect == effect)
    shown = [t for t in texts if len(vocabulary.shown(Suspect(t)))]
    items = [Contrast(vocabulary.shown(Suspect(t)), NONE, k) for k, t in enumerate(shown)]
    if not items:
        return []
    strengths = Contrasts.of(vocabulary, items).strengths(chosen)
    return [t for t, strength in zip(shown, strengths, strict=True) if strength >= DESIGN.named]


def _median(c: Contrasts, selections: Sequence[Projection]) -> np.ndarray:
    return np.asarray(np.median([c.strengths(p) for p in selections], axis=0))


def _smallest(strength: np.ndarray) -> np.ndarray:
    """Smallest detectable amplitude in units of the plausible one."""
    return np.where(strength > ROUNDING, np.sqrt(DESIGN.named / np.maximum(strength, ROUNDING)), np.inf)


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
        undetermined = _undetermined(contrasts, len(start) + done, done, count)
        best = _least_determined(p, free) if undetermined else _next(contrasts, p, free, rng)
        p.change(best, 1.0)
        free[best] = False
        chosen.append(best)
        progress(done / (count + exchanges))
    value = float(contrasts.objective(contrasts.strengths(p)))
    for done in range(exchanges if count else 0):
        every = np.sort(chosen)
        worst = int(every[np.argmax(contrasts.changed(p, every, -1.0))])
        p.change(worst, -1.0)
        free[worst] = True
        best = _next(contrasts, p, free, rng)
        p.change(best, 1.0)
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
        p.change(out[-1], 1.0)
        free[out[-1]] = False
    return np.array(out, int)


def _undetermined(contrasts: Contrasts, before: int, done: int, count: int) -> bool:
    """Whether the model has fewer residuals than unknowns, as long as effects still have their share."""
    measured = len(contrasts.columns.known_design)
    return done < SHARE * count and measured + before < contrasts.columns.design.shape[1]


def _least_determined(p: Projection, free: np.ndarray) -> int:
    """The candidate, of those that are `free`, whose prediction has the largest variance."""
    each = np.bincount(p.linear.candidate, p.variance, p.linear.count)  # sums over residuals
    return int(np.argmax(np.where(free, each, -np.inf)))


def _next(contrasts: Contrasts, p: Projection, free: np.ndarray, rng: np.random.Generator) -> int:
    """The best of the candidates that are `free`, by the objective."""
    candidates = np.flatnonzero(free)
    if len(candidates) > TRIED:
        candidates = np.sort(rng.choice(candidates, TRIED, replace=False))
    return int(candidates[np.argmax(contrasts.changed(p, candidates, 1.0))])


NO_LEVER = "no known measurement"


def with_levers(
    pool: Pool,
    effects: tuple[str, ...],
    chosen: np.ndarray,
    similar: Sequence[tuple[Pair, Confusable]],
    rng: np.random.Generator,
    without: Sequence[Part] = (),
) -> tuple[Confusable, ...]:
    """Pairs of effects, each that the plan cannot separate with the intervention that would.

    Parameters
    ----------
    pool : Pool
    effects : tuple of str
        The model.
    chosen : np.ndarray of int
        Candidates of the plan.
    similar : sequence of (Pair, Confusable)
        Of `confusable`.
    rng : np.random.Generator
    without : sequence of Part
        Parts that the model lacks.

    Notes
    -----
    `DESIGN.contacts` further contacts are chosen of each intervention. The first that reaches `SEPARATED` is
    stated, more contacts at the same poses before all others.
    """
    if all(c.after >= SEPARATED for _, c in similar):
        return tuple(c for _, c in similar)
    again, names, which = _repeated(pool, chosen)
    fitted = nominal(again.session, effects, without)

    def lever(pair: Pair) -> str:
        """The first intervention that separates a pair, as text."""
        c = contrasts(again, fitted, [pair], without)
        for k, name in enumerate(names):
            best = choose(c, DESIGN.contacts, rng, allowed=which == k, exchanges=0)
            if c.strengths(Projection(c.columns, best))[0] >= SEPARATED:
                return f"{len(best)} measurements: {name}"
        return NO_LEVER

    return tuple(c if c.after >= SEPARATED else replace(c, intervention=lever(p)) for p, c in similar)


def _repeated(pool: Pool, chosen: np.ndarray) -> tuple[Pool, list[str], np.ndarray]:
    """The planned session as measured, its contacts under other conditions as candidates; which are whose."""
    rows = np.sort(np.concatenate([np.arange(pool.measured), pool.rows_of(chosen)]))
    planned = replace(pool.session, measurements=taken(pool.session.measurements, rows))
    new = np.arange(pool.measured, len(rows))
    wide, interventions = widened(Scene(planned), new)
    role = wide.measurements.role.copy()
    role[len(rows) :] = "calibrate"
    session = replace(wide, measurements=replace(wide.measurements, role=role))
    which = np.repeat(np.arange(len(interventions)), [len(i.rows) for i in interventions])
    again = replace(pool, session=session, measured=len(rows), approach=session.measurements.readings)
    return again, [i.what for i in interventions], which[again.candidates - len(rows)]


def best_of(contrasts: Contrasts, selections: Iterable[np.ndarray]) -> np.ndarray:
    """The selection with the largest objective.

    One candidate is added after another: what tells nothing alone, as the first point that an instrument
    reads, is never tried, and a random selection may be better.
    """

    def objective(selection: np.ndarray) -> float:
        p = Projection(contrasts.columns, selection)
        return float(contrasts.objective(contrasts.strengths(p)))

    return max(selections, key=objective)
