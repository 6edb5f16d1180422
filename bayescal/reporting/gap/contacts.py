"""The contacts that a diagnosis advises: `next.csv`, entries of gap.json and a table of the first ones.

Also errors of points as lengths, and the entries about what the data leave open, for `bayescal plan --after`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayescal.effects import UNITS
from bayescal.gap.result import (
    VALIDATION_CONTACTS,
    VALIDATION_POINTS,
    Advice,
    Gap,
    NextContact,
    Shrinkage,
    Side,
)
from bayescal.reporting.shared.sheet import Column, Sheet, csv_text, of_key

FIRST = 3
"""Contacts of the first advice in the summary."""
DECIMALS = 7
"""Of degrees in the file, as in recorded sessions."""


def numbered(gap: Gap) -> Iterator[tuple[str, Advice, NextContact]]:
    """Every contact with its identifier: ``next-1-001`` is the first contact of the first advice."""
    for k, advice in enumerate(gap.advice, start=1):
        for i, contact in enumerate(advice.contacts, start=1):
            yield f"next-{k}-{i:03d}", advice, contact


def records(gap: Gap, advice: Advice) -> list[dict[str, Any]]:
    """The contacts of an advice in gap.json."""
    return [
        {
            "id": name,
            "target": c.target,
            "tool": c.tool,
            "j_deg": list(np.degrees(c.readings)),
            "j_degps": None if c.velocity is None else list(np.degrees(c.velocity)),
            "payload_kg": c.payload,
            "repeat_of": c.repeat_of,
        }
        for name, of, c in numbered(gap)
        if of is advice
    ]


def table_of_contacts(gap: Gap) -> str:
    """The content of next.csv: columns of measurements.csv without results, and what a row repeats.

    ``repeat_of`` is the contact of the session that a row repeats unchanged, or empty.
    """
    contacts = [(name, c) for name, _, c in numbered(gap)]
    joints = range(1, gap.dataset.robot.n + 1)
    moving, loaded = _recorded([c for _, c in contacts])
    head = ["id", "role", "target", "tool", *(f"j{k}_deg" for k in joints)]
    head += [f"j{k}_degps" for k in joints] * moving + ["payload_kg"] * loaded + ["repeat_of"]
    rows = []
    for name, c in contacts:
        row = [name, "calibrate", c.target, c.tool, *_degrees(c.readings)]
        if moving:
            row += _degrees(c.velocity) if c.velocity is not None else [""] * len(joints)
        if loaded:
            row.append("" if c.payload is None else f"{c.payload:g}")
        rows.append([*row, c.repeat_of])
    return csv_text(head, rows)


def _recorded(contacts: Sequence[NextContact]) -> tuple[bool, bool]:
    """Whether any of the contacts states a velocity, and a payload."""
    return any(c.velocity is not None for c in contacts), any(c.payload is not None for c in contacts)


def first_contacts(gap: Gap) -> Sheet:
    """The first contacts of the first advice."""
    chosen = [(name, c) for name, _, c in numbered(gap)][:FIRST]
    moving, loaded = _recorded([c for _, c in chosen])
    joints = [
        Column(f"J{k + 1} (deg)", of_key(_angle, k), "{:.3f}".format) for k in range(gap.dataset.robot.n)
    ]
    columns = [Column("next contacts", 0), Column("target", lambda item: item[1].target), *joints]
    if moving:
        columns.append(Column("direction of motion", lambda item: item[1].velocity, _signs))
    if loaded:
        columns.append(Column("payload (kg)", lambda item: item[1].payload, "{:g}".format))
    return Sheet(tuple(columns), chosen)


def _angle(item: tuple[str, NextContact], joint: int) -> float:
    return float(np.degrees(item[1].readings[joint]))


def _degrees(values: tuple[float, ...]) -> list[str]:
    return [f"{v:.{DECIMALS}f}" for v in np.degrees(values)]


def _signs(velocity: tuple[float, ...]) -> str:
    """The side on which each joint arrives: ``+-+0+-`` from the first joint on."""
    return "".join("+" if v > 0 else "-" if v < 0 else "0" for v in velocity)


COORDINATES = 3
POINTS = ("points", VALIDATION_POINTS)


def length(what: str, rms: float) -> float:
    """RMS length of the errors of a kind of measurement, m, from the RMS of their residuals.

    The residuals of a point are its three coordinates, that of a contact or a distance is a length.
    """
    return rms * COORDINATES**0.5 if what in POINTS else rms


def main(gap: Gap) -> str:
    """The kind of measurement with which the gap is compared: contacts where there are any."""
    contacts = any(x.what == VALIDATION_CONTACTS for x in gap.magnitude.measured)
    return VALIDATION_CONTACTS if contacts or not gap.magnitude.measured else VALIDATION_POINTS


def per_residual(gap: Gap) -> str:
    """What a figure that is not a length of points is per, to be added to its label."""
    return "" if main(gap) == VALIDATION_CONTACTS else " per coordinate"


def as_lengths(s: Shrinkage) -> Shrinkage:
    """A reduction of errors whose errors of points are lengths."""
    errors: dict[str, Any] = {
        name: length(s.what, getattr(s, name))
        for name in ("before", "after", "floor", "predicted_before", "predicted")
    }
    return replace(s, **errors)


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
