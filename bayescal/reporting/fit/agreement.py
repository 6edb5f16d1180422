"""One arm by several sessions: its entry in fit.json, its table and verdicts in the terminal."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import RenderableType

from bayescal.assess.agreement import Agreement, Pair
from bayescal.effects import UNITS
from bayescal.reporting.shared.origin import entry
from bayescal.reporting.shared.sheet import Sheet, screen, sheet_of_cells
from bayescal.reporting.shared.text import Facts, with_u, with_unit

MOST = 12  # parameters shown, those that differ most
FAR = 3.0  # standard deviations from which on a parameter is named as the one that differs
SHOWN = 4  # of those


def agreement_summary(compared: Agreement) -> RenderableType:
    """Table of the shared parameters, with standard deviations in brackets, and whether sessions disagree."""
    return screen(_table(compared), verdicts(compared))


def disagreement(compared: Agreement) -> tuple[str, ...]:
    """Why the sessions should not have been fitted together, in words; empty where they agree."""
    return tuple(_apart(compared, pair) for pair in compared.pairs if pair.disagree)


def _table(compared: Agreement) -> Sheet:
    furthest = compared.furthest
    shown = sorted(np.argsort(-furthest, kind="stable")[:MOST])
    estimates = (*compared.alone.values(), compared.together)
    rows = []
    for k in shown:
        unit, factor = UNITS[compared.units[k]]
        values = (with_u(factor * value[k], factor * sd[k]) for value, sd in estimates)
        rows.append((with_unit(compared.names[k], unit), *values, f"{furthest[k]:.1f}"))
    headings = ("parameter by session", *compared.alone, "together", "difference / u")
    caption = f"the {MOST} of {len(compared.names)} that differ most; all are in fit.json"
    return sheet_of_cells(headings, rows, caption if len(shown) < len(compared.names) else "")


def verdicts(compared: Agreement) -> Facts:
    """Whether every two sessions agree: lines of a heading, words and their style."""
    for pair in compared.pairs:
        if pair.disagree:
            yield "warning", _apart(compared, pair), "yellow"
        else:
            yield "agree", f"{' and '.join(pair.sessions)}: {_chance(pair)}", ""
    for name, why in compared.refused.items():
        yield "not compared", f"{name} cannot be fitted alone: {why}", "yellow"


def _chance(pair: Pair) -> str:
    directions = f"{pair.directions} directions identifiable in both"
    return f"chi-squared {pair.chi2:.4g} in {directions}, p {pair.p_value:.2g}"


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
    """``agreement``: parameters of one arm by several sessions."""
    return {
        "parameters": [_compared(compared, k) for k in range(len(compared.names))],
        "pairs": [
            entry(p, "sessions", "chi2", "directions", "p_value", "disagree")
            | {"apart_sd": dict(zip(compared.names, p.apart.tolist(), strict=True))}
            for p in compared.pairs
        ],
        "not_fitted_alone": dict(compared.refused),
    }


def _compared(compared: Agreement, k: int) -> dict[str, Any]:
    unit, factor = UNITS[compared.units[k]]

    def estimate(by: tuple[np.ndarray, np.ndarray]) -> dict[str, float]:
        return {"estimate": float(factor * by[0][k]), "sd": float(factor * by[1][k])}

    return {
        "name": compared.names[k],
        "unit": unit,
        "together": estimate(compared.together),
        "alone": {name: estimate(by) for name, by in compared.alone.items()},
    }
