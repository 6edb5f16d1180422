"""Figures of a score: each function takes records and results and returns a figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.blind.assessed import Record, false_names
from analysis.blind.rates import value
from analysis.blind.rows import bands
from analysis.blind.shrunk import FAR, MEASURES, factors
from analysis.charts import TINTS, figure, tidy
from bayescal.reporting.style import ACCENT, FAINT, GREY, INK, MARKED, NOISE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Found = Mapping[str, Any]
KINDS = {"null": "noise only", "single": "one effect", "pair": "two effects", "outside": "outside"}
NOTHING, OTHER, UNSURE = "noise only", "unmodelled", "ambiguous"
VERDICTS = {"null": NOTHING, "unknown": OTHER, "named+unexplained": OTHER, "ambiguous": UNSURE}
MEASURED = {"planes": "validation planes", "distances": "sphere distances", "points": "points of a tracker"}
BESIDE = "only the other effect"
"""Answer to an effect of a pair of which only the other was named."""


def draw_lambda(records: Sequence[Record], found: Found) -> Figure:
    """Correct answers by lambda with intervals: one effect, each of two, not in the list of known effects."""
    del records
    out = figure(12, 4.6, ["Share of correct answers by detectability"])
    single = found["single"]
    panels: tuple[tuple[str, Any, Any, Sequence[float]], ...] = (
        ("one effect: named, no false name", single["right"], single["wrong_name"], (0.9, 0.9, 0.98)),
        ("two effects: each named", found["each_of_two"], None, (0.93, 0.93, 0.93)),
        ("not in the list of known effects: flagged", found["outside_flagged"], None, (0.9,)),
    )
    for axes, (title, right, wrong, wanted) in zip(out.subplots(1, 3, sharey=True), panels, strict=True):
        at = np.arange(len(right))[-len(wanted) :]
        axes.hlines(wanted, at - 0.45, at + 0.45, color=INK, lw=1.4, ls=":", label="required")
        _shares(axes, right, ACCENT, "correct")
        if wrong is not None:
            _shares(axes, wrong, MARKED, "a false name", shift=0.18)
        for k, share in enumerate(right):
            axes.text(k, -0.05, f"n {share['count']}", ha="center", va="top", color=GREY)
        axes.set_xticks(range(len(right)), [words.replace(" to ", "-") for words in bands()], rotation=25)
        axes.set_ylim(-0.13, 1.04)
        axes.set_xlim(-0.6, len(right) - 0.4)
        axes.set_yticks(np.linspace(0, 1, 6))
        axes.grid(axis="y", color=NOISE)
        axes.set_xlabel("detectability λ = contacts × (visible RMS / noise)²")
        axes.set_title(title, loc="left")
        if wrong is not None:
            axes.legend(frameon=False, loc="center right", bbox_to_anchor=(1.0, 0.4))
        tidy(axes)
    out.axes[0].set_ylabel("share of sessions (bars: Wilson 95 %)")
    return out


def _shares(axes: Any, shares: Sequence[Found], colour: str, words: str, shift: float = 0.0) -> None:
    shown = [(k + shift, value(s), s["interval95"]) for k, s in enumerate(shares) if s["count"]]
    for k, share, (low, high) in shown:
        axes.plot([k, k], [low, high], color=colour, lw=5, alpha=0.25, solid_capstyle="butt")
        axes.plot(k, share, "o", color=colour, ms=7)
    axes.plot([k for k, _, _ in shown], [share for _, share, _ in shown], color=colour, lw=1.2, label=words)


def draw_reliability(records: Sequence[Record], found: Found) -> Figure:
    """Stated probabilities and observed frequencies; log scores of the answers and of base rates."""
    del records
    out = figure(12, 5.4, ["Reliability of the stated probabilities"])
    left, right = out.subplots(1, 2, width_ratios=(1.25, 1))
    left.plot([0, 1], [0, 1], color=GREY, lw=1, ls="--")
    for b in found["reliability"]:
        low, high = b["band95"]
        inside = low <= b["held"] <= high
        left.plot([b["said"]] * 2, [low, high], color=FAINT, lw=11, solid_capstyle="butt", zorder=1)
        left.plot(b["said"], b["held"], "o", color=ACCENT if inside else MARKED, ms=8, zorder=3)
        last = b is found["reliability"][-1] and len(found["reliability"]) > 1
        offset, side = (
            ((0, 9), "center") if last else ((-12, -12), "right") if b["said"] > 0.5 else ((12, -3), "left")
        )
        left.annotate(f"n {b['count']}", (b["said"], b["held"]), offset, textcoords="offset points", ha=side,
                      color=GREY)  # fmt: skip
    left.set_xlim(-0.02, 1.05)
    left.set_ylim(-0.02, 1.08)
    left.set_xlabel("stated probability (mean of a bin)")
    left.set_ylabel("observed frequency")
    left.set_title("noise only, unmodelled effect, every effect; grey: binomial 95 %", loc="left")
    left.grid(color=NOISE)
    kinds = (found["log_score"] or {"kinds": {}})["kinds"]
    shown = [(KINDS[kind], s) for kind, s in kinds.items() if s["count"]][::-1]
    for shift, key, colour, words in ((0.2, "mean", ACCENT, "answers"), (-0.2, "base", FAINT, "base rates")):
        at = np.arange(len(shown)) + shift
        values = [s[key] for _, s in shown]
        right.barh(at, values, height=0.36, color=colour, label=words)
        for y, v in zip(at, values, strict=True):
            right.annotate(f"{v:.2f}", (v, y), (-4, 0), textcoords="offset points", ha="right", va="center",
                           color=INK)  # fmt: skip
    right.set_yticks(range(len(shown)), [f"{words}\n({s['count']} sessions)" for words, s in shown])
    lowest = min([-1.0, *(s[key] for _, s in shown for key in ("mean", "base"))])
    right.set_xlim(1.18 * lowest, 0)
    right.set_xlabel("mean log probability of the ground truth (nats)")
    right.set_title("log score", loc="left")
    right.legend(frameon=False, loc="lower left")
    for axes in (left, right):
        tidy(axes)
    return out


def draw_shrinkage(records: Sequence[Record], found: Found) -> Figure:
    """Ratios of validation errors after / before the refit: predicted from fitted data, and achieved."""
    out = figure(12, 6.0, ["Validation RMS, after / before the refit: predicted and achieved"])
    shown = [what for what in MEASURES if what != "points" or factors(records, what)]
    for axes, what in zip(out.subplots(1, len(shown)), shown, strict=True):
        words = MEASURED[what]
        own = factors(records, what)
        every = [x for _, said, done in own for x in (said, done)] or [0.5, 1.0]
        ends = np.array([min(every) / 1.15, max(every) * 1.15])
        axes.fill_between(ends, ends / FAR, ends * FAR, color=NOISE, lw=0, label=f"within a factor {FAR:g}")
        axes.plot(ends, ends, color=GREY, lw=1, ls="--")
        for exact, colour, marker, label in (
            (True, ACCENT, "o", "verdict correct"),
            (False, TINTS[1], "D", "verdict incorrect"),
        ):
            mine = [(said, done) for r, said, done in own if r["right"] == exact]
            x, y = np.array(mine).reshape(-1, 2).T
            axes.scatter(
                x, y, s=30, color=colour, marker=marker, alpha=0.75, lw=0, label=f"{label} ({len(mine)})"
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(*ends)
        axes.set_ylim(*ends)
        axes.set_aspect("equal")
        ticks = [
            t for t in (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0) if ends[0] <= t <= ends[1]
        ]
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_ticks(ticks, [f"{t:g}" for t in ticks])
            axis.set_ticks([], minor=True)
        s = found["predicted"][what]
        text = (
            f": median {s['median']:.2f} of predicted, {100 * s['near']:.0f} % within a factor 1.3"
            if own
            else ""
        )
        axes.set_title(words + text, loc="left")
        axes.set_xlabel("predicted from fitted measurements")
        axes.set_ylabel("achieved")
        axes.legend(frameon=False, loc="upper left")
        tidy(axes)
    return out


def draw_confusion(records: Sequence[Record], found: Found) -> Figure:
    """Answers to every effect, to noise only and to effects not in the list of known effects."""
    del found
    counts = Counter(pair for r in records for pair in said_of(r))
    there = Counter(true for r in records for true in dict(said_of(r)))
    names = sorted({name for r in records for name in (*r["effects"], *r["named"])} - {"unknown"})
    rows = [NOTHING, *names, OTHER]
    columns = [NOTHING, UNSURE, BESIDE, *names, OTHER]
    rows = [row for row in rows if any(true == row for true, _ in counts)]
    out = figure(
        12, 1.6 + 0.36 * max(len(rows), 4), ["Confusion matrix: ground truth (rows), answer (columns)"]
    )
    axes = out.subplots()
    table = np.array([[counts[row, column] for column in columns] for row in rows]).reshape(-1, len(columns))
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    good = np.array([row == column for row in rows for column in columns], bool).reshape(share.shape)
    for chosen, cmap in ((good, "Blues"), (~good, "Oranges")):
        shown = np.ma.masked_where(~chosen | (share == 0), share)
        axes.imshow(shown, cmap=cmap, vmin=-0.15, vmax=1.3, aspect="auto")
    for y, x in zip(*np.nonzero(table), strict=True):
        ink = "white" if good[y, x] and share[y, x] > 0.6 else INK
        axes.text(x, y, str(table[y, x]), ha="center", va="center", color=ink)
    axes.set_xticks(range(len(columns)), columns, rotation=40, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(rows)), [f"{row} ({there[row]})" for row in rows])
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color=NOISE)
    axes.tick_params(which="both", length=0)
    axes.set_title("blue: correct; orange: incorrect; darker: larger share of the row", loc="left")
    tidy(axes)
    axes.spines[:].set_visible(False)
    return out


def said_of(r: Record) -> list[tuple[str, str]]:
    """Pairs of ground truth and answer: the name, else a false name, else the verdict."""
    there: dict[str, list[str]] = {"null": [NOTHING], "outside": [OTHER]}
    true = there[r["kind"]] if r["kind"] in there else r["effects"]
    if r["kind"] == "outside" and r["right"]:
        return [(OTHER, OTHER)]
    wrong, out = false_names(r), []
    for name in true:
        beside = [BESIDE] if r["named"] else [VERDICTS.get(r["verdict"], UNSURE)]
        out += [(name, said) for said in ([name] if name in r["named"] else wrong or beside)]
    return out


PICTURES: dict[str, Callable[[Sequence[Record], Found], Figure]] = {
    "blind-lambda.png": draw_lambda,
    "blind-reliability.png": draw_reliability,
    "blind-shrinkage.png": draw_shrinkage,
    "blind-confusion.png": draw_confusion,
}
"""File name of each figure and the function that draws it."""
