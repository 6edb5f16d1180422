"""Probabilities of effects and of sets of effects, of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bayescal.reporting.figures.bars import FILLED, OPEN, Bar, bars_panel
from bayescal.reporting.figures.sheet import Entry, Panel
from bayescal.reporting.shared.text import probability, rival

Json = dict[str, Any]
MOST_EFFECTS, MOST_SETS = 12, 6
LEAST = 0.001
"""Least probability of an effect that is shown."""
FEW = 3
"""Effects of a set that its label lists one by one."""


def effects_panel(record: Json) -> Panel:
    """Probabilities of the noise-only model, of an unmodelled effect and of every effect."""
    inside = record["credible_set90"]
    always = {"null", "unknown", *inside}
    ranked = sorted(record["probability"].items(), key=lambda item: -(item[1] or 0.0))
    shown = [(n, p or 0.0) for n, p in ranked if n in always or (p or 0.0) >= LEAST][:MOST_EFFECTS]
    bars = [Bar(rival(n), p, probability(p), FILLED if n in inside else OPEN, n in inside) for n, p in shown]
    missing = ", ".join(record["missing"])
    key = [Entry("in the 90 % set", FILLED, patch=True), Entry("not in it", OPEN, patch=True)]
    note = f"not assessed: {missing}" if missing else ""
    label = "probability (effects may be present together)"
    return bars_panel(bars, "Effects", label, note, key, end=1.0)


def sets_panel(record: Json) -> Panel:
    """Sets of effects, the most probable first, with their log evidence."""
    sets = record["hypotheses"][:MOST_SETS]
    bars = [
        Bar(text, h["probability"], f"{probability(h['probability'])}  ({h['log_evidence']:+.0f} nats)", OPEN)
        for text, h in zip(set_labels([h["effects"] for h in sets]), sets, strict=True)
    ]
    label = "probability (log evidence relative to noise only)"
    return bars_panel(bars, "Sets of effects, the most probable first", label, end=1.0)


def set_labels(sets: Sequence[Sequence[str]]) -> list[str]:
    """Sets of effects as text: where they are long, as the differences from the first."""
    if max((len(effects) for effects in sets), default=0) <= FEW:
        return [" + ".join(rival(n) for n in effects) or rival("null") for effects in sets]
    first, out = sets[0], []
    for effects in sets:
        less = [f"without {rival(n)}" for n in first if n not in effects]
        more = [f"with {rival(n)}" for n in effects if n not in first]
        out.append(", ".join([*more, *less]) or f"the {len(first)} most probable")
    return out
