"""What changed between sessions: changed.json, text of the terminal, page, CSV, and their run folder."""

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text as Words

from bayescal.changes import Changed, Detectable, Difference
from bayescal.changes.joint import Shift
from bayescal.dataset.table import csv_text
from bayescal.effects import UNITS
from bayescal.effects.vocabulary import unit_label
from bayescal.reporting import text
from bayescal.reporting.origin import entry, filed, origin, plain
from bayescal.reporting.page import FirstScreen, Section, Text, blocks, page, texts
from bayescal.reporting.sheet import Column, Sheet, below, headed, screen
from bayescal.statistics import grouped
from bayescal.storage.files import json_text
from bayescal.storage.folders import filled
from bayescal.storage.reading import Json

SCHEMA = "bayescal-changed/1"
MOST = 6
"""Items that a sentence lists."""
COVERAGE = 2.0
"""k of the expanded uncertainties."""
ITEM = ("item=item.name", "effect=item.effect", "parameter=parameter.name", "site=item.site")
POSE = ("dx_um", "dy_um", "dz_um", "length_um", "U_um")
"""Fields of entries."""


def changed_record(result: Changed) -> Json:
    """The content of changed.json."""
    d = result.distances
    record: dict[str, Any] = {
        **origin(SCHEMA, result.dataset, 0),
        **entry(result, "model=effects", "robot=dataset.robot.name"),
        "sessions": [s.name for s in result.sessions],
        "folders": [str(s.folder) for s in result.sessions],
        **entry(result, "verdict", "arm"),
        "probability": entry(result, "same", "arm_same"),
        "items": [_item(x) for x in result.differences],
        "detectable": [_detectable(x) for x in result.detectable],
        "distances": d and entry(d, "rms_um", "u_rms_um", "largest_um", "u_largest_um"),
        "poses": [_pose(x) for x in result.shifts],
        "noise_factor": result.noise,
        "stop_error_factor": result.of_stops,
        "model_errors": [{"effect": name, "variance_over_prior": x} for name, x in result.errors],
        "targets_compared": sorted(result.compared),
        "warnings": result.warnings,
    }
    record["words"] = words(record)
    return plain(record)


def _item(x: Difference) -> dict[str, Any]:
    unit, factor = UNITS[x.parameter.unit]
    return (
        entry(x, *ITEM, "kind=item.kind")
        | {"unit": unit}
        | entry(x, "sessions")
        | entry(x, "before", "after", "difference", "u", unit=x.parameter.unit)
        | {"U": COVERAGE * factor * x.u, "k": COVERAGE}
        | entry(x, "probability", "class=group", "stated")
    )


def _detectable(x: Detectable) -> dict[str, Any]:
    unit = x.parameter.unit
    return entry(x, *ITEM) | {"unit": UNITS[unit][0]} | entry(x, "value", "tcp_um", unit=unit)


def _pose(x: Shift) -> dict[str, Any]:
    sizes: Sequence[float | None] = [None] * len(POSE)
    if x.shift is not None and x.covariance is not None:
        u = float(np.sqrt(np.trace(x.covariance)))
        length = text.UM * float(np.linalg.norm(x.shift))
        sizes = [*(text.UM * x.shift).tolist(), length, COVERAGE * text.UM * u]
    return {"target": x.where, **dict(zip(POSE, sizes, strict=True)), "reason": x.reason}


def named(item: Json) -> str:
    """An item as text: ``zero of joint 2 (theta2)``, ``compliance J3``, ``base against the targets``."""
    name, site, kind = item["item"], item["site"], item["kind"]
    if kind == "unknown":
        return f"an unmodelled error of {site} ({name.partition(' at ')[0]})"
    if kind == "setup":
        if site == "base":
            return "base against the targets"
        return f"{name} on the flange" if site == "tool" else f"target {name}"
    if item["unit"] == "deg" and kind == "arm" and site.startswith("joint"):
        return f"zero of {site} ({name})"
    return f"{name} of {site}" if kind == "arm" and site not in name else name


def by_item(items: Sequence[Json]) -> list[list[Json]]:
    """Entries of items by the item and its sessions, in order."""
    return list(grouped(((x["item"], ", ".join(x["sessions"])), x) for x in items).values())


SMALL = {"deg": ("mdeg", 1e3), "mm": ("µm", 1e3)}
"""Units of differences, in print, and the factors to them."""


