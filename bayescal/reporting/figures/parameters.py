"""Estimates of the parameters against their priors; from draws, posteriors and correlated pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayescal.reporting.figures import scales
from bayescal.reporting.figures.scales import LANE, Row, rows_panel, upright
from bayescal.reporting.figures.sheet import MM_PER_PT, Entry, Panel, width_of
from bayescal.reporting.shared.style import ACCENT, GREY, INK, NOISE, SERIES
from bayescal.reporting.shared.text import measured, with_unit
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


def of_arm(record: Json) -> list[Json]:
    """Parameters of the arm, without the poses of targets."""
    return [p for p in record["parameters"] if p["effect"] != "target"]


def parameter_panels(record: Json) -> list[Panel]:
    """Deviations from the prior mean over the prior standard deviation, in one or two columns."""
    every = of_arm(record)
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
    mean, (low, high) = p["prior_mean"], p["interval95"]
    sd = p["prior_sd"] or 1.0
    return (low - mean) / sd, (high - mean) / sd, (p["estimate"] - mean) / sd


def _panel(shown: Sequence[Json], level: Json, edge: float, key: Sequence[Entry], note: str) -> Panel:
    rows = [Row(p["name"], measured(p["estimate"], p["sd"], p["unit"]).replace("-", "−")) for p in shown]

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        low, high, estimate = np.array([scaled(p) for p in shown]).T
        middle, of = np.array(middles), np.array([level.get(p["name"], "determined") for p in shown])
        axes.hlines(middle, -2, 2, color=NOISE, lw=LANE / MM_PER_PT, zorder=0)
        upright(axes, 0.0, middles, {"color": GREY, "lw": 0.6})
        for name, (_, style) in STYLES.items():
            mine, colour = of == name, style.get("color", style.get("markeredgecolor"))
            axes.hlines(middle[mine], low[mine], high[mine], color=colour, lw=1.6, zorder=2)
            axes.plot(estimate[mine], middle[mine], zorder=3, **style)
        scales.linear_x(axes, -edge, edge)

    x = "(estimate − prior mean) / prior standard deviation"
    return rows_panel(rows, lanes, "", x, note, key)


Draws = Mapping[str, np.ndarray]
"""Draws (chains, draws) of parameters by name, in the units of the record."""
WEAKEST, PAIRS = 6, 3
"""Parameters and pairs that are shown where none are named."""
HEIGHT, SQUARE = 24.0, 34.0
"""Of the axes of a distribution and of a pair, mm."""
BINS, POINTS = 40, 600
INSET = 7.5
"""Half a tick label of many digits, mm."""
EACH = 20.0
"""Room of a tick label, mm: values with many digits."""

PRIOR: dict[str, Any] = {"color": SERIES[1], "lw": 1.2, "ls": "--"}
INTERVAL: dict[str, Any] = {"color": INK, "lw": 2.4, "solid_capstyle": "butt"}


def weakest(record: Json) -> list[str]:
    """Names of the parameters of the arm about which the data say least, first the weakly identifiable."""
    return [p["name"] for p in sorted(of_arm(record), key=lambda p: p["contraction"])][:WEAKEST]


def pairs_of(record: Json, names: Sequence[str]) -> list[Json]:
    """The most strongly correlated pairs: of all parameters of the arm, or of those named."""
    return [c for c in record["correlations"] if not names or {c["a"], c["b"]} <= set(names)][:PAIRS]


def marginal_panel(p: Json, draws: np.ndarray, first: bool) -> Panel:
    """Histogram of the draws of a parameter, its 95 % interval and the density of its prior."""
    key = (
        Entry("posterior", {"color": ACCENT, "alpha": 0.45}, True),
        Entry("prior", PRIOR),
        Entry("95 % interval", INTERVAL),
    )

    def draw(axes: Any) -> None:
        flat = draws.ravel()
        # one polygon: a rectangle for every bin takes a quarter of the time of the figure
        heights = axes.hist(flat, BINS, density=True, color=ACCENT, alpha=0.45, histtype="stepfilled")[0]
        low, high = (float(v) for v in np.quantile(flat, [0.001, 0.999]))
        pad = 0.1 * (high - low) or 1e-9
        top = 1.12 * float(np.max(heights))
        x = np.linspace(low - pad, high + pad, 200)
        mean, sd = p["prior_mean"], p["prior_sd"]
        if sd:
            axes.plot(x, np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi)), **PRIOR)
        axes.plot(p["interval95"], [0.03 * top] * 2, **INTERVAL)
        axes.set_ylim(0, top)
        scales.without_y(axes)
        scales.linear_x(axes, low - pad, high + pad, EACH)

    return Panel(draw, HEIGHT, "", label(p), key=key if first else (), inset=INSET)


def pair_panel(a: Json, b: Json, r: float, draws: Draws) -> Panel:
    """Draws of two parameters."""

    def draw(axes: Any) -> None:
        x, y = draws[a["name"]].ravel(), draws[b["name"]].ravel()
        some = np.linspace(0, len(x) - 1, min(len(x), POINTS)).astype(int)
        axes.plot(x[some], y[some], ls="", marker="o", ms=1.4, mew=0, color=ACCENT, alpha=0.5)
        axes.axvline(float(np.mean(x)), color=GREY, lw=0.5, zorder=0)
        axes.axhline(float(np.mean(y)), color=GREY, lw=0.5, zorder=0)
        scales.linear(axes.xaxis, width_of(axes), EACH)
        scales.linear(axes.yaxis, SQUARE, scales.UP)

    return Panel(draw, SQUARE, f"correlation {r:+.2f}".replace("-", "−"), label(a), label(b), inset=INSET)


def label(p: Json) -> str:
    """A parameter with its unit."""
    return with_unit(p["name"], p["unit"])


def posterior_rows(record: Json, draws: Draws, names: Sequence[str] = ()) -> list[list[Panel]]:
    """Panels of the parameters, and of their most correlated pairs, three in a row."""
    by_name = {p["name"]: p for p in record["parameters"]}
    shown = list(names) or weakest(record)
    one = [marginal_panel(by_name[n], draws[n], k == 0) for k, n in enumerate(shown)]
    two = [pair_panel(by_name[c["a"]], by_name[c["b"]], c["r"], draws) for c in pairs_of(record, names)]
    return [part[k : k + 3] for part in (one, two) for k in range(0, len(part), 3)]
