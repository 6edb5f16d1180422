"""The contacts that a diagnosis advises: `next.csv`, entries of gap.json, and a table of the first ones.

Errors of points as reports state them: the length of the error vector, from the RMS of its coordinates.

Entries of gap.json about what the data leave open: `bayescal plan --after` reads them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
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
    Pair,
    Shrinkage,
    Side,
)
from bayescal.reporting.shared.text import FigureTable, plain_table

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
        for name, own, c in numbered(gap)
        if own is advice
    ]


def table_of_contacts(gap: Gap) -> str:
    """The content of next.csv: columns of measurements.csv without results, and what a row repeats.

    ``repeat_of`` is the contact of the session that a row repeats unchanged, or empty.
    """
    every = list(numbered(gap))
    n = gap.dataset.robot.n
    moving = any(c.velocity is not None for _, _, c in every)
    loaded = any(c.payload is not None for _, _, c in every)
    head = ["id", "role", "target", "tool", *(f"j{k}_deg" for k in range(1, n + 1))]
    head += [f"j{k}_degps" for k in range(1, n + 1)] * moving + ["payload_kg"] * loaded + ["repeat_of"]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(head)
    for name, _, c in every:
        row = [name, "calibrate", c.target, c.tool, *_degrees(c.readings)]
        if moving:
            row += _degrees(c.velocity) if c.velocity is not None else [""] * n
        if loaded:
            row.append("" if c.payload is None else f"{c.payload:g}")
        writer.writerow([*row, c.repeat_of])
    return out.getvalue()


def first_contacts(gap: Gap) -> FigureTable:
    """The first contacts of the first advice."""
    chosen = [(name, c) for name, _, c in numbered(gap)][:FIRST]
    joints = [f"J{k}" for k in range(1, gap.dataset.robot.n + 1)]
    moving = any(c.velocity is not None for _, c in chosen)
    loaded = any(c.payload is not None for _, c in chosen)
    headings = ["target", *(f"{j} (deg)" for j in joints)]
    headings += ["direction of motion"] * moving + ["payload (kg)"] * loaded
    table = plain_table("next contacts", *headings)
    for name, c in chosen:
        cells = [c.target, *(f"{v:.3f}" for v in np.degrees(c.readings))]
        if moving:
            cells.append(_signs(c.velocity))
        if loaded:
            cells.append("-" if c.payload is None else f"{c.payload:g}")
        table.add_row(name, *cells)
    return table


def _degrees(values: tuple[float, ...]) -> list[str]:
    return [f"{v:.{DECIMALS}f}" for v in np.degrees(values)]


def _signs(velocity: tuple[float, ...] | None) -> str:
    """The side on which each joint arrives: ``+-+0+-`` from the first joint on."""
    if velocity is None:
        return "-"
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
    return replace(
        s,
        before=length(s.what, s.before),
        after=length(s.what, s.after),
        floor=length(s.what, s.floor),
        predicted_before=length(s.what, s.predicted_before),
        predicted=length(s.what, s.predicted),
    )


def undecided_records(gap: Gap) -> list[dict[str, Any]]:
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
