"""Colours, markers and text sizes of figures, and the settings under which they are drawn.

Colours differ in lightness, so that they differ in grey and for colour-blind readers; series also differ in
their marker. Text has its size at the width of the figure: a figure is drawn anew for another width.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bayescal.reporting.shared.style import ACCENT, FAINT, GREY, INK, MARKED, NOISE

__all__ = [
    "ACCENT",
    "DPI",
    "FAINT",
    "GREY",
    "INK",
    "MARKED",
    "MARKERS",
    "NOISE",
    "SERIES",
    "SIZE",
    "TICK",
    "drawing",
]

SERIES = ("#12355b", "#b4441f", "#2f9e83", "#e0a526")
"""Colours of series, from dark to light; more series repeat them with other markers."""
MARKERS = ("o", "s", "D", "^", "v", "P", "X")
SIZE = 7.0
"""Text, pt; titles of a figure are larger by `LARGER`."""
LARGER = 1.5
DPI = 200

_SETTINGS: dict[str, Any] = {
    "font.size": SIZE,
    "text.color": INK,
    "text.parse_math": False,  # names from files may contain $
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.labelsize": SIZE,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-6, 7),
    "grid.color": FAINT,
    "grid.linewidth": 0.4,
    "legend.fontsize": SIZE,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "butt",
    "lines.markersize": 3.5,
    "svg.hashsalt": "bayescal",
    "svg.fonttype": "path",
}
TICK = {"labelsize": SIZE, "length": 2.5, "width": 0.6, "pad": 2.0, "color": GREY, "labelcolor": INK}
"""Parameters of the ticks of axes."""


@contextmanager
def drawing() -> Iterator[None]:
    """Settings of Matplotlib under which all figures are drawn and written; the user's are left alone."""
    from matplotlib.style import context

    styles: list[Any] = ["default", _SETTINGS]
    with context(styles):
        yield
