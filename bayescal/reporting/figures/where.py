"""Locations of an error: RMS of what they explain, and the residuals over the coordinates they depend on.

Bars in rows: probabilities, locations of an error, components of a budget.

Probabilities of effects and of sets of effects, of a diagnosis.

Components of an uncertainty budget by their contribution.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayescal.reporting.figures import scales
from bayescal.reporting.figures.sheet import LANE, Entry, Panel, Row, first_of, rows_panel
from bayescal.reporting.style import ACCENT, FAINT, GREY, MARKED
from bayescal.reporting.text import not_assessed, per_residual, probability, rival, signed, significant
from bayescal.storage.reading import Json

FILLED: dict[str, Any] = {"facecolor": ACCENT, "edgecolor": ACCENT, "lw": 0.5}
OPEN: dict[str, Any] = {"facecolor": "white", "edgecolor": GREY, "lw": 0.8}
HATCHED: dict[str, Any] = {"facecolor": FAINT, "edgecolor": GREY, "lw": 0.5, "hatch": "//////"}
"""Styles of bars that differ in grey."""


@dataclass(frozen=True, kw_only=True)
class Bar(Row):
    """A row with a bar: its length and its style."""

    value: float
    style: dict[str, Any]


def bars_panel(
    bars: Sequence[Bar], title: str, x: str, note: str = "", key: Sequence[Entry] = (), end: float = 0.0
) -> Panel:
    """Bars from zero to their values; `end` is the end of the axis."""

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        from matplotlib.patches import Rectangle

        for middle, bar in zip(middles, bars, strict=True):
            corner = (0.0, middle - 0.4 * LANE)
            axes.add_patch(Rectangle(corner, bar.value, 0.8 * LANE, zorder=2, **bar.style))
        last = end or 1.05 * max((bar.value for bar in bars), default=1.0) or 1.0
        scales.linear_x(axes, 0, last)

    return rows_panel(bars, lanes, title, x, note, key)


PLACES, CURVES = 7, 3

FEW_VALUES = 3
BINS = 18
SMOOTH = 0.05
"""Fitted values whose mean square step along x is below this share of their variance are drawn as a line."""
HEIGHT = 36.0
"""Of the axes of a curve, mm."""
RESIDUAL: dict[str, Any] = {"color": FAINT, "marker": "o", "ls": "", "ms": 2, "mew": 0}
MEASURED: dict[str, Any] = {"color": ACCENT, "marker": "o", "ls": "", "ms": 3}
EXPLAINED: dict[str, Any] = {"color": MARKED, "lw": 1.6}
SCATTERED: dict[str, Any] = {"color": MARKED, "marker": "o", "ls": "", "ms": 2.5, "mew": 0}


def places_panel(record: Json) -> Panel:
    """Bars of the largest locations with their share of the excess."""
    shown = record["where"][:PLACES]
    bars = []
    for w in shown:
        clear, share = significant(w["family_p_value"]), w["share"]
        text = f"{w['rms_um']:.1f} µm" + (f" ({100 * share:.0f} %)" if clear and share is not None else "")
        name = w["text"] + (f" ({w['explained_by']})" if w["explained_by"] else "")
        bars.append(Bar(name, text, value=w["rms_um"], style=FILLED if clear else OPEN))
    some = any(significant(w["family_p_value"]) for w in shown)
    title = "Locations, with their share of the excess" if some else "Locations; none is significant"
    key = [Entry("significant", FILLED, patch=True), Entry("not significant", OPEN, patch=True)]
    label = f"RMS of the explained residuals{per_residual(record)} (µm)"
    return bars_panel(bars, title, label, "", key if bars else ())


def drawn_curves(record: Json) -> list[Json]:
    """Curves of the significant locations, each event once."""
    out: list[Json] = []
    p_values = {(w["site"], w["driver"]): w["family_p_value"] for w in record["where"]}
    for curve in record["curves"]:
        event = curve["event"] and any(drawn["event"] for drawn in out)
        if len(curve["x"]) and significant(p_values[curve["site"], curve["driver"]]) and not event:
            out.append(curve)
    return out[:CURVES]


def curve_panel(curve: Json) -> Panel:
    """The residuals of a location over its coordinate, or the displacement that they show."""
    lever = curve["lever"]
    displaced = lever is not None and bool(curve["coordinate"]) and bool(np.any(lever))
    y = displacement(curve) if displaced else "residual (µm)"
    explained = EXPLAINED if displaced or is_line(curve) else SCATTERED
    key = (
        Entry("measured (k = 2)", MEASURED) if displaced else Entry("residual", RESIDUAL),
        Entry("explained", explained),
    )
    draw = _displaced if displaced else _residuals
    x = "contact" if not curve["coordinate"] else curve["coordinate"].replace("degC", "°C")
    return Panel(lambda axes: draw(axes, curve), HEIGHT, curve["text"], x, y, key=key)


def displacement(curve: Json) -> str:
    """Label of a displacement; the error of a joint is one of its link angle."""
    site = curve["site"]
    if curve["lever_unit"] != "rad":
        return f"displacement of {site} (µm)"
    return f"link angle error of {site} (µrad)" if site.startswith("joint") else f"rotation of {site} (µrad)"


def _residuals(axes: Any, curve: Json) -> None:
    """Residuals over the coordinate of a location, and the part that it explains."""
    x, residual, fitted = (np.array(curve[k], float) for k in ("x", "residual_um", "fitted_um"))
    values = np.unique(x)
    if len(values) <= FEW_VALUES:  # two or three values: spread the contacts so that they do not overlap
        x = x + 0.12 * max(np.ptp(values), 1.0) * np.random.default_rng(0).uniform(-1, 1, len(x))
    axes.plot(x, residual, **RESIDUAL)
    order = np.argsort(x, kind="stable")
    if is_line(curve):
        axes.plot(x[order], fitted[order], **EXPLAINED)
    else:
        axes.plot(x, fitted, **SCATTERED)
    edge = 1.15 * max(float(np.quantile(np.abs(residual), 0.99)), float(np.max(np.abs(fitted))), 1e-6)
    axes.set_ylim(-edge, edge)
    _finish(axes)


def _displaced(axes: Any, curve: Json) -> None:
    """Displacement of the site over the coordinate: residuals of a bin fitted on their lever arms.

    The lever arms of the contacts differ in size and sign, so that raw residuals do not show it.
    """
    middle, measured, error, explained = binned(curve)
    axes.errorbar(middle, measured, error, fmt="o", ms=3, lw=0.8, color=ACCENT)
    axes.plot(middle, explained, **EXPLAINED)
    _finish(axes)


def binned(curve: Json) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Middle, measured displacement, its U (k = 2), explained part of each bin; (B,) each, µm or µrad."""
    x, residual, fitted, lever = (
        np.array(curve[k], float) for k in ("x", "residual_um", "fitted_um", "lever")
    )
    values = np.unique(x)
    edges = values if len(values) <= BINS else np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))[:-1]
    bins = np.searchsorted(np.append(edges, np.inf), x, side="right") - 1
    count = len(edges)
    weight = np.bincount(bins, lever**2, count)
    seen = weight > 1e-3 * np.max(weight)
    middle = np.bincount(bins, x, count)[seen] / np.bincount(bins, minlength=count)[seen]
    measured = np.bincount(bins, lever * residual, count)[seen] / weight[seen]
    explained = np.bincount(bins, lever * fitted, count)[seen] / weight[seen]
    error = 2.0 * float(np.std(residual - fitted)) / np.sqrt(weight[seen])
    return middle, measured, error, explained


