"""Numbers with their units as text, and tables of the terminal in which no figure is ever cut off."""

import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Column, Table
from rich.text import Text

from bayescal.effects import BASELINE, EFFECTS, UNITS
from bayescal.effects.location import OPPOSITE, words_of
from bayescal.effects.selection import Selection
from bayescal.effects.vocabulary import unit_label
from bayescal.gap.settings import OUTCOME
from bayescal.statistics import decimals_of, grouped


def model_options(model: Sequence[str], without: Sequence[str]) -> str:
    """Options by which a further command has the same model, after a blank; none of the usual one."""
    options = {"model": () if tuple(model) == BASELINE else model, "without": without}
    return "".join(f" --{key} {shlex.quote(','.join(names))}" for key, names in options.items() if names)


GAP = 2
"""Blanks between columns."""
LOOK: dict[str, Any] = {"box": None, "pad_edge": False, "header_style": "dim", "padding": (0, GAP, 0, 0)}
"""Of all tables of the terminal."""
LEAST_NAME = 15
"""Characters that a name keeps before columns move to a further block."""


class FigureTable(Table):
    """A table without lines: a column of names, headed by the title, and columns of figures to the right.

    A column of figures is as wide as its widest cell; its heading wraps at blanks. Names wrap. Columns that
    do not fit the terminal's width follow in a further block with the same names.
    """

    def __init__(self, title: str, *headings: str) -> None:
        super().__init__(**LOOK)
        self.add_column(Text(title))
        for heading in headings:
            self.add_column(Text(heading), justify="right")

    def add_row(self, *cells: Any, **options: Any) -> None:
        """Add a row; the text of a cell is no markup, whatever console prints it."""
        super().add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells), **options)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Blocks of columns, each no wider than the terminal."""
        names, *figures = self.columns
        longest = max(cell_len(str(cell)) for cell in (names.header, *names.cells))
        for k, block in enumerate(_blocks(figures, options.max_width - min(longest, LEAST_NAME))):
            if k:
                yield Text("")
            room = max(options.max_width - sum(GAP + _width(c) for c in block), 1)
            shown = [(names, min(longest, room)), *((c, _width(c)) for c in block)]
            table = Table(**LOOK)
            for c, wide in shown:
                table.add_column(c.header, justify=c.justify, width=wide, overflow="fold")
            for row, *cells in zip(self.rows, *(c.cells for c, _ in shown), strict=True):
                table.add_row(*cells, style=row.style)
            yield table
        if self.caption:
            yield Text(str(self.caption), style="dim italic")


def _width(column: Column) -> int:
    """What a column of figures needs: its widest cell, and the longest word of its heading."""
    return max([1, *(cell_len(text) for text in (*map(str, column.cells), *str(column.header).split()))])


def _blocks(figures: list[Column], room: int) -> list[list[Column]]:
    """Columns in order, in as few blocks as fit a width; each block has one column at least."""
    out: list[list[Column]] = [[]]
    remaining = room
    for column in figures:
        needed = GAP + _width(column)
        if needed > remaining and out[-1]:
            out.append([])
            remaining = room
        out[-1].append(column)
        remaining -= needed
    return out


MISSING = "-"
"""What a text states where there is no value."""
UM = 1e6
MM = 1e3
MDEG = 1e3 * 180.0 / np.pi
Facts = Iterable[tuple[str, str, str]]
"""Lines of the terminal: heading, text and style."""
LABELS: dict[tuple[str, ...], str] = {("nominal",): "nominal", ("joint",): "joint offsets"}
"""Model levels that the names of their effects do not describe."""
NEVER = 1000.0
"""Ratio to the plausible amplitude from which on an effect is not detectable at any amplitude."""
SURE = 0.9
"""Probability from which on a named effect is found; below, it is probable (convention)."""
LEAST = 0.01
"""Least probability of an effect that is listed."""
FEW_SITES = 2
"""Sites of an effect that its label names."""


def model_label(effects: Sequence[str]) -> str:
    """The text of a model level: its effects joined by ``+``, each `short`."""
    names = tuple(map(short, effects))
    return LABELS.get(names, " + ".join(names) or LABELS[("nominal",)])


def short(name: str) -> str:
    """An effect of ``--model`` with its sites if they are few, without setting, drivers and priors."""
    chosen = Selection.read(name)
    few = 0 < len(chosen.sites) <= FEW_SITES
    return f"{chosen.effect} at {words_of(chosen.sites)}" if few else chosen.effect


def um(value: float) -> str:
    """A length in µm with three significant digits, one below 0.05 µm; "-" where there is none."""
    if not np.isfinite(value):
        return "-"
    if 5e-4 < abs(UM * value) < 0.05:
        return f"{UM * value:.1g}"
    return unsigned_zero(f"{UM * value:.1f}") if abs(UM * value) < 100 else f"{UM * value:.0f}"


def um2(value: float) -> str:
    """An uncertainty in µm with two significant digits; "-" where there is none."""
    decimals = 1 if abs(UM * value) < 9.95 else 0
    return f"{float(f'{UM * value:.2g}'):.{decimals}f}" if np.isfinite(value) else "-"


def amplitude(value: float, unit: str) -> tuple[float, str]:
    """The size of an error and its unit from SI: lengths in µm, unit `um` (ASCII, for JSON)."""
    name, factor = ("um", UM) if unit == "m" else UNITS[unit]
    return factor * value, name


def size(value: float, unit: str) -> str:
    """The size of an error with its unit as text, from SI, two significant digits."""
    number, name = amplitude(value, unit)
    return quantity(number if np.isfinite(number) else None, name)


def two_digits(value: float) -> str:
    """A number with two significant digits, without an exponent where it is above 1e-4."""
    return f"{float(f'{value:.2g}'):.6g}"


def percent(probability: float) -> str:
    """A probability in per cent, ``< 1 %`` and ``> 99 %`` at the ends."""
    if probability < 0.01:
        return "< 1 %"
    return "> 99 %" if probability > 0.99 else f"{100 * probability:.0f} %"


def unsigned_zero(text: str) -> str:
    """A number as text, without the sign of a value that is rounded to zero: ``-0.00`` is ``0.00``."""
    return text if any(c in "123456789" for c in text.partition("e")[0]) else text.lstrip("+-")


def signed(value: float | np.ndarray, decimals: int = 0) -> str:
    """A number with its sign; zero has none."""
    return unsigned_zero(f"{value:+.{decimals}f}")


NEARLY, MOST = 0.99, "> 99 %"
"""Share from which on it is stated as more than that."""


def reduction(
    removed: float | None, ends: tuple[float | None, float | None] | None, claimed: bool
) -> tuple[str, str]:
    """Share of the excess variance removed, and its 95 % interval, as text.

    An interval that holds zero does not determine the share; where no improvement is claimed none is stated.
    """
    if not claimed or removed is None or not np.isfinite(removed):
        return "-", "-"
    low, high = ends or (None, None)
    if low is None or high is None or not np.isfinite(low + high):
        return f"{100 * removed:.0f} %", "-"
    if low <= 0.0:
        return "not determined", "-"
    if low > NEARLY:
        return MOST, MOST
    return MOST if removed > NEARLY else f"{100 * removed:.0f} %", f"{100 * low:.0f} to {100 * high:.0f} %"


def with_u(value: float, u: float) -> str:
    """A value with its standard uncertainty, two digits of it: ``0.0244(10)``, ``12.3(1.4)``."""
    if not (np.isfinite(u) and u > 0):
        return f"{value + 0.0:.9g}"
    number, size = rounded(value, u)
    return f"{number}({size if float(size) >= 1.0 else size.replace('.', '').lstrip('0')})"


def rounded(value: float, u: float) -> tuple[str, str]:
    """A value and its uncertainty as text: two significant digits of u."""
    if not (np.isfinite(u) and u > 0):
        return f"{value:.9g}", f"{u:.2g}"
    decimals = decimals_of(u)
    digits = max(decimals, 0)
    return f"{round(value, decimals) + 0.0:.{digits}f}", f"{round(u, decimals):.{digits}f}"  # no -0


def facts(rows: Facts) -> Table:
    """A grid of headings and their text, each row (heading, text, style)."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True, min_width=15)
    table.add_column()
    for heading, text, style in rows:
        table.add_row(heading, Text(text, style))
    return table


