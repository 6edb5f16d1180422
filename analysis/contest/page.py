"""The tables of all entries, for the page of the documentation and for one that stands alone."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from analysis.pages import table

MARKS = ("<!-- contest: begin -->", "<!-- contest: end -->")
REFERENCE = "nominal arm"
OURS = "bayescal gap"
SMALLER = f"Tasks in which an entry has an error smaller than {OURS} by more than 2 %"
UM = 1e3
EQUAL = 0.02
"""Errors that differ by less count as equal."""
Record = dict[str, Any]
Table = list[list[str]]


def size(r: Record) -> float | None:
    """Error of an entry: RMS of residuals, of distances, or their geometric mean where both are."""
    known = [v for v in (r["rms"], r["distance_rms"]) if v]
    return float(np.exp(np.mean(np.log(known)))) if known else None


@dataclass(frozen=True)
class Ratio:
    """A tool's error over another's on common tasks."""

    mean: float  # geometric
    u: float  # its standard uncertainty, relative
    smaller: int  # tasks with an error smaller by more than `EQUAL`
    larger: int
    count: int


def ratio(records: Sequence[Record], tool: str, to: str) -> Ratio:
    """Compare two tools on the tasks that both entered."""
    own, other = ({r["task"]: size(r) for r in records if r["tool"] == name} for name in (tool, to))
    logs = np.array([np.log(a / b) for task in own if (a := own[task]) and (b := other.get(task))])
    if not len(logs):
        return Ratio(np.nan, np.nan, 0, 0, 0)
    u = float(np.expm1(np.std(logs, ddof=1) / np.sqrt(len(logs)))) if len(logs) > 1 else np.nan
    less, more = (int(np.sum(sign * logs > np.log1p(EQUAL))) for sign in (-1, 1))
    return Ratio(float(np.exp(np.mean(logs))), u, less, more, len(logs))


def mean(values: Iterable[float | None]) -> float:
    """Of the values that there are; nan of none."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else float("nan")


def text(value: float, form: str = ".2f") -> str:
    """A number, or a dash."""
    return "-" if not np.isfinite(value) else f"{value:{form}}"


def groups(records: Sequence[Record]) -> list[str]:
    """Simulated ones first."""
    return sorted({r["group"] for r in records}, key=lambda g: (g == "real", g))


def tools(records: Sequence[Record]) -> list[str]:
    """The best first, by the error over ours; those without a common task last."""
    names = {r["tool"] for r in records}
    return sorted(names, key=lambda tool: (np.nan_to_num(ratio(records, tool, OURS).mean, nan=np.inf), tool))


def overview(records: Sequence[Record]) -> Table:
    """A line a tool: errors by group, wins against ours, intervals, names, seconds."""
    kinds = groups(records)
    heads = ["tool", "tasks", *(f"error / nominal: {g}" for g in kinds), f"error / {OURS}, same tasks",
             f"smaller / larger than {OURS}", "within 95 %", "interval score, µm", "log score of names",
             "names right", "s (median)"]  # fmt: skip
    lines = [heads]
    for tool in tools(records):
        own = [r for r in records if r["tool"] == tool]
        by = [ratio([r for r in records if r["group"] == g], tool, REFERENCE).mean for g in kinds]
        against = ratio(records, tool, OURS)
        told = [r for r in own if r["log_score"] is not None]
        lines.append(
            [
                tool,
                str(len(own)),
                *(text(v, ".3f") for v in by),
                "-" if tool == OURS else f"{text(against.mean)} (u {text(against.u)})",
                "-" if tool == OURS else f"{against.smaller} / {against.larger} of {against.count}",
                text(100 * mean(r["inside95"] for r in own), ".0f"),
                text(UM * mean(r["interval_score"] for r in own), ".0f"),
                text(mean(r["log_score"] for r in told)),
                f"{sum(r['right'] for r in told):.0f} of {len(told)}" if told else "-",
                text(float(np.median([r["seconds"] for r in own])), ".1f"),
            ]
        )
    return lines


def by_task(records: Sequence[Record], figure: Callable[[Record], float | None]) -> Table:
    """A line a task, a column a tool: a figure in µm; the smallest of a line is bold."""
    names = tools(records)
    lines = [["task", "truth", *names]]
    for task in dict.fromkeys(r["task"] for r in records):
        own = {r["tool"]: figure(r) for r in records if r["task"] == task}
        known = [v for v in own.values() if v is not None]
        if not known:
            continue
        truth = next(r["truth"] for r in records if r["task"] == task)
        what = "" if truth is None else truth.get("outside") or " + ".join(truth["effects"]) or "null"
        cells = []
        for name in names:
            v = own.get(name)
            cell = "-" if v is None else f"{UM * v:.1f}"
            cells.append(f"**{cell}**" if v is not None and v == min(known) else cell)
        lines.append([task, what, *cells])
    return lines


