"""Colours, sizes and text styles of figures."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

INK = "#22313f"
GREY = "#7b8794"
FAINT = "#c3ccd5"
NOISE = "#edf1f5"
ACCENT = "#1b4f72"
MARKED = "#c0392b"
SERIES = ("#1b4f72", "#d68910", "#3a8f6b", "#8e5ea2", "#5b8db8", "#a0522d")
DPI = 130
TITLE = 8.5
"""Characters of a title per inch of width."""


def figure(width: float, height: float, title: Sequence[str]) -> Figure:
    """A new figure (inches), not registered with pyplot, with its title lines."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    out = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(out)
    lines = [part for line in title for part in textwrap.wrap(line, round(TITLE * width))]
    out.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=13, color=INK, fontweight="bold")
    return out


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG.

    `savefig` draws a figure that has or had a layout engine twice, the first time for the layout alone. The
    same pixels come in less time from axes that are placed before and a canvas that draws once.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    for text in figure.findobj(Text):  # names from files may contain $; labels of ticks are none
        if "$" in text.get_text() and "\\mathdefault" not in text.get_text():
            text.set_parse_math(False)
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
    FigureCanvasAgg(figure).print_png(path)


def tidy(axes: Any) -> None:
    """Remove the upper and right frame; set text sizes that are readable at 1200 pixels."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9.5, colors=INK)
    axes.title.set_fontsize(10.5)
    axes.title.set_color(GREY)
    for at in ("left", "right"):
        axes.set_title(axes.get_title(at), loc=at, fontsize=10.5, color=GREY)
    axes.xaxis.label.set(fontsize=10, color=INK)
    axes.yaxis.label.set(fontsize=10, color=INK)
    for text in axes.texts:
        text.set_fontsize(9)
    legend = axes.get_legend()
    for text in legend.get_texts() if legend else ():
        text.set_fontsize(9.5)
