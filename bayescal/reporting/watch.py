"""A session that was watched: a line for each event, `watch.json`, `watch.csv` and `watch.png`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.text import Text

from bayescal.dataset.table import csv_text
from bayescal.gap.result import BlindSpot
from bayescal.reporting.figures import scales
from bayescal.reporting.figures.figures import Content, picture
from bayescal.reporting.figures.sheet import Entry, Panel
from bayescal.reporting.fit.record import fit_record, write_fit
from bayescal.reporting.origin import entry, origin, sized
from bayescal.reporting.style import ACCENT, GREY, MARKED
from bayescal.reporting.text import UM, size, um, um2
from bayescal.storage.files import json_text
from bayescal.storage.reading import Json
from bayescal.watching import SHIFTED, Complete, Event, Notice, WatchOptions
from bayescal.watching.update import ODD, Contact

SCHEMA = "bayescal-watch/1"
RECORD, TABLE, FIGURE = "watch.json", "watch.csv", "watch.png"
FIRST = 3
"""Effects that the contacts would not show yet, named in a line."""
HIGH, LOW = 50.0, 26.0
"""Of the axes of U and of residuals, mm."""
EACH: dict[str, Any] = {"color": GREY, "lw": 1.0}
COMPLETE: dict[str, Any] = {"color": ACCENT, "marker": "o", "ls": "", "ms": 4}
USUAL: dict[str, Any] = {"color": GREY, "marker": "o", "ls": "", "ms": 2, "mew": 0}
APART: dict[str, Any] = {"color": MARKED, "marker": "X", "ls": "", "ms": 5}
KEYS = ("id", "target", "role", "residual_um", "u_um", "p_value", "U_um", "odd")
"""Of a contact, in watch.json and as columns of watch.csv."""


def line(event: Event) -> Text:
    """What a person who probes reads of an event."""
    if isinstance(event, Contact):
        return _contact(event)
    if isinstance(event, Complete):
        return Text(_complete(event), style="bold")
    return Text(event.text, style="bold red" if event.kind == SHIFTED else "yellow")


def _contact(c: Contact) -> Text:
    out = Text.assemble(f"{c.row + 1:>5}  {c.id:<10} {c.target:<14}")
    if not np.isfinite(c.p_value):
        return out.append("" if c.role == "calibrate" else f" {c.role}", style="dim")
    out.append(f" {um(c.residual):>7} µm (u {um2(c.u)})", style="bold red" if c.odd else "")
    out.append(f"   U {um2(c.U)} µm", style="dim")
    if c.odd:
        out.append(f"   ODD: by chance {c.p_value:.1g}; set aside, measure it again", style="bold red")
    return out


def _complete(e: Complete) -> str:
    rejected = len(e.fit.final.estimate.rejected)
    parts = [
        f"fit of {e.rows} rows ({e.seconds:.1f} s): U of a distance {um2(e.U)} µm (k = {e.distance.k:.2g})"
    ]
    if rejected:
        parts.append(f"{rejected} rejected")
    if e.spots:
        hidden = e.hidden
        parts.append(f"{len(e.spots) - len(hidden)} of {len(e.spots)} effects would show")
        if hidden:
            first = (f"{s.effect} at {s.site.text} below {size(s.smallest, s.unit)}" for s in hidden[:FIRST])
            parts.append(f"not yet {', '.join(first)}")
    return "; ".join(parts)


def watch_record(events: Sequence[Event], contacts: Sequence[Contact], asked: WatchOptions) -> dict[str, Any]:
    """The content of watch.json."""
    fits = [e for e in events if isinstance(e, Complete)]
    return {
        **origin(SCHEMA, fits[-1].fit.dataset, asked.fit.seed),
        "model": list(asked.effects),
        "aim": entry(asked, "U_um=enough", "planned"),
        "odd_below": ODD,
        "contacts": [entry(c, *KEYS) for c in contacts],
        "fits": [
            entry(e, "rows", "U_um", "k=distance.k", "seconds", "largest_change_u=moved")
            | {"rejected": [e.fit.dataset.measurements.ids[k] for k in e.fit.final.estimate.rejected]}
            | {"effects": [_spot(s) for s in e.spots]}
            for e in fits
        ],
        "notices": [entry(e, "kind", "text") for e in events if isinstance(e, Notice)],
    }


def _spot(s: BlindSpot) -> dict[str, Any]:
    sizes = sized(s, "smallest", "plausible")
    return entry(s, "effect", "site") | sizes | entry(s, "distance_error_um")


def write_watch(
    events: Sequence[Event], contacts: Sequence[Contact], record: Json, folder: Path, pictures: bool
) -> tuple[str, ...]:
    """Write the run folder of the last complete fit, as `bayescal fit` does, and what was watched."""
    last_fit = [e.fit for e in events if isinstance(e, Complete)][-1]
    more = {
        RECORD: json_text(record).encode(),
        TABLE: csv_text(KEYS, ([c[key] for key in KEYS] for c in record["contacts"])).encode(),
    }
    if pictures:
        more[FIGURE] = picture(watch_content(events, contacts))
    return write_fit(last_fit, folder, fit_record(last_fit), pictures, more=more)


def watch_content(events: Sequence[Event], contacts: Sequence[Contact]) -> Content:
    """Above, U over the contacts; below, each residual in its standard uncertainties, odd ones marked."""
    fits = [e for e in events if isinstance(e, Complete)]
    judged = [c for c in contacts if np.isfinite(c.p_value)]
    row = np.array([c.row + 1 for c in judged], float)
    ratio, odd = np.array([c.residual / c.u for c in judged]), np.array([c.odd for c in judged], bool)
    every = [e.rows for e in fits] + row.tolist()
    ends = min(every) - 1, max(every) + 1

    def above(axes: Any) -> None:
        u, u_fits = [UM * c.U for c in judged], [UM * e.U for e in fits]
        axes.plot(row, u, **EACH)
        axes.plot([e.rows for e in fits], u_fits, **COMPLETE)
        scales.linear_x(axes, *ends)
        if some := [value for value in (*u, *u_fits) if 0.0 < value < np.inf]:
            scales.log_y(axes, some, HIGH)

    def below(axes: Any) -> None:
        axes.plot(row[~odd], ratio[~odd], **USUAL)
        axes.plot(row[odd], ratio[odd], **APART)
        axes.set_xlim(*ends)
        scales.linear_both(axes, LOW)

    key = Entry("after each contact", EACH), Entry("complete fit", COMPLETE)
    last = fits[-1]
    title = f"{last.fit.dataset.name}: U of a distance {um2(last.U)} µm after {last.rows} rows"
    top = Panel(above, HIGH, y="U of a distance (µm)", key=key)
    low = Panel(below, LOW, x="contacts", y="residual / u", key=[Entry("odd", APART)] if odd.any() else ())
    return [title], [[top], [low]]


def outcome(record: Json) -> str:
    """The end of a session that was watched, in a line."""
    judged = [c for c in record["contacts"] if c["p_value"] is not None]
    odd = [c["id"] for c in judged if c["odd"]]
    text = f"{len(record['contacts'])} rows watched, {len(judged)} of them judged by the others"
    return text + (f"; odd: {', '.join(odd)}" if odd else "; none odd")
