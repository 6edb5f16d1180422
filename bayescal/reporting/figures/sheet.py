"""Figures from panels: title, axes, legends, labels and notes, placed by Matplotlib's constrained layout.

Sizes are in mm, so that a figure of 80 mm has the same text as one of 160 mm; panels that are beside each
other in a wide figure are below each other in a narrow one. Text is wrapped to a width in mm: what keeps
labels inside a figure.

A panel of rows: the label and the numbers of a row are above its lane, so that long names have room.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.reporting.figures.scales import MM_PER_INCH, width_of, without_y
from bayescal.reporting.style import DPI, GREY, INK, LARGER, SIZE, TICK

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MM_PER_PT = 25.4 / 72.0
LEADING = 1.25
"""Distance of two lines over the size of the text."""

HINTED = 1.03
"""Width of drawn text, whose letters begin at pixels, over that of its outlines, at most."""
ASCENT = 0.95
"""From the top of a line to its baseline, over the size of the text."""


@lru_cache(maxsize=4096)
def width(text: str, size: float = SIZE, bold: bool = False) -> float:
    """The width of a line of text, mm; `size` in pt."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=size, weight="bold" if bold else "normal")
    points = float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])
    return HINTED * points * MM_PER_PT


def line(size: float = SIZE) -> float:
    """The height of a line of text, mm."""
    return LEADING * size * MM_PER_PT


def baseline(k: int) -> float:
    """From the top of a block of lines to the baseline of line k (from 0), mm."""
    return ASCENT * SIZE * MM_PER_PT + k * line()


def wrapped(text: str, room: float, size: float = SIZE, bold: bool = False) -> list[str]:
    """Lines of a text that are at most `room` mm wide; a word that is wider is divided."""
    lines: list[str] = []
    for word in _pieces(text.split(), room, size, bold):
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and width(longer, size, bold) <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines or [""]


def _pieces(words: Iterable[str], room: float, size: float, bold: bool) -> list[str]:
    """Words, those that are too wide in parts."""
    out = []
    for word in words:
        while len(word) > 1 and width(word, size, bold) > room:
            fits = next((n for n in range(len(word) - 1, 1, -1) if width(word[:n], size, bold) <= room), 1)
            out.append(word[:fits])
            word = word[fits:]
        out.append(word)
    return out


WIDTH = 160.0
"""Width of a figure, mm."""
NARROW = 120.0
"""Below this width every panel has a row of its own."""
EDGE, PAD = 2.0, 1.0
"""Margin of a figure, and about its parts."""
TICKS, AXIS = 15.0, 4.2
"""Room for the y axis (label and tick labels), and for the tick labels of the x axis."""
TALLER = 8.0
"""Length of the label of a y axis beyond that of the axis, mm."""
HANDLE, COLUMN = 6.0, 3.0
"""Room for the sign of an entry of a legend, and between its columns."""

Height = float | Callable[[float], float]


@dataclass(frozen=True)
class Entry:
    """An entry of a legend: its text, and how its sign is drawn (a line, or a patch where `patch`)."""

    text: str
    style: Mapping[str, Any]
    patch: bool = False


@dataclass(frozen=True)
class Panel:
    """Axes with all their text.

    Attributes
    ----------
    draw : callable
        Draws the data into axes, whose width is `width_of`.
    height : float or callable
        Height of the axes, mm, or a function of their width.
    title, x, y, note : str
        Text above, labels of the axes, and grey text below.
    key : sequence of Entry
        Legend, above the axes.
    share : float
        Width, relative to the other panels of its row.
    inset : float
        Least room beside the axes, mm: half a tick label.
    """

    draw: Callable[[Any], None]
    height: Height
    title: str = ""
    x: str = ""
    y: str = ""
    note: str = ""
    key: Sequence[Entry] = field(default=())
    share: float = 1.0
    inset: float = 2.5

    def tall(self, inner: float) -> float:
        """Height of axes of a width, mm."""
        return self.height(inner) if callable(self.height) else self.height


