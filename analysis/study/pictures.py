"""Three pictures: z-scores by quantity, coverage at every level, distance errors of the model levels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from scipy.stats import beta, norm

from analysis.study.figures import COVERAGE, COVERED, PUBLISHED_MM, inside, maximum
from analysis.study.session import LEVELS, Record

NAMES = ("study-z-scores.png", "study-coverage.png", "study-errors.png")
DOTS = 150  # per inch
INK, FAINT = "#222222", "#9aa0a6"
COLOURS = ("#b2182b", "#8c6bb1", "#e08214", "#2166ac")  # of each level
KINDS = {
    "parameters": "#2166ac",
    "sphere distances": "#b2182b",
    "sphere diameters": "#4d9221",
    "validation contacts": "#8073ac",
}
SYMBOLS = {"alpha": r"\alpha", "beta": r"\beta", "theta": r"\theta"}
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


def draw(records: Sequence[Record], found: dict[str, Any], folder: Path) -> None:
    """Write all pictures into a folder."""
    done = [r for r in records if "refused" not in r]
    with mpl.rc_context(STYLE):
        for name, make in zip(NAMES, (_z_scores, _coverage, _errors), strict=True):
            make(done, found).savefig(folder / name, dpi=DOTS, facecolor="white")


def label(name: str) -> str:
    """A quantity's name as it is set: Greek letters, subscripts."""
    if name.startswith("compliance "):
        return f"compliance {name.split()[1]}"
    if name.startswith("ball "):
        return name
    parts = []
    for part in name.split(" + "):
        letters, index = part.rstrip("0123456789"), part[len(part.rstrip("0123456789")) :]
        parts.append(rf"${SYMBOLS.get(letters, letters)}_{{{index}}}$")
    return " + ".join(parts)


def _z_scores(done: Sequence[Record], found: dict[str, Any]) -> Figure:
    z, names = np.array([r["z"] for r in done]), done[0]["names"]
    figure = Figure(figsize=(9.0, 6.2))
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    rng = np.random.default_rng(0)
    left.axvspan(-1.96, 1.96, color="#2166ac", alpha=0.08, lw=0)
    left.axvline(0, color=FAINT, lw=0.8)
    for row, (name, own) in enumerate(zip(names, z.T, strict=True)):
        left.plot(
            own, row + rng.uniform(-0.22, 0.22, len(own)), ".", ms=4.5, color="#2166ac", alpha=0.6, mew=0
        )
        q = found["z_scores"]["by_quantity"][name]
        left.errorbar(q["mean"], row, xerr=q["sd"], fmt="o", ms=3.2, color=INK, elinewidth=1.1, capsize=2)
        left.text(
            4.15, row, f"{q['mean']:+.2f}  {q['sd']:.2f}", va="center", fontsize=7.5, family="monospace"
        )
    left.text(4.15, -1.1, " mean   sd", fontsize=7.5, family="monospace", va="center")
    left.set(
        xlim=(-4.1, 4.1),
        ylim=(len(names) - 0.4, -0.7),
        yticks=range(len(names)),
        yticklabels=map(label, names),
    )
    left.tick_params(axis="y", length=0)
    left.set_xlabel("z-score: (estimate − truth) / stated standard deviation")
    left.set_title(f"{len(done)} sessions a row; black: mean and sd")
    _quantiles(right, np.sort(np.array([r["independent_z"] for r in done]).ravel()), found)
    return figure


def _quantiles(axes: Axes, scores: np.ndarray, found: dict[str, Any]) -> None:
    """Quantiles of the independent scores less those of the normal, with pointwise 95 % bands."""
    rank = np.arange(1, len(scores) + 1)
    expected = norm.ppf((rank - 0.5) / len(scores))
    low, high = (norm.ppf(beta.ppf(p, rank, len(scores) + 1 - rank)) for p in (0.025, 0.975))
    axes.fill_between(
        expected,
        low - expected,
        high - expected,
        color=FAINT,
        alpha=0.35,
        lw=0,
        label="95 % of sampling, pointwise",
    )
    axes.axhline(0, color=INK, lw=0.8)
    axes.plot(
        expected, scores - expected, color="#2166ac", lw=1.2, label=f"{len(scores)} scores made independent"
    )
    p = found["z_scores"]["independent"]["ks_p_value"]
    axes.set(xlim=(-3.6, 3.6), ylim=(-1.0, 1.0))
    axes.set_xlabel("quantile of the standard normal")
    axes.set_ylabel("quantile of the z-scores, less that of the normal")
    axes.set_title(f"pooled: Kolmogorov-Smirnov p = {p:.2f}")
    axes.legend(loc="upper left", fontsize=8)


