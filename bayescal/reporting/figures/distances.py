"""Validation of a fit, each distance with its prediction interval; reduction of errors by a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.reporting.figures import scales
from bayescal.reporting.figures.palette import ACCENT, FAINT, GREY, INK, MARKED, SERIES
from bayescal.reporting.figures.rows import LANE, Row, rows_panel, upright
from bayescal.reporting.figures.sheet import Entry, Panel, width_of

if TYPE_CHECKING:
    pass

Json = dict[str, Any]
MOST = 15
"""Distances that are shown, those with the largest errors first."""
INTERVAL: dict[str, Any] = {"color": FAINT, "lw": 5.0, "solid_capstyle": "butt"}
INSIDE: dict[str, Any] = {"color": ACCENT, "marker": "o", "ls": "", "ms": 4}
OUTSIDE: dict[str, Any] = {"color": MARKED, "marker": "X", "ls": "", "ms": 5}
HOLLOW = {"markerfacecolor": "white", "ls": ""}
BEFORE: dict[str, Any] = {"markeredgecolor": SERIES[1], "marker": "o", "ms": 4.5, **HOLLOW}
AFTER: dict[str, Any] = {"color": SERIES[0], "marker": "s", "ls": "", "ms": 4.5}
EXPECTED: dict[str, Any] = {"color": GREY, "lw": 1.6}
KINDS = {"planes": "validation contacts", "distances": "sphere distances", "points": "validation points"}


def measured(record: Json) -> bool:
    """Whether there is any validation measurement."""
    if record["schema"] == "bayescal-fit/1":
        return bool(record["validation"]["distances"] or _of_fit(record))
    return bool(_of_gap(record))


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
        axes.set_xlim(-1.08 * max(ends), 1.08 * max(ends))
        scales.linear(axes.xaxis, width_of(axes))

    key = [Entry("error after calibration", INSIDE), Entry("95 % prediction interval", INTERVAL)]
    if not all(d["inside95"] for d in shown):
        key.insert(1, Entry("outside the interval", OUTSIDE))
    more = len(every) - len(shown)
    note = f"{more} distances with smaller errors are not shown" if more else ""
    title = "Certified distances: error before → after calibration"
    return rows_panel(rows, lanes, title, "error after calibration (µm)", note, key)


def reduction_panel(record: Json) -> Panel | None:
    """Errors of validation measurements before and after: by target of a fit, by kind of a diagnosis."""
    items = _of_fit(record) if record["schema"] == "bayescal-fit/1" else _of_gap(record)
    if not items:
        return None
    values = [v for _, _, before, after, expected in items for v in (before, after, expected) if v]

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        low, high = scales.around(values)
        axes.set_xscale("log")
        axes.set_xlim(low, high)
        before, after, expected = np.array([item[2:] for item in items], float).T
        middle = np.array(middles)
        axes.hlines(middle, before, after, color=INK, lw=0.8, zorder=1.5)
        axes.vlines(expected, middle - 0.5 * LANE, middle + 0.5 * LANE, zorder=1, **EXPECTED)
        axes.plot(before, middle, **BEFORE)
        axes.plot(after, middle, **AFTER)
        scales.log(axes.xaxis, low, high, width_of(axes))

    fit = record["schema"] == "bayescal-fit/1"
    key = [
        Entry("nominal" if fit else "without the named effects", BEFORE),
        Entry("calibrated" if fit else "with them", AFTER),
        Entry("predicted" if fit else "expected for a correct model", EXPECTED),
    ]
    title = (
        "Validation contacts and points" if fit else "Validation errors without and with the named effects"
    )
    return rows_panel(
        [Row(label, text) for label, text, *_ in items], lanes, title, "RMS error (µm)", "", key
    )


Item = tuple[str, str, float, float, float | None]
"""Label, numbers as text, error before, after, and expected, µm."""


def _of_fit(record: Json) -> list[Item]:
    own = record["validation"]
    out: list[Item] = [
        (p["target"], _change(p["nominal_rms_um"], p["calibrated_rms_um"]), p["nominal_rms_um"],
         p["calibrated_rms_um"], p["predicted_rms_um"])
        for p in own["planes"]
    ]  # fmt: skip
    points = own["points"]
    if points["count"]:
        before, after = points["nominal_mean_um"], points["calibrated_mean_um"]
        label = f"{points['count']} validation points (mean error length)"
        out.append((label, _change(before, after), before, after, points["predicted_mean_um"]))
    return out


def _of_gap(record: Json) -> list[Item]:
    out: list[Item] = []
    for what, s in record["shrinkage"].items():
        if s:
            own = record["lengths"]["shrinkage"].get(what, s)
            before, after = own["before_rms_um"], own["after_rms_um"]
            claim = "" if s["claimed"] else ", no improvement claimed"
            label = f"{KINDS.get(what, what)} ({s['count']})"
            out.append((label, _change(before, after) + claim, before, after, own["floor_um"]))
    return out


def _change(before: float, after: float) -> str:
    return f"{_um(before)} → {_um(after)} µm"


def _um(value: float) -> str:
    text = f"{value:.0f}" if abs(value) >= 99.5 else f"{round(value, 1) + 0.0:.1f}"
    return text.replace("-", "−")