def _finish(axes: Any) -> None:
    axes.axhline(0, color=GREY, lw=0.5, zorder=0)
    scales.linear_both(axes, HEIGHT)


def is_line(curve: Json) -> bool:
    """Whether the fitted values are nearly a function of the coordinate alone."""
    order = np.argsort(np.array(curve["x"], float), kind="stable")
    fitted = np.array(curve["fitted_um"], float)[order]
    variance = float(np.var(fitted))
    return len(fitted) > 2 and variance > 0 and float(np.mean(np.diff(fitted) ** 2)) < SMOOTH * variance


MOST_EFFECTS, MOST_SETS = 12, 6
LEAST = 0.001
"""Least probability of an effect that is shown."""
FEW = 3
"""Effects of a set that its label lists one by one."""


def effects_panel(record: Json) -> Panel:
    """Probabilities of the noise-only model, of an unmodelled effect and of every effect."""
    inside = record["credible_set90"]
    always = {"null", "unknown", *inside}
    ranked = sorted(record["probability"].items(), key=lambda item: -(item[1] or 0.0))
    shown = [(n, p or 0.0) for n, p in ranked if n in always or (p or 0.0) >= LEAST][:MOST_EFFECTS]
    bars = [
        Bar(rival(n), probability(p), n in inside, value=p, style=FILLED if n in inside else OPEN)
        for n, p in shown
    ]
    missing = ", ".join(not_assessed(record))
    key = [Entry("in the 90 % set", FILLED, patch=True), Entry("not in it", OPEN, patch=True)]
    note = f"not assessed: {missing}" if missing else ""
    label = "probability (effects may be present together)"
    return bars_panel(bars, "Effects", label, note, key, end=1.0)


