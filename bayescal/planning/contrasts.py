"""Contrasts: effects that a plan shall show, each beside a model and beside what it could be confused with.

An effect at one site has the amplitudes of a random draw of its prior, as in `gap.advise`: its
detectability lambda is the sum over its parameters. Rivals are further columns that the model may use, with
their priors; masses of links and of the load are always such, as in a diagnosis. With the rivals' columns b,

    lambda = trace(G_aa - G_ab inv(1 + G_bb) G_ba),

where G is the information of `Projection`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from bayescal.estimate import Estimate
from bayescal.gap.result import Pair
from bayescal.model.options import Part
from bayescal.planning.pool import Pool
from bayescal.planning.projection import CandidateColumns, Projection, Vocabulary, vocabulary

NONE = np.empty(0, int)
LEAST = 1e-12
"""Least sum of weights (rounding)."""


@dataclass(frozen=True)
class Contrast:
    """Columns (k,) of an effect that is true, beside a model with the columns (b,) of its rivals.

    `mix` (k, m) are amplitudes of these columns that may be true, in units of their priors; None if each may
    be, alone. Contrasts of one `group` are decided together: the smallest lambda counts.
    """

    truth: np.ndarray
    rivals: np.ndarray
    group: int
    mix: np.ndarray | None = None


@dataclass(frozen=True)
class Contrasts:
    """What a plan for the gap maximises: the weighted sum over groups of log(1 + lambda).

    With weights that are equal for every effect, the geometric mean of the smallest detectable amplitudes of
    all effects falls; below a lambda of 1, one standard deviation, an effect counts as not detectable.
    """

    vocabulary: Vocabulary
    items: tuple[Contrast, ...]
    weight: np.ndarray  # (groups,)

    @classmethod
    def of(cls, effects: Vocabulary, items: Sequence[Contrast]) -> Contrasts:
        """Contrasts with equal weights of all groups, which are numbered anew."""
        _, group = np.unique([item.group for item in items], return_inverse=True)
        numbered = tuple(replace(item, group=int(k)) for item, k in zip(items, group, strict=True))
        return cls(effects, numbered, np.ones(int(group.max()) + 1))

    @property
    def columns(self) -> CandidateColumns:
        """Of all effects."""
        return self.vocabulary.columns

    @cached_property
    def _by_rivals(self) -> tuple[_Together, ...]:
        sets: dict[tuple[int, ...], list[int]] = {}
        for k, item in enumerate(self.items):
            sets.setdefault(tuple(item.rivals.tolist()), []).append(k)
        return tuple(_together([self.items[k] for k in of], np.array(of)) for of in sets.values())

    @cached_property
    def _by_group(self) -> tuple[np.ndarray, np.ndarray]:
        """Contrasts ordered by group, and the first of each group."""
        group = np.array([item.group for item in self.items])
        order = np.argsort(group, kind="stable")
        return order, np.searchsorted(group[order], np.arange(len(self.weight)))

    def strengths(self, p: Projection) -> np.ndarray:
        """Lambda (contrasts,) of the contacts that are chosen."""
        return self._evaluated(p, np.empty(0, int), 1.0)[0]

    def objective(self, strengths: np.ndarray) -> np.ndarray:
        """The objective (...) of lambdas (contrasts, ...)."""
        order, first = self._by_group
        least = np.minimum.reduceat(strengths[order], first, axis=0)
        return self.weight @ np.log1p(np.maximum(least, 0.0))

    def changed(self, p: Projection, candidates: np.ndarray, sign: float) -> np.ndarray:
        """The objective (len(candidates),) after adding (1.0) or removing (-1.0) each of some candidates.

        Of a candidate with several residuals, their correlation is neglected.
        """
        rows = self.columns.residuals(candidates)
        strength, change = self._evaluated(p, rows, sign)
        if len(rows) > len(candidates):
            first = np.flatnonzero(np.diff(self.columns.candidate[rows], prepend=-1))
            change = np.add.reduceat(change, first, axis=1)
        return self.objective(strength[:, None] + change)

    def _evaluated(self, p: Projection, rows: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Lambda (contrasts,), and its change (contrasts, rows) by adding (1) or removing (-1) residuals."""
        strength, change = np.empty(len(self.items)), np.empty((len(self.items), len(rows)))
        error, every = p.error[:, rows], p.variance[rows]
        for x in self._by_rivals:
            error_beside, g, variance = error[x.truth], p.information[np.ix_(x.truth, x.truth)], every
            if len(x.rivals):
                inner = np.linalg.inv(np.eye(len(x.rivals)) + p.information[np.ix_(x.rivals, x.rivals)])
                across, of_rivals = p.information[np.ix_(x.rivals, x.truth)], error[x.rivals]
                error_beside = error_beside - (inner @ across).T @ of_rivals
                g = g - across.T @ inner @ across
                variance = variance + np.sum(inner @ of_rivals * of_rivals, axis=0)
            if x.mix is not None:
                error_beside, g = x.mix.T @ error_beside, x.mix.T @ g @ x.mix
            strength[x.index] = np.add.reduceat(np.diag(g), x.first)
            change[x.index] = np.add.reduceat(error_beside**2, x.first, axis=0) / (sign + variance)
        return strength, change