def _coverage(done: Sequence[Record], found: dict[str, Any]) -> Figure:
    figure = Figure(figsize=(9.0, 4.0))
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    levels = np.linspace(0.02, 0.99, 98)
    left.axhline(0, color=INK, lw=0.8)
    for name, key in COVERED.items():
        places = [r[key] for r in done]
        hits = np.array([inside(places, level).mean(axis=1) for level in levels])
        mean, error = hits.mean(axis=1), hits.std(axis=1, ddof=1) / np.sqrt(len(done))
        off = 100 * (mean - levels)
        left.fill_between(
            100 * levels, off - 196 * error, off + 196 * error, color=KINDS[name], alpha=0.12, lw=0
        )
        left.plot(100 * levels, off, color=KINDS[name], lw=1.4, label=name)
    left.set(xlim=(0, 100), ylim=(-13, 13))
    left.set_xlabel("level of the central interval, %")
    left.set_ylabel("intervals that hold the truth, less their level, %")
    left.set_title("all levels; bands: 95 %, over sessions")
    left.legend(loc="lower left", fontsize=8, ncols=2)
    right.axvline(100 * COVERAGE, color=INK, lw=0.8)
    for row, (name, c) in enumerate(found["coverage"].items()):
        low, high = (100 * v for v in c["binomial95_if_independent"])
        right.barh(row, high - low, left=low, height=0.5, color=FAINT, alpha=0.35, lw=0)
        at, (below, above) = 100 * c["inside"], (100 * v for v in c["band95"])
        right.plot([below, above], [row, row], color=KINDS[name], lw=1.6)
        right.plot(at, row, "o", color=KINDS[name], ms=5)
        said = f"{at:.1f} %\nof {c['count']}"
        aside = right.get_yaxis_transform()
        right.text(1.01, row, said, transform=aside, va="center", fontsize=8, color=KINDS[name])
    right.set(yticks=range(len(COVERED)), yticklabels=COVERED, ylim=(len(COVERED) - 0.5, -0.7))
    right.margins(x=0.15)
    right.tick_params(axis="y", length=0)
    right.set_xlabel("95 % intervals that contain the truth, %")
    right.set_title("bar: 95 % band over sessions; grey: binomial")
    return figure


def _errors(done: Sequence[Record], found: dict[str, Any]) -> Figure:
    figure = Figure(figsize=(9.0, 4.0))
    left, right = figure.subplots(1, 2, sharey=True)
    for level, colour in zip(LEVELS, COLOURS, strict=True):
        _steps(left, 1e-3 * maximum(done, level), colour, level)
        every = np.abs(np.concatenate([r["distance_error_um"][level] for r in done]))
        _steps(right, 1e-3 * every, colour, level)
    for level, published in PUBLISHED_MM.items():
        colour = COLOURS[LEVELS.index(level)]
        left.axvline(published, color=colour, lw=1.0, ls=(0, (4, 3)))
        left.text(published, 1.03, f"{published:.3f}", color=colour, fontsize=8, ha="center", va="bottom")
    right.plot([], [], color=FAINT, lw=1.0, ls=(0, (4, 3)), label="a real arm\n(Joubair, Bonev 2015)")
    left.set(xlabel="largest sphere distance error of a session, mm", ylabel="share of sessions or distances")
    left.set_title(f"{len(done)} sessions", pad=12)
    right.set(xlabel="error of a sphere distance, absolute, mm", xlim=(6e-5, 6.0))
    right.set_title(f"{sum(len(r['distance_pit']) for r in done)} distances", pad=12)
    for axes in (left, right):
        axes.set(xscale="log", ylim=(0, 1.02))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.grid(axis="x", which="major", color="#e4e6e8", lw=0.8)
        axes.set_axisbelow(True)
    right.legend(loc="upper left", fontsize=8)
    return figure


def _steps(axes: Axes, values: np.ndarray, colour: str, name: str) -> None:
    x = np.sort(values)
    axes.step(
        np.append(x[0], x), np.arange(len(x) + 1) / len(x), where="post", color=colour, lw=1.6, label=name
    )
