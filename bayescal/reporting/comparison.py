"""Methods beside each other: the terminal's table and `compare.json`."""

from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from bayescal.effects import UNITS
from bayescal.methods import Comparison, Result, Row, Solution
from bayescal.reporting.origin import entry, origin, plain
from bayescal.reporting.sheet import Column, Sheet, below, headed, screen
from bayescal.reporting.text import UM, model_label, um
from bayescal.storage.files import json_text
from bayescal.storage.folders import filled

SCHEMA = "bayescal-compare/1"

LOCATED = (
    "targets are located by the stated noise; fit estimates the noise of each model: its errors may differ"
)
"""Why the errors of the nominal arm are not those of a fit."""
NO_ERRORS = "no validation measurements, so no errors: withhold some rows (role `validate`)"


COLUMNS: dict[str, tuple[str, Callable[[Result], float]]] = {
    "planes_rms_um": ("contacts RMS", attrgetter("validation.contacts.rms")),
    "distances_rms_um": ("distances RMS", attrgetter("validation.distance_errors.rms")),
    "distances_max_um": ("maximum", attrgetter("validation.distance_errors.maximum")),
    "predicted_distance_sd_um": ("predicted u", attrgetter("distance_sd")),
    "points_rms_um": ("points RMS", attrgetter("validation.point_lengths.rms")),
    "points_mean_um": ("mean", attrgetter("validation.point_lengths.mean")),
    "points_max_um": ("maximum", attrgetter("validation.point_lengths.maximum")),
}
"""Key, heading and value, m, of what is compared."""


def comparison_summary(comparison: Comparison) -> RenderableType:
    """A row for each method; below, methods that do not apply and parameters kept nominal."""
    results = [row.result for row in comparison.rows if row.result is not None]
    shown = [key for key, (_, value) in COLUMNS.items() if any(np.isfinite(value(r)) for r in results)]
    title = headed(comparison.dataset.name, comparison.dataset.robot.name, model_label(comparison.effects))
    columns = (
        Column("validation (µm)", lambda row: row.method.name),
        *(Column(heading, _of_result(value), um) for heading, value in (COLUMNS[key] for key in shown)),
        Column("parameters", _of_result(attrgetter("solution.free"))),
        Column("seconds", _of_result(attrgetter("seconds")), "{:.2f}".format),
    )
    notes = [(row.method.name, row.why, "dim") for row in comparison.rows if row.result is None]
    held = [(row.method.name, text, "dim") for row in comparison.rows if (text := _held(row))]
    table = Sheet(columns, comparison.rows, LOCATED if shown else NO_ERRORS, style=_style)
    return screen(title, table, *below(notes or None), *below(held or None))


def _of_result(value: Callable[[Result], Any]) -> Callable[[Row], Any]:
    return lambda row: None if row.result is None else value(row.result)


def _style(row: Row) -> str:
    if row.result is None:
        return "dim"
    return "bold" if row.result.predicted is not None else ""


def _held(row: Row) -> str:
    if row.result is None or not row.result.solution.free or not row.result.solution.held:
        return ""
    solution = row.result.solution
    moved = [name for name in solution.model.names if name not in solution.held]
    if len(moved) < len(solution.held):
        return f"kept nominal: all but {', '.join(moved)}"
    return f"kept nominal: {', '.join(solution.held)}"


def comparison_record(comparison: Comparison) -> dict[str, Any]:
    """The content of compare.json."""
    return {
        **origin(SCHEMA, comparison.dataset, comparison.seed),
        "model": list(comparison.effects),
        "methods": [_method(row) for row in comparison.rows],
    }


def _method(row: Row) -> dict[str, Any]:
    method = entry(row.method, "name", "source", "idea")
    if (r := row.result) is None:
        return {**method, "applies": False, "why": row.why}
    return {
        **method,
        "applies": True,
        **entry(r, "seconds", "parameter_count=solution.free", "held=solution.held"),
        **entry(r, "condition=solution.condition"),
        "heldout": {
            "plane_contacts": len(r.validation.contacts.values),
            "distances": len(r.validation.distances),
            "points": len(r.validation.point_lengths.values),
            **{key: plain(UM * value(r)) for key, (_, value) in COLUMNS.items()},
        },
        "distances": [entry(d, "between", "certified_mm", "error_um") for d in r.validation.distances],
        "parameters": _parameters(r.solution),
    }


def _parameters(solution: Solution) -> list[dict[str, Any]]:
    values = zip(solution.model.parameters, solution.values, strict=True)
    return [
        {"name": p.name, "unit": unit, "nominal": p.nominal * factor}
        | {"estimate": (p.nominal + float(deviation)) * factor}
        for p, deviation in values
        for unit, factor in (UNITS[p.unit],)
    ]


def write_comparison(comparison: Comparison, folder: Path) -> tuple[str, ...]:
    """Write compare.json atomically; return its name."""
    return filled(folder, {"compare.json": json_text(comparison_record(comparison), rows=False)})
