"""Components of an uncertainty budget by their contribution."""

from __future__ import annotations

from typing import Any

from bayescal.reporting.figures.bars import FILLED, HATCHED, OPEN, Bar, bars_panel
from bayescal.reporting.figures.sheet import Entry, Panel

Json = dict[str, Any]
MOST = 12
"""Components that are shown, the largest first."""
TYPES = {"A": FILLED, "B": HATCHED}
"""Style of a bar by the type of evaluation (JCGM 100)."""


def budget_panel(budget: Json) -> Panel:
    """Bars of the contributions; `budget` is the content of budget.json."""
    every = sorted(budget["components"], key=lambda c: -abs(c["contribution_um"]))
    shown = every[:MOST]
    total = budget["u_um"]
    bars = [
        Bar(
            c["name"],
            abs(c["contribution_um"]),
            f"{c['contribution_um']:.2g} µm, {100 * c['contribution_um'] ** 2 / total**2:.0f} %"
            if total
            else "",
            TYPES.get(c["type"], OPEN),
        )
        for c in shown
    ]
    used = dict.fromkeys(c["type"] for c in shown)
    key = [Entry(f"type {t}", TYPES.get(t, OPEN), True) for t in used]
    more = len(every) - len(shown)
    notes = [f"u {total:.2g} µm, U {budget['U_um']:.2g} µm (k = {budget['k']:.3g})"]
    notes += [f"{more} smaller components are not shown"] if more else []
    return bars_panel(bars, "", "contribution to the standard uncertainty (µm)", "; ".join(notes), key)