def sheet(title: Sequence[str], rows: Sequence[Sequence[Panel]], wide: float = WIDTH) -> Figure:
    """A figure of panels, laid out by Matplotlib.

    Panels choose ticks and wrap labels by the width of their axes, which is known after the layout only: they
    are drawn twice.

    Parameters
    ----------
    title : sequence of str
        Lines above all panels; they wrap.
    rows : sequence of sequences of Panel
        Panels of a row are beside each other where the figure is not `NARROW`.
    wide : float
        Width, mm; the height follows from the content.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if wide < NARROW:
        rows = [[panel] for row in rows for panel in row]
    large = SIZE + LARGER
    heading = [part for text in title for part in wrapped(text, wide - 2 * EDGE, large, bold=True)]
    rooms = [[(wide - 2 * EDGE) * p.share / sum(q.share for q in row) for p in row] for row in rows]
    tall = [max(map(_tall, row, room)) for row, room in zip(rows, rooms, strict=True)]
    height = sum(tall) + len(heading) * line(large) + 2 * EDGE
    out = Figure(figsize=(wide / MM_PER_INCH, height / MM_PER_INCH), dpi=DPI, layout="constrained")
    FigureCanvasAgg(out)
    engine: Any = out.get_layout_engine()
    engine.set(w_pad=PAD / MM_PER_INCH, h_pad=PAD / MM_PER_INCH, wspace=0.0, hspace=0.0)
    out.suptitle("\n".join(heading), x=EDGE / wide, ha="left", fontsize=large, fontweight="bold", color=INK)
    parts = out.subfigures(len(rows), 1, height_ratios=tall, squeeze=False)[:, 0]
    placed = []
    for part, row, room in zip(parts, rows, rooms, strict=True):
        cells = part.subfigures(1, len(row), width_ratios=room, squeeze=False)[0]
        placed.append([(_surrounded(cell, p, mm), p) for cell, p, mm in zip(cells, row, room, strict=True)])
    for cells in placed:
        for axes, panel in cells:
            _draw(axes, panel)
    out.draw_without_rendering()
    out.set_layout_engine("none")
    for cells in placed:
        top = min(axes.get_window_extent().y1 for axes, _ in cells)
        for axes, panel in cells:
            _settle(axes, panel, top)
            _draw(axes, panel)
    return out


def _settle(axes: Any, panel: Panel, top: float) -> None:
    """Give axes the height of their panel, below `top` (pixels), and its least room on both sides."""
    per_mm = axes.figure.dpi / MM_PER_INCH
    cell, box = axes.figure.bbox, axes.get_window_extent()
    inset = panel.inset * per_mm
    x0, x1 = max(box.x0, cell.x0 + inset), min(box.x1, cell.x1 - inset)
    tall = min(panel.tall((x1 - x0) / per_mm) * per_mm, top - box.y0)
    corner = ((x0 - cell.x0) / cell.width, (top - tall - cell.y0) / cell.height)
    axes.set_position((*corner, (x1 - x0) / cell.width, tall / cell.height))


def _tall(panel: Panel, room: float) -> float:
    """Height of a panel with all its text, mm, in `room` mm."""
    inner = room - max(TICKS if panel.y else 0.0, panel.inset) - panel.inset
    lines = sum(len(wrapped(text, wide)) for text, wide in ((panel.note, room), (panel.x, inner)) if text)
    key, columns = _columns(panel, room)
    title = len(wrapped(panel.title, room, bold=True)) if panel.title else 0
    above = line() * (-(-len(key) // columns) + title)
    return panel.tall(inner) + above + lines * line() + AXIS + 2 * PAD


def _columns(panel: Panel, room: float) -> tuple[list[str], int]:
    """Lines of the legend of a panel, wrapped, and its number of columns."""
    key = ["\n".join(wrapped(entry.text, room - HANDLE - 1.0)) for entry in panel.key]
    widest = max((width(part) for text in key for part in text.split("\n")), default=0.0)
    return key, max(min(int((room + COLUMN) / (widest + HANDLE + COLUMN)), len(key)), 1)


def _surrounded(cell: Any, panel: Panel, room: float) -> Any:
    """Axes in a part of a figure, with title and legend above and the note below."""
    strong = {"fontsize": SIZE, "fontweight": "bold", "color": INK}
    title = "\n".join(wrapped(panel.title, room, bold=True))
    if panel.key:
        key, columns = _columns(panel, room)
        legend = cell.legend(
            handles=[_handle(e, text) for e, text in zip(panel.key, key, strict=True)],
            loc="outside upper left", ncols=columns, borderpad=0,
            handlelength=(HANDLE - 2.0) / (SIZE * MM_PER_PT), handletextpad=0.4,
            columnspacing=COLUMN / (SIZE * MM_PER_PT), labelspacing=0.2, title=title or None,
            alignment="left",
        )  # fmt: skip
        legend.get_title().set(**strong)
    elif title:
        cell.suptitle(title, x=0.0, ha="left", **strong)
    if panel.note:
        note = "\n".join(wrapped(panel.note, room))
        cell.supxlabel(note, x=0.0, ha="left", fontsize=SIZE, color=GREY)
    return cell.subplots()


def _draw(axes: Any, panel: Panel) -> None:
    """Draw the data of a panel, and the labels of its axes."""
    axes.clear()
    axes.tick_params(**TICK)  # ticks are made when the figure is drawn, perhaps under other settings
    inner = width_of(axes)
    panel.draw(axes)
    axes.set_xlabel("\n".join(wrapped(panel.x, inner)))
    axes.set_ylabel("\n".join(wrapped(panel.y, panel.tall(inner) + TALLER)))


def into(axes: Any, panel: Panel) -> Figure:
    """Draw a panel into the user's axes, with title and legend of Matplotlib; return their figure."""
    figure: Any = axes.get_figure(root=True)
    inner = width_of(axes)
    panel.draw(axes)
    axes.set_title("\n".join(wrapped(panel.title, inner)), loc="left", fontsize=SIZE, color=GREY)
    axes.set_xlabel(panel.x)
    axes.set_ylabel(panel.y)
    if panel.key:
        axes.legend(handles=[_handle(entry) for entry in panel.key], loc="best")
    return figure


