"""Validation errors of the model levels of a fit or a diagnosis, from nominal to the last."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bayescal.reporting.figures import scales
from bayescal.reporting.figures.palette import GREY, MARKERS, SERIES
from bayescal.reporting.figures.rows import Row, rows_panel, upright
from bayescal.reporting.figures.sheet import Entry, Panel, width_of
from bayescal.reporting.shared.text import model_label, short

if TYPE_CHECKING:
    pass

Json = dict[str, Any]
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


def levels_panel(record: Json) -> Panel:
    """Errors of validation measurements by model level, on a logarithmic scale."""
    levels = record["ladder"]
    keys = dict(SERIES_OF[record["schema"]])
    if record["schema"] == "bayescal-gap/1" and record["lengths"]["of"] != "validation contacts":
        del keys["heldout_rms_um"]  # per coordinate; the points are drawn by their lengths
    drawn = {key: what for key, what in keys.items() if any(step.get(key) for step in levels)}
    rows = [
        Row(
            label(levels, k),
            ", ".join(f"{what} {_um(step[key])}" for key, what in drawn.items() if step[key]) + " µm",
        )
        for k, step in enumerate(levels)
    ]
    values = [step[key] for step in levels for key in drawn if step[key]]
    lines = (
        reference_lines(record) if CONTACTS in drawn.values() or record["schema"] != "bayescal-fit/1" else []
    )
    ends = [*values, *(value for _, value, _ in lines)]
    mean = "mean length" if record["schema"] == "bayescal-fit/1" else "RMS length"
    names = {
        CONTACTS: "validation contacts (RMS)",
        DISTANCES: "sphere distances (RMS)",
        POINTS: f"validation points ({mean})",
    }
    styles = {
        what: {"color": SERIES[k], "marker": MARKERS[k], "ls": "", "ms": 5}
        for k, what in enumerate((CONTACTS, DISTANCES, POINTS))
    }
    key = [Entry(names[what], styles[what]) for what in drawn.values()]
    key += [Entry(text, style) for text, _, style in lines]

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        if not ends:
            return
        low, high = scales.around(ends)
        axes.set_xscale("log")
        axes.set_xlim(low, high)
        for _, value, style in lines:
            upright(axes, value, middles, style)
        for name, what in drawn.items():
            at = [(step[name], y) for step, y in zip(levels, middles, strict=True) if step[name]]
            axes.plot(*zip(*at, strict=True), clip_on=False, **styles[what])
        scales.log(axes.xaxis, low, high, width_of(axes))

    return rows_panel(rows, lanes, x="error (µm)", key=key)


def reference_lines(record: Json) -> list[tuple[str, float, Json]]:
    """Vertical lines: text, value in µm and style of the noise and of what a correct model would have."""
    if record["schema"] == "bayescal-fit/1":
        noise = record["noise"]["estimated_um"]
        return [
            (f"estimated noise of a contact, {_um(noise)} µm", noise, {"color": GREY, "ls": "--", "lw": 1.0})
        ]
    own = record["lengths"]
    what = "contact" if own["of"] == "validation contacts" else "point"
    noise = own["noise_um"]
    out = (
        [(f"noise of a {what}, {_um(noise)} µm", noise, {"color": GREY, "ls": "--", "lw": 1.0})]
        if noise
        else []
    )
    expected = (record["shrinkage"].get("distances") or {}).get("floor_um")
    if expected:
        text = f"expected RMS of a distance for a correct model, {_um(expected)} µm"
        out.append((text, expected, {"color": SERIES[1], "ls": ":", "lw": 1.2}))
    return out


def label(levels: Sequence[Json], k: int) -> str:
    """A model level by what it adds to the level before."""
    model = tuple(levels[k]["model"])
    before = tuple(levels[k - 1]["model"]) if k else ()
    if len(before) > 1 and model[: len(before)] == before and model != before:
        return "+ " + " + ".join(short(name) for name in model[len(before) :])
    return model_label(model)


def _um(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.1f}"