def small(x: Json) -> tuple[float, float, str]:
    """Difference and u of an entry in a unit for print, and that unit."""
    unit, factor = SMALL.get(x["unit"], (unit_label(x["unit"]), 1.0))
    return factor * x["difference"], factor * x["u"], unit


def sized(entries: Sequence[Json]) -> str:
    """The difference of an item as text; the length of a vector."""
    if len(units := dict.fromkeys(x["unit"] for x in entries)) > 1:
        return ", ".join(sized([x for x in entries if x["unit"] == unit]) for unit in units)
    values = np.array([small(x)[:2] for x in entries])
    size, u, unit = float(values[0, 0]), float(values[0, 1]), small(entries[0])[2]
    if len(entries) > 1:
        size = float(np.linalg.norm(values[:, 0]))
        u = float(np.linalg.norm(values[:, 0] * values[:, 1])) / max(size, np.finfo(float).tiny)
    return f"{text.with_u(size, u)} {unit}".rstrip()


OTHER_ARM = 9
"""Changes from which on the sessions may be of different arms (assumed)."""


def words(record: Json) -> list[str]:
    """The conclusion in sentences, the verdict first."""
    same = text.percent(record["probability"]["same"])
    stated = by_item([x for x in record["items"] if x["stated"]])
    open_ = by_item([x for x in record["items"] if not x["stated"]])
    out = []
    if record["verdict"] == "same":
        out.append(f"No change was found. That nothing changed has a probability of {same}.")
    elif record["verdict"] == "ambiguous":
        names = [f"{named(x[0])} ({text.percent(x[0]['probability'])})" for x in (*stated, *open_)[:MOST]]
        out.append(
            f"Not decided. That nothing changed has a probability of {same}."
            + (f" Possible: {text.listed(names, 'or')}." if names else "")
        )
    else:
        groups = dict.fromkeys(tuple(sorted(e[0]["class"])) or (e[0]["item"],) for e in stated)
        for group in groups:
            members = [e for e in stated if e[0]["item"] in group]
            sizes, x = [f"{named(e[0])} by {sized(e)}" for e in members], members[0][0]
            when = since(x["sessions"], record["sessions"])
            what = f"{sizes[0]} (probability {text.percent(x['probability'])})"
            if len(members) > 1:
                what = f"{text.listed(sizes, 'or')}; these sessions do not tell which"
            out.append(f"Changed {when}: {what}.")
        if more := len(out) - MOST:
            out = [*out[:MOST], f"{more} more, in the table."] if more > 1 else out
        if len(groups) >= OTHER_ARM:
            out.append("So much differs that these may be different arms.")
        if all(x[0]["kind"] == "setup" for x in stated):
            p = text.percent(record["probability"]["arm_same"])
            certain = f"The arm itself did not change (probability {p})."
            undecided = "Whether the arm itself changed is not decided."
            out.append(certain if record["arm"] == "same" else undecided)
    moves = record["distances"]
    if moves and record["verdict"] != "same":
        rms, largest = f"{text.with_u(moves['rms_um'], moves['u_rms_um'])} µm", abs(moves["largest_um"])
        out.append(
            f"Distances between the poses of these sessions change by {rms} RMS, at most {largest:.0f} µm."
        )
    return out + found_from(record)


def since(sessions: Sequence[str], every: Sequence[str]) -> str:
    """When something changed, in words."""
    alone = len(sessions) == 1 and sessions[0] != every[-1]
    return f"in {sessions[0]} alone" if alone else f"from {sessions[0]} on"


def found_from(record: Json) -> list[str]:
    """What would have been found, in a sentence for each kind of parameter."""
    parts = []
    for label, entries in detectable_kinds(record).items():
        if seen := [x for x in entries if x["value"] is not None]:
            ends = dict.fromkeys(f"{f(x['tcp_um'] for x in seen):.0f}" for f in (min, max))
            parts.append(f"{label} {' to '.join(ends)} µm")
    said = {x["parameter"] for x in record["items"] if x["stated"]}
    every = [x for group in detectable_kinds(record).values() for x in group]
    unseen = [x["parameter"] for x in every if x["value"] is None and x["parameter"] not in said]
    out = [f"A change would have been found (9 times in 10) if it moved the TCP by: {'; '.join(parts)}."]
    if unseen:
        shown = [*unseen[:MOST], *(["others"] if unseen[MOST:] else [])]
        out.append(f"Not visible in these sessions: {text.listed(shown)}.")
    return out if parts else out[1:]