def _handle(entry: Entry, text: str = "") -> Any:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    label = text or entry.text
    return Patch(label=label, **entry.style) if entry.patch else Line2D([], [], label=label, **entry.style)


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


def first_of(every: Sequence[Any], most: int, what: str) -> tuple[Sequence[Any], str]:
    """The first of what could be shown, and a note: how many others `what`, or ""."""
    more = len(every) - most
    return every[:most], f"{more} {what}" if more > 0 else ""


def _lines(row: Row, inner: float) -> tuple[list[str], list[str], float, float]:
    """Lines of a label and of its numbers, how far below the label's top these begin, and the height; mm."""
    taken = width(row.text) + BETWEEN if row.text else 0.0
    if taken < BESIDE * inner:
        label = wrapped(row.label, inner - taken, SIZE, row.strong)
        return label, [row.text], 0.0, line() * len(label)
    label, text = wrapped(row.label, inner, SIZE, row.strong), wrapped(row.text, inner)
    return label, text, line() * len(label), line() * (len(label) + len(text))


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
        return sum(_lines(row, inner)[-1] + LANE + SPACE for row in rows) or 5.0

    def draw(axes: Any) -> None:
        inner, top, middles = width_of(axes), 0.0, []
        for row in rows:
            label, text, below, tall = _lines(row, inner)
            _write(axes, label, 0, top, row.strong)
            _write(axes, text, 0 if below else 1, top + below)
            middles.append(top + tall + 0.5 * LANE)
            top += tall + LANE + SPACE
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
