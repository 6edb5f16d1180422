"""What changed, as text of the terminal, as a page, as CSV, and its run folder."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from rich.console import RenderableType
from rich.text import Text as Words

from bayescal import __version__
from bayescal.dataset.table import csv_text
from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.changed_record import SMALL, detectable_kinds, named, since, small
from bayescal.reporting.page.section import FirstScreen, Section, Text, blocks, page, texts
from bayescal.reporting.shared.origin import filed
from bayescal.reporting.shared.sheet import Column, Sheet, below, screen
from bayescal.reporting.shared.text import (
    Facts,
    length,
    listed,
    model_label,
    percent,
    probability,
    two_digits,
    under,
    with_u,
)
from bayescal.storage.files import json_text
from bayescal.storage.folders import filled
from bayescal.storage.reading import Json

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
    value = x[key]
    return value if value is None else f"{with_u(value, x['u']).partition('(')[0]} {unit_label(x['unit'])}"


def difference(x: Json) -> str:
    """The difference of an entry with its expanded uncertainty."""
    value, u, unit = small(x)
    decimals = len(with_u(value, u).partition("(")[0].partition(".")[2])
    return f"{value:+.{decimals}f} ± {two_digits(2.0 * u)} {unit}".rstrip()


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
        Column("P", "probability", probability),
    )
    return Sheet(columns, items, "U: expanded uncertainty, k = 2; P: probability")


def least(x: Json) -> str | None:
    """The smallest change in a unit for print; None where none would have been found."""
    unit, factor = SMALL.get(x["unit"], (unit_label(x["unit"]), 1.0))
    return None if x["value"] is None else f"{two_digits(factor * x['value'])} {unit}".rstrip()


def detectable_sheet(record: Json) -> Sheet:
    """The smallest change of every parameter that would have been found."""
    items = [x for own in detectable_kinds(record).values() for x in own]
    items += [x for x in record["detectable"] if x not in items]
    columns = (
        Column("parameter", "parameter"),
        Column("site", "site", words=True),
        Column("smallest change", least),
        Column("TCP (µm RMS)", "tcp_um", length),
    )
    caption = "Found with a probability of 90 %. Without a value: not visible in these sessions."
    return Sheet(columns, items, caption, 12)


def poses_sheet(record: Json) -> Sheet:
    """Displacements at given poses."""
    columns = (
        Column("target", "target"),
        *(Column(f"{a} (µm)", f"d{a}_um", length) for a in "xyz"),
        Column("length (µm)", "length_um", length),
        Column("U (µm)", "U_um", length),
        Column("note", "reason", words=True),
    )
    caption = "Displacement of the TCP in F0 since the first session, without that of the base."
    return Sheet(columns, record["poses"], caption)


def _basis(record: Json) -> Facts:
    noise = ", ".join(f"{x:.2f}" for x in record["noise_factor"])
    others = {named(x): x["probability"] for x in record["items"] if not x["stated"]}
    if others and record["verdict"] != "same":
        yield "also possible", ", ".join(f"{name} ({percent(p)})" for name, p in others.items()), ""
    yield "noise", f"{noise} times the stated noise", ""
    if record["model_errors"]:
        names = listed(x["effect"] for x in record["model_errors"])
        yield "model errors", f"of all sessions alike, not a change: {names} (bayescal gap judges them)", ""
    count = len(record["targets_compared"])
    words = f"{count} targets of the same name and description" if count else "no target is in two sessions"
    yield "compared", words, ""


def changed_summary(record: Json) -> RenderableType:
    """The conclusion, then values, then what would have been found."""
    first, *others = record["words"]
    title = Words.assemble(
        (" -> ".join(record["sessions"]), "bold"), f"  {record['robot']}  {model_label(record['model'])}"
    )
    basis = [*_basis(record), *under("warning", record["warnings"], "yellow")]
    return screen(
        *(title, "", Words(first, STYLES[record["verdict"]]), *map(Words, others)),
        *(*below(items_sheet(record)), *below(poses_sheet(record)), "", basis),
    )


def _first(record: Json) -> Section:
    tone, sign, word = SIGNS[record["verdict"]]
    d = record["distances"]
    keys = [("nothing changed", probability(record["probability"]["same"]), "probability")]
    keys += [("the arm is the same", probability(record["probability"]["arm_same"]), "probability")]
    if d and record["verdict"] != "same":
        rms, most = length(d["rms_um"]), length(abs(d["largest_um"]))
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
    notes = [f"Only one of these: {listed(names, 'or')}." for names in classes]
    basis = [f"{heading}: {words}." for heading, words, _ in _basis(record)]
    sections = [
        _first(record),
        blocks("items", "What changed", items_sheet(record), *texts(notes)),
        blocks("possible", "What else is possible", items_sheet(record, stated=False)),
        blocks("poses", "Given poses", poses_sheet(record)),
        blocks("detectable", "What would have been found", detectable_sheet(record)),
        blocks(
            "basis",
            "Basis",
            *texts(basis),
            Text("before and after: values of the joint fit of all sessions; U: of the difference.", "quiet"),
        ),
    ]
    subtitle = f"{listed(record['sessions'])}, {record['robot']}; model: {', '.join(record['model'])}"
    return page(
        "Changes between sessions", subtitle, sections, (f"bayescal {__version__}",), headers=filed(record)
    )


def items_csv(record: Json) -> str:
    """The items as CSV; several values of a cell have `; ` between them."""

    def cell(value: object) -> object:
        return "; ".join(map(str, value)) if isinstance(value, list) else value

    return csv_text(CELLS, ([cell(x[key]) for key in CELLS] for x in record["items"]))


def write_changed(record: Json, folder: Path) -> tuple[str, ...]:
    """Write changed.json, changed.html and changed.csv atomically; return their names."""
    texts = {CHANGED: json_text(record, rows=False), PAGE: changed_page(record), TABLE: items_csv(record)}
    return filled(folder, texts)
