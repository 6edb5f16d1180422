"""Figures of ISO 9283: as a record, and as a table of the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Group, RenderableType

from bayescal.assess.iso9283 import Iso9283
from bayescal.reporting.shared.text import UM, facts, plain_table, um, um2


def iso9283_record(found: Iso9283) -> dict[str, Any]:
    """``iso9283`` of fit.json; u is of the measurement, k = 1."""
    return {
        "figures": [
            {
                "symbol": f.symbol,
                "name": f.words,
                "count": f.count,
                "mean_um": UM * f.mean,
                "max_um": UM * f.maximum,
                "u_mean_um": None if f.u is None else UM * f.u,
                "u_max_um": None if f.u_max is None else UM * f.u_max,
            }
            for f in found.figures
        ],
        "differs_from_norm": list(found.differs),
    }


def iso9283_table(found: Iso9283) -> RenderableType:
    """The figures, and what differs from the procedure of the standard."""
    if not found.figures:
        return Group()
    table = plain_table("ISO 9283 (validation measurements)", "number", "mean (µm)", "u", "max (µm)", "u")
    for f in found.figures:
        of_mean, of_max = ("-" if u is None else um2(u) for u in (f.u, f.u_max))
        table.add_row(f"{f.symbol}: {f.words}", str(f.count), um(f.mean), of_mean, um(f.maximum), of_max)
    return Group(
        table, facts(("differs" if k == 0 else "", text, "dim") for k, text in enumerate(found.differs))
    )
