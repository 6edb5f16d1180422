"""Tables of a fit: model levels against validation measurements, distances, parameters with uncertainties.

The verdict of a fit in fit.json: tests, what rejected measurements share, decisions on a tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.text import Text

from bayescal.assess.acceptance import FAIL, PASS, Acceptance, Check, Tolerance
from bayescal.assess.budget import COVERAGE
from bayescal.calibration import Fit, ModelLevel
from bayescal.dataset import Dataset
from bayescal.effects.vocabulary import unit_label
from bayescal.estimate.unexplained import FORM
from bayescal.predict import RowCheck, Validation, inside95, interval95
from bayescal.reporting.shared.text import (
    MDEG,
    MM,
    UM,
    FigureTable,
    model_label,
    parameter_notes,
    percent,
    plain_table,
    signed,
    um,
    um2,
    unsigned_zero,
    with_u,
)

MOST_DISTANCES = 5
"""Distances shown without --verbose, those with the largest errors."""
DECISIONS = {PASS: "green", FAIL: "red"}


def level_table(levels: Sequence[ModelLevel]) -> FigureTable:
    """Errors of validation measurements by model level."""
    v = levels[-1].validation
    headings = ["contacts RMS"] * bool(v.planes)
    headings += ["distances RMS", "maximum", "95 % predicted"] * bool(v.distances)
    headings += ["points RMS", "mean", "maximum"] * bool(v.points)
    headings += ["angles mean (mdeg)"] * bool(v.turns)
    table = plain_table("validation (µm)", *headings, "within 95 %")
    for level in levels:
        v = level.validation
        cells = []
        if v.planes:
            cells.append(um(np.sqrt(np.mean(np.concatenate([p.residuals for p in v.planes]) ** 2))))
        if v.distances:
            low, high = interval95(np.concatenate([d.predicted for d in v.distances]))
            cells.append(um(np.sqrt(np.mean([d.error**2 for d in v.distances]))))
            cells += [um(v.maximum_distance_error), f"{signed(UM * low)} .. {signed(UM * high)}"]
        if v.points:
            length = np.concatenate([np.linalg.norm(p.residuals, axis=0) for p in v.points])
            cells += [um(np.sqrt(np.mean(length**2))), um(np.mean(length)), um(np.max(length))]
        if v.turns:
            angles = np.concatenate([np.linalg.norm(t.residuals, axis=0) for t in v.turns])
            cells.append(f"{MDEG * np.mean(angles):.2g}")
        table.add_row(model_label(level.effects), *cells, _within(v))
    return table


def _within(v: Validation) -> str:
    """How many values of validation measurements lie within their 95 % prediction intervals."""
    hits = [np.atleast_1d(inside95(d.error, d.predicted)) for d in v.distances]
    checks: list[RowCheck] = [*v.planes, *v.points, *v.turns]
    hits += [inside95(check.residuals, check.predicted).ravel() for check in checks]
    return f"{100 * np.mean(np.concatenate(hits)):.0f} %" if hits else "-"


def distance_table(v: Validation, nominal: Validation, every: bool) -> FigureTable:
    """Errors of certified distances; the largest alone unless `every`."""
    table = plain_table(
        "distances", "certified (mm)", "nominal (µm)", "calibrated (µm)", "95 % predicted", ""
    )
    order = sorted(range(len(v.distances)), key=lambda k: -abs(v.distances[k].error))
    shown = range(len(order)) if every else sorted(order[:MOST_DISTANCES])
    for k in shown:
        d, n = v.distances[k], nominal.distances[k]
        low, high = interval95(d.predicted)
        within = inside95(d.error, d.predicted)
        table.add_row(
            " - ".join(d.between),
            f"{MM * d.certified:.3f}",
            signed(UM * n.error),
            signed(UM * d.error, 1),
            f"{signed(UM * low, 1)} .. {signed(UM * high, 1)}",
            Text("within", style="green") if within else Text("outside", style="yellow"),
        )
    if len(shown) < len(order):
        table.caption = f"the {len(shown)} largest errors of {len(order)}; --verbose: all"
    return table


def tolerance_table(decided: Tolerance) -> FigureTable:
    """Decision on each certified distance."""
    table = plain_table("tolerance", "error (µm)", "U = k u (µm)", "k", "probability within", "decision")
    for d in decided.distances:
        table.add_row(
            " - ".join(d.between),
            signed(UM * d.error, 1),
            um2(d.expanded),
            f"{d.k:.2f}",
            percent(d.probability),
            Text(d.decision, style=DECISIONS.get(d.decision, "yellow")),
        )
    return table


def parameter_table(fit: Fit, every: bool) -> FigureTable:
    """Parameters with standard uncertainties; with `every` those of the targets too."""
    model, known = fit.final.estimate.model, fit.identifiability
    units, factor = model.in_file_units()
    value = model.physical(fit.final.estimate.z) * factor
    u = np.std(model.physical(fit.draws.flat), axis=0) * factor
    prior = np.concatenate([model.sd, *(b.sd for b in model.states)]) * factor
    states = dict.fromkeys(known.determined, "yes")
    states |= dict.fromkeys(known.partly, "weakly") | dict.fromkeys(known.prior_only, "no")
    table = plain_table("parameter", "nominal", "value(u)", "unit", "prior u", "identifiable")
    arm = len(model.parameters)
    for k, name in enumerate(model.names):
        if not every and (k >= arm or model.parameters[k].effect == FORM):
            continue
        nominal = model.parameters[k].nominal * factor[k] if k < arm else 0.0
        number = with_u(value[k], u[k])
        decimals = len(number.partition("(")[0].partition(".")[2])
        table.add_row(
            name,
            unsigned_zero(f"{nominal:.{decimals}f}"),
            number,
            unit_label(units[k]),
            f"{float(f'{prior[k]:.2g}'):.9g}",
            states.get(name, "-"),
            style="yellow" if states.get(name) == "no" else "",
        )
    table.caption = "\n".join(parameter_notes(p.effect for p in model.parameters))
    return table


def verdict_record(tests: Acceptance, dataset: Dataset) -> dict[str, Any]:
    """``verdict``: the word, the tests that fail (`reasons`) and all of them, shared causes of rejections."""
    return {
        "words": tests.verdict,
        "explains": tests.explains,
        "validated": tests.validated,
        "determined": tests.determined,
        "reasons": [_check(c) for c in tests.failed],
        "tests": [_check(c) for c in tests.checks],
        "shared_causes": [
            {
                "kind": cause.kind,
                "label": cause.label,
                "rows": [dataset.measurements.ids[row] for row in cause.rows],
                "rows_in_group": cause.size,
                "rejected": cause.rejected,
                "count": cause.count,
                "p": cause.p_value,
            }
            for cause in tests.causes
        ],
    }


def _check(c: Check) -> dict[str, Any]:
    return {
        "test": c.test, "value": c.value, "limit": c.limit, "p": c.p_value, "level": c.level, "words": c.words
    }  # fmt: skip


def tolerance_record(decided: Tolerance) -> dict[str, Any]:
    """``acceptance``: decisions by ISO 14253-1 on a tolerance of distance errors."""
    return {
        "rule": "ISO 14253-1: PASS where abs(error) + U <= tolerance, FAIL where abs(error) - U > tolerance",
        "tolerance_mm": MM * decided.tolerance,
        "k": decided.k,
        "coverage": COVERAGE,
        "decision": decided.decision,
        "why": decided.why,
        "volume": {"probability": decided.probability, "U_um": UM * decided.expanded},
        "distances": [
            {
                "between": list(d.between),
                "error_um": UM * d.error,
                "U_um": UM * d.expanded,
                "k": d.k,
                "probability": d.probability,
                "decision": d.decision,
            }
            for d in decided.distances
        ],
    }
