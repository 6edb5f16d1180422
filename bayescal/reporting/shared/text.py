"""What the reports share: units, numbers as words, plain tables of the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from rich.table import Table
from rich.text import Text

from bayescal.effects import UNITS
from bayescal.reporting.shared.table import FigureTable

UM = 1e6
MM = 1e3
MDEG = 1e3 * 180.0 / np.pi
LABELS = {
    ("nominal",): "as drawn",
    ("joint",): "joint zeros and scales",
    ("geometry",): "kinematic",
    ("geometry", "compliance"): "kinematic + stiffness",
}
"""Models in a metrologist's words."""


def model_label(effects: Sequence[str]) -> str:
    """A model in words: its effects, or what the trade calls it."""
    return LABELS.get(tuple(effects), " + ".join(effects) or LABELS[("nominal",)])


def um(value: float) -> str:
    """A length in um, three figures; "-" where there is none."""
    if not np.isfinite(value):
        return "-"
    return f"{UM * value:.1f}" if abs(UM * value) < 100 else f"{UM * value:.0f}"


def amplitude(value: float, unit: str) -> tuple[float, str]:
    """The size of an error and its unit from SI: as in files, but lengths in um."""
    name, factor = ("um", UM) if unit == "m" else UNITS[unit]
    return factor * value, name


def size(value: float, unit: str) -> str:
    """The size of an error in words, from SI."""
    number, name = amplitude(value, unit)
    if not np.isfinite(number):
        return "-"
    figures = f"{number:.2g}"
    if 100 <= abs(number) < 1e6:  # 7.5e+02 is no size that anyone reads
        figures = f"{float(figures):.0f}"
    return figures + ("" if name == "1" else f" {name}")


def facts(rows: Iterable[tuple[str, str, str]]) -> Table:
    """Lines of a heading, what it says, and the style of that."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True, min_width=15)
    table.add_column()
    for heading, text, style in rows:
        table.add_row(heading, Text(text, style))
    return table


def plain_table(title: str, *headings: str) -> FigureTable:
    """A table without lines, headed by its title; its figures are never cut off."""
    return FigureTable(title, *headings)
