"""history.json and its page: parameters of an arm over time, and when to calibrate again."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text as Words

from bayescal.changes.history import DAY, QUANTILES, TREND, Course, History, Limit
from bayescal.dataset.table import csv_text
from bayescal.effects import UNITS
from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.changed import COVERAGE, SMALL
from bayescal.reporting.origin import entry, plain, software
from bayescal.reporting.page import Figures, FirstScreen, blocks, page, svg
from bayescal.reporting.sheet import Column, Sheet, below, headed, of_key, screen
from bayescal.reporting.text import listed, probability, under, with_u, with_unit
from bayescal.storage.files import json_text
from bayescal.storage.folders import filled
from bayescal.storage.reading import Json

SCHEMA = "bayescal-history/1"
HISTORY, PAGE, TABLE = "history.json", "history.html", "history.csv"
FEW = 5
"""Items that a sentence lists."""
RUN = (
    *("folder", "command=arm.origin.command", "dataset=arm.dataset.name", "sha256=arm.dataset.sha256"),
    *("date=dates", "time", "model=arm.effects"),
)
"""Fields of ``runs``."""
YEAR = 365.25
"""Days; the rate of a trend over days is stated for a year."""


def history_record(result: History) -> Json:
    """The content of history.json."""
    record: dict[str, Any] = {
        "schema": SCHEMA, "robot": result.robot, "serial": result.serial or None,
        "software": software(("numpy", "scipy")), "time_unit": result.unit,
        "runs": [entry(e, *RUN) | {"date": e.dates or None} for e in result.entries],
        "parameters": [_course(c, result) for c in result.courses],
        "limit": result.limit and _limit(result.limit), "notes": result.notes,
    }  # fmt: skip
    record["words"] = words(record)
    return plain(record)


def _limit(limit: Limit) -> dict[str, Any]:
    when = {"probability": QUANTILES, "time_after_last_run": limit.times, "date": limit.dates or None}
    return entry(limit, "limit_um", "rate_um", "u_rate_um") | when


def _course(c: Course, result: History) -> dict[str, Any]:
    unit, factor = UNITS[c.parameter.unit]
    sizes = {"size": factor * c.size, "u": factor * c.u, "U": COVERAGE * factor * c.u}
    return {
        **entry(c, "name=parameter.name", "effect=parameter.effect", "site=parameter.site"),
        "unit": unit,
        "values": [v and {"value": factor * v[0], "u": factor * v[1]} for v in c.values],
        "change": c.kind or None,
        **(sizes if c.kind else dict.fromkeys(sizes)),
        "from_run": result.entries[c.since].folder if c.kind and c.kind != TREND else None,
        "probability": c.probability,
    }


def changed(record: Json) -> list[Json]:
    """Parameters with a trend or a step, the most probable first."""
    return sorted((p for p in record["parameters"] if p["change"]), key=lambda p: -p["probability"])


def size(p: Json, record: Json) -> str:
    """A trend or a step with its u."""
    unit, factor = SMALL.get(p["unit"], (unit_label(p["unit"]), 1.0))
    if p["change"] == TREND:
        factor, per = (YEAR * factor, "year") if record["time_unit"] == DAY else (factor, "session")
        unit = f"{unit} per {per}"
    return f"{with_u(factor * p['size'], factor * p['u'])} {unit}"


def words(record: Json) -> list[str]:
    """The conclusion in sentences."""
    with_change, limit = changed(record), record["limit"]
    count = f"{len(record['runs'])} sessions"
    if not with_change:
        out = [f"No parameter changed over {count}."]
    else:
        out = [f"{len(with_change)} of {len(record['parameters'])} parameters changed over {count}."]
        for p in with_change[:FEW]:
            what = "drifts by" if p["change"] == TREND else f"changed from {p['from_run']} on by"
            out.append(f"{p['name']} {what} {size(p, record)} (probability {probability(p['probability'])}).")
    if limit:
        early, middle, _ = limit["date"] or [
            f"{t:.0f} {record['time_unit']}s after the last run" for t in limit["time_after_last_run"]
        ]
        out.append(
            f"By these drifts the RMS error of distances reaches {limit['limit_um']:.0f} µm: {middle} "
            f"(with a probability of 5 % before {early}). Calibrate again by then."
        )
    return out


def course_sheet(record: Json, some: Sequence[Json]) -> Sheet:
    """Values of all runs, and what changed."""
    runs = [r["date"] or r["folder"] for r in record["runs"]]
    shown = range(len(runs)) if len(runs) <= FEW else (0, len(runs) - 1)
    columns = (
        Column("parameter", lambda p: with_unit(p["name"], p["unit"])),
        *(Column(runs[k], of_key(lambda p, k: p["values"][k], k), lambda v: with_u(**v)) for k in shown),
        Column("change", lambda p: size(p, record) if p["change"] else None, words=True),
        Column("P", "probability", probability),
    )
    return Sheet(columns, some, "value(u); P: probability of a trend or a step")


def history_summary(record: Json) -> RenderableType:
    """The conclusion, what changed, the runs."""
    first, *others = record["words"]
    title = headed(record["robot"], record["serial"] or "")
    runs = [
        f"{r['date'] or ''} {r['folder']} ({r['command']}, {r['dataset']})".strip() for r in record["runs"]
    ]
    notes = [*under("runs", runs), *under("note", record["notes"], "yellow")]
    table = below(course_sheet(record, changed(record)))
    return screen(title, "", Words(first, "bold"), *map(Words, others), *table, "", notes)


def _panel(p: Json, record: Json) -> tuple[str, Any]:
    """The values of a parameter with their U, and its trend or step."""
    time = np.array([r["time"] for r in record["runs"]])
    has = np.array([v is not None for v in p["values"]])
    value, u = np.array([(v["value"], v["u"]) for v in p["values"] if v is not None]).T
    weight = 1.0 / u**2
    since = [r["folder"] for r in record["runs"]].index(p["from_run"]) if p["from_run"] else 0
    trend = p["change"] == TREND
    part = p["size"] * (time if trend else (time >= time[since]).astype(float))
    start = np.sum(weight * (value - part[has])) / np.sum(weight)
    when, line = time, start + part
    if not trend:  # between two runs
        middle = 0.5 * (time[since - 1] + time[since])
        when = np.array([time[0], middle, middle, time[-1]])
        line = start + p["size"] * np.array([0.0, 0.0, 1.0, 1.0])
    labels = f"time ({record['time_unit']}s)", unit_label(p["unit"])
    values = time[has], value, COVERAGE * u
    drawing = svg.course(values, (when, line), labels, f"{p['name']} over time")
    return f"{p['name']}: {size(p, record)}", drawing


def history_page(record: Json) -> str:
    """The page, as text."""
    with_change = changed(record)
    others = [p for p in record["parameters"] if not p["change"]]
    word, tone, sign = "Nothing changed", "good", "✓"
    if with_change:
        word, tone, sign = f"{len(with_change)} changed", "warn", "!"
    keys = [("sessions", str(len(record["runs"])), "runs of fit or gap")]
    if record["limit"]:
        middle = record["limit"]["time_after_last_run"][1]
        when = f"{middle:.0f} {record['time_unit']}s"
        keys.append(("calibrate again", when, "after the last run, by the drift found"))
    steps = [("Compare two sessions in detail:", "bayescal changed BEFORE AFTER")]
    first = FirstScreen(
        word, tone, sign, record["words"], len(record["words"]), keys, next=steps, warnings=record["notes"]
    )
    columns = (
        Column("run", "folder"),
        *(Column(key, key, words=True) for key in ("date", "dataset", "command")),
        Column("model", lambda r: ", ".join(r["model"]), words=True),
    )
    panels = Figures(tuple(_panel(p, record) for p in with_change)) if with_change else None
    sections = [
        first.section(),
        blocks("changed", "What changed", panels, course_sheet(record, with_change)),
        blocks("others", "Other parameters", course_sheet(record, others)),
        blocks("runs", "Runs", Sheet(columns, record["runs"])),
    ]
    subtitle = f"{record['robot']} {record['serial'] or ''}: {listed(r['folder'] for r in record['runs'])}"
    return page("History", subtitle, sections)


def history_csv(record: Json) -> str:
    """Values of all parameters in all runs."""
    rows = (
        [p["name"], p["unit"], r["folder"], r["date"], r["time"], v["value"], v["u"]]
        for p in record["parameters"]
        for r, v in zip(record["runs"], p["values"], strict=True)
        if v is not None
    )
    return csv_text(("parameter", "unit", "run", "date", "time", "value", "u"), rows)


def write_history(record: Json, folder: Path) -> tuple[str, ...]:
    """Write history.json, history.html and history.csv atomically; return their names."""
    texts = {HISTORY: json_text(record, rows=False), PAGE: history_page(record), TABLE: history_csv(record)}
    return filled(folder, texts)
