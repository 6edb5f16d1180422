"""Figures from panels: places of title, axes, legends, labels and notes, from the widths of their text.

Sizes are in mm, so that a figure of 80 mm has the same text as one of 160 mm; panels that are beside each
other in a wide figure are below each other in a narrow one. There is no second pass for a layout.

Widths of text in mm, and text wrapped to a width: what keeps labels inside a figure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from bayescal.reporting.figures.palette import DPI, GREY, INK, LARGER, SIZE, TICK

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


def baseline(k: int, size: float = SIZE) -> float:
    """From the top of a block of lines to the baseline of line k (from 0), mm."""
    return ASCENT * size * MM_PER_PT + k * line(size)


def wrapped(text: str, room: float, size: float = SIZE, bold: bool = False) -> list[str]:
    """Lines of a text that are at most `room` mm wide; a word that is wider is divided."""
    out: list[str] = []
    for paragraph in text.split("\n"):
        out += _filled(_pieces(paragraph.split(), room, size, bold), room, size, bold) or [""]
    return out


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


def _filled(words: list[str], room: float, size: float, bold: bool) -> list[str]:
    lines: list[str] = []
    for word in words:
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and width(longer, size, bold) <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


WIDTH = 160.0
"""Width of a figure, mm."""
NARROW = 120.0
"""Below this width every panel has a row of its own."""
EDGE, GAP, GUTTER = 2.0, 3.0, 4.0
"""Margin of a figure, between its rows, between its columns."""
TICKS, AXIS = 15.0, 4.2
"""Room for the y axis (label and tick labels), and for the tick labels of the x axis."""
TALLER = 8.0
"""Length of the label of a y axis beyond that of the axis, mm."""
HANDLE, COLUMN = 6.0, 3.0
"""Room for the sign of an entry of a legend, and between its columns."""
MM_PER_INCH = 25.4

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
        Draws the data into axes of a given width, mm.
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

    draw: Callable[[Any, float], None]
    height: Height
    title: str = ""
    x: str = ""
    y: str = ""
    note: str = ""
    key: Sequence[Entry] = field(default=())
    share: float = 1.0
    inset: float = 1.0

    def tall(self, inner: float) -> float:
        """Height of axes of a width, mm."""
        return self.height(inner) if callable(self.height) else self.height


@dataclass(frozen=True)
class _Cell:
    """A panel at its place: `room` is the width of the axes, and what is above and below them, mm."""

    panel: Panel
    x: float
    left: float
    room: float
    side: list[str]
    title: list[str]
    note: list[str]
    x_label: list[str]
    columns: int
    key: list[str]
    above: float
    below: float
    tall: float


def sheet(title: Sequence[str], rows: Sequence[Sequence[Panel]], wide: float = WIDTH) -> Figure:
    """A figure of panels.

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

    large = SIZE + LARGER
    heading = [part for text in title for part in wrapped(text, wide - 2 * EDGE, large, bold=True)]
    if wide < NARROW:
        rows = [[panel] for row in rows for panel in row]
    placed = [_row(row, wide) for row in rows]
    top = EDGE + (len(heading) * line(large) + 0.5 * GAP if heading else 0.0)
    tall = top + sum(_height(row) + GAP for row in placed) + EDGE - GAP
    out = Figure(figsize=(wide / MM_PER_INCH, tall / MM_PER_INCH), dpi=DPI)
    FigureCanvasAgg(out)
    for k, text in enumerate(heading):
        y = 1 - (EDGE + baseline(k, large)) / tall
        out.text(EDGE / wide, y, text, fontsize=large, fontweight="bold", color=INK)
    for row in placed:
        above = max(c.above for c in row)
        for cell in row:
            cell = replace(cell, above=above)
            start = top + above
            axes = out.add_axes(
                (cell.x / wide, 1 - (start + cell.tall) / tall, cell.room / wide, cell.tall / tall)
            )
            _fill(axes, cell)
        top += _height(row) + GAP
    return out


def _height(row: Sequence[_Cell]) -> float:
    """Height of a row whose axes begin at the same height, mm."""
    return max(cell.above for cell in row) + max(cell.tall + cell.below for cell in row)


def width_of(axes: Any) -> float:
    """The width of axes, mm."""
    figure: Any = axes.figure
    return float(axes.get_window_extent().width / figure.dpi * MM_PER_INCH)


