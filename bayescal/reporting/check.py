"""The terminal report of a check."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from operator import itemgetter
from typing import Any

from rich.console import Group, RenderableType

from bayescal.preparing.check import Check, check_record
from bayescal.preparing.missing import KINDS, Finding
from bayescal.reporting.shared.text import Facts, by_reason, facts

TITLES = {"refused": "refused by fit", "odd": "odd", "missing": "missing"}
STYLES = {"refused": "red", "odd": "yellow", "missing": "yellow"}
MOST = 6
"""Targets that are listed each; more of one kind are counted."""


def check_summary(of: Check) -> RenderableType:
    """What is understood, what can be assessed, and all findings."""
    record = check_record(of)
    return Group(f"{record['dataset']}  {record['robot']['name']}", facts(_grouped(_lines(of, record))))


def _lines(of: Check, record: dict[str, Any]) -> Facts:
    for key, text in _understood(record):
        yield key, text, ""
    yield "assessable", ", ".join(record["assessed"]) or "nothing", ""
    for reason, names in by_reason(record["not_assessed"]).items():
        yield "not assessable", f"{', '.join(names)}: {reason}", "dim"
    for text in record["not_shown"]:
        yield "not shown", text, "dim"
    if not of.findings:
        yield "findings", "none", "green"
    for f in of.findings:
        yield TITLES[f.kind], f"{f.where}: {f.what}; {f.remedy}", STYLES[f.kind]


def said(findings: tuple[Finding, ...]) -> str:
    """The number of findings of each kind."""
    counts = {kind: sum(f.kind == kind for f in findings) for kind in KINDS}
    return ", ".join(f"{count} {TITLES[kind]}" for kind, count in counts.items() if count) or "no findings"


def _grouped(lines: Facts) -> Facts:
    """Lines with their title only where it changes."""
    before = ""
    for title, text, style in lines:
        yield "" if title == before else title, text, style
        before = title


def _understood(r: dict[str, Any]) -> Iterator[tuple[str, str]]:
    masses = "with masses of the links" if r["robot"]["masses"] else "no masses of the links"
    yield "robot", f"{r['robot']['name']}, {r['robot']['joints']} joints, {masses}; readings: {r['readings']}"
    roles = {role: n for role, n in r["rows"].items() if role != "total"}
    yield "rows", ", ".join([str(r["rows"]["total"]), *(f"{n} {role}" for role, n in roles.items())])
    for kind, targets in _by_kind(r["targets"]):
        names = [f"{t['name']} ({_counts(t['rows'])})" for t in targets]
        more = f" and {len(names) - MOST} more" if len(names) > MOST else ""
        yield "targets", f"{len(names)} {kind}: {', '.join(names[:MOST])}{more}"
    yield "tools", ", ".join(f"{name} ({n} measurements)" for name, n in r["tools"].items())
    for kind, certificates in _by_kind(r["certificates"]):
        yield "certificates", _certified(kind, certificates)
    stated = [(*key.partition("_"), value) for key, value in r["noise"].items() if value]
    yield "noise (k = 1)", ", ".join(f"{of} {value:g} {unit}" for of, _, unit, value in stated)
    time = "no times" if r["duration_s"] is None else f"{r['duration_s'] / 3600:.1f} h"
    load = ", ".join(f"{p:g}" for p in r["payloads_kg"]) or "0"
    conditions = (
        time,
        f"payload {load} kg",
        f"{r['repeats']} repeated contacts, {r['stops']} stops",
        f"{'with' if r['velocities'] else 'no'} joint velocities",
        f"temperature of the {r['temperature_of']}" if r["temperature_of"] else "no temperatures",
    )
    yield "conditions", "; ".join(conditions)
    model = " + ".join(r["model"]) or "none"
    yield "model", f"{model}: {r['unknowns']} unknowns, {r['values']} values to fit them"


def _by_kind(entries: list[dict[str, Any]]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    for kind, group in groupby(sorted(entries, key=itemgetter("kind")), key=itemgetter("kind")):
        yield kind, list(group)


def _counts(rows: dict[str, int]) -> str:
    return ", ".join(f"{n} {role}" for role, n in rows.items()) or "no measurements"


def _certified(kind: str, group: list[dict[str, Any]]) -> str:
    """Certificates of one kind, with the ranges of their lengths and uncertainties."""

    def span(key: str, digits: int) -> str:
        values = sorted({c[key] for c in group if key in c})
        return (
            " to ".join(f"{v:.{digits}g}" for v in dict.fromkeys((values[0], values[-1]))) if values else ""
        )

    units = {"u_um": "µm", "u_form_um": "µm", "u_angle_urad": "µrad"}
    u = [f"u = {text} {unit}" for key, unit in units.items() if (text := span(key, 3))]
    length = span("distance_mm", 6)
    return f"{len(group)} {kind}{f' of {length} mm' if length else ''}, {', '.join(u)}"
