"""Estimates of the parameters against their priors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.figures import scales
from bayescal.reporting.figures.palette import ACCENT, GREY, NOISE, SERIES
from bayescal.reporting.figures.scales import LANE, Row, rows_panel, upright
from bayescal.reporting.figures.sheet import MM_PER_PT, Entry, Panel, width_of
from bayescal.reporting.shared.text import with_u
from bayescal.storage.reading import Json

MOST = 48
"""Parameters that are shown, the first of the model."""
STYLES: dict[str, Any] = {
    "determined": ("identifiable", {"color": ACCENT, "marker": "o", "ls": "", "ms": 3.5}),
    "partly": ("weakly identifiable", {"color": SERIES[1], "marker": "s", "ls": "", "ms": 4}),
    "prior_only": (
        "not identifiable",
        {"markeredgecolor": GREY, "markerfacecolor": "white", "marker": "D", "ls": "", "ms": 4},
    ),
}
"""Lists of fit.json, their text and their marks."""


def chosen(record: Json, names: Sequence[str] = ()) -> list[Json]:
    """Parameters of the arm (or those named), without the poses of targets."""
    every = record["parameters"]
    if names:
        by_name = {p["name"]: p for p in every}
        return [by_name[name] for name in names]
    return [p for p in every if p["effect"] != "target"]


def parameter_panels(record: Json, names: Sequence[str] = ()) -> list[Panel]:
    """Deviations from the prior mean over the prior standard deviation, in one or two columns."""
    every = chosen(record, names)
    shown = every[:MOST]
    level = {name: key for key in STYLES for name in record["identifiability"][key]}
    used = [key for key in STYLES if any(level.get(p["name"], "determined") == key for p in shown)]
    key = [Entry(*STYLES[k]) for k in used]
    key += [
        Entry("95 % interval", {"color": ACCENT, "lw": 1.6}),
        Entry("prior, ± 2 standard deviations", {"color": NOISE}, True),
    ]
    most = max((abs(v) for p in shown for v in scaled(p)), default=1.0)
    edge = max(2.3, 1.08 * most)
    half = -(-len(shown) // 2)
    parts = [shown[:half], shown[half:]] if len(shown) > 6 else [shown]
    more = len(every) - len(shown)
    note = f"{more} further parameters are not shown" if more else ""
    return [
        _panel(part, level, edge, key if k == 0 else (), note if k == len(parts) - 1 else "")
        for k, part in enumerate(parts)
    ]


def scaled(p: Json) -> tuple[float, float, float]:
    """Ends of the 95 % interval and the estimate, as deviations from the prior mean over the prior sd."""
    mean = p.get("prior_mean", p["nominal"])
    low, high = p["interval95"]
    sd = p["prior_sd"] or 1.0
    return (low - mean) / sd, (high - mean) / sd, (p["estimate"] - mean) / sd


def _panel(shown: Sequence[Json], level: Json, edge: float, key: Sequence[Entry], note: str) -> Panel:
    rows = [
        Row(p["name"], f"{with_u(p['estimate'], p['sd'])} {unit_label(p['unit'])}".strip().replace("-", "−"))
        for p in shown
    ]

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        low, high, estimate = np.array([scaled(p) for p in shown]).T
        middle, of = np.array(middles), np.array([level.get(p["name"], "determined") for p in shown])
        axes.hlines(middle, -2, 2, color=NOISE, lw=LANE / MM_PER_PT, zorder=0)
        upright(axes, 0.0, middles, {"color": GREY, "lw": 0.6})
        for name, (_, style) in STYLES.items():
            mine, colour = of == name, style.get("color", style.get("markeredgecolor"))
            axes.hlines(middle[mine], low[mine], high[mine], color=colour, lw=1.6, zorder=2)
            axes.plot(estimate[mine], middle[mine], zorder=3, **style)
        axes.set_xlim(-edge, edge)
        scales.linear(axes.xaxis, width_of(axes))

    x = "(estimate − prior mean) / prior standard deviation"
    return rows_panel(rows, lanes, "", x, note, key)