@dataclass(frozen=True)
class _Together:
    """Contrasts `index` with the same rivals: all their true columns, amplitudes `mix`, the first of each."""

    rivals: np.ndarray
    truth: np.ndarray
    mix: np.ndarray | None
    first: np.ndarray
    index: np.ndarray


def _together(items: Sequence[Contrast], index: np.ndarray) -> _Together:
    mixes = [np.eye(len(item.truth)) if item.mix is None else item.mix for item in items]
    truth, first = np.concatenate([i.truth for i in items]), np.cumsum([0, *(m.shape[1] for m in mixes[:-1])])
    mix = None if all(item.mix is None for item in items) else block_diag(*mixes)
    return _Together(items[0].rivals, truth, mix, first, index)


def contrasts(
    pool: Pool,
    fitted: Estimate,
    pairs: Sequence[Pair] = (),
    without: Sequence[Part] = (),
    probability: Mapping[str, float] | None = None,
) -> Contrasts:
    """Contrasts of a model.

    Parameters
    ----------
    pool : Pool
    fitted : Estimate
        The model of the pool's session, where it is linearised.
    pairs : sequence of Pair
        What the contacts shall decide; default: every effect that the model lacks, at each site.
    without : sequence of Part
        Parts that the model lacks; they are effects like others.
    probability : mapping of str to float, optional
        Of effects: every effect counts by it, all together as much as the pairs. What is true may be in no
        pair. Default: the pairs alone, or all effects alike.

    Raises
    ------
    BayescalError
        If a pair names an effect or a site that the session cannot show.
    """
    sides = [side for pair in pairs for side in (pair.a, pair.b, pair.common)]
    every = vocabulary(pool, fitted, [one for side in sides for one in side], without)
    if not pairs:
        return of_effects(every, probability)
    decided = of_pairs(every, pairs)
    return joined(decided, of_effects(every, probability)) if probability else decided


def joined(a: Contrasts, b: Contrasts) -> Contrasts:
    """Contrasts of one vocabulary, of which both parts count alike."""
    shifted = (replace(item, group=item.group + len(a.weight)) for item in b.items)
    parts = [c.weight / max(float(np.sum(c.weight)), LEAST) for c in (a, b)]
    return Contrasts(a.vocabulary, (*a.items, *shifted), np.concatenate(parts))


def of_effects(effects: Vocabulary, probability: Mapping[str, float] | None = None) -> Contrasts:
    """Every effect at each site, beside the model and beside the effects that are confusable with it.

    Both have half of an effect's weight, and its sites equal shares. Effects count alike, or by their
    `probability`, where any has one.
    """
    stated = probability or {}
    alike = not any(stated.get(name, 0.0) > 0 for name in effects.names)
    items: list[Contrast] = []
    weight: list[float] = []
    for name in effects.names:
        sites = [s.columns for s in effects.seats if s.effect == name]
        rivals = [effects.of(other) for other in effects.confusable(name)]
        for against in (NONE, *([np.concatenate(rivals)] if rivals else [])):
            items += [Contrast(columns, against, len(items) + k) for k, columns in enumerate(sites)]
            share = 1.0 if alike else stated.get(name, 0.0)
            weight += [share / (len(sites) * (1 + bool(rivals)))] * len(sites)
    return Contrasts(effects, tuple(items), np.array(weight))


def of_pairs(effects: Vocabulary, pairs: Sequence[Pair]) -> Contrasts:
    """Each side of every pair beside the other: neither may be able to replace the other."""
    items = [
        item
        for group, pair in enumerate(pairs)
        for item in (beside(effects, pair, group), beside(effects, pair.reversed, group))
        if item is not None
    ]
    return Contrasts.of(effects, items)


def beside(effects: Vocabulary, pair: Pair, group: int) -> Contrast | None:
    """The first side of a pair as true, beside the second; None for noise only, which nothing shows."""
    if not pair.a:
        return None
    truth, mix = effects.side(pair.a)
    return Contrast(truth, effects.side((*pair.b, *pair.common))[0], group, mix)
