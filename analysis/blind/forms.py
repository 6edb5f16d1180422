"""Share of correct answers by the form in which an effect was simulated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from analysis.blind.assessed import FIRST, Record
from analysis.blind.rates import proportion, share


def by_form(records: Sequence[Record], least: float) -> dict[str, Any]:
    """Shares by form.

    Parameters
    ----------
    records : sequence of dict
        Of sessions with one or two effects.
    least : float
        Lambda of an effect from which on it is counted.

    Returns
    -------
    dict
        ``first`` and ``further``: sessions with a single effect in its first and in another form, correct;
        ``effects``: by effect and form, sessions in which it was named.
    """
    single = [r for r in records if r["kind"] == "single" and r["lambda"] >= least]
    found: dict[str, dict[str, list[Record]]] = {}
    for r in records:
        for name, size in r["each"].items():
            if size >= least:
                found.setdefault(name, {}).setdefault(r["forms"][name], []).append(r)
    return {
        "first": share([r for r in single if _first(r)], _right),
        "further": share([r for r in single if not _first(r)], _right),
        "effects": {
            name: {
                form: proportion(sum(name in r["named"] for r in own), len(own))
                for form, own in forms.items()
            }
            for name, forms in sorted(found.items())
        },
    }


def _first(r: Record) -> bool:
    return all(form == FIRST for form in r["forms"].values())


def _right(r: Record) -> bool:
    return bool(r["right"])
