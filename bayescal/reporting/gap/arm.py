"""`gap-where.png`: the largest locations, the arm with its probed points, residuals and fitted functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.arm import chain as reference
from bayescal.effects.location import ARTEFACT, BASE, PROBE, TOOL, Site
from bayescal.gap.result import Curve, Gap, Place
from bayescal.model.scene import Scene
from bayescal.reporting.gap.lengths import per_residual
from bayescal.reporting.gap.phrases import headline, place, unexplained
from bayescal.reporting.shared.style import ACCENT, FAINT, GREY, INK, MARKED, NOISE, figure, tidy
from bayescal.reporting.shared.text import MM, UM

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLACES = 7
EVENT = "event"
"""Kind of driver of a sudden change: at whichever site it is seen, it is one event."""
CURVES = 3
SIGNIFICANT = 0.01
AXIS = 0.07
"""Half the length of the line that marks the axis of a joint, m."""
FEW_VALUES = 3
BINS = 18
SMOOTH = 0.05
"""Fitted values whose mean square step along x is below this share of their variance are drawn as a line."""


def draw_where(gap: Gap) -> Figure:
    """Above: bars of the largest locations, the arm. Below: residuals over the coordinates they depend on."""
    import matplotlib

    curves = drawn_curves(gap.where)
    out = figure(12, 9.0 if curves else 5.4, headline(gap))
    parts: Any = out.subfigures(
        1 + bool(curves), 1, height_ratios=(1.35, 1)[: 1 + bool(curves)], squeeze=False
    )
    upper = parts[0, 0]
    bars = upper.add_subplot(1, 2, 1)
    _bars(gap, bars)
    tidy(bars)
    with matplotlib.rc_context({"grid.color": NOISE, "grid.linewidth": 0.7}):
        arm = upper.add_subplot(1, 2, 2, projection="3d")
    _arm(gap, arm)
    if curves:
        row = parts[1, 0].subplots(1, len(curves), squeeze=False)[0]
        for k, (axes, w) in enumerate(zip(row, curves, strict=True)):
            _curve(axes, w, first=k == 0)
            tidy(axes)
    return out


def drawn_curves(places: Sequence[Place]) -> list[Place]:
    """Significant locations whose functions are drawn, each event once."""
    out: list[Place] = []
    for w in places:
        event = w.driver.kind == EVENT and any(own.driver.kind == EVENT for own in out)
        if len(w.curve.x) and w.family_p_value < SIGNIFICANT and not event:
            out.append(w)
    return out[:CURVES]


def _bars(gap: Gap, axes: Any) -> None:
    shown = gap.where[:PLACES][::-1]
    sizes = [UM * w.rms for w in shown]
    colours = [ACCENT if w.family_p_value < SIGNIFICANT else FAINT for w in shown]
    axes.barh(range(len(shown)), sizes, color=colours, height=0.62)
    for k, w in enumerate(shown):
        text = f"{UM * w.rms:.1f}"
        if np.isfinite(w.share) and w.family_p_value < SIGNIFICANT:
            text += f"  ({100 * w.share:.0f} %)"
        if w.explained_by:
            text += f"  {w.explained_by}"
        axes.annotate(text, (UM * w.rms, k), (5, 0), textcoords="offset points", va="center", color=INK)
    axes.set_yticks(range(len(shown)), [place(w).replace(", ", "\n", 1) for w in shown])
    axes.set_xlim(0, 1.6 * max(sizes, default=1.0))
    axes.set_xlabel(f"RMS of the explained residuals{per_residual(gap)} (µm)")
    axes.set_ylim(-0.7, max(len(shown), 4) - 0.3)
    title = "locations; none is significant"
    if any(w.family_p_value < SIGNIFICANT for w in shown):
        title = "locations and share of the excess; pale: not significant"
    axes.set_title(title, loc="left")


def _arm(gap: Gap, axes: Any) -> None:
    """The nominal arm in a pose of the session, the site marked, contacts coloured by residual."""
    scene = Scene(gap.dataset)
    rows, before, _ = gap.residuals
    points = scene.points[rows]
    size = UM * before
    edge = max(float(np.quantile(np.abs(size), 0.97)), 1e-3)
    shown = axes.scatter(
        *(MM * points.T),
        c=size,
        cmap="RdBu_r",
        vmin=-edge,
        vmax=edge,
        s=13,
        lw=0.25,
        edgecolors=GREY,
        depthshade=False,
        clip_on=False,
    )
    readings = gap.dataset.measurements.readings[rows]
    scale = np.maximum(np.std(readings, axis=0), 1e-6)
    pose = rows[int(np.argmin(np.sum(((readings - np.median(readings, axis=0)) / scale) ** 2, axis=1)))]
    frames = reference.frames(scene.chain, scene.q[pose : pose + 1])[0]
    joints, ball = frames[1:-1], scene.points[pose]
    line = np.vstack([frames[0, :3, 3], *(f[:3, 3] for f in joints), frames[-1, :3, 3], ball])
    axes.plot(*(MM * line.T), color=INK, lw=3, alpha=0.75, solid_capstyle="round", solid_joinstyle="round")
    site = _site(gap)
    number = site.number if site else 0
    axis_lines: list[np.ndarray] = []
    for k, frame in enumerate(joints, start=1):
        stroke = np.outer([-AXIS, AXIS], frame[:3, 2]) + frame[:3, 3]
        axis_lines.append(stroke)
        marked = k == number
        axes.plot(
            *(MM * stroke.T), color=MARKED if marked else ACCENT, lw=7 if marked else 4, solid_capstyle="butt"
        )
    axes.scatter(*(MM * ball), s=30, color=INK)
    if site:
        _mark(gap, axes, site, line, points)
    _equal(axes, MM * np.vstack([line, points, *axis_lines]))
    bar = axes.figure.colorbar(shown, ax=axes, shrink=0.62, pad=0.09, aspect=26)
    bar.set_label("residual (µm)", fontsize=10, color=INK)
    bar.ax.tick_params(labelsize=9, colors=INK)
    bar.outline.set_visible(False)


def _site(gap: Gap) -> Site | None:
    """The site to mark: of the first named effect, else of the unmodelled effect, else the largest."""
    if gap.verdict.kind == "null":
        return None
    chosen = unexplained(gap) if gap.verdict.kind == "unknown" else next(iter(gap.where), None)
    own = gap.verdict.named[0].sites if gap.verdict.named else ()
    return own[0] if own else chosen.site if chosen else None


def _mark(gap: Gap, axes: Any, site: Site, line: np.ndarray, points: np.ndarray) -> None:
    """Label the site in the figure: joint, link, base, stylus tip or the contacts of a target."""
    above = 0.16 * float(np.max(np.ptp(np.vstack([line, points]), axis=0))) * np.array([0, 0, 1])
    names = [t.name for t in gap.dataset.targets]
    mine = gap.dataset.measurements.target[gap.residuals[0]]
    number = site.number
    if number:
        if site.kind == "link":
            axes.plot(*(MM * line[number : number + 2].T), color=MARKED, lw=6, alpha=0.8)
        at = line[number]
    elif site.name in names:
        chosen = points[mine == names.index(site.name)]
        at = chosen.mean(axis=0)
        axes.scatter(*(MM * chosen.T), s=46, facecolors="none", edgecolors=MARKED, lw=0.7)
    elif site in (TOOL, PROBE):
        at = line[-1]
        axes.plot(*(MM * line[-2:].T), color=MARKED, lw=6, alpha=0.8)
    elif site == ARTEFACT:
        at = points.mean(axis=0)
    else:
        at = line[0]
        if site == BASE:
            axes.scatter(*(MM * at), s=120, color=MARKED, marker="s")
    axes.text(
        *(MM * (at + above)), str(site), color=MARKED, fontsize=11, fontweight="bold", ha="center",
        bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.5}, zorder=100,
    )  # fmt: skip


def _equal(axes: Any, corners: np.ndarray) -> None:
    low, high = corners.min(axis=0), corners.max(axis=0)
    half = 0.5 * np.maximum(high - low, 0.3 * float(np.max(high - low)))
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_zlim(middle[2] - half[2], middle[2] + half[2])
    axes.set_box_aspect(half, zoom=1.05)
    axes.view_init(elev=18, azim=-62)
    for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_pane_color((1, 1, 1, 0))
        axis.line.set_color(GREY)
        axis.set_label_text(f"{name} (mm)", fontsize=9, color=GREY)
        axis.set_major_locator(_locator())
        axis.set_tick_params(labelsize=8, labelcolor=GREY)


def _locator() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(4)


def _curve(axes: Any, w: Place, first: bool) -> None:
    """Residuals over the coordinate of a location, and the part that it explains."""
    curve = w.curve
    if curve.lever is not None and curve.coordinate and np.any(curve.lever):
        _displacement(axes, w, first)
        return
    x, residual, fitted = curve.x.astype(float), UM * curve.residual, UM * curve.fitted
    values = np.unique(x)
    if len(values) <= FEW_VALUES:  # two or three values: spread the contacts so that they do not overlap
        x = x + 0.12 * np.ptp(values) * np.random.default_rng(0).uniform(-1, 1, len(x))
        axes.set_xticks(values)
    axes.scatter(x, residual, s=9, color=FAINT, lw=0, label="residual")
    order = np.argsort(x, kind="stable")
    colour = MARKED if w.family_p_value < SIGNIFICANT else GREY
    if is_line(curve):
        axes.plot(x[order], fitted[order], color=colour, lw=2, label="explained")
    else:
        axes.scatter(x, fitted, s=9, color=colour, lw=0, alpha=0.9, label="explained")
    edge = 1.15 * max(float(np.quantile(np.abs(residual), 0.99)), float(np.max(np.abs(fitted))))
    axes.set_ylim(-edge, edge)
    axes.axhline(0, color=FAINT, lw=0.8, zorder=0)
    axes.set_xlabel(curve.coordinate or "contact")
    axes.set_title(place(w), loc="left")
    if first:
        axes.set_ylabel("residual (µm)")
        axes.legend(frameon=False, loc="upper right", handletextpad=0.3, markerscale=2)


def _displacement(axes: Any, w: Place, first: bool) -> None:
    """Displacement of the site over the coordinate: residuals of a bin fitted on their lever arms.

    The lever arms of the contacts differ in size and sign, so that raw residuals do not show it.
    """
    curve = w.curve
    assert curve.lever is not None
    x, lever = curve.x.astype(float), curve.lever
    values = np.unique(x)
    if len(values) <= BINS:
        edges = np.append(values, np.inf)
    else:
        edges = np.append(np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))[:-1], np.inf)
    at = np.searchsorted(edges, x, side="right") - 1
    weight = np.bincount(at, lever**2, len(edges) - 1)
    seen = weight > 1e-3 * np.max(weight)
    divide = np.where(seen, weight, 1.0)
    middle = np.bincount(at, x, len(edges) - 1) / np.maximum(np.bincount(at, minlength=len(edges) - 1), 1)
    noise = float(np.std(curve.residual - curve.fitted))
    measured = UM * np.bincount(at, lever * curve.residual, len(edges) - 1) / divide
    explained = UM * np.bincount(at, lever * curve.fitted, len(edges) - 1) / divide
    error = 2.0 * UM * noise / np.sqrt(divide)
    colour = MARKED if w.family_p_value < SIGNIFICANT else GREY
    axes.errorbar(
        middle[seen],
        measured[seen],
        error[seen],
        fmt="o",
        ms=4,
        lw=1,
        color=ACCENT,
        alpha=0.75,
        label="measured, k = 2",
    )
    axes.plot(middle[seen], explained[seen], color=colour, lw=2, label="explained")
    axes.axhline(0, color=FAINT, lw=0.8, zorder=0)
    axes.set_xlabel(curve.coordinate)
    axes.set_title(place(w), loc="left")
    axes.set_ylabel(_displaced(w.site, curve.unit))
    if first:
        axes.legend(frameon=False, loc="best", handletextpad=0.3)


def _displaced(site: Site, unit: str) -> str:
    """Axis label; the error of a joint is an error of its link angle, whatever the sign of its reading."""
    if unit != "rad":
        return f"displacement of {site} (µm)"
    return f"link angle error of {site} (µrad)" if site.kind == "joint" else f"rotation of {site} (µrad)"


def is_line(curve: Curve) -> bool:
    """Whether the fitted values are nearly a function of the coordinate alone."""
    order = np.argsort(curve.x, kind="stable")
    fitted = curve.fitted[order]
    variance = float(np.var(fitted))
    return len(fitted) > 2 and variance > 0 and float(np.mean(np.diff(fitted) ** 2)) < SMOOTH * variance
