"""The tables of docs/benchmarks.md, from the content of bench.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from analysis.pages import between, table

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
ABSENT = "-"


def tables(record: dict[str, Any]) -> str:
    """Markdown of the ratios, the durations and the growth of a record; what it lacks is left out."""
    out = []
    if "ratios" in record:
        out.append(f"{record['contacts']} contacts, {record['parameters']} parameters, one core.")
        rows = [[f"`{name}`", _number(r), record["raw"][name]] for name, r in record["ratios"].items()]
        rows += [[f"`{name}`, s", _number(s), ""] for name, s in record["seconds"].items()]
        out.append(table(["quantity", "value", "from"], rows))
    if "growth" in record:
        runs = record["growth"]["runs"]
        rows = [
            [
                r["command"], f"{r['contacts']:,}", _number(r["cpu_s"] if r["done"] else None),
                _number(r["seconds"] if r["done"] else None), f"{r['peak_mb']:.0f}",
            ]
            for r in runs
        ]  # fmt: skip
        out.append(table(["command", "contacts", "CPU, s", "by the clock, s", "memory, MB"], rows))
        slopes = [f"{name} {value:.2f}" for name, value in record["growth"]["exponents"].items()]
        if slopes:
            out.append(f"Exponents of the CPU time over the contacts, from 1000 on: {'; '.join(slopes)}.")
    return "\n\n".join(out)


def update(path: Path, record: dict[str, Any]) -> None:
    """Replace the measured part of a page."""
    between(path, (BEGIN, END), f"\n{tables(record)}\n")


def _number(value: float | None) -> str:
    return ABSENT if value is None else f"{value:.3g}" if value < 1000 else f"{value:.0f}"
