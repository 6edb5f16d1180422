"""Validation of a fit, each distance with its prediction interval; reduction of errors by a diagnosis.

Validation errors of the model levels of a fit or a diagnosis, from nominal to the last.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from bayescal.reporting.figures import scales
from bayescal.reporting.figures.scales import LANE, Row, rows_panel, upright
from bayescal.reporting.figures.sheet import Entry, Panel
from bayescal.reporting.shared.style import ACCENT, FAINT, GREY, INK, MARKED, MARKERS, SERIES
from bayescal.reporting.shared.text import level_labels, per_residual
from bayescal.storage.reading import Json

MOST = 15
"""Distances that are shown, those with the largest errors first."""
INTERVAL: dict[str, Any] = {"color": FAINT, "lw": 5.0, "solid_capstyle": "butt"}
INSIDE: dict[str, Any] = {"color": ACCENT, "marker": "o", "ls": "", "ms": 4}
OUTSIDE: dict[str, Any] = {"color": MARKED, "marker": "X", "ls": "", "ms": 5}
HOLLOW = {"markerfacecolor": "white", "ls": ""}
BEFORE: dict[str, Any] = {"markeredgecolor": SERIES[1], "marker": "o", "ms": 4.5, **HOLLOW}
AFTER: dict[str, Any] = {"color": SERIES[0], "marker": "s", "ls": "", "ms": 4.5}
EXPECTED: dict[str, Any] = {"color": GREY, "lw": 1.6}
NOISE: dict[str, Any] = {"color": GREY, "ls": "--", "lw": 1.0}
SIGNS = (BEFORE, AFTER, EXPECTED)
REDUCTION = {
    "bayescal-fit/1": ("Validation contacts and points", "nominal", "calibrated", "predicted"),
    "bayescal-gap/1": (
        "Validation errors without and with the named effects",
        *("without the named effects", "with them", "expected for a correct model"),
    ),
}
"""By schema: title of the panel of errors before and after, and entries of its legend."""
KINDS = {"planes": "validation contacts", "distances": "sphere distances", "points": "validation points"}


def measured(record: Json) -> bool:
    """Whether there is any validation measurement."""
    return bool(record.get("validation", {}).get("distances") or _items(record))


def distances_panel(record: Json) -> Panel | None:
    """Error of each certified distance after calibration, and its 95 % prediction interval."""
    every = sorted(record["validation"]["distances"], key=lambda d: -abs(d["calibrated_error_um"]))
    shown = every[:MOST]
    if not shown:
        return None
    rows = [
        Row(
            f"{' to '.join(d['between'])}, {d['certified_mm']:.3f} mm",
            f"{_um(d['nominal_error_um'])} → {_um(d['calibrated_error_um'])} µm",
        )
        for d in shown
    ]

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        upright(axes, 0.0, middles, {"color": GREY, "lw": 0.8})
        low, high = np.array([d["predicted_interval95_um"] for d in shown]).T
        error, within = (np.array([d[k] for d in shown]) for k in ("calibrated_error_um", "inside95"))
        axes.hlines(middles, low, high, color=FAINT, lw=5.0, zorder=1)
        for mine, style in ((within, INSIDE), (~within, OUTSIDE)):
            axes.plot(error[mine], np.array(middles)[mine], **style)
        ends = [abs(v) for d in shown for v in (*d["predicted_interval95_um"], d["calibrated_error_um"])]
        scales.linear_x(axes, -1.08 * max(ends), 1.08 * max(ends))

    key = [Entry("error after calibration", INSIDE), Entry("95 % prediction interval", INTERVAL)]
    if not all(d["inside95"] for d in shown):
        key.insert(1, Entry("outside the interval", OUTSIDE))
    more = len(every) - len(shown)
    note = f"{more} distances with smaller errors are not shown" if more else ""
    title = "Certified distances: error before → after calibration"
    return rows_panel(rows, lanes, title, "error after calibration (µm)", note, key)


def reduction_panel(record: Json) -> Panel | None:
    """Errors of validation measurements before and after: by target of a fit, by kind of a diagnosis."""
    items = _items(record)
    if not items:
        return None
    values = [v for _, _, before, after, expected in items for v in (before, after, expected) if v]

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        scales.log_x(axes, values)
        before, after, expected = np.array([item[2:] for item in items], float).T
        middle = np.array(middles)
        axes.hlines(middle, before, after, color=INK, lw=0.8, zorder=1.5)
        axes.vlines(expected, middle - 0.5 * LANE, middle + 0.5 * LANE, zorder=1, **EXPECTED)
        axes.plot(before, middle, **BEFORE)
        axes.plot(after, middle, **AFTER)

    title, *texts = REDUCTION[record["schema"]]
    key = [Entry(text, style) for text, style in zip(texts, SIGNS, strict=True)]
    rows = [Row(label, text) for label, text, *_ in items]
    points = record["schema"] == "bayescal-fit/1" and record["validation"]["points"]["count"]
    x = "RMS error, of points the mean error length (µm)" if points else "RMS error (µm)"
    return rows_panel(rows, lanes, title, x, "", key)


Item = tuple[str, str, float, float, float | None]
"""Label, numbers as text, error before, after, and expected, µm."""


def _items(record: Json) -> list[Item]:
    return list((_of_fit if record["schema"] == "bayescal-fit/1" else _of_gap)(record))


def _of_fit(record: Json) -> Iterator[Item]:
    for p in record["validation"]["planes"]:
        yield _item(p["target"], p["nominal_rms_um"], p["calibrated_rms_um"], p["predicted_rms_um"])
    p = record["validation"]["points"]
    if p["count"]:
        label = f"{p['count']} validation points (mean error length)"
        yield _item(label, p["nominal_mean_um"], p["calibrated_mean_um"], p["predicted_mean_um"])


def _of_gap(record: Json) -> Iterator[Item]:
    for what, s in record["shrinkage"].items():
        if s:
            length = record["lengths"]["shrinkage"].get(what, s)
            claim = "" if s["claimed"] else ", no improvement claimed"
            label = f"{KINDS.get(what, what)} ({s['count']})"
            yield _item(label, length["before_rms_um"], length["after_rms_um"], length["floor_um"], claim)


def _item(label: str, before: float, after: float, expected: float | None, claim: str = "") -> Item:
    return label, f"{_um(before)} → {_um(after)} µm{claim}", before, after, expected


def _um(value: float) -> str:
    text = f"{value:.0f}" if abs(value) >= 99.5 else f"{round(value, 1) + 0.0:.1f}"
    return text.replace("-", "−")


CONTACTS, POINTS, DISTANCES = "contacts", "points", "distances"
SERIES_OF: dict[str, dict[str, str]] = {
    "bayescal-fit/1": {
        "heldout_planes_rms_um": CONTACTS, "distance_rms_um": DISTANCES, "points_mean_um": POINTS,
    },
    "bayescal-gap/1": {
        "heldout_rms_um": CONTACTS, "distance_rms_um": DISTANCES, "point_length_rms_um": POINTS,
    },
}  # fmt: skip
"""Keys of a level by schema, and what they are errors of."""


def levelled(record: Json) -> bool:
    """Whether any model level has an error of validation measurements."""
    return any(step.get(key) for step in record["ladder"] for key in SERIES_OF[record["schema"]])


def levels_panel(record: Json) -> Panel:
    """Errors of validation measurements by model level, on a logarithmic scale."""
    levels = record["ladder"]
    keys = dict(SERIES_OF[record["schema"]])
    fit = record["schema"] == "bayescal-fit/1"
    if not fit and per_residual(record):
        del keys["heldout_rms_um"]  # per coordinate; the points are drawn by their lengths
    drawn = {key: what for key, what in keys.items() if any(step.get(key) for step in levels)}

    def errors(step: Json) -> str:
        parts = (f"{what} {_um(step[key])}" for key, what in drawn.items() if step[key])
        return ", ".join(parts) + " µm"

    rows = [Row(name, errors(step)) for name, step in zip(level_labels(levels), levels, strict=True)]
    values = [step[key] for step in levels for key in drawn if step[key]]
    lines = reference_lines(record) if CONTACTS in drawn.values() or not fit else []
    ends = [*values, *(value for _, value, _ in lines)]
    mean = "mean length" if fit else "RMS length"
    names = {
        CONTACTS: "validation contacts (RMS)",
        DISTANCES: "sphere distances (RMS)",
        POINTS: f"validation points ({mean})",
    }
    styles = {
        what: {"color": SERIES[k], "marker": MARKERS[k], "ls": "", "ms": 5} for k, what in enumerate(names)
    }
    key = [Entry(names[what], styles[what]) for what in drawn.values()]
    key += [Entry(text, style) for text, _, style in lines]

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        if not ends:
            return
        scales.log_x(axes, ends)
        for _, value, style in lines:
            upright(axes, value, middles, style)
        for name, what in drawn.items():
            points = [(step[name], y) for step, y in zip(levels, middles, strict=True) if step[name]]
            axes.plot(*zip(*points, strict=True), clip_on=False, **styles[what])

    return rows_panel(rows, lanes, x="error (µm)", key=key)


def reference_lines(record: Json) -> list[tuple[str, float, Json]]:
    """Vertical lines: text, value in µm and style of the noise and of what a correct model would have."""
    if record["schema"] == "bayescal-fit/1":
        noise = record["noise"]["estimated_um"]
        return [(f"estimated noise of a contact, {_um(noise)} µm", noise, NOISE)]
    noise = record["lengths"]["noise_um"]
    what = "point" if per_residual(record) else "contact"
    out: list[tuple[str, float, Json]] = []
    if noise:
        out.append((f"noise of a {what}, {_um(noise)} µm", noise, NOISE))
    expected = (record["shrinkage"].get("distances") or {}).get("floor_um")
    if expected:
        text = f"expected RMS of a distance for a correct model, {_um(expected)} µm"
        out.append((text, expected, {"color": SERIES[1], "ls": ":", "lw": 1.2}))
    return out
