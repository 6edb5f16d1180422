"""Figures of the documentation with Matplotlib's own axes: title, size, text that is readable on a screen."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayescal.reporting.style import GREY, INK

TINTS = ("#1b4f72", "#d68910", "#3a8f6b", "#8e5ea2", "#5b8db8", "#a0522d")
"""Colours of series."""
DPI = 130
TITLE = 8.5
"""Characters of a title per inch of width."""


def figure(width: float, height: float, title: Sequence[str]) -> Figure:
    """A new figure (inches), not registered with pyplot, with its title lines."""
    out = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(out)
    lines = [part for line in title for part in textwrap.wrap(line, round(TITLE * width))]
    out.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=13, color=INK, fontweight="bold")
    return out


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
