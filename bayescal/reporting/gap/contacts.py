"""The contacts that a diagnosis advises: entries of gap.json, `next.csv` and a table of the first ones.

Also errors of points as lengths, and the entries about what the data leave open, for `bayescal plan --after`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayescal.effects import UNITS
from bayescal.gap.result import VALIDATION_POINTS, Advice, Gap, Side
from bayescal.reporting.shared.sheet import Column, Sheet, csv_text, of_key
from bayescal.storage.reading import Json

FIRST = 3
"""Contacts in the summary."""
DECIMALS = 7
"""Of degrees in the file, as in recorded sessions."""


def records(advice: Advice, number: int) -> list[dict[str, Any]]:
    """The contacts of an advice in gap.json: ``next-1-001`` is the first contact of the first advice."""
    return [
        {
            "id": f"next-{number}-{k:03d}",
            "target": c.target,
            "tool": c.tool,
            "j_deg": list(np.degrees(c.readings)),
            "j_degps": None if c.velocity is None else list(np.degrees(c.velocity)),
            "payload_kg": c.payload,
            "repeat_of": c.repeat_of,
        }
        for k, c in enumerate(advice.contacts, start=1)
    ]


def _stated(contacts: Sequence[Json], key: str) -> bool:
    return any(c[key] is not None for c in contacts)


def table_of_contacts(contacts: Sequence[Json]) -> str:
    """The content of next.csv: columns of measurements.csv without results, and what a row repeats.

    ``repeat_of`` is the contact of the session that a row repeats unchanged, or empty.
    """
    joints = range(1, len(contacts[0]["j_deg"]) + 1)
    moving, loaded = _stated(contacts, "j_degps"), _stated(contacts, "payload_kg")
    head = ["id", "role", "target", "tool", *(f"j{k}_deg" for k in joints)]
    head += [f"j{k}_degps" for k in joints] * moving + ["payload_kg"] * loaded + ["repeat_of"]
    rows = []
    for c in contacts:
        row = [c["id"], "calibrate", c["target"], c["tool"], *(f"{v:.{DECIMALS}f}" for v in c["j_deg"])]
        if moving:
            row += [f"{v:.{DECIMALS}f}" for v in c["j_degps"]] if c["j_degps"] else [""] * len(joints)
        if loaded:
            row.append("" if c["payload_kg"] is None else f"{c['payload_kg']:g}")
        rows.append([*row, c["repeat_of"]])
    return csv_text(head, rows)


def first_contacts(contacts: Sequence[Json]) -> Sheet:
    """The first of the contacts that are advised."""
    shown = contacts[:FIRST]
    columns = [Column("next contacts", "id"), Column("target", "target")]
    columns += [
        Column(f"J{k + 1} (deg)", of_key(lambda c, k: c["j_deg"][k], k), "{:.3f}".format)
        for k in range(len(shown[0]["j_deg"]))
    ]
    if _stated(shown, "j_degps"):
        columns.append(Column("direction of motion", "j_degps", _signs))
    if _stated(shown, "payload_kg"):
        columns.append(Column("payload (kg)", "payload_kg", "{:g}".format))
    return Sheet(tuple(columns), shown)


def _signs(velocity: Sequence[float]) -> str:
    """The side on which each joint arrives: ``+-+0+-`` from the first joint on."""
    return "".join("+" if v > 0 else "-" if v < 0 else "0" for v in velocity)


def per_vector(what: str) -> float:
    """Factor from the RMS of the residuals of a kind of measurement to the RMS of the lengths of its errors.

    The residuals of a point are its three coordinates, that of a contact or a distance is a length.
    """
    return 3**0.5 if what in ("points", VALIDATION_POINTS) else 1.0


def undecided_records(gap: Gap) -> list[dict[str, Any]]:
    """Pairs of explanations, each side with its effects as for --model and their fitted parameters."""
    sides = ("a", "b", "common")
    return [{side: _side(getattr(pair, side)) for side in sides} for pair in gap.undecided]


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
