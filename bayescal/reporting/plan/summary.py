"""The terminal summary of a plan: its benefit, its contacts, what it can detect, and its limits."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Group, RenderableType
from rich.text import Text

from bayescal.planning.result import Plan
from bayescal.reporting.page.section import Sheet
from bayescal.reporting.plan import sheets
from bayescal.reporting.shared.text import FigureTable, facts, plain_table

PAIRS = 4
"""Pairs that are not separated; the others are in plan.html."""

Facts = Iterable[tuple[str, str, str]]


def plan_summary(plan: Plan) -> RenderableType:
    """Expected uncertainty, contacts, detectable amplitudes, pairs, warnings: one screen."""
    name = Text.assemble((plan.session.name, "bold"), f"  {plan.session.robot.name}  {sheets.title(plan)}")
    parts: list[RenderableType] = [
        name,
        *(Text(line, "" if k else "bold") for k, line in enumerate(sheets.headline(plan))),
        "",
    ]
    if plan.expected:
        parts.append(_table(sheets.expected(plan)))
    parts += [facts(_buys(plan)), "", _table(sheets.by_target(plan)), facts(_costs(plan))]
    if plan.detectable:
        parts += ["", _table(sheets.detectable(plan)), facts(_detects(plan))]
    parts.append(facts(_limits(plan)))
    return Group(*parts)


def _table(sheet: Sheet) -> FigureTable:
    table = plain_table(sheet.title, *sheet.headings)
    for row in sheet.rows:
        table.add_row(*(Text(cell) for cell in row))
    return table


def _buys(plan: Plan) -> Facts:
    if text := sheets.further(plan):
        yield "next 20", text, ""


def _costs(plan: Plan) -> Facts:
    yield "contacts", sheets.contacts_phrase(plan), ""
    yield "travel", sheets.travel(plan), ""
    yield "candidates", sheets.candidates(plan), "dim"


def _detects(plan: Plan) -> Facts:
    if text := sheets.detectability(plan):
        yield "detectable", text, ""


def _limits(plan: Plan) -> Facts:
    """Pairs of effects, and warnings."""
    if text := sheets.separated(plan):
        yield "separates", text, ""
    lines = sheets.not_separated(plan)
    more = [f"and {len(lines) - PAIRS} further pairs: see plan.html"] if len(lines) > PAIRS + 1 else []
    for k, line in enumerate([*lines[:PAIRS], *more] if more else lines):
        yield "" if k else "not separated", line, "yellow"
    for k, warning in enumerate(plan.warnings):
        yield "" if k else "warning", warning, "yellow"
