"""The page of the real sessions: validation errors compared with those in the READMEs of the sessions."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from analysis.pages import table as markdown

MARKS = "<!-- real-sessions: begin -->", "<!-- real-sessions: end -->"
QUOTED = Path(__file__).with_name("real_figures.csv")
"""Published results, with their source."""
LEVELS = {
    "nominal": "nominal",
    "base+tool": "base and tool",
    "geometry": "geometry",
    "compliance": "geometry + compliance",
    "form": "geometry + compliance + plane form",
    "named": "+ effects named by gap",
}
Record = dict[str, Any]


def quoted() -> dict[tuple[str, str, str], Record]:
    """Published results by session, kind of validation measurements, and model level."""
    with QUOTED.open(encoding="utf-8", newline="") as file:
        return {(r["session"], r["validation"], r["ours"]): r for r in csv.DictReader(file)}


def table(sessions: Sequence[Record], places: Sequence[Record]) -> str:
    """All tables, as Markdown."""
    parts = (_validation(sessions), _unseen(sessions, places), _distances(sessions), _said(sessions))
    return "\n\n".join(parts)


def _number(value: Any) -> str:
    return "" if value in ("", None) else f"{float(value):.3f}"


def _headed(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return f"### {title}\n\n{markdown(heads, rows)}"


def _validation(sessions: Sequence[Record]) -> str:
    sizes = ("mean", "RMS", "maximum")
    heads = ("session", "model", *sizes, "within 95 %", "README: model", *sizes)
    out, others = [], quoted()
    for r in sessions:
        for kind in ("planes", "points"):
            steps = [step for step in r["levels"] if kind in step]
            for k, step in enumerate(steps):
                size, other = step[kind], others.get((r["session"], kind, step["model"]), {})
                inside = f"{100 * size['inside95']:.0f} %" if "inside95" in size else ""
                out.append([
                    f"{r['session']}, {size['count']} {kind}" if k == 0 else "",
                    _level(step["model"], r),
                    *(_number(size[f"{what}_mm"]) for what in ("mean", "rms", "max")),
                    inside,
                    other.get("model", ""),
                    *(_number(other.get(f"{what}_mm")) for what in ("mean", "rms", "max")),
                ])  # fmt: skip
    return _headed("Validation errors, mm", heads, out)


def _level(model: str, r: Record) -> str:
    return f"{LEVELS[model]}: {', '.join(r['names'])}" if model == "named" else LEVELS[model]


def _unseen(sessions: Sequence[Record], places: Sequence[Record]) -> str:
    heads = (
        "session", "model", "mean over locations", "minimum", "maximum, at location", "without it",
        "distance between sockets", "README: mean over locations", "without it",
    )  # fmt: skip
    out, others = [], quoted()
    for r in sessions:
        own = [p for p in places if p["session"] == r["session"]]
        for k in range(len(own[0]["levels"]) if own else 0):
            model = own[0]["levels"][k]["model"]
            by = {p["place"]: p["levels"][k] for p in own}
            means = {place: step["mean_mm"] for place, step in by.items()}
            apart = [size for step in by.values() if (size := step["distance_mm"]) is not None]
            largest = max(means, key=lambda place: means[place])
            rest = [value for place, value in means.items() if place != largest]
            other = others.get((r["session"], "unseen", model), {})
            out.append([
                f"{r['session']}, {len(own)} locations" if k == 0 else "",
                _level(model, r),
                _number(fmean(means.values())),
                _number(min(means.values())),
                f"{largest} {means[largest]:.3f}",
                _number(fmean(rest)),
                _number(fmean(apart) if apart else None),
                _number(other.get("mean_mm")),
                _number(others.get((r["session"], f"unseen, without {largest}", model), {}).get("mean_mm")),
            ])  # fmt: skip
    return _headed("Sockets at a location not used in the fit, mm", heads, out)


def _distances(sessions: Sequence[Record]) -> str:
    heads = ("session", "model", "between", "predicted (95 %)", "measured", "share of the prior")
    out = []
    for r in sessions:
        for k, step in enumerate(s for s in r["levels"] if s.get("distances")):
            for d in step["distances"]:
                low, high = d["predicted_interval95_um"]
                measured = d["measured_rms_um"]
                out.append([
                    r["session"] if k == 0 and d is step["distances"][0] else "",
                    LEVELS[step["model"]],
                    d["over"],
                    f"{d['predicted_rms_um']:.0f} ({low:.0f} to {high:.0f})",
                    "" if measured is None else f"{measured:.0f}",
                    "" if measured is not None else f"{100 * step['prior_share']:.0f} %",
                ])  # fmt: skip
    return _headed("Distances: predicted and measured, µm RMS", heads, out)


def _said(sessions: Sequence[Record]) -> str:
    out = ["### Warnings of `bayescal fit`", ""]
    for r in sessions:
        out += [f"- **{r['session']}** (gap: {r['verdict']})", *(f"  - {w}" for w in r["warnings"])]
    return "\n".join(out)
