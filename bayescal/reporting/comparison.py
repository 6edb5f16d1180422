"""Methods beside each other: the terminal's table and `compare.json`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from bayescal.effects import UNITS
from bayescal.methods import Comparison, Result, Row, Solution
from bayescal.reporting.shared.origin import origin
from bayescal.reporting.shared.text import MM, UM, facts, model_label, plain_table, um
from bayescal.storage.folders import whole

COMPARE = "compare.json"
SCHEMA = "bayescal-compare/1"
LIBRARIES = ("gtsam", "numpy", "scipy", "numba")

LOCATED = (
    "targets are located by the stated noise; fit estimates the noise of each model: its nominal differs"
)
"""Why the errors of the nominal arm are not those of a fit."""


def rms(values: np.ndarray) -> float:
    """Root mean square; nan of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def largest(values: np.ndarray) -> float:
    """Largest absolute value; nan of nothing."""
    return float(np.max(np.abs(values))) if len(values) else float("nan")


def mean(values: np.ndarray) -> float:
    """Mean; nan of nothing."""
    return float(np.mean(values)) if len(values) else float("nan")


COLUMNS: dict[str, tuple[str, Callable[[Result], float]]] = {
    "planes_rms_um": ("contacts RMS", lambda r: rms(r.planes)),
    "distances_rms_um": ("distances RMS", lambda r: rms(r.distances)),
    "distances_max_um": ("maximum", lambda r: largest(r.distances)),
    "predicted_distance_sd_um": ("predicted u", lambda r: r.distance_sd),
    "points_mean_um": ("points mean", lambda r: mean(r.points)),
    "points_max_um": ("maximum", lambda r: largest(r.points)),
}
"""Key, heading and value, m, of what is compared."""


def comparison_summary(comparison: Comparison) -> RenderableType:
    """A row for each method; below, methods that do not apply and parameters kept nominal."""
    results = [row.result for row in comparison.rows if row.result is not None]
    shown = [key for key, (_, value) in COLUMNS.items() if any(np.isfinite(value(r)) for r in results)]
    title = Text.assemble(
        (comparison.dataset.name, "bold"),
        f"  {comparison.dataset.robot.name}  {model_label(comparison.effects)}",
    )
    headings = [COLUMNS[key][0] for key in shown]
    table = plain_table("validation (µm)", *headings, "parameters", "seconds")
    for row in comparison.rows:
        _add(table, row, shown)
    table.caption = LOCATED
    notes = [(row.method.name, row.why, "dim") for row in comparison.rows if row.result is None]
    held = [(row.method.name, text, "dim") for row in comparison.rows if (text := _held(row))]
    parts: list[RenderableType] = [title, table]
    parts += ["", facts(notes)] if notes else []
    parts += ["", facts(held)] if held else []
    return Group(*parts)


def _add(table: Table, row: Row, shown: list[str]) -> None:
    if row.result is None:
        table.add_row(row.method.name, *("-" for _ in shown), "-", "-", style="dim")
        return
    cells = [um(COLUMNS[key][1](row.result)) for key in shown]
    free = str(row.result.solution.free)
    style = "bold" if row.result.predicted is not None else ""
    table.add_row(row.method.name, *cells, free, f"{row.result.seconds:.2f}", style=style)


def _held(row: Row) -> str:
    if row.result is None or not row.result.solution.free or not row.result.solution.held:
        return ""
    return f"kept nominal: {', '.join(row.result.solution.held)}"


def comparison_record(comparison: Comparison) -> dict[str, Any]:
    """The content of compare.json."""
    return {
        **origin(SCHEMA, comparison.dataset, comparison.seed, LIBRARIES),
        "model": list(comparison.effects),
        "methods": [_method(row) for row in comparison.rows],
    }


def _method(row: Row) -> dict[str, Any]:
    method = {"name": row.method.name, "source": row.method.source, "idea": row.method.idea}
    if row.result is None:
        return {**method, "applies": False, "why": row.why}
    r, solution = row.result, row.result.solution
    return {
        **method,
        "applies": True,
        "seconds": r.seconds,
        "parameter_count": solution.free,
        "held": list(solution.held),
        "condition": None if solution.condition is None else _finite(solution.condition),
        "heldout": {
            "plane_contacts": len(r.planes),
            "distances": len(r.distances),
            "points": len(r.points),
            **{key: _finite(UM * value(r)) for key, (_, value) in COLUMNS.items()},
        },
        "distances": [
            {"between": list(d.between), "certified_mm": MM * d.certified, "error_um": UM * d.error}
            for d in r.validation.distances
        ],
        "parameters": _parameters(solution),
    }


def _parameters(solution: Solution) -> list[dict[str, Any]]:
    out = []
    for p, deviation in zip(solution.model.parameters, solution.values, strict=True):
        unit, factor = UNITS[p.unit]
        nominal, value = p.nominal * factor, (p.nominal + float(deviation)) * factor
        out.append({"name": p.name, "unit": unit, "nominal": nominal, "estimate": value})
    return out


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def write_comparison(comparison: Comparison, folder: Path) -> None:
    """Write compare.json atomically."""
    record = json.dumps(comparison_record(comparison), indent=1, allow_nan=False) + "\n"
    with whole(folder, COMPARE) as stage:
        (stage / COMPARE).write_text(record, encoding="utf-8")
