"""The record of a verification, verify.json, and its report on the terminal."""

from __future__ import annotations

import math
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from bayescal import __version__
from bayescal.exporting.verify.result import Verification
from bayescal.reporting.shared.table import FigureTable
from bayescal.reporting.shared.text import um

SCHEMA = "bayescal-verify/1"


def record(v: Verification) -> dict[str, Any]:
    """The content of verify.json."""
    out: dict[str, Any] = {
        "schema": SCHEMA,
        "format": v.format,
        "file": v.path.name,
        "software": {"bayescal": __version__, "simulator": v.software},
        "model": list(v.arm.effects),
        "state_row": v.arm.dataset.measurements.ids[v.state],
        "poses": len(v.levels[-1].differences),
        "max_difference_um": {level.name: 1e6 * level.maximum for level in v.levels},
        "rms_difference_um": {level.name: 1e6 * level.rms for level in v.levels},
        "limit_um": {level.name: 1e6 * level.limit for level in v.levels},
        "not_in_file_rms_um": {name: 1e6 * size for name, size in v.missing.items()},
        "use": v.arm.use.record(),
        "passed": v.passed,
        "measured": None,
    }
    if v.gap is not None:
        g = v.gap
        out["measured"] = {"before_model": g.before_is} | {
            kind: {
                "count": g.count[kind],
                "before_rms_um": _um(g.before[kind]),
                "after_rms_um": _um(g.after[kind]),
                "predicted_before_rms_um": _um(g.predicted[kind][0]),
                "predicted_after_rms_um": _um(g.predicted[kind][1]),
            }
            for kind in g.after
        }
    return out


def _um(value: float) -> float | None:
    return 1e6 * value if math.isfinite(value) else None


def report(v: Verification) -> RenderableType:
    """The verification in a few lines."""
    title = f"{v.path.name} in {v.software}, {len(v.levels[-1].differences)} poses of {v.arm.dataset.name}"
    parts: list[RenderableType] = [Text(title, style="bold"), _levels(v)]
    if v.gap is None:
        parts.append(Text("The session has no validation measurements: no gap is measured."))
    else:
        parts.append(_gap(v))
    if v.missing:
        sizes = ", ".join(f"{name} ({um(size)} µm RMS)" for name, size in v.missing.items())
        parts.append(Text(f"not in the file, and part of the gap after: {sizes}"))
    parts += [Text(remark, style="yellow") for remark in v.arm.use.remarks]
    worst = next((level for level in v.levels if not level.passed), None)
    if worst is None:
        rest = " without these effects" if v.missing else ""
        parts.append(Text(f"passed: the simulator has the fitted arm{rest}"))
    else:
        what = f"FAILED: {worst.name} differs by up to {1e6 * worst.maximum:.3g} µm"
        parts.append(Text(f"{what} (limit {1e6 * worst.limit:.3g} µm, RMS 1 µm)", style="red"))
    return Group(*parts)


def _levels(v: Verification) -> FigureTable:
    table = FigureTable("simulator against model", "RMS (µm)", "maximum (µm)", "limit (µm)")
    for level in v.levels:
        figures = (level.rms, level.maximum, level.limit)
        table.add_row(level.name, *(f"{1e6 * x:.2g}" if x else "0" for x in figures))
    return table


def _gap(v: Verification) -> FigureTable:
    g = v.gap
    assert g is not None
    table = FigureTable(
        "simulator against measurements: RMS (µm)", "count", f"before ({g.before_is})", "after",
        "run: before", "run: after",
    )  # fmt: skip
    for kind in g.after:
        values = (g.before[kind], g.after[kind], *g.predicted[kind])
        table.add_row(
            kind, str(g.count[kind]), *(f"{1e6 * x:.3g}" if math.isfinite(x) else "-" for x in values)
        )
    return table
