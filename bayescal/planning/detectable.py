"""What a plan can show: the smallest detectable amplitude of every effect, and what it cannot separate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.gap.result import Pair, Side, Suspect
from bayescal.gap.settings import DESIGN
from bayescal.planning.contrasts import Contrast, Contrasts, beside
from bayescal.planning.projection import Projection
from bayescal.planning.result import Confusable, Detectable
from bayescal.planning.vocabulary import Vocabulary

SEPARATED = 30.0
"""Lambda from which on two effects are separated (in the blind check 9 of 10 names are right from it on)."""
NOISE = "noise only"
ROUNDING = 1e-6
"""Lambda up to which the contacts do not show an effect at all."""


def detectable(found: Vocabulary, chosen: Projection, random: Sequence[Projection]) -> tuple[Detectable, ...]:
    """Smallest detectable amplitude of every effect at every site.

    Parameters
    ----------
    found : Vocabulary
    chosen, random : Projection
        With the contacts of the plan, and of random selections of the same size; the median of these counts.

    Notes
    -----
    The amplitude has a detectability lambda of `DESIGN.named`. Amplitudes are root mean squares over the
    parameters of a site; an effect that the contacts cannot show has an infinite one.
    """
    none = np.empty(0, int)
    each = Contrasts.of(found, [Contrast(s.columns, none, k) for k, s in enumerate(found.seats)])
    smallest, by_chance = (_smallest(x) for x in (each.strengths(chosen), _median(each, random)))
    plausible = [np.sqrt(np.mean([found.parameters[k].sd ** 2 for k in s.columns])) for s in found.seats]
    return tuple(
        Detectable(s.effect, s.site, s.unit, float(a * sd), float(b * sd), float(sd))
        for s, a, b, sd in zip(found.seats, smallest, by_chance, plausible, strict=True)
    )


def confusable(
    found: Vocabulary, chosen: Projection, before: Sequence[Projection], pairs: Sequence[Pair] = ()
) -> tuple[tuple[Pair, Confusable], ...]:
    """Pairs of effects, and lambda of one beside the other, before and after.

    Parameters
    ----------
    found : Vocabulary
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
    for options in [[p, p.reversed] for p in pairs] or _plausible(found, chosen):
        shown = [(p, x) for k, p in enumerate(options) if (x := beside(found, p, k)) is not None]
        if not shown:
            continue
        c = Contrasts.of(found, [item for _, item in shown])
        old, new = _median(c, before), c.strengths(chosen)
        weakest = int(np.argmin(new))
        pair = shown[weakest][0]
        names = words(pair.a), words(pair.b)
        out.append((pair, Confusable(names, float(old[weakest]), float(new[weakest]))))
    return tuple(sorted(out, key=lambda x: x[1].after))


def words(side: Side) -> str:
    """An explanation as text."""
    return " and ".join(one.model for one in side) or NOISE


def _plausible(found: Vocabulary, chosen: Projection) -> list[list[Pair]]:
    """Of every pair of confusable effects, each at each site where it is detectable, beside the other."""
    pairs = {frozenset((a, b)): (a, b) for a in found.names for b in found.confusable(a)}
    seats = {a: _detected(found, a, chosen) for a in found.names}
    return [
        [Pair((Suspect(own),), (Suspect(y),)) for x, y in ((a, b), (b, a)) for own in seats[x]]
        for a, b in pairs.values()
    ]


def _detected(found: Vocabulary, effect: str, chosen: Projection) -> list[str]:
    """An effect at each site where it is detectable at its plausible amplitude, as text."""
    texts = dict.fromkeys(f"{effect} at {s.site}" for s in found.seats if s.effect == effect)
    own = [t for t in texts if len(found.shown(Suspect(t)))]
    items = [Contrast(found.shown(Suspect(t)), np.empty(0, int), k) for k, t in enumerate(own)]
    if not items:
        return []
    strengths = Contrasts.of(found, items).strengths(chosen)
    return [t for t, strength in zip(own, strengths, strict=True) if strength >= DESIGN.named]


def _median(c: Contrasts, selections: Sequence[Projection]) -> np.ndarray:
    return np.asarray(np.median([c.strengths(p) for p in selections], axis=0))


def _smallest(strength: np.ndarray) -> np.ndarray:
    """Smallest detectable amplitude in units of the plausible one."""
    return np.where(strength > ROUNDING, np.sqrt(DESIGN.named / np.maximum(strength, ROUNDING)), np.inf)