def detectable_kinds(record: Json) -> dict[str, list[Json]]:
    """Entries of `detectable` by kind, of the model's parameters and the tool."""
    out: dict[str, list[Json]] = {}
    for x in record["detectable"]:
        if x["effect"] in record["model"] or x["site"] == "tool" or x["item"].startswith("theta"):
            angle = "joint zeros" if x["site"].startswith("joint") else "twists"
            kind = {"deg": angle, "mm": "lengths"}.get(x["unit"], x["effect"])
            out.setdefault("tool" if x["site"] == "tool" else kind, []).append(x)
    return out


CHANGED, PAGE, TABLE = "changed.json", "changed.html", "changed.csv"
SIGNS = {
    "same": ("good", "✓", "No change found"),
    "changed": ("warn", "!", "Changed"),
    "ambiguous": ("warn", "?", "Not decided"),
}
"""Tone, sign and word of a verdict."""
STYLES = {"same": "bold green", "changed": "bold red", "ambiguous": "bold yellow"}
CELLS = (
    *("item", "parameter", "effect", "site", "kind", "sessions", "unit", "before", "after", "difference"),
    *("u", "U", "probability", "class", "stated"),
)
"""Columns of the CSV file: keys of the items."""


def absolute(x: Json, key: str) -> str | None:
    """A value of an item with as many decimals as its difference; None where only the difference is known."""
    if x[key] is None:
        return None
    return f"{text.rounded(x[key], x['U'])[0]} {unit_label(x['unit'])}"


def difference(x: Json) -> str:
    """The difference of an entry with its expanded uncertainty, two digits of it and as many of the value."""
    value, u, unit = small(x)
    number, expanded = text.rounded(value, 2.0 * u)
    sign = "+" * (value > 0 and float(number) != 0)
    return f"{sign}{number} ± {expanded} {unit}".rstrip()


def entry_name(x: Json, several: Mapping[str, int]) -> str:
    """A parameter of an item: the item, and the parameter where it has several."""
    name, axis = named(x), x["parameter"].removeprefix(x["item"]).strip()
    return f"{name}: {axis}" if several[x["item"]] > 1 and axis else name


def items_sheet(record: Json, stated: bool = True) -> Sheet:
    """Values before and after, difference with U, probability; of items that are stated or of the others."""
    items = [x for x in record["items"] if x["stated"] == stated]
    several = Counter(x["item"] for x in items)
    when = Column("when", lambda x: since(x["sessions"], record["sessions"]), words=True)
    columns = (
        Column("changed" if stated else "possible", lambda x: entry_name(x, several)),
        *((when,) if len(record["sessions"]) > 2 else ()),
        Column("before", lambda x: absolute(x, "before")),
        Column("after", lambda x: absolute(x, "after")),
        Column("difference ± U", difference),
        Column("P", "probability", text.probability),
    )
    return Sheet(columns, items, "U: expanded uncertainty, k = 2; P: probability")


def least(x: Json) -> str | None:
    """The smallest change in a unit for print; None where none would have been found."""
    unit, factor = SMALL.get(x["unit"], (unit_label(x["unit"]), 1.0))
    return None if x["value"] is None else f"{text.two_digits(factor * x['value'])} {unit}".rstrip()


def detectable_sheet(record: Json) -> Sheet:
    """The smallest change of every parameter that would have been found."""
    items = [x for group in detectable_kinds(record).values() for x in group]
    items += [x for x in record["detectable"] if x not in items]
    columns = (
        Column("parameter", "parameter"),
        Column("site", "site", words=True),
        Column("smallest change", least),
        Column("TCP (µm RMS)", "tcp_um", text.length),
    )
    caption = "Found with a probability of 90 %. Without a value: not visible in these sessions."
    return Sheet(columns, items, caption, 12)


def poses_sheet(record: Json) -> Sheet:
    """Displacements at given poses."""
    columns = (
        Column("target", "target"),
        *(Column(f"{a} (µm)", f"d{a}_um", text.length) for a in "xyz"),
        Column("length (µm)", "length_um", text.length),
        Column("U (µm)", "U_um", text.length),
        Column("note", "reason", words=True),
    )
    caption = "Displacement of the TCP in F0 since the first session, without that of the base."
    return Sheet(columns, record["poses"], caption)


