"""Posterior distributions of parameters with their priors, and pairs of correlated parameters, from draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.figures import scales
from bayescal.reporting.figures.palette import ACCENT, GREY, INK, SERIES
from bayescal.reporting.figures.sheet import Entry, Panel, width_of
from bayescal.storage.reading import Json

Draws = Mapping[str, np.ndarray]
"""Draws (chains, draws) of parameters by name, in the units of the record."""
MOST, PAIRS = 6, 3
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


def weakest(record: Json, count: int = MOST) -> list[str]:
    """Names of the parameters of the arm about which the data say least, first the weakly identifiable."""
    of_arm = [p for p in record["parameters"] if p["effect"] != "target"]
    return [p["name"] for p in sorted(of_arm, key=lambda p: p["contraction"])][:count]


def pairs_of(record: Json, names: Sequence[str] = (), count: int = PAIRS) -> list[tuple[str, str, float]]:
    """The most strongly correlated pairs: of all parameters of the arm, or of those named."""
    every = [(c["a"], c["b"], c["r"]) for c in record.get("correlations", ())]
    return [c for c in every if not names or {c[0], c[1]} <= set(names)][:count]


def marginal_panel(p: Json, draws: np.ndarray, first: bool) -> Panel:
    """Histogram of the draws of a parameter, its 95 % interval and the density of its prior."""
    key = (
        Entry("posterior", {"color": ACCENT, "alpha": 0.45}, True),
        Entry("prior", PRIOR),
        Entry("95 % interval", INTERVAL),
    )

    def draw(axes: Any, inner: float) -> None:
        flat = draws.ravel()
        # one polygon: a rectangle for every bin takes a quarter of the time of the figure
        heights = axes.hist(flat, BINS, density=True, color=ACCENT, alpha=0.45, histtype="stepfilled")[0]
        low, high = (float(v) for v in np.quantile(flat, [0.001, 0.999]))
        pad = 0.1 * (high - low) or 1e-9
        axes.set_xlim(low - pad, high + pad)
        top = 1.12 * float(np.max(heights))
        x = np.linspace(low - pad, high + pad, 200)
        mean, sd = p["prior_mean"] if "prior_mean" in p else p["nominal"], p["prior_sd"]
        if sd:
            axes.plot(x, np.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * np.sqrt(2 * np.pi)), **PRIOR)
        axes.plot(p["interval95"], [0.03 * top] * 2, **INTERVAL)
        axes.set_ylim(0, top)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        scales.linear(axes.xaxis, width_of(axes), EACH)

    return Panel(draw, HEIGHT, "", label(p), key=key if first else (), inset=INSET)


def pair_panel(a: Json, b: Json, r: float, draws: Draws) -> Panel:
    """Draws of two parameters."""

    def draw(axes: Any, inner: float) -> None:
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
    unit = unit_label(p["unit"])
    return f"{p['name']} ({unit})" if unit else str(p["name"])


def posterior_rows(record: Json, draws: Draws, names: Sequence[str] = ()) -> list[list[Panel]]:
    """Panels of the parameters, and of their most correlated pairs, three in a row."""
    by_name = {p["name"]: p for p in record["parameters"]}
    shown = list(names) or weakest(record)
    one = [marginal_panel(by_name[n], draws[n], k == 0) for k, n in enumerate(shown)]
    two = [pair_panel(by_name[a], by_name[b], r, draws) for a, b, r in pairs_of(record, names)]
    return [part[k : k + 3] for part in (one, two) for k in range(0, len(part), 3)]
