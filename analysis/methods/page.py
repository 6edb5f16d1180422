"""The study's tables as Markdown, and a page that holds them between two marks."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

import numpy as np

from analysis.pages import table

BEGIN, END = "<!-- methods: begin -->", "<!-- methods: end -->"
Record = dict[str, Any]


def methods_of(records: Sequence[Record]) -> dict[str, list[Record]]:
    """What each method made of some sessions, by its name; sessions that it does not apply to left out."""
    out: dict[str, list[Record]] = {}
    for record in records:
        for method in record.get("methods", ()):
            out.setdefault(method["name"], [])
            if method["applies"]:
                out[method["name"]].append(method)
    return out


def pooled(methods: Sequence[Record]) -> str:
    """Rms over sessions of the distance errors, or of mean point errors where there are no distances; µm."""
    for key in ("distances_rms_um", "points_mean_um"):
        values = [m["heldout"][key] for m in methods if m["heldout"][key] is not None]
        if values:
            return f"{np.sqrt(np.mean(np.square(values))):.1f}"
    return "-"


def tables(records: Sequence[Record]) -> str:
    """One table of simulated sorts, one of real sessions."""
    by_sort: dict[str, list[Record]] = {}
    for record in records:
        by_sort.setdefault(record["sort"], []).append(record)
    many = {sort: own for sort, own in by_sort.items() if len(own) > 1}
    single = {sort: own[0] for sort, own in by_sort.items() if len(own) == 1 and "methods" in own[0]}
    return "\n\n".join(part for part in (_simulated(many), _real(single)) if part)


def _simulated(sorts: dict[str, list[Record]]) -> str:
    if not sorts:
        return ""
    heads = [f"{sort} ({sum('methods' in r for r in own)})" for sort, own in sorts.items()]
    found = [methods_of(own) for own in sorts.values()]
    lines = []
    for name in found[0]:
        seconds = [m["seconds"] for each in found for m in each[name]]
        lines.append((name, *(pooled(f[name]) for f in found), f"{median(seconds):.2f}" if seconds else "-"))
    sds = []
    for f in found:
        values = [m["heldout"]["predicted_distance_sd_um"] for m in f.get("bayescal", ())]
        told = [v for v in values if v is not None]
        sds.append(f"{np.sqrt(np.mean(np.square(told))):.1f}" if told else "-")
    lines.append(("predicted standard deviation (bayescal)", *sds, ""))
    return table(["validation error, µm (sessions)", *heads, "seconds"], lines)


def _real(sessions: dict[str, Record]) -> str:
    if not sessions:
        return ""
    names = [m["name"] for m in next(iter(sessions.values()))["methods"]]
    lines = ([name, *(_cell(r["methods"][k]) for r in sessions.values())] for k, name in enumerate(names))
    return table(["validation error, µm: mean / maximum", *sessions], lines)


def _cell(method: Record) -> str:
    if not method["applies"]:
        return "-"
    h = method["heldout"]
    out = [f"{h['points_mean_um']:.0f} / {h['points_max_um']:.0f}"] if h["points"] else []
    out += [f"planes RMS {h['planes_rms_um']:.0f}"] if h["plane_contacts"] else []
    return ", ".join(out)
