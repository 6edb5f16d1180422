"""Candidates: every effect that the baseline lacks, in each setting, at all sites and at each single site.

If the baseline has an effect without some of its parts, these parts are the candidate.

Ripples that the poses of a session do not distinguish from low harmonics of the same angle.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from math import comb

import numpy as np

from bayescal.effects import EFFECTS, MODELS, Circumstances, Effect, Parameter, Setting, named, parameters_of
from bayescal.effects.location import Driver, Site, words_of
from bayescal.effects.selection import in_proportion, plain
from bayescal.effects.vocabulary import Form, same_terms
from bayescal.gap.settings import SEARCH
from bayescal.model.options import Part
from bayescal.statistics import grouped

ALIASED = "the poses do not distinguish it from a low harmonic of the angle"
HARMONICS = 2  # the orders that other effects have


def unaliased(parameters: Sequence[Parameter], c: Circumstances) -> list[bool]:
    """Whether the poses of a session show a ripple as what it is; True for any other parameter.

    A parameter with more than two periods per revolution is a ripple. At angles on a raster, or at a few
    angles, it has the values of a low harmonic (sampling theorem); within a small range it is slow.
    It is aliased if a straight line and the harmonics explain nearly all of it at the fitted measurements.
    """
    out = [True] * len(parameters)
    ripples = [k for k, p in enumerate(parameters) if p.driver.kind == "angle" and p.driver.order > HARMONICS]
    for j, indices in grouped((parameters[k].driver.joint, k) for k in ripples).items():
        angle = c.q[c.fitted, j - 1]
        slow = [np.ones_like(angle), angle]
        slow += [f(k * angle) for k in range(1, HARMONICS + 1) for f in (np.sin, np.cos)]
        directions, size, _ = np.linalg.svd(np.column_stack(slow), full_matrices=False)
        basis = directions[:, size > 1e-9 * size[0]]
        waves = np.column_stack([np.asarray(parameters[k].terms[0].driver)[c.fitted] for k in indices])
        mean_squares = np.mean((waves - basis @ (basis.T @ waves)) ** 2, axis=0)
        for k, square in zip(indices, mean_squares, strict=True):
            out[k] = bool(square > SEARCH.aliased / 2)
    return out


NOTHING = "its driver does not vary in this session"


@dataclass(frozen=True, eq=False)
class Variant:
    """A form of an effect: its setting if any, its sites or () for all, its columns of the pool."""

    effect: str
    setting: Setting
    sites: tuple[Site, ...]
    columns: np.ndarray  # (k,)
    log_prior: float  # within the effect
    places: tuple[tuple[Site, Driver], ...] = ()  # of its columns
    partial: bool = False  # the effect has further parameters, which are not assessed
    together: bool = False  # its column is one factor for all parameters, in proportion

    @property
    def site(self) -> str:
        """Its sites as text, "" for all."""
        return words_of(self.sites)


@dataclass(frozen=True)
class Candidates:
    """All variants by effect, their parameters as one pool, and effects not assessed, with the reason.

    `partly` are effects that the baseline has, except for parts that are candidates.
    """

    pool: tuple[Parameter, ...]
    variants: dict[str, tuple[Variant, ...]]
    missing: dict[str, str]
    partly: tuple[str, ...] = ()


def candidates(
    circumstances: Circumstances, baseline: tuple[str, ...], without: Sequence[Part] = ()
) -> Candidates:
    """List the candidates for a baseline model, except wide scans, which are screened first."""
    modelled = {plain(name) for name in baseline}
    has = {p.name for p in parameters_of(baseline, circumstances, lenient=True)}
    shared = {name for effect in modelled for name in MODELS[effect].part_of}
    modelled |= {name for name in shared if has >= {p.name for p in EFFECTS[name].at(circumstances)}}
    out = Candidates((), {}, {})
    for effect in EFFECTS.values():
        if effect.name in modelled or wide(effect, circumstances):
            continue
        lacks = effect.missing(circumstances)
        settings: list[float | None] = [] if lacks else [None]
        if effect.scan is not None and not lacks:
            settings += [float(v) for v in effect.scan.values(circumstances)]
        out = extended(out, effect, settings, circumstances, lacks)
    for name in baseline:
        if mine := [part for part in without if part.effect == plain(name)]:
            out = with_parts(out, name, mine, circumstances)
    return out


def unscreened(c: Circumstances, effects: tuple[str, ...], without: Sequence[Part] = ()) -> Candidates:
    """The candidates of a diagnosis; of a scan that it screens by residuals, one setting."""
    assessed = candidates(c, effects, without)
    for effect in EFFECTS.values():
        if effect.name not in assessed.variants and wide(effect, c) and effect.scan is not None:
            lacks, values = effect.missing(c), effect.scan.values(c)
            setting = float(values[len(values) // 2]) if lacks else None
            assessed = extended(assessed, effect, [setting], c, lacks)
    return assessed


def with_parts(existing: Candidates, name: str, parts: Sequence[Part], c: Circumstances) -> Candidates:
    """Candidates with parts of an effect that the baseline lacks: each part alone, and all together."""
    effect, setting = named(name)
    parameters = [p for p in parameters_of((name,), c) if any(part.holds(p) for part in parts)]

    def variant(chosen: Sequence[Part], weight: float) -> Variant:
        indices = [k for k, p in enumerate(parameters) if any(part.holds(p) for part in chosen)]
        sites, columns = tuple(part.site for part in chosen), len(existing.pool) + np.array(indices, int)
        places = tuple(dict.fromkeys((parameters[k].site, parameters[k].driver) for k in indices))
        return Variant(effect.name, setting, sites, columns, -float(np.log(weight)), places)

    variants = [variant(parts, 1 if len(parts) == 1 else 2)]
    variants += [variant([part], 2 * len(parts)) for part in parts if len(parts) > 1]
    pool, every = (*existing.pool, *parameters), existing.variants | {effect.name: tuple(variants)}
    return replace(existing, pool=pool, variants=every, partly=(*existing.partly, effect.name))


def wide(effect: Effect, c: Circumstances) -> bool:
    """Whether an effect has more settings than the search keeps."""
    return effect.scan is not None and len(effect.scan.values(c)) > SEARCH.whole_scan


def extended(
    existing: Candidates, effect: Effect, settings: Sequence[float | None], c: Circumstances, lacks: str = ""
) -> Candidates:
    """Candidates with some settings of a further effect; each has the prior of one setting of the scan."""
    tables = [(value, effect.at(c, value)) for value in settings]
    visible = [(value, list(compress(table, unaliased(table, c)))) for value, table in tables]
    usable = [(value, parameters) for value, parameters in visible if parameters]
    if not usable:
        lacks = lacks or (ALIASED if any(table for _, table in tables) else NOTHING)
        return replace(existing, missing=existing.missing | {effect.name: lacks})
    sites = dict.fromkeys(p.site for _, table in tables for p in table)
    seen = {p.site for _, parameters in usable for p in parameters}
    missing = existing.missing | {f"{effect.name} at {site}": ALIASED for site in sites if site not in seen}
    count = max(len(usable), 0 if effect.scan is None else len(effect.scan.values(c)))
    forms = [] if lacks else _other_forms(effect, c, dict(tables).get(None))
    usual = float(np.log1p(-sum(form.odds for form, _, _ in forms) * SEARCH.other_forms / max(len(forms), 1)))
    pool, variants = list(existing.pool), []
    for value, parameters in usable:
        joined = in_proportion(effect.name, parameters)
        weight = usual - float(np.log(count)) - float(np.log(2.0)) * len(joined)
        whole = next(len(table) for setting, table in tables if setting == value)
        subsets = _subsets(effect, value, parameters, len(pool), weight)
        variants += [replace(v, partial=len(parameters) < whole) for v in subsets]
        pool += parameters
        places = tuple(dict.fromkeys((p.site, p.driver) for p in parameters))
        variants += [
            Variant(effect.name, value, (), np.array([len(pool)]), weight, places, together=True)
            for _ in joined
        ]
        pool += joined
    for form, parameters, others in forms:
        weight = float(np.log(form.odds * SEARCH.other_forms / len(forms)))
        variants += _subsets(effect, form.name, parameters, len(pool), weight, others)
        pool += parameters
    every = existing.variants | {effect.name: tuple(variants)}
    return replace(existing, pool=tuple(pool), variants=every, missing=missing)


@dataclass(frozen=True)
class Single:
    """A setting of a scan at one site, by one driver, with the nats that it gains over a state."""

    setting: float
    site: Site
    driver: Driver
    gain: float = 0.0  # averaged over scales
    scale: float = 1.0  # the best one


def with_own_settings(
    existing: Candidates, effect: Effect, choices: Sequence[Sequence[Single]], count: int
) -> Candidates:
    """Candidates with several settings of an effect, at one or several sites: the first two of a choice, ...

    They share `SEARCH.other_forms` of the prior of the effect: by their number of sites, then by the choice
    of sites and of settings.

    Parameters
    ----------
    choices : sequence of sequence of Single
        The leading ones; their settings are candidates already.
    count : int
        Number of settings that were tried, at all sites.
    """
    if effect.scan is None or effect.name not in existing.variants:
        return existing
    usual = existing.variants[effect.name]
    shared = [replace(v, log_prior=v.log_prior + float(np.log(1.0 - SEARCH.other_forms))) for v in usual]
    single = {(v.setting, v.places): v.columns for v in usual}
    sites, several = len({site for v in usual for site, _ in v.places}), effect.scan.several
    for some in (singles[:size] for singles in choices for size in range(2, len(singles) + 1)):
        size, settings = len(some), tuple((one.site, one.setting) for one in some)
        if any(v.setting == settings for v in shared):
            continue
        number = comb(sites, size) if several == 1 else comb(sites + size - 1, size)
        share = SEARCH.other_forms / (max(sites, several) - 1) / number
        chosen_sites = tuple(one.site for one in some)
        columns = np.concatenate([single[one.setting, ((one.site, one.driver),)] for one in some])
        log_prior = float(np.log(share) - size * np.log(count / sites))
        places = tuple((one.site, one.driver) for one in some)
        shared.append(Variant(effect.name, settings, chosen_sites, columns, log_prior, places))
    return replace(existing, variants=existing.variants | {effect.name: tuple(shared)})


def _other_forms(
    effect: Effect, c: Circumstances, usual: Sequence[Parameter] | None
) -> list[tuple[Form, list[Parameter], set[Site]]]:
    """Other forms of an effect in a session, their parameters, and sites that differ from the usual form."""
    if not effect.forms:
        return []
    usual_terms = {p.name: p.terms for p in (effect.at(c) if usual is None else usual)}
    out = []
    for form in effect.forms:
        parameters = effect.at(c, form.name)
        same = {
            p.name
            for p in parameters
            if p.name in usual_terms and same_terms(p.terms, usual_terms[p.name], np.allclose)
        }
        if sites := {p.site for p in parameters if p.name not in same}:
            out.append((form, parameters, sites))
    return out


def _subsets(
    effect: Effect, value: Setting, parameters: list[Parameter], first: int, log_prior: float,
    sites: Collection[Site] = (),
) -> list[Variant]:  # fmt: skip
    """An effect at all sites and at each single site, or only at each of `sites` where given.

    The columns of the parameters begin at `first`.
    """
    single = _at_sites(effect, value, parameters, first)
    places = tuple(place for one in single for place in one.places)
    every = Variant(effect.name, value, (), np.arange(first, first + len(parameters)), log_prior, places)
    if len(single) == 1 or (effect.whole and isinstance(value, str)):
        return [every]
    if effect.alternatives:  # the first site, or one of the others, which share `SEARCH.other_forms`
        usual = log_prior + float(np.log(1.0 - SEARCH.other_forms))
        other = log_prior + float(np.log(SEARCH.other_forms / (len(single) - 1)))
        others = [replace(one, log_prior=other) for one in single[1:]]
        return [replace(single[0], sites=(), log_prior=usual), *others]
    single = [one for one in single if not sites or one.sites[0] in sites]
    share = SEARCH.other_forms if effect.whole else 0.5
    alone = log_prior + float(np.log(share / len(single)))
    every = replace(every, log_prior=log_prior + float(np.log1p(-share)))
    return [every, *(replace(one, log_prior=alone) for one in single)]


def _at_sites(effect: Effect, value: Setting, parameters: Sequence[Parameter], first: int) -> list[Variant]:
    """An effect at each single site, by each driver; all orders of a coordinate of a form act together."""
    joined, out = isinstance(value, str), []
    by_site = ((p.site, p.driver.course if joined else p.driver) for p in parameters)
    for (site, _), indices in grouped((place, k) for k, place in enumerate(by_site)).items():
        places = tuple(dict.fromkeys((site, parameters[k].driver) for k in indices))
        out.append(Variant(effect.name, value, (site,), first + np.array(indices), 0.0, places))
    return out
