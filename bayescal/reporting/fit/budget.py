"""`budget.json` and `budget.csv`: uncertainty budgets in numbers, and as a table of the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import RenderableType

from bayescal.assess.budget import COVERAGE, MOST_DOF, Budget, Component
from bayescal.assess.inputs import Basis
from bayescal.assess.measurand import PARAMETER
from bayescal.dataset.table import csv_text
from bayescal.effects import UNITS
from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.shared.origin import entry, origin, plain, scaled
from bayescal.reporting.shared.sheet import screen, sheet_of_cells
from bayescal.reporting.shared.text import MISSING, Facts, percent, size, two_digits
from bayescal.statistics import decimals_of

SCHEMA = "bayescal-budget/1"
LIBRARIES = ("numpy", "scipy")
COLUMNS = (
    "group", "name", "type", "distribution", "value", "u", "unit", "dof", "sensitivity", "sensitivity_unit",
    "contribution", "contribution_um", "share",
)  # fmt: skip
PRIORS = 0.5
"""Share of the variance from which on priors, not rows, determine a result."""
SHOWN = 1e-3
"""Share of the variance below which the terminal does not list a component."""


def budget_record(budgets: Sequence[Budget], basis: Basis, seed: int) -> dict[str, Any]:
    """The content of budget.json: the first budget at the top, and all of them as a list."""
    every = [measurand_record(b) for b in budgets]
    record = {
        **origin(SCHEMA, basis.stated.plain.model.scene.dataset, seed, LIBRARIES),
        **every[0],
        "unexplained_um": 1e6 * basis.excess,
        "unexplained_dof": basis.excess_dof,
        "correlations": [
            {"between": [a, b], "correlation": r} for a, b, r in (budgets[0].correlations if budgets else ())
        ],
        "budgets": every,
    }
    out: dict[str, Any] = plain(record)
    return out


def measurand_record(budget: Budget) -> dict[str, Any]:
    """One budget. Contributions are in the unit of the measurand, and in µm where that is a length."""
    m = budget.measurand
    unit, factor = UNITS[m.unit]
    length = m.unit == "m"
    return {
        "measurand": m.name,
        "kind": m.kind,
        "unit": unit,
        "value": scaled(m.value, factor),
        "position_mm": None if m.position is None else 1e3 * m.position,
        "components": [_component(budget, c) for c in budget.components],
        "u": factor * budget.u,
        "U": factor * budget.expanded,
        **(entry(budget, "u_um", "U_um=expanded") if length else {"u_um": None, "U_um": None}),
        **entry(budget, "effective_dof=dof", "k"),
        "coverage": COVERAGE,
        "prior_share": budget.prior_share,
        "text": in_words(budget),
    }


def _component(budget: Budget, c: Component) -> dict[str, Any]:
    unit, factor = UNITS[c.input.unit]
    of, scale = UNITS[budget.measurand.unit]

    def contribution(value: float) -> dict[str, Any]:
        length = budget.measurand.unit == "m"
        return {"contribution": scale * value, "contribution_um": 1e6 * value if length else None}

    return {
        **entry(c.input, "group", "name", "type=evaluation", "distribution"),
        "value": scaled(c.input.value, factor),
        "u": scaled(c.input.u, factor),
        "unit": unit,
        "dof": c.input.dof,
        "sensitivity": None if c.sensitivity is None else c.sensitivity * scale / factor,
        "sensitivity_unit": f"{of}/{unit}" if of != unit else "1",
        **contribution(c.contribution),
        "share": c.contribution**2 / budget.u**2 if budget.u else 0.0,
        "by_target": [{"target": name, **contribution(value)} for name, value in c.by_target],
    }


def budget_csv(budgets: Sequence[Budget]) -> str:
    """All components of all budgets, and the sum of each, as CSV."""
    rows = []
    for b in budgets:
        record = plain(measurand_record(b))
        components = record["components"]
        for name, key in (("combined standard uncertainty", "u"), ("expanded uncertainty", "U")):
            components.append(
                {
                    "group": key,
                    "name": name,
                    "unit": record["unit"],
                    "contribution": record[key],
                    "contribution_um": record[f"{key}_um"],
                    "dof": record["effective_dof"] or None,
                    "sensitivity": record["k"] if key == "U" else None,
                    "value": record["value"],
                }
            )
        rows += [(b.measurand.name, *(c.get(key) for key in COLUMNS)) for c in components]
    return csv_text(("measurand", *COLUMNS), rows)


def in_words(budget: Budget) -> str:
    """``(0.1 ± 15.2) µm, k = 2.00``: two digits of U, the value to the same decimal (JCGM 100, 7.2.6)."""
    m = budget.measurand
    error = m.value is None or abs(m.value) < 1e3 * budget.u  # then a length is in µm
    unit, factor = ("um", 1e6) if m.unit == "m" and m.kind != PARAMETER and error else UNITS[m.unit]
    value, u = rounded(None if m.value is None else factor * m.value, factor * budget.expanded)
    of = unit_label(unit)
    text = f"U = {u} {of}" if value is None else f"({value} ± {u}) {of}"
    return f"{text.rstrip()}, k = {budget.k:.2f}"


def rounded(value: float | None, u: float) -> tuple[str | None, str]:
    """A value and its uncertainty as text: two significant digits of u."""
    if not (np.isfinite(u) and u > 0):
        return (None if value is None else f"{value:.9g}"), f"{u:.2g}"
    decimals = decimals_of(u)
    digits = max(decimals, 0)
    first = None if value is None else f"{round(value, decimals) + 0.0:.{digits}f}"
    return first, f"{round(u, decimals):.{digits}f}"


def budget_table(budget: Budget) -> RenderableType:
    """The components of a budget, the largest first, its sum and its expanded uncertainty."""
    m = budget.measurand
    unit, factor = ("um", 1e6) if m.unit == "m" else UNITS[m.unit]
    ranked = sorted(budget.components, key=lambda c: -abs(c.contribution))
    shown = [c for c in ranked if c.contribution**2 >= SHOWN * budget.u**2]
    rows = [
        (
            c.input.name,
            c.input.evaluation,
            MISSING if c.input.u is None else size(c.input.u, c.input.unit),
            _sensitivity(budget, c),
            two_digits(factor * c.contribution),
            percent(c.contribution**2 / budget.u**2),
        )
        for c in shown
    ]
    if small := ranked[len(shown) :]:
        together = float(np.sqrt(sum(c.contribution**2 for c in small)))
        share = percent(together**2 / budget.u**2)
        rows.append((f"{len(small)} smaller components", "", "", "", two_digits(factor * together), share))
    contribution = f"contribution ({unit_label(unit) or '1'})"
    headings = ("component", "type", "u", "sensitivity", contribution, "share")
    return screen(sheet_of_cells(headings, rows), "", _sums(budget))


def _sensitivity(budget: Budget, c: Component) -> str:
    if c.sensitivity is None:
        return "-"
    (of, scale), (unit, factor) = UNITS[budget.measurand.unit], UNITS[c.input.unit]
    number = f"{c.sensitivity * scale / factor:.2g}"
    return number if of == unit else f"{number} {unit_label(of) or '1'}/{unit_label(unit)}".removesuffix("/")


def _sums(budget: Budget) -> Facts:
    """The measurand, its uncertainty, and whether priors determine it."""
    unit, factor = ("um", 1e6) if budget.measurand.unit == "m" else UNITS[budget.measurand.unit]
    dof = "normal" if budget.dof > MOST_DOF else f"{budget.dof:.0f} effective degrees of freedom"
    u = rounded(None, factor * budget.u)[1]
    yield "measurand", budget.measurand.name, "bold"
    if budget.measurand.position is not None:
        coordinates = ", ".join(f"{1e3 * x:.3f}" for x in budget.measurand.position)
        yield "position", f"({coordinates}) mm in F0", ""
    yield "u", f"{u} {unit_label(unit)} ({dof})", ""
    yield "result", f"{in_words(budget)}, coverage {100 * COVERAGE:.2f} %", "bold"
    if budget.prior_share >= PRIORS:
        words = f"by the measurements: {percent(budget.prior_share)} of the variance is that of priors"
        yield "not determined", words, "yellow"
