"""Colours, markers, text sizes and settings of figures.

Colours differ in lightness, so that they differ in grey and for colour-blind readers; series also differ in
their marker. Text has its size at the width of the figure: a figure is drawn anew for another width.
"""

from __future__ import annotations

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
SERIES = ("#12355b", "#b4441f", "#2f9e83", "#e0a526")
"""Colours of series, from dark to light; more series repeat them with other markers."""
MARKERS = ("o", "s", "D", "^", "v", "P", "X")
HOLLOW = {"markerfacecolor": "white"}
"""Of open markers."""
SIZE = 7.0
"""Text, pt; titles of a figure are larger by `LARGER`."""
LARGER = 1.5
DPI = 200

_SETTINGS: dict[str, Any] = {
    "text.parse_math": False,  # names from files may contain $
    "font.size": SIZE, "text.color": INK,
    "axes.edgecolor": GREY, "axes.labelcolor": INK, "axes.labelsize": SIZE, "axes.linewidth": 0.6,
    "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True, "axes.unicode_minus": True,
    "axes.formatter.useoffset": False, "axes.formatter.limits": (-6, 7), "grid.color": FAINT,
    "grid.linewidth": 0.4, "legend.fontsize": SIZE, "legend.frameon": False, "lines.linewidth": 1.2,
    "lines.solid_capstyle": "butt", "lines.markersize": 3.5,
}  # fmt: skip
TICK = {"labelsize": SIZE, "length": 2.5, "width": 0.6, "pad": 2.0, "color": GREY, "labelcolor": INK}
"""Parameters of the ticks of axes."""


def drawing() -> AbstractContextManager[None]:
    """Settings of Matplotlib under which all figures are drawn and written; the user's are left alone."""
    from matplotlib.style import context

    return context(["default", _SETTINGS])


FAST = {"compress_level": 3}
"""Compression of PNG: half the time of the default, for a tenth more bytes."""


def png(figure: Figure) -> bytes:
    """A figure as PNG, without a date: drawn once, as `savefig` does not where axes were laid out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    out = BytesIO()
    FigureCanvasAgg(figure).print_png(out, metadata={"Software": None}, pil_kwargs=FAST)
    return out.getvalue()