def under(heading: str, texts: Iterable[str], style: str = "") -> Facts:
    """Lines of the terminal below one heading, which stands beside the first of them."""
    for k, text in enumerate(texts):
        yield "" if k else heading, text, style


def probability(value: float) -> str:
    """A probability with two decimals, ``< 0.01`` or ``> 0.99`` beyond."""
    if value > 0.99:
        return "> 0.99"
    return "< 0.01" if value < 0.01 else f"{value:.2f}"


def p_value(value: float) -> str:
    """A p-value with one significant digit."""
    if value < 1e-4:
        return "< 0.0001"
    return f"{value:.4f}" if value < 0.01 else f"{value:.2f}"


def listed(names: Iterable[str], last: str = "and") -> str:
    """Names joined by commas, the last by `last`; "" without any."""
    *some, final = list(names) or [""]
    return f"{', '.join(some)} {last} {final}" if some else final


def not_assessed(record: Mapping[str, Any]) -> dict[str, str]:
    """Effects that were not assessed, with the reason; without those that are listed as missed."""
    spots = {spot["effect"] for spot in record["blind_spots"]}
    return {name: why for name, why in record["missing"].items() if name not in spots}


def significant(p_value: float | None) -> bool:
    """Whether a location or a group is significant, by a p-value that is corrected for their number."""
    return p_value is not None and p_value < OUTCOME.significant


