"""The run folder of a plan: plan.json, by the output contract, plan.csv, and plan.html."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.dataset.table import CLEARANCE
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Target
from bayescal.dataset.write import table_text, write_setup
from bayescal.importing.onto import MEASURED, PLAN
from bayescal.planning.result import DISTANCES, GAP, REPEAT, VALIDATE, Plan
from bayescal.programs.probing import Probe, formats_of
from bayescal.reporting import plan_sheets
from bayescal.reporting.origin import entry, origin, plain, sized
from bayescal.reporting.page import Facts, FirstScreen, Section, Text, blocks, page, picture
from bayescal.reporting.plan_sheets import clearances, count, payloads
from bayescal.reporting.sheet import Sheet
from bayescal.reporting.text import MM, UM
from bayescal.storage.files import json_text
from bayescal.storage.folders import put, whole


def table_of_plan(plan: Plan) -> str:
    """The content of plan.csv: measurements.csv in the order of probing, cells of results empty.

    Columns of what an instrument reads are there for sessions that have instruments. The last column is the
    smallest clearance of the motions of a row.
    """
    m = plan.session.measurements

    def empty(column: np.ndarray | None) -> np.ndarray | None:
        return None if column is None else np.full_like(column, np.nan)

    rows = replace(
        m, payload=payloads(plan.session), xyz=empty(m.xyz), rpy=empty(m.rpy), length=empty(m.length),
        pixel=None, u=None, stop=None, command=None, torque=None, time=None, temperature=None,
    )  # fmt: skip
    head, *lines = table_text(replace(plan.session, measurements=rows), name_tool=True).splitlines()
    cells = zip(lines, clearances(plan), strict=True)
    return "\n".join([f"{head},{CLEARANCE}", *(f"{line},{clearance}" for line, clearance in cells), ""])


SCHEMA = "bayescal-plan/1"
LIBRARIES = ("numpy", "scipy", "numba")


def plan_record(plan: Plan, commands: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The contents of plan.json; a value that is not finite is null.

    Parameters
    ----------
    plan : Plan
    commands : mapping of str to str, optional
        What to run next, by its purpose.
    """
    setup, session = plan.pool.setup, plan.session
    m = session.measurements
    names = [t.name for t in session.targets]
    mass, loaded = np.unique(payloads(session), return_counts=True)
    used, touched = np.unique(m.target, return_counts=True)
    distances = [
        entry(e, "over", "count", "distance_sd_um=u")
        | {"distance_sd_um_random": UM * e.u_random}
        | entry(e, "shares")
        for e in plan.expected
    ]
    first = distances[0] if distances else {}
    volume = setup.volume
    record = {
        **origin(SCHEMA, setup.dataset, plan.seed, LIBRARIES),
        **entry(plan, "for=aim", "model=effects", "order"),
        "contacts": count(plan),
        "rows": len(m.ids),
        "purposes": {p: plan.purpose.count(p) for p in (DISTANCES, GAP, REPEAT, VALIDATE)},
        "targets": {names[k]: int(n) for k, n in zip(used, touched, strict=True)},
        "payloads": [{"payload_kg": x, "contacts": int(n)} for x, n in zip(mass, loaded, strict=True)],
        "purpose": dict(zip(m.ids, plan.purpose, strict=True)),
        "clearance_mm": dict(zip(m.ids, (MM * plan.clearance).tolist(), strict=False)),
        "smallest_clearance_mm": MM * setup.clearance,
        "changes": {name: text for name, text in zip(m.ids, plan.changes, strict=False) if text},
        "by_hand": {name: text for name, text in zip(m.ids, plan.by_hand, strict=False) if text},
        "candidates": len(plan.pool.candidates),
        **entry(plan.pool, "dropped", "measured"),
        "volume": volume and entry(volume, "centre_mm", "size_mm"),
        "expected": {
            **{key: first.get(key) for key in ("over", "distance_sd_um", "distance_sd_um_random")},
            **entry(plan, "equals_random_contacts=equals_random", "next_distance_sd_um=next_u"),
            "distances": distances,
            "parameters": [entry(p, "name", "unit", "u", "prior_u=prior") for p in plan.parameters],
        },
        **entry(plan, "observability", "observability_random"),
        "curve": _curve(plan.curve),
        "curve_random": _curve(plan.curve_random),
        "detectable": [
            entry(d, "effect", "site") | sized(d, "smallest", "smallest_random", "plausible")
            for d in plan.detectable
        ],
        "confusable": [
            entry(c, "pair", "lambda_before=before", "lambda_after=after")
            | {"intervention": c.intervention or None}
            for c in plan.confusable
        ],
        **entry(plan, "travel_s=travel", "seconds", "warnings"),
        "commands": dict(commands or {}),
    }
    return plain(record)


def _curve(points: Sequence[tuple[int, float]]) -> list[dict[str, Any]]:
    return [{"contacts": n, "distance_sd_um": UM * u} for n, u in points]


STEPS = {
    "import": "Probe the contacts of plan.csv in their order, then import the log of the controller.",
    "images": "Take an image at each row of plan.csv, named by its id, then import the images.",
    "fit": "Calibrate.",
    "gap": "Diagnose unmodelled effects.",
}
"""What each command that follows is for."""


