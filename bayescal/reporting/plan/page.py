"""`plan.html`: a plan as a page of one file, from the templates of all pages."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import replace

from bayescal import __version__
from bayescal.planning.result import Plan
from bayescal.reporting.page.render import page
from bayescal.reporting.page.section import Facts, FirstScreen, Section, Text, blocks
from bayescal.reporting.plan import sheets
from bayescal.reporting.shared.sheet import Sheet

STEPS = {
    "import": "Probe the contacts of plan.csv in their order, then import the log of the controller.",
    "fit": "Calibrate.",
    "gap": "Diagnose unmodelled effects.",
}
"""What each command that follows is for."""


def plan_page(plan: Plan, picture: bytes, commands: Sequence[tuple[str, str]] = ()) -> str:
    """The page as text.

    Parameters
    ----------
    plan : Plan
    picture : bytes
        The figure as PNG.
    commands : sequence of (str, str)
        What to run when the contacts are measured: purpose (of `STEPS`) and command.
    """
    title = sheets.title(plan)
    found = (
        _first(plan, commands),
        _contacts(plan, picture),
        blocks("expected", "What to expect, assuming the model is correct", sheets.expected(plan)),
        _detectable(plan),
        blocks("confusable", "Confusable effects", sheets.confusable(plan)),
        blocks("parameters", "Parameters", Sheet(sheets.PARAMETERS, plan.parameters)),
        blocks("observability", "Observability", sheets.observability(plan)),
        blocks("candidates", "Candidates", Text(sheets.candidates(plan))),
        blocks("all", "All contacts, in the order of probing", sheets.contacts(plan)),
        _inputs(plan),
    )
    foot = [f"bayescal {__version__}"]
    sections = [s for s in found if s is not None]
    return page(plan.session.name, f"{plan.session.robot.name}; {title}", sections, foot)


def _first(plan: Plan, commands: Sequence[tuple[str, str]]) -> Section:
    """Expected uncertainty, contacts, time; what to run next; warnings."""
    lines = list(sheets.headline(plan)) or [sheets.title(plan)]
    keys = [("Contacts", str(len(plan.purpose)), sheets.contacts_phrase(plan))]
    keys += [("Motion between contacts", sheets.duration(plan.travel), f"order: {plan.order}")]
    if text := sheets.further(plan):
        name, _, found = text.partition(": ")
        value, _, less = found.removesuffix(")").partition(" (")
        keys.append((name, value, less))
    return FirstScreen(
        lines[0],
        lines=lines[1:],
        most=len(lines),
        keys=keys,
        next=[(STEPS[purpose], command) for purpose, command in commands],
        warnings=[*plan.warnings, *(f"not separated: {line}" for line in sheets.not_separated(plan))],
    ).section()


def _contacts(plan: Plan, picture: bytes) -> Section:
    source = f"data:image/png;base64,{base64.b64encode(picture).decode('ascii')}"
    parts = {"blocks": [sheets.by_target(plan)], "pictures": [(sheets.title(plan), source)]}
    return Section("contacts", "What to probe", "plan.html.j2", parts)


def _detectable(plan: Plan) -> Section | None:
    if not plan.detectable:
        return None
    ratio = sheets.detectability(plan)
    caption = f"Smallest detectable {ratio}" if ratio else ""
    sheet = sheets.detectable(plan, every_site=True)
    named = replace(sheet.columns[0], heading="effect")
    sheet = replace(sheet, columns=(named, *sheet.columns[1:]), caption=caption)
    return blocks("detectable", "Smallest detectable amplitude of each effect", sheet)


def _inputs(plan: Plan) -> Section | None:
    lines = (
        ("set-up, SHA-256", plan.pool.setup.dataset.sha256 or "-"),
        ("model", ", ".join(plan.effects) or "nominal"),
        ("seed", str(plan.seed)),
        ("computed in", sheets.duration(plan.seconds)),
    )
    return blocks("inputs", "Inputs", Facts(lines))
