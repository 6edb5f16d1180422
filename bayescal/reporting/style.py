"""Colours, markers, text sizes and settings of figures.

Colours differ in lightness, so that they differ in grey and for colour-blind readers; series also differ in
their marker. Text has its size at the width of the figure: a figure is drawn anew for another width.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from contextlib import AbstractContextManager
from io import BytesIO
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#22313f"
GREY = "#7b8794"
FAINT = "#c3ccd5"
NOISE = "#edf1f5"
ACCENT = "#1b4f72"
MARKED = "#c0392b"
TINTS = ("#1b4f72", "#d68910", "#3a8f6b", "#8e5ea2", "#5b8db8", "#a0522d")
"""Colours of series of a `figure`; those of records have `SERIES`."""
SCREEN_DPI = 130
TITLE = 8.5
"""Characters of a title per inch of width."""
SERIES = ("#12355b", "#b4441f", "#2f9e83", "#e0a526")
"""Colours of series, from dark to light; more series repeat them with other markers."""
MARKERS = ("o", "s", "D", "^", "v", "P", "X")
HOLLOW = {"markerfacecolor": "white"}
"""Of open markers."""
SIZE = 7.0
"""Text, pt; titles of a figure are larger by `LARGER`."""
LARGER = 1.5
DPI = 200

PLAIN_TEXT: dict[str, Any] = {"text.parse_math": False}
"""Names from files may contain $."""
_SETTINGS: dict[str, Any] = PLAIN_TEXT | {
    "font.size": SIZE, "text.color": INK,
    "axes.edgecolor": GREY, "axes.labelcolor": INK, "axes.labelsize": SIZE, "axes.linewidth": 0.6,
    "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True, "axes.unicode_minus": True,
    "axes.formatter.useoffset": False, "axes.formatter.limits": (-6, 7), "grid.color": FAINT,
    "grid.linewidth": 0.4, "legend.fontsize": SIZE, "legend.frameon": False, "lines.linewidth": 1.2,
    "lines.solid_capstyle": "butt", "lines.markersize": 3.5,
}  # fmt: skip
TICK = {"labelsize": SIZE, "length": 2.5, "width": 0.6, "pad": 2.0, "color": GREY, "labelcolor": INK}
"""Parameters of the ticks of axes."""


def drawing(settings: dict[str, Any] = _SETTINGS) -> AbstractContextManager[None]:
    """Settings of Matplotlib under which all figures are drawn and written; the user's are left alone."""
    from matplotlib.style import context

    return context(["default", settings])


def figure(width: float, height: float, title: Sequence[str]) -> Figure:
    """A new figure (inches), not registered with pyplot, with its title lines."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    out = Figure(figsize=(width, height), dpi=SCREEN_DPI, layout="constrained")
    FigureCanvasAgg(out)
    lines = [part for line in title for part in textwrap.wrap(line, round(TITLE * width))]
    out.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=13, color=INK, fontweight="bold")
    return out


FAST = {"compress_level": 3}
"""Compression of PNG: half the time of the default, for a tenth more bytes."""


def png(figure: Figure) -> bytes:
    """A figure as PNG, without a date.

    `savefig` draws a figure that has or had a layout engine twice, the first time for the layout alone. The
    same pixels come in less time from axes that are placed before and a canvas that draws once.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
    out = BytesIO()
    FigureCanvasAgg(figure).print_png(out, metadata={"Software": None}, pil_kwargs=FAST)
    return out.getvalue()


def tidy(axes: Any) -> None:
    """Remove the upper and right frame; set text sizes that are readable at 1200 pixels."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9.5, colors=INK)
    axes.title.set_fontsize(10.5)
    axes.title.set_color(GREY)
    for side in ("left", "right"):
        axes.set_title(axes.get_title(side), loc=side, fontsize=10.5, color=GREY)
    axes.xaxis.label.set(fontsize=10, color=INK)
    axes.yaxis.label.set(fontsize=10, color=INK)
    for text in axes.texts:
        text.set_fontsize(9)
    legend = axes.get_legend()
    for text in legend.get_texts() if legend else ():
        text.set_fontsize(9.5)
