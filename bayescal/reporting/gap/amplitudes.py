"""Amplitudes of named effects as text and as entries of gap.json: only those that are significant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayescal.effects.location import Site
from bayescal.effects.sizes import DEVIATION
from bayescal.effects.vocabulary import unit_label
from bayescal.gap.result import Amplitude, Gap
from bayescal.reporting.shared.text import amplitude, with_u


def told(gap: Gap, effect: str) -> tuple[Amplitude, ...]:
    """The significant amplitudes of an effect; one where none is significant alone.

    That is the amplitude at the largest location that the effect explains, else the clearest.
    """
    own = [a for a in gap.amplitudes if a.effect == effect]
    clear = tuple(a for a in own if a.significant)
    if clear:
        return clear
    largest = max((w for w in gap.where if w.explained_by == effect), key=lambda w: w.rms, default=None)
    there = [a for a in own if largest and (a.site, a.driver) == (largest.site, largest.driver)]
    return tuple(sorted(there or own, key=lambda a: -abs(a.value) / a.u if a.u > 0 else 0.0)[:1])


def sites(gap: Gap, effect: str) -> tuple[tuple[Site, ...], bool]:
    """Sites with a significant amplitude, and whether these are all sites of the effect in the refit."""
    own = [a for a in gap.amplitudes if a.effect == effect]
    clear = tuple(dict.fromkeys(a.site for a in own if a.significant))
    return clear, len(clear) == len({a.site for a in own})


def short(site: Site) -> str:
    """A site in a table: ``J3``, ``link 3``, ``the base``."""
    return f"J{site.number}" if site.kind == "joint" else site.text


def line(a: Amplitude, others: Sequence[Amplitude]) -> str:
    """An amplitude in its unit and place: ``backlash of J3: half-width 0.0244(10) deg``.

    `others` are those told of the same effect; the driver or the parameter is added where the site and the
    name of the amplitude do not identify it.
    """
    same = [o for o in others if (o.site, o.what) == (a.site, a.what)]
    by = ""
    if len({o.driver for o in same}) > 1:
        by = f" ({a.driver.text})"
    elif len(same) > 1 or a.what == DEVIATION.what:
        by = f" ({', '.join(a.parameters)})"
    value, unit = amplitude(a.value, a.unit)
    u, _ = amplitude(a.u, a.unit)
    text = f"{a.effect} of {short(a.site)}: {a.what} {with_u(value, u)} {unit_label(unit)}".rstrip() + by
    if a.phase is not None:
        text += f", phase {with_u(*np.degrees(a.phase))} deg"
    return text if a.significant else f"{text}, not significant alone"


def lines(gap: Gap) -> list[str]:
    """All amplitudes that are told."""
    out: list[str] = []
    for effect in dict.fromkeys(a.effect for a in gap.amplitudes):
        own = told(gap, effect)
        out += [line(a, own) for a in own]
    return out


def records(gap: Gap) -> list[dict[str, Any]]:
    """Entries of gap.json, with the validation gain of their effect."""
    gain = _gains(gap)
    out = []
    for effect in dict.fromkeys(a.effect for a in gap.amplitudes):
        for a in told(gap, effect):
            value, unit = amplitude(a.value, a.unit)
            u, _ = amplitude(a.u, a.unit)
            nats, se = gain.get(effect, (float("nan"), float("nan")))
            out.append(
                {
                    "effect": effect,
                    "site": str(a.site),
                    "driver": str(a.driver),
                    "parameters": list(a.parameters),
                    "what": a.what,
                    "value": value,
                    "u": u,
                    "unit": unit,
                    "phase_deg": None if a.phase is None else float(np.degrees(a.phase[0])),
                    "u_phase_deg": None if a.phase is None else float(np.degrees(a.phase[1])),
                    "significant": a.significant,
                    "validation_gain_nats": nats,
                    "validation_gain_se": se,
                }
            )
    return out


def _gains(gap: Gap) -> dict[str, tuple[float, float]]:
    """Change of the log predictive density of validation data at the model level that adds each effect."""
    last = gap.levels[-len(gap.verdict.named) :] if gap.verdict.named else ()
    pairs = zip(gap.verdict.named, last, strict=False)
    return {n.effect: (step.delta_elpd, step.delta_elpd_se) for n, step in pairs}
