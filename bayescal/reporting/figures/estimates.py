"""Figures of estimates: validation errors by distance and model level, parameters, and their posterior."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayescal.reporting.figures import scales
from bayescal.reporting.figures.sheet import LANE, MM_PER_PT, Entry, Panel, Row, first_of, rows_panel, upright
from bayescal.reporting.style import ACCENT, FAINT, GREY, HOLLOW, INK, MARKED, MARKERS, NOISE, SERIES
from bayescal.reporting.text import level_labels, measured, per_residual, with_unit
from bayescal.storage.reading import Json

MOST = 15
"""Distances that are shown, those with the largest errors first."""
INTERVAL: dict[str, Any] = {"color": FAINT, "lw": 5.0, "solid_capstyle": "butt"}
INSIDE: dict[str, Any] = {"color": ACCENT, "marker": "o", "ls": "", "ms": 4}
OUTSIDE: dict[str, Any] = {"color": MARKED, "marker": "X", "ls": "", "ms": 5}
BEFORE: dict[str, Any] = {"markeredgecolor": SERIES[1], "marker": "o", "ls": "", "ms": 4.5, **HOLLOW}
AFTER: dict[str, Any] = {"color": SERIES[0], "marker": "s", "ls": "", "ms": 4.5}
EXPECTED: dict[str, Any] = {"color": GREY, "lw": 1.6}
NOISE_LINE: dict[str, Any] = {"color": GREY, "ls": "--", "lw": 1.0}
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


def distances_panel(record: Json) -> Panel | None:
    """Error of each certified distance after calibration, and its 95 % prediction interval."""
    every = sorted(record["validation"]["distances"], key=lambda d: -abs(d["calibrated_error_um"]))
    shown, note = first_of(every, MOST, "distances with smaller errors are not shown")
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
    title = "Certified distances: error before → after calibration"
    return rows_panel(rows, lanes, title, "error after calibration (µm)", note, key)


def reduction_panel(record: Json) -> Panel | None:
    """Errors of validation measurements before and after: by target of a fit, by kind of a diagnosis."""
    fit = record["schema"] == "bayescal-fit/1"
    items = list((_of_fit if fit else _of_gap)(record))
    if not items:
        return None

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        scales.log_x(axes, [v for _, *values in items for v in values if v])
        before, after, expected = np.array([values for _, *values in items], float).T
        middle = np.array(middles)
        axes.hlines(middle, before, after, color=INK, lw=0.8, zorder=1.5)
        axes.vlines(expected, middle - 0.5 * LANE, middle + 0.5 * LANE, zorder=1, **EXPECTED)
        axes.plot(before, middle, **BEFORE)
        axes.plot(after, middle, **AFTER)

    title, *texts = REDUCTION[record["schema"]]
    key = [Entry(text, style) for text, style in zip(texts, SIGNS, strict=True)]
    points = fit and record["validation"]["points"]["count"]
    x = "RMS error, of points the mean error length (µm)" if points else "RMS error (µm)"
    return rows_panel([row for row, *_ in items], lanes, title, x, "", key)


Item = tuple[Row, float, float, float | None]
"""A row, and its error before, after, and expected, µm."""


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
    return Row(label, f"{_um(before)} → {_um(after)} µm{claim}"), before, after, expected


def _um(value: float) -> str:
    text = f"{value:.0f}" if abs(value) >= 99.5 else f"{round(value, 1) + 0.0:.1f}"
    return text.replace("-", "−")


CONTACTS, POINTS, DISTANCES = "contacts", "points", "distances"
SERIES_OF = {"heldout_planes_rms_um": CONTACTS, "heldout_rms_um": CONTACTS, "distance_rms_um": DISTANCES}
SERIES_OF |= {"points_mean_um": POINTS, "point_length_rms_um": POINTS}
"""Keys of a level of a fit or a diagnosis, and what they are errors of."""


def levelled(record: Json) -> bool:
    """Whether any model level has an error of validation measurements."""
    return any(step.get(key) for step in record["ladder"] for key in SERIES_OF)


def levels_panel(record: Json) -> Panel:
    """Errors of validation measurements by model level, on a logarithmic scale."""
    levels = record["ladder"]
    fit = record["schema"] == "bayescal-fit/1"
    drawn = {key: what for key, what in SERIES_OF.items() if any(step.get(key) for step in levels)}
    if not fit and per_residual(record):
        drawn.pop("heldout_rms_um", None)  # per coordinate; the points are drawn by their lengths

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
        return [(f"estimated noise of a contact, {_um(noise)} µm", noise, NOISE_LINE)]
    noise = record["lengths"]["noise_um"]
    what = "point" if per_residual(record) else "contact"
    out: list[tuple[str, float, Json]] = []
    if noise:
        out.append((f"noise of a {what}, {_um(noise)} µm", noise, NOISE_LINE))
    expected = (record["shrinkage"].get("distances") or {}).get("floor_um")
    if expected:
        text = f"expected RMS of a distance for a correct model, {_um(expected)} µm"
        out.append((text, expected, {"color": SERIES[1], "ls": ":", "lw": 1.2}))
    return out


MOST_PARAMETERS = 48
"""Parameters that are shown, the first of the model."""
STYLES: dict[str, Any] = {
    "determined": ("identifiable", {"color": ACCENT, "marker": "o", "ls": "", "ms": 3.5}),
    "partly": ("weakly identifiable", {"color": SERIES[1], "marker": "s", "ls": "", "ms": 4}),
    "prior_only": ("not identifiable", {"markeredgecolor": GREY, "marker": "D", "ls": "", "ms": 4, **HOLLOW}),
}
"""Lists of fit.json, their text and their marks."""


def of_arm(record: Json) -> list[Json]:
    """Parameters of the arm, without the poses of targets."""
    return [p for p in record["parameters"] if p["effect"] != "target"]


def parameter_panels(record: Json) -> list[Panel]:
    """Deviations from the prior mean over the prior standard deviation, in one or two columns."""
    shown, note = first_of(of_arm(record), MOST_PARAMETERS, "further parameters are not shown")
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
BINS, SCATTERED = 40, 600
INSET = 7.5
"""Half a tick label of many digits, mm."""
EACH = 20.0
"""Room of a tick label, mm: values with many digits."""

PRIOR: dict[str, Any] = {"color": SERIES[1], "lw": 1.2, "ls": "--"}
CREDIBLE: dict[str, Any] = {"color": INK, "lw": 2.4, "solid_capstyle": "butt"}


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
        Entry("95 % interval", CREDIBLE),
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
        axes.plot(p["interval95"], [0.03 * top] * 2, **CREDIBLE)
        axes.set_ylim(0, top)
        scales.without_y(axes)
        scales.linear_x(axes, low - pad, high + pad, EACH)

    return Panel(draw, HEIGHT, "", label(p), key=key if first else (), inset=INSET)


def pair_panel(a: Json, b: Json, r: float, draws: Draws) -> Panel:
    """Draws of two parameters."""

    def draw(axes: Any) -> None:
        x, y = draws[a["name"]].ravel(), draws[b["name"]].ravel()
        some = np.linspace(0, len(x) - 1, min(len(x), SCATTERED)).astype(int)
        axes.plot(x[some], y[some], ls="", marker="o", ms=1.4, mew=0, color=ACCENT, alpha=0.5)
        axes.axvline(float(np.mean(x)), color=GREY, lw=0.5, zorder=0)
        axes.axhline(float(np.mean(y)), color=GREY, lw=0.5, zorder=0)
        scales.linear_both(axes, SQUARE, EACH)

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