def _basis(record: Json) -> text.Facts:
    noise = ", ".join(f"{x:.2f}" for x in record["noise_factor"])
    others = {named(x): x["probability"] for x in record["items"] if not x["stated"]}
    if others and record["verdict"] != "same":
        yield "also possible", ", ".join(f"{name} ({text.percent(p)})" for name, p in others.items()), ""
    yield "noise", f"{noise} times the stated noise", ""
    if max(record["stop_error_factor"]) >= 1.0:
        shared = text.listed(f"{x:.1f}" for x in record["stop_error_factor"])
        yield "stops", f"measurements of one stop share an error of {shared} times this noise", ""
    if record["model_errors"]:
        names = text.listed(x["effect"] for x in record["model_errors"])
        yield "model errors", f"of all sessions alike, not a change: {names} (bayescal gap judges them)", ""
    count = len(record["targets_compared"])
    yield "compared", f"{count or 'no'} target{'s' * (count != 1)} of the same name and description", ""


def changed_summary(record: Json) -> RenderableType:
    """The conclusion, then values, then what would have been found."""
    first, *others = record["words"]
    title = headed(" -> ".join(record["sessions"]), record["robot"], text.model_label(record["model"]))
    basis = [*_basis(record), *text.under("warning", record["warnings"], "yellow")]
    return screen(
        *(title, "", Words(first, STYLES[record["verdict"]]), *map(Words, others)),
        *(*below(items_sheet(record)), *below(poses_sheet(record)), "", basis),
    )


def _first(record: Json) -> Section:
    tone, sign, word = SIGNS[record["verdict"]]
    d = record["distances"]
    keys = [("nothing changed", text.probability(record["probability"]["same"]), "probability")]
    keys += [("the arm is the same", text.probability(record["probability"]["arm_same"]), "probability")]
    if d and record["verdict"] != "same":
        rms, most = text.length(d["rms_um"]), text.length(abs(d["largest_um"]))
        keys.append(("distances change by", f"{rms} µm", f"RMS; at most {most} µm"))
    folders = [shlex.quote(name) for name in record["folders"]]
    steps = {
        "same": [("One calibration of all sessions:", f"bayescal fit {' '.join(folders)}")],
        "changed": [("Calibrate the arm as it is now:", f"bayescal fit {folders[-1]}")],
        "ambiguous": [("Measure more contacts, and compare again.", "")],
    }[record["verdict"]]
    return FirstScreen(
        word, tone, sign, record["words"], len(record["words"]), keys, next=steps, warnings=record["warnings"]
    ).section()


def changed_page(record: Json) -> str:
    """The page, as text."""
    classes = dict.fromkeys(tuple(x["class"]) for x in record["items"] if x["stated"] and x["class"])
    notes = [f"Only one of these: {text.listed(names, 'or')}." for names in classes]
    basis = [f"{heading}: {words}." for heading, words, _ in _basis(record)]
    values = Text("before and after: values of the joint fit of all sessions; U: of the difference.", "quiet")
    sections = [
        _first(record),
        blocks("items", "What changed", items_sheet(record), *texts(notes)),
        blocks("possible", "What else is possible", items_sheet(record, stated=False)),
        blocks("poses", "Given poses", poses_sheet(record)),
        blocks("detectable", "What would have been found", detectable_sheet(record)),
        blocks("basis", "Basis", *texts(basis), values),
    ]
    subtitle = f"{text.listed(record['sessions'])}, {record['robot']}; model: {', '.join(record['model'])}"
    return page("Changes between sessions", subtitle, sections, headers=filed(record))


def items_csv(record: Json) -> str:
    """The items as CSV; several values of a cell have `; ` between them."""

    def cell(value: object) -> object:
        return "; ".join(map(str, value)) if isinstance(value, list) else value

    return csv_text(CELLS, ([cell(x[key]) for key in CELLS] for x in record["items"]))


def write_changed(record: Json, folder: Path) -> tuple[str, ...]:
    """Write changed.json, changed.html and changed.csv atomically; return their names."""
    texts = {CHANGED: json_text(record, rows=False), PAGE: changed_page(record), TABLE: items_csv(record)}
    return filled(folder, texts)