def by_reason(missing: Mapping[str, str]) -> dict[str, list[str]]:
    """Names by the reason that each of them has."""
    return grouped((reason, name) for name, reason in missing.items())


def rival(name: str) -> str:
    """A member of the 90 % set as text."""
    return {"null": "noise only", "unknown": "unmodelled effect"}.get(name, name)


def level_labels(levels: Iterable[Mapping[str, Any]]) -> list[str]:
    """Model levels of a record by what each adds to the one before: ``nominal``, ``+ backlash``."""
    models = [tuple(step["model"]) for step in levels]
    return [
        f"+ {', '.join(map(short, added))}"
        if len(before) > 1 and model[: len(before)] == before and (added := model[len(before) :])
        else model_label(model)
        for before, model in zip([(), *models], models, strict=False)
    ]


def per_residual(record: Mapping[str, Any]) -> str:
    """What a figure of a diagnosis that is not a length of points is per, to be added to its label."""
    return "" if record["lengths"]["of"] == "validation contacts" else " per coordinate"


def parameter_notes(effects: Collection[str]) -> list[str]:
    """Notes to a table of parameters of some effects: how u is written, and what it contains."""
    notes = ["value(u): standard uncertainty u in units of the last digits"]
    if "compliance" in effects:
        notes.append("u includes the uncertainty of the stated masses, not of measured torques")
    for name in dict.fromkeys(effects):
        sizes = EFFECTS[name].sizes.values() if name in EFFECTS else ()
        signed = [size.what for size in sizes if size.what in OPPOSITE]
        notes += [f"{name} above 0: {what} it; below 0: {OPPOSITE[what]} it" for what in signed]
    return notes


def length(value: float | None) -> str:
    """A length in µm, three significant digits, without its unit."""
    return MISSING if value is None else um(1e-6 * value)


def uncertainty(value: float | None) -> str:
    """An uncertainty in µm, two significant digits, without its unit."""
    return MISSING if value is None else um2(1e-6 * value)


def interval(ends: list[float | None] | None, of: float = 1.0) -> str:
    """An interval in µm: ``4.3 to 6.6``."""
    if not ends or None in ends:
        return MISSING
    low, high = (of * end for end in ends if end is not None)
    return f"{length(low)} to {length(high)}"


def quantity(value: float | None, unit: str) -> str:
    """A value with its unit, two significant digits."""
    if value is None:
        return MISSING
    figures = f"{value:.2g}"
    if 99.5 <= abs(value) < 1e6:
        figures = f"{float(figures):.0f}"
    return f"{figures} {unit_label(unit)}".rstrip()


def measured(value: float, u: float, unit: str) -> str:
    """A value with its standard uncertainty and unit: ``0.0244(10) deg``."""
    return f"{with_u(value, u)} {unit_label(unit)}".rstrip()


def with_unit(name: str, unit: str) -> str:
    """A name with the unit of its values: ``a2 (mm)``; of a pure number the name alone."""
    return f"{name} ({label})" if (label := unit_label(unit)) else name


def share(value: float | None) -> str:
    """A fraction in per cent."""
    return MISSING if value is None else f"{100 * value:.0f} %"


def as_precise(value: float, text: str) -> str:
    """A value with as many decimals as a ``value(u)`` has: ``0.00`` beside ``0.02(13)``."""
    decimals = len(text.partition("(")[0].partition(".")[2])
    return unsigned_zero(f"{value:.{decimals}f}")
