"""The contacts that a diagnosis advises: `next.csv`, entries of gap.json, and a table of the first ones."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from typing import Any

import numpy as np

from bayescal.gap.result import Advice, Gap, NextContact
from bayescal.reporting.shared.table import FigureTable
from bayescal.reporting.shared.text import plain_table

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
