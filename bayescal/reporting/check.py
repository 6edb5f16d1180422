"""The terminal report of a check."""

from collections.abc import Iterator
from itertools import groupby
from operator import itemgetter
from shlex import quote
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType

from bayescal.errors import listed
from bayescal.preparing.check import Check
from bayescal.preparing.missing import KINDS, Finding
from bayescal.reporting.sheet import Column, Sheet, headed, screen
from bayescal.reporting.text import MISSING, Facts, by_reason, with_u
from bayescal.storage.reading import Json

if TYPE_CHECKING:  # with it comes all that reads joint logs
    from bayescal.preparing.joint_log import LogCheck

TITLES = {"refused": "refused by fit", "odd": "odd", "missing": "missing"}
STYLES = {"refused": "red", "odd": "yellow", "missing": "yellow"}
MOST = 6
"""Targets that are listed each; more of one kind are counted."""


def check_summary(of: "Check | LogCheck", record: Json) -> RenderableType:
    """What is understood, what can be assessed, and all findings; `record` is that of the check."""
    name, robot = record["dataset"], record["robot"]["name"]
    if isinstance(of, Check):
        return screen(f"{name}  {robot}", _grouped(_lines(of, record)))
    head = headed(name, robot if robot != name else "")
    return screen(head, _grouped(_log_lines(of, record)), "", joint_sheet(record))


def _lines(of: Check, record: Json) -> Facts:
    for key, text in _understood(record):
        yield key, text, ""
    yield from _assessed(record)
    for text in record["not_shown"]:
        yield "not shown", text, "dim"
    yield from _found(of.findings)


def _assessed(record: Json) -> Facts:
    yield "assessable", ", ".join(record["assessed"]) or "nothing", ""
    for reason, names in by_reason(record["not_assessed"]).items():
        yield "not assessable", f"{', '.join(names)}: {reason}", "dim"


def _found(findings: tuple[Finding, ...]) -> Facts:
    if not findings:
        yield "findings", "none", "green"
    for f in findings:
        yield TITLES[f.kind], f"{f.where}: {f.what}; {f.remedy}", STYLES[f.kind]


def _log_lines(of: "LogCheck", record: Json) -> Facts:
    """A joint log: what is understood, what can be assessed, findings."""
    torque, stamps = record["torque"], record["stamps"]
    kind = f"torque: {torque['kind'] or 'none'}{'' if torque['signed'] else ', unsigned'}"
    yield "columns", f"{', '.join(record['columns'])}; {kind}", ""
    for role in ("calibrate", "validate"):
        group = [m for m in record["motions"] if m["role"] == role]
        kinds = ", ".join(dict.fromkeys(m["kind"] for m in group if m["kind"]))
        again = sum(m["same_as"] != m["id"] for m in group)
        loaded = sum(m["payload_kg"] > 0 for m in group)
        time = sum(m["duration_s"] for m in group)
        text = f"{len(group)} motions, {time:.0f} s{f' ({kinds})' if kinds else ''}; "
        text += f"{again} repeats, {loaded} loaded"
        yield role, text, ""
    scatter = f"{100 * stamps['jitter']:.2g} %" if stamps["jitter"] > 1e-4 else "< 0.01 %"
    steps = f"{record['rows']} rows, a step of {stamps['step_ms']:.4g} ms, scatter {scatter}"
    yield "stamps", f"{steps}, longest {stamps['longest_ms']:.4g} ms", ""
    warm = record["temperature_range_K"]
    yield "conditions", "no temperature" if warm is None else f"temperature range {warm:.2g} K", ""
    for text in record["assumed"]:
        yield "assumed", text, "dim"
    yield from _assessed(record)
    yield from _found(of.findings)
    if record["assessed"]:
        yield "next", f"bayescal fit {quote(str(of.log.files[0].parent))}", "bold"


def _delay(of: Json) -> str:
    """A delay with its u."""
    value, u = of["value"], of["u"]
    if value is None:
        return MISSING
    return f"{value:.2g}" if u is None else with_u(value, max(u, 0.01))


JOINTS = (
    Column("joint", "name"),
    Column("range / deg", "range_deg", lambda ends: f"{ends[0]:.0f} to {ends[1]:.0f}"),
    Column("fastest / rad/s", "fastest_rad_per_s", "{:.2f}".format),
    Column("at rest / %", "at_rest", lambda share: f"{100 * share:.0f}"),
    Column("slow / s", "slow_s", "{:.1f}".format),
    Column("torque late / ms", lambda joint: joint["delay_ms"]["torque"], _delay),
    Column("velocity late / ms", lambda joint: joint["delay_ms"]["velocity"], _delay),
    Column("tracking late / ms", lambda joint: joint["delay_ms"]["position_after_command"], _delay),
    Column("tracking / deg", "tracking_rms_deg", "{:.2g}".format),
    Column("velocity filtered / Hz", "velocity_cutoff_Hz", "{:.2g}".format),
    Column("torque filtered / Hz", "torque_filtered_above_Hz", "{:.2g}".format),
)
LATE = (
    "late: torque behind what positions predict, velocity behind the derivative of position, position "
    "behind command; in brackets u of the last digits"
)


def joint_sheet(record: Json) -> Sheet:
    """The joints of a joint log: range, speed, rest, delays with their u, filters."""
    return Sheet(JOINTS, record["joints"], LATE)


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


def _understood(r: Json) -> Iterator[tuple[str, str]]:
    masses = "with masses of the links" if r["robot"]["masses"] else "no masses of the links"
    yield "robot", f"{r['robot']['name']}, {r['robot']['joints']} joints, {masses}; readings: {r['readings']}"
    if r["robot"].get("two_arms"):
        yield "", r["robot"]["two_arms"]
    roles = {role: n for role, n in r["rows"].items() if role != "total"}
    yield "rows", ", ".join([str(r["rows"]["total"]), *(f"{n} {role}" for role, n in roles.items())])
    for kind, targets in _by_kind(r["targets"]):
        names = [f"{t['name']} ({_counts(t['rows'])})" for t in targets]
        yield "targets", f"{len(names)} {kind}: {listed(names, MOST)}"
    yield "tools", ", ".join(f"{name} ({n} measurements)" for name, n in r["tools"].items())
    for kind, certificates in _by_kind(r["certificates"]):
        yield "certificates", _certified(kind, certificates)
    stated = [(*key.partition("_"), value) for key, value in r["noise"].items() if value]
    yield "noise (k = 1)", ", ".join(f"{of} {value:g} {unit}" for of, _, unit, value in stated)
    time = "no times" if r["duration_s"] is None else f"{r['duration_s'] / 3600:.1f} h"
    load = ", ".join(f"{p:g}" for p in r["payloads_kg"]) or "0"
    unstated = "temperatures of arm or air (`temperature_of` does not say which)"
    unstated = unstated if r["temperatures"] else "no temperatures"
    conditions = (
        time,
        f"payload {load} kg",
        f"{r['repeats']} repeated contacts, {r['stops']} stops",
        f"{'with' if r['velocities'] else 'no'} joint velocities",
        f"temperature of the {r['temperature_of']}" if r["temperature_of"] else unstated,
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
        return " to ".join(f"{v:.{digits}g}" for v in dict.fromkeys((*values[:1], *values[-1:])))

    units = {"u_um": "µm", "u_form_um": "µm", "u_angle_urad": "µrad"}
    u = [f"u = {text} {unit}" for key, unit in units.items() if (text := span(key, 3))]
    length = span("distance_mm", 6)
    return f"{len(group)} {kind}{f' of {length} mm' if length else ''}, {', '.join(u)}"