def into(axes: Any, panel: Panel) -> Figure:
    """Draw a panel into the user's axes, with title and legend of Matplotlib; return their figure."""
    figure: Any = axes.get_figure(root=True)
    inner = width_of(axes)
    panel.draw(axes, inner)
    axes.set_title("\n".join(wrapped(panel.title, inner)), loc="left", fontsize=SIZE, color=GREY)
    axes.set_xlabel(panel.x)
    axes.set_ylabel(panel.y)
    if panel.key:
        axes.legend(handles=[_handle(entry) for entry in panel.key], loc="best")
    return figure


def _row(row: Sequence[Panel], wide: float) -> list[_Cell]:
    free = wide - 2 * EDGE - GUTTER * (len(row) - 1)
    total = sum(panel.share for panel in row)
    out, x = [], EDGE
    for panel in row:
        room = free * panel.share / total
        out.append(_cell(panel, x, room))
        x += room + GUTTER
    return out


def _cell(panel: Panel, x: float, room: float) -> _Cell:
    side = wrapped(panel.y, panel.tall(room) + TALLER) if panel.y else []
    left = TICKS + (len(side) - 1) * line() if side else panel.inset
    inner = room - left - max(2.0, panel.inset)
    title = wrapped(panel.title, room, bold=True) if panel.title else []
    note = wrapped(panel.note, room) if panel.note else []
    key = ["\n".join(wrapped(entry.text, room - HANDLE - 1.0)) for entry in panel.key]
    widest = max((width(part) for text in key for part in text.split("\n")), default=0.0)
    columns = max(min(int((room + COLUMN) / (widest + HANDLE + COLUMN)), len(key)), 1)
    deep = _legend_height(key, columns)
    above = len(title) * line() + deep + (2.4 if key else 1.5 if title else 1.0)
    labels = wrapped(panel.x, inner) if panel.x else []
    below = (AXIS if panel.x else 0.5) + len(labels) * line() + len(note) * line() + (0.8 if note else 0.0)
    return _Cell(
        panel, x + left, left, inner, side, title, note, labels, columns, key, above, below, panel.tall(inner)
    )


def _legend_height(key: Sequence[str], columns: int) -> float:
    """Height of a legend that is filled column by column."""
    each = -(-len(key) // columns)
    parts = [key[k * each : (k + 1) * each] for k in range(columns)]
    return max((sum(1 + text.count("\n") for text in part) for part in parts), default=0) * (line() + 0.5)


def _fill(axes: Any, cell: _Cell) -> None:
    """Draw the data of a panel, then its text at places in mm from the axes."""
    from matplotlib.transforms import ScaledTranslation

    panel = cell.panel
    axes.tick_params(**TICK)  # ticks are made when the figure is drawn, perhaps under other settings
    panel.draw(axes, cell.room)
    figure: Any = axes.figure

    def at(dx: float, dy: float) -> Any:
        """Axes coordinates moved by mm."""
        return axes.transAxes + ScaledTranslation(dx / MM_PER_INCH, dy / MM_PER_INCH, figure.dpi_scale_trans)

    def write(lines: Sequence[str], x: float, dx: float, top: float, **style: Any) -> None:
        """Lines from `top` mm above the lower end of the axes downwards, at a fraction x of the axes."""
        for k, text in enumerate(lines):
            axes.text(x, 0, text, transform=at(dx, top - baseline(k)), **style)

    write(cell.title, 0, -cell.left, cell.tall + cell.above, color=INK, fontweight="bold")
    if panel.key:
        _legend(axes, cell, at)
    below = -AXIS if panel.x else -0.5
    write(cell.x_label, 0.5, 0, below, ha="center")
    write(cell.note, 0, -cell.left, below - len(cell.x_label) * line() - 0.4, color=GREY)
    for k, text in enumerate(cell.side):
        axes.text(
            0, 0.5, text, transform=at(-cell.left + 0.2 + k * line(), 0), rotation=90, ha="left", va="center"
        )


def _legend(axes: Any, cell: _Cell, at: Callable[[float, float], Any]) -> None:
    legend = axes.legend(
        handles=[_handle(e, text) for e, text in zip(cell.panel.key, cell.key, strict=True)],
        loc="upper left",
        bbox_to_anchor=(0, 1),
        bbox_transform=at(-cell.left, cell.above - 0.8 - len(cell.title) * line()),
        ncols=cell.columns,
        borderpad=0,
        borderaxespad=0,
        handlelength=(HANDLE - 2.0) / (SIZE * 25.4 / 72),
        handletextpad=0.4,
        columnspacing=COLUMN / (SIZE * 25.4 / 72),
        labelspacing=0.2,
    )
    legend.set_in_layout(False)


def _handle(entry: Entry, text: str = "") -> Any:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    label = text or entry.text
    return Patch(label=label, **entry.style) if entry.patch else Line2D([], [], label=label, **entry.style)
