"""The figures as Markdown tables, a page that holds them between two marks, and a CSV file beside it."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from analysis.calibration_checks.designs import DESIGNS
from analysis.calibration_checks.figures import LEVELS
from analysis.pages import between, table

BEGIN, END = "<!-- checks: begin -->", "<!-- checks: end -->"
Figures = Mapping[str, Mapping[str, Any]]


def text(found: Figures) -> str:
    """All tables."""
    parts = (_designs, _ranks, _tarp, _coverage, _rest)
    return "\n\n".join(part(found) for part in parts)


def _designs(found: Figures) -> str:
    summary = {d.name: d.summary for d in DESIGNS}
    rows = (
        (name, summary[name], f["sessions"], f"{f['seeds'][0]} to {f['seeds'][1]}", len(f["refused"]))
        for name, f in found.items()
    )
    return table(("design", "contacts of a session", "sessions", "seeds", "refused"), rows)


def _ranks(found: Figures) -> str:
    rows = (
        [
            name, str(len(f["by_quantity"])), f"{f['least_ecdf_p_holm']:.2f} ({f['least']})",
            f"{f['least_chi2_p_holm']:.2f}", f"{f['joint_p']['plain']:.2f}",
        ]
        for name, f in found.items()
    )  # fmt: skip
    head = (
        "ranks", "quantities", "minimum p, largest deviation", "minimum p, chi-square",
        "p, all unknowns jointly",
    )  # fmt: skip
    return table(head, rows)


def _tarp(found: Figures) -> str:
    rows = (
        [name, *(_share(*t["expected_coverage"][str(level)]) for level in LEVELS), f"{t['p_value']:.2f}"]
        for name, t in ((name, f["tarp"]["plain"]) for name, f in found.items())
    )
    return table(("TARP", *map(_percent, LEVELS), "p"), rows)


def _coverage(found: Figures) -> str:
    rows = (
        [name, quantity, *(_share(c["covered"], c["low"], c["high"]) for c in levels)]
        for name, f in found.items()
        for quantity, levels in f["coverage"].items()
    )
    return table(("coverage", "of", *map(_percent, LEVELS)), rows)


def _rest(found: Figures) -> str:
    rows = (
        [
            name, f"{f['contacts']['ks_p']:.2f}",
            " ".join(f"{100 * v:.0f}" for v in f["contacts"]["histogram"]),
            "{:.2f}, {:.2f}, {:.2f}".format(*f["stated_over_posterior_sd"]),
            ", ".join(f"{v:.2f}" for v in f["of_distances"]),
            str(f["with_discrepancy"]), str(f["with_unexplained_error"]), str(f["contradicted"]),
            "{1} of {0}, {2}".format(*f["gross"]),
        ]
        for name, f in found.items()
    )  # fmt: skip
    head = (
        "sessions", "KS p, validation contacts", "their places, % in fifths",
        "stated over posterior s.d.: minimum, median, maximum", "of distances: median, maximum",
        "with a discrepancy", "with an unexplained error", "contradicted",
        "gross contacts rejected, others rejected",
    )  # fmt: skip
    return table(head, rows)


def _percent(level: float) -> str:
    return f"{100 * level:.0f} %"


def _share(value: float, low: float, high: float) -> str:
    return f"{100 * value:.1f} ({100 * low:.0f} to {100 * high:.0f})"


def update(path: Path, found: Figures) -> None:
    """Renew the tables of a page between its marks, and the CSV file of the same name beside it."""
    between(path, (BEGIN, END), text(found))
    with path.with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("design", "figure", "of", "level", "value", "low", "high"))
        writer.writerows(_rows(found))


def _rows(found: Figures) -> Iterator[tuple[str, ...]]:
    """All figures, one a row."""
    for name, f in found.items():
        for quantity, p in f["by_quantity"].items():
            for test, value in p.items():
                yield name, test, quantity, "", f"{value:.4f}", "", ""
        for quantity, levels in f["coverage"].items():
            for c in levels:
                values = (f"{c[k]:.4f}" for k in ("covered", "low", "high"))
                yield name, "coverage", quantity, str(c["level"]), *values
        for draws, t in f["tarp"].items():
            yield name, "joint_p", draws, "", f"{f['joint_p'][draws]:.4f}", "", ""
            yield name, "tarp_p", draws, "", f"{t['p_value']:.4f}", "", ""
            for level, values in t["expected_coverage"].items():
                yield name, "tarp", draws, level, *(f"{v:.4f}" for v in values)