def sets_panel(record: Json) -> Panel:
    """Sets of effects, the most probable first, with their log evidence."""
    sets = record["hypotheses"][:MOST_SETS]
    nats = [signed(h["log_evidence"], 1).replace("-", "−") for h in sets]
    labels = set_labels([h["effects"] for h in sets])
    bars = [
        Bar(text, f"{probability(h['probability'])}  ({n} nats)", value=h["probability"], style=OPEN)
        for text, h, n in zip(labels, sets, nats, strict=True)
    ]
    label = "probability (log evidence relative to noise only)"
    return bars_panel(bars, "Sets of effects, the most probable first", label, end=1.0)


def set_labels(sets: Sequence[Sequence[str]]) -> list[str]:
    """Sets of effects as text: where they are long, as the differences from the first."""
    if max((len(effects) for effects in sets), default=0) <= FEW:
        return [" + ".join(rival(n) for n in effects) or rival("null") for effects in sets]
    first, out = sets[0], []
    for effects in sets:
        less = [f"without {rival(n)}" for n in first if n not in effects]
        more = [f"with {rival(n)}" for n in effects if n not in first]
        out.append(", ".join([*more, *less]) or f"the {len(first)} most probable")
    return out


MOST = 12
"""Components that are shown, the largest first."""
TYPES = {"A": FILLED, "B": HATCHED}
"""Style of a bar by the type of evaluation (JCGM 100)."""


def budget_panel(budget: Json) -> Panel:
    """Bars of the contributions; `budget` is the content of budget.json."""
    every = sorted(budget["components"], key=lambda c: -abs(c["contribution_um"]))
    shown, note = first_of(every, MOST, "smaller components are not shown")
    total = budget["u_um"]

    def share(um: float) -> str:
        return f"{um:.2g} µm, {100 * um**2 / total**2:.0f} %" if total else ""

    bars = [
        Bar(c["name"], share(um), value=abs(um), style=TYPES.get(c["type"], OPEN))
        for c in shown
        for um in (c["contribution_um"],)
    ]
    used = dict.fromkeys(c["type"] for c in shown)
    key = [Entry(f"type {t}", TYPES.get(t, OPEN), True) for t in used]
    notes = filter(None, (f"u {total:.2g} µm, U {budget['U_um']:.2g} µm (k = {budget['k']:.3g})", note))
    return bars_panel(bars, "", "contribution to the standard uncertainty (µm)", "; ".join(notes), key)