def losses(records: Sequence[Record]) -> list[str]:
    """Tasks in which an entry has a smaller error than ours: the smallest, and ours."""
    out = []
    for task in dict.fromkeys(r["task"] for r in records):
        own = {r["tool"]: value for r in records if r["task"] == task and (value := size(r)) is not None}
        if OURS not in own:
            continue
        best = min(own, key=lambda tool: own[tool])
        if own[best] * (1 + EQUAL) < own[OURS]:
            out.append(f"{task}: {best} {UM * own[best]:.1f} µm, {OURS} {UM * own[OURS]:.1f} µm")
    return out


def sections(records: Sequence[Record], said: Sequence[str]) -> list[tuple[str, Table | Sequence[str]]]:
    """Headings with a table or a list."""
    return [
        ("", overview(records)),
        (SMALLER, losses(records)),
        ("RMS of the validation residuals, µm", by_task(records, lambda r: r["rms"])),
        ("RMS of the errors of certified distances, µm", by_task(records, lambda r: r["distance_rms"])),
        ("Left out", said),
    ]


def markdown(records: Sequence[Record], said: Sequence[str]) -> str:
    """All sections as Markdown."""
    parts = []
    for head, content in sections(records, said):
        is_table = content and isinstance(content[0], list)
        lines = table(content[0], content[1:]) if is_table else "\n".join(f"- {line}" for line in content)
        parts += [f"{head}:" if head else "", lines or "- none"]
    return "\n\n".join(part for part in parts if part)


def picture(records: Sequence[Record]) -> str:
    """Error over that of the nominal arm, a point a task, as PNG in base 64."""
    names, kinds = tools(records)[::-1], groups(records)
    figure = Figure(figsize=(8, 0.34 * len(names) + 1.2), layout="constrained")
    axes = figure.subplots()
    nominal = {r["task"]: size(r) for r in records if r["tool"] == REFERENCE}
    for k, group in enumerate(kinds):
        own = [r for r in records if r["group"] == group and nominal.get(r["task"]) and size(r)]
        x = [size(r) / nominal[r["task"]] for r in own]  # type: ignore[operator]
        y = [names.index(r["tool"]) + 0.2 * (k - 1) for r in own]
        axes.plot(x, y, "osD^"[k % 4], ms=4, alpha=0.7, label=group)
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel("validation error over that of the nominal arm")
    axes.grid(axis="x", alpha=0.3)
    axes.legend(fontsize="small", loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=130)
    return base64.b64encode(out.getvalue()).decode()


STYLE = """body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:110rem;padding:0 1rem}
body{color:#222}.wide{overflow-x:auto}
table{border-collapse:collapse;margin:1rem 0;font-variant-numeric:tabular-nums}
td,th{padding:.25rem .6rem;border-bottom:1px solid #ddd;text-align:right;vertical-align:bottom}
td{white-space:nowrap}td:first-child,th:first-child{text-align:left;white-space:nowrap}img{max-width:100%}"""


def standalone(records: Sequence[Record], said: Sequence[str]) -> str:
    """The page as HTML without further files."""

    def cell(c: str, tag: str = "td") -> str:
        plain = html.escape(c.strip("*"))
        return f"<{tag}>{f'<b>{plain}</b>' if c.startswith('**') else plain}</{tag}>"

    parts = ["<h1>Calibration of robot arms: entries compared</h1>"]
    for head, content in sections(records, said):
        parts.append(f"<h2>{head}</h2>" if head else "")
        if content and isinstance(content[0], list):
            rows = [[cell(c, "td" if k else "th") for c in row] for k, row in enumerate(content)]
            lines = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
            parts.append(f'<div class="wide"><table>{lines}</table></div>')
        else:
            parts.append(
                f"<ul>{''.join(f'<li>{html.escape(str(c))}</li>' for c in content) or '<li>none'}</ul>"
            )
        if not head:
            image = f"data:image/png;base64,{picture(records)}"
            parts.append(f'<img alt="Validation errors of all entries" src="{image}">')
    start = f'<meta charset="utf-8"><title>Calibration of robot arms</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{start}</head><body>{"".join(parts)}</body></html>\n'
