"""The terminal report of a check."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from rich.console import Group, RenderableType

from bayescal.preparing.check import Check, check_record
from bayescal.preparing.missing import KINDS, Finding
from bayescal.reporting.shared.text import by_reason, facts

TITLES = {"refused": "refused by fit", "odd": "odd", "missing": "missing"}
STYLES = {"refused": "red", "odd": "yellow", "missing": "yellow"}
MOST = 6
"""Targets that are listed each; more of one kind are counted."""


def check_summary(of: Check) -> RenderableType:
    """What is understood, what can be assessed, and all findings."""
    record = check_record(of)
    lines = [(key, text, "") for key, text in _understood(record)]
    lines += [("assessable", ", ".join(record["assessed"]) or "nothing", "")]
    for reason, names in by_reason(record["not_assessed"]).items():
        lines.append(("not assessable", f"{', '.join(names)}: {reason}", "dim"))
    lines += [("not shown", text, "dim") for text in record["not_shown"]]
    if not of.findings:
        lines.append(("findings", "none", "green"))
    for kind, own in groupby(of.findings, key=lambda f: f.kind):
        lines += [(TITLES[kind], f"{f.where}: {f.what}; {f.remedy}", STYLES[kind]) for f in own]
    return Group(f"{record['dataset']}  {record['robot']['name']}", facts(_grouped(lines)))


def said(findings: tuple[Finding, ...]) -> str:
    """The number of findings of each kind."""
    counts = {kind: sum(f.kind == kind for f in findings) for kind in KINDS}
    return ", ".join(f"{count} {TITLES[kind]}" for kind, count in counts.items() if count) or "no findings"


def _grouped(lines: list[tuple[str, str, str]]) -> Iterator[tuple[str, str, str]]:
    """Lines with their title only where it changes."""
    before = ""
    for title, text, style in lines:
        yield "" if title == before else title, text, style
        before = title


def _understood(r: dict[str, Any]) -> Iterator[tuple[str, str]]:
    masses = "with masses of the links" if r["robot"]["masses"] else "no masses of the links"
    yield "robot", f"{r['robot']['name']}, {r['robot']['joints']} joints, {masses}; readings: {r['readings']}"
    yield (
        "rows",
        ", ".join(
            [f"{r['rows']['total']}", *(f"{n} {role}" for role, n in r["rows"].items() if role != "total")]
        ),
    )
    for kind, own in groupby(sorted(r["targets"], key=lambda t: t["kind"]), key=lambda t: t["kind"]):
        each = list(own)
        names = [f"{t['name']} ({_counts(t['rows'])})" for t in each]
        more = f" and {len(names) - MOST} more" if len(names) > MOST else ""
        yield "targets", f"{len(each)} {kind}: {', '.join(names[:MOST])}{more}"
    yield "tools", ", ".join(f"{name} ({n} measurements)" for name, n in r["tools"].items())
    for kind, group in groupby(sorted(r["certificates"], key=lambda c: c["kind"]), key=lambda c: c["kind"]):
        yield "certificates", _certified(kind, list(group))
    noise = [
        " ".join((key.partition("_")[0], f"{value:g}", key.partition("_")[2]))
        for key, value in r["noise"].items()
        if value
    ]
    yield "noise (k = 1)", ", ".join(noise)
    time = "no times" if r["duration_s"] is None else f"{r['duration_s'] / 3600:.1f} h"
    load = ", ".join(f"{p:g}" for p in r["payloads_kg"]) or "0"
    yield (
        "conditions",
        (
            f"{time}; payload {load} kg; {r['repeats']} repeated contacts, {r['stops']} stops; "
            f"{'with' if r['velocities'] else 'no'} joint velocities; "
            f"{'temperature of the ' + r['temperature_of'] if r['temperature_of'] else 'no temperatures'}"
        ),
    )
    yield (
        "model",
        f"{' + '.join(r['model']) or 'none'}: {r['unknowns']} unknowns, {r['values']} values to fit them",
    )


def _counts(rows: dict[str, int]) -> str:
    return ", ".join(f"{n} {role}" for role, n in rows.items()) or "no measurements"


def _certified(kind: str, group: list[dict[str, Any]]) -> str:
    """Certificates of one kind, with the range of their uncertainties."""
    keys = {"u_um": "µm", "u_form_um": "µm", "u_angle_urad": "µrad"}
    parts = []
    for key, unit in keys.items():
        values = sorted({c[key] for c in group if key in c})
        if values:
            span = f"{values[0]:.3g}" + (f" to {values[-1]:.3g}" if len(values) > 1 else "")
            parts.append(f"u = {span} {unit}")
    lengths = sorted({c["distance_mm"] for c in group if "distance_mm" in c})
    of = (
        f" of {lengths[0]:.6g}" + (f" to {lengths[-1]:.6g}" if len(lengths) > 1 else "") + " mm"
        if lengths
        else ""
    )
    return f"{len(group)} {kind}{of}, {', '.join(parts)}"
