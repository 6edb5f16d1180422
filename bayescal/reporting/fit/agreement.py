"""Parameters of one arm by several sessions: a table, a verdict in words, and the record of both.

Figures of ISO 9283: as a record, and as a table of the terminal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table

from bayescal.assess.agreement import Agreement, Pair
from bayescal.assess.iso9283 import Iso9283
from bayescal.effects import UNITS
from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.shared.text import UM, facts, plain_table, um, um2, with_u

MOST = 12  # parameters shown, those that differ most
FAR = 3.0  # standard deviations from which on a parameter is named as the one that differs
SHOWN = 4  # of those


def agreement_summary(compared: Agreement) -> RenderableType:
    """Table of the shared parameters, with standard deviations in brackets, and whether sessions disagree."""
    return Group(_table(compared), facts(verdicts(compared)))


def disagreement(compared: Agreement) -> tuple[str, ...]:
    """Why the sessions should not have been fitted together, in words; empty where they agree."""
    return tuple(_apart(compared, pair) for pair in compared.pairs if pair.disagree)


def _table(compared: Agreement) -> Table:
    table = plain_table("parameter by session", *compared.alone, "together", "difference / u")
    furthest = compared.furthest
    shown = sorted(np.argsort(-furthest, kind="stable")[:MOST])
    for k in shown:
        unit, factor = UNITS[compared.units[k]]
        cells = [
            with_u(factor * values[k], factor * sd[k])
            for values, sd in (*compared.alone.values(), compared.together)
        ]
        label = unit_label(unit)
        name = compared.names[k] + (f" ({label})" if label else "")
        table.add_row(name, *cells, f"{furthest[k]:.1f}")
    if len(shown) < len(compared.names):
        table.caption = f"the {MOST} of {len(compared.names)} that differ most; all are in fit.json"
    return table


def verdicts(compared: Agreement) -> Iterable[tuple[str, str, str]]:
    """Whether every two sessions agree: lines of a heading, words and their style."""
    for pair in compared.pairs:
        if pair.disagree:
            yield "warning", _apart(compared, pair), "yellow"
        else:
            yield "agree", f"{' and '.join(pair.sessions)}: {_chance(pair)}", ""
    for name, why in compared.refused.items():
        yield "not compared", f"{name} cannot be fitted alone: {why}", "yellow"


def _chance(pair: Pair) -> str:
    return (
        f"chi-squared {pair.chi2:.4g} in {pair.directions} directions identifiable in both, "
        f"p {pair.p_value:.2g}"
    )


def _apart(compared: Agreement, pair: Pair) -> str:
    order = np.argsort(-np.abs(pair.apart))
    most = [k for k in order if abs(pair.apart[k]) > FAR][:SHOWN]
    where = ", ".join(f"{compared.names[k]} by {abs(pair.apart[k]):.1f} u" for k in most)
    return (
        f"{' and '.join(pair.sessions)} disagree ({_chance(pair)})"
        + (f": {where}" if where else "")
        + ". Another arm, something changed in between, a tool taken off (--remounted), "
        "or an effect that the model lacks (bayescal gap): do not trust the fit of both"
    )


def agreement_record(compared: Agreement) -> dict[str, Any]:
    """The content of ``agreement`` in fit.json."""
    return {
        "parameters": [_parameter(compared, k) for k in range(len(compared.names))],
        "pairs": [
            {
                "sessions": list(p.sessions),
                "chi2": p.chi2,
                "directions": p.directions,
                "p_value": p.p_value,
                "disagree": p.disagree,
                "apart_sd": dict(zip(compared.names, p.apart.tolist(), strict=True)),
            }
            for p in compared.pairs
        ],
        "not_fitted_alone": dict(compared.refused),
    }


def _parameter(compared: Agreement, k: int) -> dict[str, Any]:
    unit, factor = UNITS[compared.units[k]]

    def said(of: tuple[np.ndarray, np.ndarray]) -> Mapping[str, float]:
        return {"estimate": float(factor * of[0][k]), "sd": float(factor * of[1][k])}

    return {
        "name": compared.names[k],
        "unit": unit,
        "together": said(compared.together),
        "alone": {name: said(of) for name, of in compared.alone.items()},
    }


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
