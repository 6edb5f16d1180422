"""What an import understood, in words: the columns, the first row, and what was left out."""

from __future__ import annotations

import re

import numpy as np

from bayescal.dataset import Dataset
from bayescal.importing.columns import Columns
from bayescal.importing.mapping import Column

SHOWN = 12
"""Unused columns in a message."""


def mapping_words(columns: Columns) -> tuple[str, ...]:
    """The columns with their units, joints together, and the columns that are not used."""
    entries = [f"{key} = {_source(column)}" for key, column in _folded(columns.said).items()]
    lines = [f"columns of {columns.name}: {'; '.join(entries)}"]
    if columns.unused:
        more = f", ... ({len(columns.unused)} in all)" if len(columns.unused) > SHOWN else ""
        lines.append(f"columns not used: {', '.join(columns.unused[:SHOWN])}{more}")
    return (*lines, *columns.notes)


def row_words(dataset: Dataset, line: int) -> str:
    """The first row as it was understood; `line` is its line in the log."""
    rows = dataset.measurements
    parts = [
        f"id {rows.ids[0]}",
        f"target {dataset.targets[rows.target[0]].name}",
        *([f"tool {dataset.tools[rows.tool[0]].name}"] if len(dataset.tools) > 1 else []),
        f"joints {_numbers(np.degrees(rows.readings[0]), 4)} deg",
    ]
    if rows.xyz is not None:
        parts.append(f"point {_numbers(1e3 * rows.xyz[0], 4)} mm")
    if rows.rpy is not None:
        parts.append(f"roll, pitch, yaw {_numbers(np.degrees(rows.rpy[0]), 4)} deg")
    singles = (
        ("length", rows.length, 1e3, "mm"),
        ("u", rows.u, 1e3, "mm"),
        ("time", rows.time, 1.0, "s"),
        ("temperature", rows.temperature, 1.0, "°C"),
        ("payload", rows.payload, 1.0, "kg"),
    )
    parts += [
        f"{name} {values[0] * scale:.6g} {unit}"
        for name, values, scale, unit in singles
        if values is not None and np.isfinite(values[0])
    ]
    return f"first row (line {line}): {', '.join(parts)}"


def _numbers(values: np.ndarray, decimals: int) -> str:
    return " ".join(f"{v:.{decimals}f}" for v in values)


def _folded(said: dict[str, Column]) -> dict[str, Column]:
    """Entries with those of all joints as the first and the last, where they differ by the number alone."""
    out: dict[str, Column] = {}
    groups: dict[str, list[str]] = {}
    for key in said:
        if joint := re.fullmatch(r"j\d+(\w*)", key):
            groups.setdefault(joint[1], []).append(key)
    for key, column in said.items():
        joint = re.fullmatch(r"j\d+(\w*)", key)
        keys = groups[joint[1]] if joint else [key]
        if len(keys) < 2 or not _alike([said[k] for k in keys]):
            out[key] = column
        elif key == keys[0]:
            last = said[keys[-1]]
            name = f"{column.name} to {last.name}"
            out[f"{key} to {keys[-1]}"] = Column(name, column.unit, column.constant, column.stamp)
    return out


def _alike(columns: list[Column]) -> bool:
    """Whether names differ only by numbers and units are the same."""
    return len({(re.sub(r"\d+", "*", c.name), c.unit) for c in columns}) == 1


def _source(column: Column) -> str:
    if column.constant:
        return f"'{column.name}'"
    if column.turn:
        return f"{column.name} {column.turn}" + (f" {column.unit.name}" if column.unit else "")
    unit = column.stamp or (column.unit.name if column.unit else "")
    return f"{column.name} {unit}".strip()
