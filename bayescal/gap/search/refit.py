"""The non-linear refit of a model with the named effects: the same fit as that of `fit` with their names.

Screening of wide scans: only the settings that explain most become candidates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress

import numpy as np

from bayescal.assess.shared_causes import completed
from bayescal.effects import EFFECTS, Circumstances, Effect, Setting
from bayescal.effects.selection import Selection, driver_words, shortest
from bayescal.estimate import Estimate, calibrated
from bayescal.gap.linear.evidence import SCALE_PRIOR, SCALES, Bank, log_sum, weigh_sets
from bayescal.gap.linear.problem import Problem, Slopes
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.search.beam import Member
from bayescal.gap.search.candidates import Candidates, Single, extended, unaliased, with_own_settings
from bayescal.gap.search.unknown import MOST_ROWS
from bayescal.gap.settings import SEARCH
from bayescal.model.options import USUAL, FitOptions, Part
from bayescal.statistics import grouped


def model_name(member: Member, candidates: Candidates) -> str:
    """A member in the form of ``--model``: effect, setting, site and priors; see `selection`."""
    v = member.variant
    parameters = [candidates.pool[k] for k in v.columns]
    sites = v.sites
    drivers: tuple[str, ...] = ()
    if v.partial or isinstance(v.setting, tuple):
        sites = v.sites if isinstance(v.setting, tuple) else tuple(dict.fromkeys(p.site for p in parameters))
        every = (candidates.pool[k] for o in candidates.variants[v.effect] for k in o.columns)
        there = {driver_words(p) for p in every if p.site in sites}
        drivers = tuple(dict.fromkeys(map(driver_words, parameters)))
        drivers = drivers if v.partial or there != set(drivers) else ()
    elif v.sites and v.effect not in candidates.partly:
        alike = (o for o in candidates.variants[v.effect] if (o.setting, o.sites) == (v.setting, v.sites))
        here = {driver_words(candidates.pool[k]) for o in alike for k in o.columns}
        mine = tuple(dict.fromkeys(map(driver_words, parameters)))
        drivers = mine if here != set(mine) else ()
    setting = _setting(v.setting)
    usual = v.effect in candidates.partly or (
        member.scale == 1.0 and all(p.centre == p.nominal for p in parameters)
    )
    factor = None if usual else member.scale
    return str(Selection(v.effect, setting, sites, drivers, v.together, factor))


def _setting(setting: Setting) -> str | None:
    """A setting as the text after ``@``; see `bayescal.effects.named`."""
    if isinstance(setting, tuple):
        return "/".join(shortest(value) for _, value in setting)
    return shortest(setting) if isinstance(setting, float) else setting


def still_without(without: Sequence[Part], members: Sequence[Member]) -> tuple[Part, ...]:
    """Parts that stay nominal: those that no member is."""
    named = {(m.effect, site) for m in members for site in m.variant.sites}
    return tuple(part for part in without if (part.effect, part.site) not in named)


def refit(
    before: Estimate, candidates: Candidates, members: Sequence[Member], options: FitOptions = USUAL,
    flat: bool = False,
) -> Estimate:  # fmt: skip
    """Fit a baseline with some effects in addition to its own.

    It is completed as by `fit`: with the form of faces that are uneven beside these effects, and with
    rejected rows that share a cause.

    Parameters
    ----------
    before : Estimate
        Of the baseline.
    candidates : Candidates
        Of the search; a member that is a part of the baseline's effects has the priors of the effect.
    members : sequence of Member
    options : FitOptions
        As of the baseline.
    flat : bool
        Without the form of uneven faces.
    """
    extra = tuple(model_name(m, candidates) for m in members if m.effect not in candidates.partly)
    scene = replace(before.model.scene, stance=None, compliances={})
    options = replace(options, without=still_without(options.without, members))
    estimate = calibrated(scene, (*before.model.effects, *extra), options)
    return completed(estimate, options.robust, flat=flat).fitted


@dataclass(frozen=True)
class Screening:
    """Leading settings of a wide scan, and those of sites of their own, in the order of their choice."""

    settings: frozenset[float]
    singles: tuple[tuple[Single, ...], ...]  # of each state over which they were chosen
    tried: int  # settings, at all sites

    @property
    def nats(self) -> float:
        """What the best choice gains, less the logarithm of the number of settings for each one."""
        gains = [np.cumsum([one.gain - np.log(self.tried) for one in of]) for of in self.singles if of]
        return float(max(map(np.max, gains), default=-np.inf))

    def joined(self, other: Screening) -> Screening:
        """Both choices, those of a further state last."""
        singles = (*self.singles, *(of for of in other.singles if of not in self.singles))
        return replace(self, settings=self.settings | other.settings, singles=singles)


def screening(
    effect: Effect, slopes: Slopes, states: Sequence[State], c: Circumstances, most: int = SEARCH.screened
) -> Screening:
    """Screen the settings of a wide scan by site, by gains over several states; `most` of them lead.

    Where each site may have a setting of its own, the leading ones are chosen one after another.
    """
    assert effect.scan is not None
    values = effect.scan.values(c)
    few = effect.scan.by_site and len(slopes.residual) <= MOST_ROWS  # else made anew for each site

    def banks(some: np.ndarray) -> Iterable[Screened]:
        made = _banks(effect, some, slopes, states[0].problem, c)
        return list(made) if few else made

    parts = banks(values)
    by_state = _screen(parts, states)
    leading = _leading(by_state, most)
    more = np.concatenate([np.empty(0), *(effect.scan.beside(c, value) for value in leading)])
    if len(more := np.setdiff1d(more, values)):
        further = banks(more)
        by_state = [[*a, *b] for a, b in zip(by_state, _screen(further, states), strict=True)]
        leading, values, parts = _leading(by_state, most), np.append(values, more), (*parts, *further)
    singles = list[Single]()
    if effect.scan.by_site:
        screen = partial(_screen, parts) if few else lambda of: _screen(banks(values), of)
        singles = _one_by_one(effect, slopes, states[0], c, by_state, screen)
    settings = frozenset((*leading, *(one.setting for one in singles)))
    return Screening(settings, (tuple(singles),), len(by_state[0]))


def screened(candidates: Candidates, screenings: Mapping[str, Screening], c: Circumstances) -> Candidates:
    """Candidates with the settings of wide scans, by effect, that were screened; see `with_own_settings`."""
    for name, of in screenings.items():
        effect = EFFECTS[name]
        assert effect.scan is not None
        values = effect.scan.values(c)
        middle = float(values[len(values) // 2])  # the first one: the usual setting
        candidates = extended(candidates, effect, [middle, *sorted(of.settings - {middle})], c)
        if effect.scan.by_site:
            candidates = with_own_settings(candidates, effect, of.singles, of.tried)
    return candidates


def _leading(by_state: Sequence[Sequence[Single]], most: int) -> list[float]:
    """Settings with the largest gains at any site, over any state."""
    best: dict[float, float] = {}
    for one in (one for every in by_state for one in every):
        best[one.setting] = max(one.gain, best.get(one.setting, -np.inf))
    return sorted(best, key=lambda value: -best[value])[:most]


Screened = tuple[Mapping[Single, Sequence[int]], Bank]
"""Settings at their sites, and the bank whose sets are their columns, in order."""


def _banks(
    effect: Effect, values: np.ndarray, slopes: Slopes, p: Problem, c: Circumstances
) -> Iterator[Screened]:
    """Settings of a scan at every site, by each driver, a few at a time."""
    for first in range(0, len(values), SEARCH.chunk):
        chunk = [float(value) for value in values[first : first + SEARCH.chunk]]
        every = [(value, p) for value in chunk for p in effect.at(c, value)]
        columns, seen = slopes.columns([p for _, p in every]), unaliased([p for _, p in every], c)
        singles = [Single(value, q.site, q.driver) for value, q in every]
        groups = grouped((one, k) for k, one in enumerate(singles) if seen[k])
        yield groups, Bank(columns, tuple(map(np.array, groups.values())), p.count, p.worth, p.jacobian)


def _screen(parts: Iterable[Screened], states: Sequence[State]) -> list[list[Single]]:
    """Gains of settings over each of several states."""
    out = [list[Single]() for _ in states]
    for groups, bank in parts:
        for state, of_state in zip(states, out, strict=True):
            nats = weigh_sets(state, bank) + SCALE_PRIOR
            gains, scales = log_sum(nats, axis=1).tolist(), SCALES[np.argmax(nats, axis=1)].tolist()
            screened_ones = zip(groups, gains, scales, strict=True)
            of_state += [replace(one, gain=gain, scale=scale) for one, gain, scale in screened_ones]
    return out


def _columns(one: Single, effect: Effect, slopes: Slopes, c: Circumstances) -> np.ndarray:
    """Columns (R, k) of a setting at one site."""
    parameters = [p for p in effect.at(c, one.setting) if (p.site, p.driver) == (one.site, one.driver)]
    return slopes.columns(list(compress(parameters, unaliased(parameters, c))))


def screening_states(p: Problem, columns: np.ndarray, scales: np.ndarray, robust: bool) -> list[State]:
    """States over which settings are screened: also with all rows, of which outliers may be the effect."""
    state = fit_state(p, columns, scales, robust=robust)
    return [state, fit_state(p, columns, scales, robust=False)] if state.gross else [state]


def _one_by_one(
    effect: Effect,
    slopes: Slopes,
    state: State,
    c: Circumstances,
    by_state: Sequence[Sequence[Single]],
    screen: Callable[[Sequence[State]], list[list[Single]]],
) -> list[Single]:
    """The leading setting of each site, the largest gain first, each over states with those before it.

    `by_state` are the gains over the first states, `screen` makes those over others. A site whose gain does
    not exceed the logarithm of the number of settings that were tried has none. A site may have as many as
    the scan's `several`, each `apart` from the others.
    """
    assert effect.scan is not None
    scan, out = effect.scan, list[Single]()

    def apart(one: Single, other: Single) -> bool:
        return scan.apart(c, (one.site, one.setting), (other.site, other.setting))

    while len(out) < max(effect.scan.several, len({one.site for one in by_state[0]})):
        sites = [single.site for single in out]
        tried = [one for every in by_state for one in every]
        eligible = [one for one in tried if sites.count(one.site) < effect.scan.several]
        eligible = [one for one in eligible if all(apart(one, before) for before in out)]
        if not eligible:
            break
        best = max(eligible, key=lambda one: one.gain)
        if best.gain <= np.log(len(tried)):
            break
        out.append(best)
        columns = _columns(best, effect, slopes, c)
        width, size = state.problem.pool.shape[1], columns.shape[1]
        states = screening_states(
            replace(state.problem, pool=np.column_stack([state.problem.pool, columns])),
            np.append(state.columns, np.arange(width, width + size)),
            np.append(state.scales, np.full(size, best.scale)),
            state.robust,
        )
        state, by_state = states[0], screen(states)
    return out
