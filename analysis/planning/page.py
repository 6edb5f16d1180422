"""The study's tables as Markdown, and a page that holds them between two marks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from analysis.blind.card import between

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
    lines = [
        _line(
            "contacts", "u, certified", "u, region", "random", "u, certified", "u, region", "equals random"
        ),
        _line(*["---"] * 7),
    ]
    for p in plans:
        equal = " / ".join(f"{n:.0f}" if np.isfinite(n) else "more than the pool" for n in p["equals_random"])
        lines.append(
            _line(
                p["count"], *(f"{u:.2f}" for u in p["u_um"]),
                p["count_random"], *(f"{u:.2f}" for u in p["u_random_um"]), equal,
            )
        )  # fmt: skip
    return "\n".join(lines)


def _sessions(sessions: Sequence[Record]) -> str:
    groups: dict[str, list[Record]] = {}
    for r in sessions:
        groups.setdefault(r["selection"], []).append(r)
    chosen = [r for r in sessions if r["selection"].endswith("chosen")]
    lines = [
        _line(
            "selection", "sessions", "expected / measured, certified", "expected / measured, region",
            "ratio, certified", "ratio, region",
        ),
        _line(*["---"] * 6),
    ]  # fmt: skip
    for name, own in {**groups, "all chosen": chosen, "all": list(sessions)}.items():
        if own:
            expected, found = (_pooled([r[key] for r in own]) for key in ("u_um", "measured_um"))
            pairs = (f"{e:.2f} / {m:.2f}" for e, m in zip(expected, found, strict=True))
            lines.append(_line(name, len(own), *pairs, *(f"{r:.2f}" for r in ratios(own))))
    return "\n".join(lines)


def _pooled(values: Sequence[Sequence[float]]) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def _line(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def update(path: Path, text: str) -> None:
    """Renew the tables of a page between its marks."""
    between(path, (BEGIN, END), text)
