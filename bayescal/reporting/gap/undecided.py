"""Entries of gap.json about what the data leave open: `bayescal plan --after` reads them."""

from __future__ import annotations

from typing import Any

from bayescal.effects import UNITS
from bayescal.gap.result import Gap, Pair, Side


def records(gap: Gap) -> list[dict[str, Any]]:
    """Pairs of explanations, each side with its effects as for --model and their fitted parameters."""
    return [_pair(pair) for pair in gap.undecided]


def _pair(pair: Pair) -> dict[str, Any]:
    return {"a": _side(pair.a), "b": _side(pair.b), "common": _side(pair.common)}


def _side(side: Side) -> list[dict[str, Any]]:
    return [
        {
            "model": s.model,
            "values": [
                {"parameter": name, "value": value * factor, "unit": unit}
                for name, value in s.values.items()
                for unit, factor in (UNITS[s.units[name]],)
            ],
        }
        for s in side
    ]