def plan_page(plan: Plan, drawn: bytes, commands: Sequence[tuple[str, str]] = ()) -> str:
    """The page as text.

    Parameters
    ----------
    plan : Plan
    drawn : bytes
        The figure as PNG.
    commands : sequence of (str, str)
        What to run when the contacts are measured: purpose (of `STEPS`) and command.
    """
    title = plan_sheets.title(plan)
    contacts = {"blocks": [plan_sheets.by_target(plan)], "pictures": [picture(title, drawn)]}
    parts = (
        _first(plan, commands),
        Section("contacts", "What to probe", "plan.html.j2", contacts),
        blocks("expected", f"What to expect, {plan_sheets.if_right(plan)}", plan_sheets.expected(plan)),
        _detectable(plan),
        blocks("confusable", "Confusable effects", plan_sheets.confusable(plan)),
        blocks("parameters", "Parameters", Sheet(plan_sheets.PARAMETERS, plan.parameters)),
        blocks("observability", "Observability", plan_sheets.observability(plan)),
        blocks("candidates", "Candidates", Text(plan_sheets.candidates(plan))),
        blocks("all", f"All {plan_sheets.noun(plan)}, in their order", plan_sheets.contacts(plan)),
        _inputs(plan),
    )
    return page(plan.session.name, f"{plan.session.robot.name}; {title}", parts)


def _first(plan: Plan, commands: Sequence[tuple[str, str]]) -> Section:
    """Expected uncertainty, contacts, time; what to run next; warnings."""
    lines = list(plan_sheets.headline(plan)) or [plan_sheets.title(plan)]
    noun = plan_sheets.noun(plan)
    keys = [
        (noun.capitalize(), str(len(plan.purpose)), plan_sheets.contacts_phrase(plan)),
        (f"Motion between {noun}", plan_sheets.duration(plan.travel), f"order: {plan.order}"),
    ]
    if more := plan_sheets.further(plan):
        keys.append((f"{plan_sheets.FURTHER} further {noun}", *more))
    return FirstScreen(
        lines[0],
        lines=lines[1:],
        most=len(lines),
        keys=keys,
        next=[(STEPS[purpose], command) for purpose, command in commands],
        warnings=[*plan.warnings, *(f"not separated: {line}" for line in plan_sheets.not_separated(plan))],
    ).section()


def _detectable(plan: Plan) -> Section | None:
    ratio = plan_sheets.detectability(plan)
    caption = f"Smallest detectable {ratio}" if ratio else ""
    sheet = plan_sheets.detectable(plan, every_site=True)
    named = replace(sheet.columns[0], heading="effect")
    sheet = replace(sheet, columns=(named, *sheet.columns[1:]), caption=caption)
    return blocks("detectable", "Smallest detectable amplitude of each effect", sheet)


def _inputs(plan: Plan) -> Section | None:
    lines = (
        ("set-up, SHA-256", plan.pool.setup.dataset.sha256 or "-"),
        ("model", ", ".join(plan.effects) or "nominal"),
        ("seed", str(plan.seed)),
        ("computed in", plan_sheets.duration(plan.seconds)),
    )
    return blocks("inputs", "Inputs", Facts(lines))


RECORD, PICTURE, PAGE = "plan.json", "plan.png", "plan.html"


def commands(folder: Path, targets: Sequence[Target]) -> dict[str, str]:
    """What to run when the contacts are measured: the import of their log or images, and the calibration."""
    run, board = shlex.quote(str(folder)), targets[0].texts.get("board", "")
    log = {"import": f"bayescal import LOG.csv --plan {run} --out SESSION"}
    if all(KINDS[t.kind].posed for t in targets):
        joints = shlex.quote(str(folder / PLAN))
        options = f"--board {shlex.quote(board)} --joints {joints} --template {run}"
        log = {"images": f"bayescal import IMAGES {options} --out SESSION" if board else ""}
    return {**log, "fit": "bayescal fit SESSION", "gap": "bayescal gap SESSION"}


def write_plan(
    plan: Plan, folder: Path, formats: Sequence[str] = (), probe: Probe | None = None
) -> tuple[str, ...]:
    """Write plan.csv, plan.json, the page, the figure and the setup atomically.

    Parameters
    ----------
    plan : Plan
    folder : Path
        Where they are written; an earlier plan there is replaced.
    formats : sequence of str
        Names of formats for a controller that are written too; see `bayescal.programs.probing`.
    probe : Probe, optional
        How the controller notices a contact.

    Returns
    -------
    tuple of str
        File names.
    """
    from bayescal.reporting.figures.plan import plan_picture

    later = commands(folder, plan.session.targets)
    texts = {PLAN: table_of_plan(plan), RECORD: json_text(plan_record(plan, later), rows=False)}
    if plan.pool.measured:
        texts[MEASURED] = table_text(plan.pool.setup.dataset)
    for form in formats_of(formats, probe):
        texts |= form.files(plan, probe or Probe())
    drawn = plan_picture(plan)
    with whole(folder, RECORD) as stage:
        texts[PAGE] = plan_page(plan, drawn, tuple(later.items()))
        return *put(stage, {**texts, PICTURE: drawn}), *write_setup(plan.pool.setup.dataset, stage)
