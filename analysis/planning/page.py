"""The study's tables as Markdown, and a page that holds them between two marks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.pages import table

BEGIN, END = "<!-- planning: begin -->", "<!-- planning: end -->"
Record = dict[str, Any]


def tables(plans: Sequence[Record], sessions: Sequence[Record]) -> str:
    """One table of selections, one of simulated sessions."""
    return f"{_selections(plans)}\n\n{_sessions(sessions)}"


def ratios(records: Sequence[Record]) -> tuple[float, float]:
    """Expected over measured errors (root mean squares), of certified distances and of the region."""
    expected, found = (np.array([r[key] for r in records]) for key in ("u_um", "measured_um"))
    first, second = np.sqrt(np.mean(expected**2, axis=0) / np.mean(found**2, axis=0))
    return float(first), float(second)


def _selections(plans: Sequence[Record]) -> str:
    heads = ("contacts", "u, certified", "u, region", "random", "u, certified", "u, region", "equals random")
    rows = []
    for p in plans:
        equal = " / ".join(f"{n:.0f}" if np.isfinite(n) else "more than the pool" for n in p["equals_random"])
        u, u_random = ([f"{x:.2f}" for x in p[key]] for key in ("u_um", "u_random_um"))
        rows.append((p["count"], *u, p["count_random"], *u_random, equal))
    return table(heads, rows)


def _sessions(sessions: Sequence[Record]) -> str:
    groups: dict[str, list[Record]] = {}
    for r in sessions:
        groups.setdefault(r["selection"], []).append(r)
    chosen = [r for r in sessions if r["selection"].endswith("chosen")]
    heads = (
        "selection", "sessions", "expected / measured, certified", "expected / measured, region",
        "ratio, certified", "ratio, region",
    )  # fmt: skip
    rows = []
    for name, own in {**groups, "all chosen": chosen, "all": list(sessions)}.items():
        if own:
            expected, found = (_pooled([r[key] for r in own]) for key in ("u_um", "measured_um"))
            pairs = (f"{e:.2f} / {m:.2f}" for e, m in zip(expected, found, strict=True))
            rows.append((name, len(own), *pairs, *(f"{r:.2f}" for r in ratios(own))))
    return table(heads, rows)


def _pooled(values: Sequence[Sequence[float]]) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))
