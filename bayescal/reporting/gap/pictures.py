"""Figures of a diagnosis: probabilities of the effects, model levels, residuals; `arm` draws the locations.

Each function takes a `Gap` and returns a figure, also where the session lacks some of the data.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.gap.result import VALIDATION_CONTACTS, VALIDATION_POINTS, Gap
from bayescal.reporting.gap.arm import draw_where
from bayescal.reporting.gap.lengths import length, main, per_residual
from bayescal.reporting.gap.phrases import headline
from bayescal.reporting.shared.style import ACCENT, FAINT, GREY, INK, NOISE, SERIES, figure, remark, tidy
from bayescal.reporting.shared.text import UM, model_label, probability, rival, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_EFFECTS = 12
MOST_SETS = 6
MOST_TARGETS = 6
FEW = 3
"""Effects of a set that its label lists one by one."""
LABEL = 26
"""Characters in a line of a label."""
CLIP = 0.99
"""Quantile of the absolute residuals that an axis covers; larger ones are marked at its edge."""


def draw_which(gap: Gap) -> Figure:
    """Probabilities of the noise-only model, of an unmodelled effect and of every effect."""
    verdict = gap.verdict
    out = figure(12, 5.2, headline(gap))
    left, right = out.subplots(1, 2, width_ratios=(1.15, 1))
    always = {"null", "unknown", *verdict.credible_set90}
    ranked = sorted(verdict.probability.items(), key=lambda item: item[1])
    shown = [(n, p) for n, p in ranked if n in always or p >= 0.001][-MOST_EFFECTS:]
    inside = [n in verdict.credible_set90 for n, _ in shown]
    left.barh(
        range(len(shown)), [p for _, p in shown], color=[ACCENT if i else FAINT for i in inside], height=0.65
    )
    for k, (_, p) in enumerate(shown):
        left.annotate(probability(p), (p, k), (5, 0), textcoords="offset points", va="center", color=INK)
    left.set_yticks(range(len(shown)), [rival(n) for n, _ in shown])
    left.set_xlim(0, 1.12)
    left.set_xticks(np.linspace(0, 1, 6))
    left.set_xlabel("probability (effects may be present together)")
    left.set_title("effects; dark: 90 % set", loc="left")
    missing = len(verdict.missing)
    if missing:
        remark(left, f"not assessed: {', '.join(verdict.missing)}", 0.99, 0.03, "right")
    sets = verdict.hypotheses[:MOST_SETS][::-1]
    right.barh(range(len(sets)), [h.probability for h in sets], color=GREY, height=0.65)
    for k, h in enumerate(sets):
        text = f"{probability(h.probability)}   ({h.log_evidence:+.0f} nats)"
        right.annotate(text, (h.probability, k), (5, 0), textcoords="offset points", va="center", color=INK)
    right.set_yticks(range(len(sets)), set_labels([h.effects for h in verdict.hypotheses[:MOST_SETS]])[::-1])
    right.set_xlim(0, 1.4)
    right.set_xticks(np.linspace(0, 1, 6))
    right.set_xlabel("probability (log evidence relative to noise only)")
    right.set_title("sets of effects, the most probable first", loc="left")
    for axes, count in ((left, len(shown)), (right, len(sets))):
        axes.set_ylim(count - max(count, 5) - 0.6, max(count, 1) - 0.4)
        tidy(axes)
    return out


def set_labels(sets: Sequence[Sequence[str]]) -> list[str]:
    """Sets of effects in few lines each: where they are long, as the differences from the first."""
    if max((len(effects) for effects in sets), default=0) <= FEW:
        return ["\n+ ".join(rival(n) for n in effects) or rival("null") for effects in sets]
    first = sets[0]
    out = []
    for effects in sets:
        less = [f"without {rival(n)}" for n in first if n not in effects]
        more = [f"with {rival(n)}" for n in effects if n not in first]
        out.append(textwrap.fill(", ".join([*more, *less]), LABEL) or f"the {len(first)} most probable")
    return out


def draw_levels(gap: Gap) -> Figure:
    """Validation errors of the model levels, from the nominal model to the named effects."""
    out = figure(12, 5.0, ["Validation error of the model levels"])
    axes = out.subplots()
    at = np.arange(len(gap.levels))
    series = (
        (VALIDATION_CONTACTS, "o", [length(main(gap), s.validation_rms) for s in gap.levels]),
        ("sphere distances", "s", [s.distance_rms for s in gap.levels]),
        (VALIDATION_POINTS, "D", [length("points", s.point_rms) for s in gap.levels]),
    )
    drawn = [(w, m, UM * np.array(v)) for w, m, v in series if np.any(np.isfinite(v))]
    points_only = len(drawn) > 1 and np.allclose(drawn[0][2], drawn[-1][2], equal_nan=True)
    shown = drawn[1:] if points_only else drawn
    for k, (what, marker, values) in enumerate(shown):
        axes.plot(at, values, marker=marker, color=SERIES[k], lw=1.6, ms=7, label=what)
        for j in np.flatnonzero(np.isfinite(values)):
            v = values[j]
            top = v >= np.nanmax([other[j] for _, _, other in shown])
            text = f"{v:.1f}" if v < 100 else f"{v:.0f}"
            axes.annotate(text, (j, v), (9, 5 if top else -13), textcoords="offset points", color=SERIES[k])
    one, what = length(main(gap), UM), "contact" if main(gap) == VALIDATION_CONTACTS else "point"
    noise = one * gap.magnitude.noise
    axes.axhspan(*(one * np.array(gap.magnitude.noise_interval95)), color=NOISE, lw=0)
    axes.axhline(noise, color=GREY, lw=1.2, ls="--", label=f"noise of a {what}, {noise:.1f} µm (95 %)")
    for s in gap.shrinkage:
        if s.what == "distances":
            axes.axhline(
                UM * s.floor,
                color=SERIES[1],
                lw=1,
                ls=":",
                label=f"expected RMS of a distance for a correct model, {UM * s.floor:.1f} µm",
            )
    axes.set_yscale("log")
    axes.set_ylabel("RMS error (µm)")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "235" else "")
    axes.set_xticks(at, [_level(gap, k) for k in range(len(at))])
    axes.set_xlim(-0.4, max(len(at) - 1, 0) + 0.6)
    axes.legend(frameon=False, loc="upper right")
    axes.grid(axis="y", color=NOISE)
    tidy(axes)
    return out


def _level(gap: Gap, k: int) -> str:
    """A model level by what it adds to the one before."""
    step = gap.levels[k]
    before = gap.levels[k - 1].model if k else ()
    if len(before) > 1 and step.model[: len(before)] == before and step.model != before:
        return "\n".join(f"+ {short(name)}" for name in step.model[len(before) :])
    return model_label(step.model).replace(" + ", "\n+ ")


def draw_residuals(gap: Gap) -> Figure:
    """Residuals over time, before and after the refit, each with its histogram and the noise."""
    rows, before, after = gap.residuals
    m = gap.dataset.measurements
    same = np.allclose(before, after)
    lines = ["Residuals of the fitted contacts" + ("" if same else ", before and after the refit")]
    out = figure(12, 3.9 if same else 6.6, lines)
    grid = out.subplots(1 if same else 2, 2, width_ratios=(3.2, 1), sharey=True, squeeze=False)
    x = rows + 1.0 if m.time is None else (m.time[rows] - np.min(m.time)) / 60.0
    both = UM * np.concatenate([before, after])
    edge = 1.15 * max(float(np.quantile(np.abs(both), CLIP)), 3.2 * UM * gap.magnitude.noise)
    bins = np.linspace(-edge, edge, 45)
    values = [before] if same else [before, after]
    baseline = model_label(gap.baseline)
    named = " + ".join((baseline, *(n.effect for n in gap.verdict.named)))
    inside = np.max(np.abs(UM * np.array(values)), axis=0) <= edge  # the same rows before and after
    beyond = f", without {np.sum(~inside)} outside the axis" if not np.all(inside) else ""
    each = per_residual(gap)
    for k, r in enumerate(values):
        along, across = grid[k]
        _in_order(gap, along, x, UM * r, edge, legend=k == 0)
        rms = UM * np.sqrt(np.mean(r[inside] ** 2))
        along.set_title(f"{(baseline, named)[k]}: RMS {rms:.1f} µm{each}{beyond}", loc="left")
        across.hist(UM * r, bins=bins, orientation="horizontal", color=SERIES[0], alpha=0.75, density=True)
        fine, sd = np.linspace(-edge, edge, 200), UM * gap.magnitude.noise
        bell = np.exp(-0.5 * (fine / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
        across.plot(bell, fine, color=INK, lw=1.3, label=f"noise, {sd:.1f} µm")
        across.set_xticks([])
        across.legend(frameon=False, loc="upper right", handlelength=1.2)
        along.set_ylabel(f"residual{each} (µm)")
        for axes in (along, across):
            axes.set_ylim(-edge, edge)
            tidy(axes)
    grid[-1][0].set_xlabel("row" if m.time is None else "time (min)")
    grid[-1][1].set_xlabel("density (band: 2 x noise)")
    return out


def _in_order(gap: Gap, axes: Any, x: np.ndarray, r: np.ndarray, edge: float, legend: bool) -> None:
    rows = gap.residuals[0]
    target = gap.dataset.measurements.target[rows]
    groups = np.unique(target)
    noise = UM * gap.magnitude.noise
    axes.axhspan(-2 * noise, 2 * noise, color=NOISE, lw=0, zorder=0)
    few = len(groups) <= MOST_TARGETS
    beyond = np.abs(r) > edge
    for k, t in enumerate(groups):
        mine = target == t
        colour = SERIES[k % len(SERIES)] if few else SERIES[0]
        name = gap.dataset.targets[t].name if few and len(groups) > 1 else None
        axes.scatter(x[mine & ~beyond], r[mine & ~beyond], s=11, color=colour, label=name, lw=0, alpha=0.85)
        for side, marker in ((1, "^"), (-1, "v")):
            out = mine & beyond & (np.sign(r) == side)
            axes.scatter(x[out], np.full(out.sum(), side * 0.97 * edge), s=26, color=colour, marker=marker)
    if legend and few and len(groups) > 1:
        axes.legend(
            frameon=False, ncols=len(groups), loc="lower right", bbox_to_anchor=(1.0, 0.98),
            handletextpad=0.0, columnspacing=0.8, markerscale=1.8, borderpad=0.0,
        )  # fmt: skip


PICTURES: dict[str, Callable[[Gap], Figure]] = {
    "gap-where.png": draw_where,
    "gap-which.png": draw_which,
    "gap-levels.png": draw_levels,
    "gap-residuals.png": draw_residuals,
}
"""File name of each figure and the function that draws it."""
