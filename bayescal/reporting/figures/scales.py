"""Ticks that have room: as many as the width of an axis allows.

A panel of rows: the label and the numbers of a row are above its lane, so that long names have room.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.reporting.figures.sheet import Entry, Panel, baseline, line, width, width_of, wrapped
from bayescal.reporting.style import GREY, INK, SIZE

if TYPE_CHECKING:
    from matplotlib.axis import Axis

LANE, SPACE = 2.6, 1.4
"""Height of a lane, and room below it, mm."""
BETWEEN = 3.0
"""Least room between a label and the numbers in the same line, mm."""
BESIDE = 0.6
"""Share of the width that numbers may take in the line of the label; longer ones are below it."""

Lanes = Callable[[Any, Sequence[float]], None]


@dataclass(frozen=True)
class Row:
    """A row: its label, its numbers as text, and whether its label is emphasised."""

    label: str
    text: str = ""
    strong: bool = False


@dataclass(frozen=True)
class _Lines:
    """Lines of a label and of the numbers, which are `beside` its first line or below it."""

    label: list[str]
    text: list[str]
    beside: bool

    @property
    def tall(self) -> float:
        return line() * (len(self.label) + (0 if self.beside else len(self.text)))


def _lines(row: Row, inner: float) -> _Lines:
    taken = width(row.text) + BETWEEN if row.text else 0.0
    if taken < BESIDE * inner:
        return _Lines(wrapped(row.label, inner - taken, SIZE, row.strong), [row.text], True)
    return _Lines(wrapped(row.label, inner, SIZE, row.strong), wrapped(row.text, inner), False)


def rows_panel(
    rows: Sequence[Row], lanes: Lanes, title: str = "", x: str = "", note: str = "", key: Sequence[Entry] = ()
) -> Panel:
    """A panel of rows.

    Parameters
    ----------
    rows : sequence of Row
        From top to bottom.
    lanes : callable
        Draws the data; given the axes and the middle of each lane in the y coordinate of the axes (mm from
        the top). It sets the limits of x.
    title, x, note, key
        As for `Panel`.
    """

    def height(inner: float) -> float:
        return sum(_lines(row, inner).tall + LANE + SPACE for row in rows) or 5.0

    def draw(axes: Any) -> None:
        inner, top, middles = width_of(axes), 0.0, []
        for row in rows:
            lines = _lines(row, inner)
            _write(axes, lines.label, 0, top, row.strong)
            if lines.beside:
                _write(axes, lines.text, 1, top)
            else:
                _write(axes, lines.text, 0, top + line() * len(lines.label))
            middles.append(top + lines.tall + 0.5 * LANE)
            top += lines.tall + LANE + SPACE
        axes.set_ylim(top or 1.0, 0)
        axes.hlines(middles, 0, 1, transform=axes.get_yaxis_transform(), color=GREY, lw=0.3, zorder=0)
        without_y(axes)
        lanes(axes, middles)

    return Panel(draw, height, title, x, "", note, key)


def _write(axes: Any, lines: Sequence[str], x: float, y: float, strong: bool = False) -> None:
    for k, text in enumerate(filter(None, lines)):
        axes.text(
            x, y + baseline(k), text, transform=axes.get_yaxis_transform(), color=INK,
            ha="right" if x else "left", fontweight="bold" if strong else "normal",
        )  # fmt: skip


def upright(axes: Any, x: float, middles: Sequence[float], style: Mapping[str, Any]) -> None:
    """A vertical line at x, in the lanes alone: it does not cross the text between them."""
    middle = np.asarray(middles, float)
    axes.vlines(np.full(len(middle), x), middle - 0.5 * LANE, middle + 0.5 * LANE, zorder=0.5, **style)


EACH = 14.0
"""Room of a tick label on the x axis, mm."""
UP = 8.0
"""Room of a tick label on the y axis, mm."""
APART = 8.0
"""Least distance of two tick labels on a logarithmic axis, mm."""
STEPS = ((1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0), (1.0, 2.0, 3.0, 5.0), (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))
"""Ticks of a decade, from many to few."""


def linear(axis: Axis, room: float, each: float = EACH) -> None:
    """Ticks of a linear axis that is `room` mm long, `each` mm for a label."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(max(int(room / each), 2), steps=[1, 2, 2.5, 5, 10]))


def linear_x(axes: Any, low: float, high: float, each: float = EACH) -> None:
    """A linear x axis between limits, `each` mm for a label."""
    axes.set_xlim(low, high)
    linear(axes.xaxis, width_of(axes), each)


def without_y(axes: Any) -> None:
    """No ticks and no line of the y axis."""
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def log_x(axes: Any, values: Sequence[float]) -> None:
    """A logarithmic x axis about values."""
    from matplotlib.ticker import FixedLocator, NullLocator

    low, high = around(values)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axis, room, length = axes.xaxis, width_of(axes), np.log(high / low)
    for steps, every in (*((ticks, 1) for ticks in STEPS), ((1.0,), 2), ((1.0,), 3)):
        chosen = ticks_of(low, high, steps)[::every]
        if np.all(np.diff(np.log(chosen)) * room / length >= APART):
            break
    axis.set_major_locator(FixedLocator(chosen))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, _: f"{value:.10g}")


def ticks_of(low: float, high: float, steps: Sequence[float]) -> list[float]:
    """Ticks of logarithmic axes within the limits."""
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [s * 10.0**d for d in decades for s in steps if low <= s * 10.0**d * 1.0000001 <= high * 1.000001]


def around(values: Sequence[float], pad: float = 0.06) -> tuple[float, float]:
    """Limits of a logarithmic axis about positive values, at least a factor of three apart."""
    logs = np.log(np.asarray(values, float))
    low, high = float(np.min(logs)), float(np.max(logs))
    more = max(pad * (high - low), 0.5 * (np.log(3.0) - (high - low)))
    return float(np.exp(low - more)), float(np.exp(high + more))
