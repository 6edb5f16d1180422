"""Bars in rows: probabilities, locations of an error, components of a budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayescal.reporting.figures import scales
from bayescal.reporting.figures.palette import ACCENT, FAINT, GREY
from bayescal.reporting.figures.rows import LANE, Row, rows_panel
from bayescal.reporting.figures.sheet import Entry, Panel, width_of

if TYPE_CHECKING:
    pass

FILLED: dict[str, Any] = {"facecolor": ACCENT, "edgecolor": ACCENT, "lw": 0.5}
OPEN: dict[str, Any] = {"facecolor": "white", "edgecolor": GREY, "lw": 0.8}
HATCHED: dict[str, Any] = {"facecolor": FAINT, "edgecolor": GREY, "lw": 0.5, "hatch": "//////"}
"""Styles of bars that differ in grey."""


@dataclass(frozen=True)
class Bar:
    """A bar: label, length, its value as text, and its style."""

    label: str
    value: float
    text: str
    style: dict[str, Any]
    strong: bool = False


def bars_panel(
    bars: Sequence[Bar],
    title: str = "",
    x: str = "",
    note: str = "",
    key: Sequence[Entry] = (),
    end: float | None = None,
    share: float = 1.0,
) -> Panel:
    """Bars from zero to their values; `end` is the end of the axis."""

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        from matplotlib.patches import Rectangle

        for middle, bar in zip(middles, bars, strict=True):
            corner = (0.0, middle - 0.4 * LANE)
            axes.add_patch(Rectangle(corner, bar.value, 0.8 * LANE, zorder=2, **bar.style))
        last = end or 1.05 * max((bar.value for bar in bars), default=1.0) or 1.0
        axes.set_xlim(0, last)
        scales.linear(axes.xaxis, width_of(axes))

    return rows_panel([Row(b.label, b.text, b.strong) for b in bars], lanes, title, x, note, key, share)
