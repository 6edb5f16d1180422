"""Parts of the terminal summary of a fit: one arm by several sessions, figures of ISO 9283."""

from __future__ import annotations

import numpy as np
from rich.console import Group, RenderableType

from bayescal.assess.agreement import Agreement, Pair
from bayescal.assess.iso9283 import Iso9283
from bayescal.effects import UNITS
from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.shared.sheet import Column, Sheet, sheet_of_cells, terminal
from bayescal.reporting.shared.text import Facts, facts, um, um2, under, with_u

MOST = 12  # parameters shown, those that differ most
FAR = 3.0  # standard deviations from which on a parameter is named as the one that differs
SHOWN = 4  # of those
ISO9283 = (
    Column("ISO 9283 (validation measurements)", lambda f: f"{f.symbol}: {f.words}"),
    Column("number", "count"),
    Column("mean (µm)", "mean", um),
    Column("u", "u", um2),
    Column("max (µm)", "maximum", um),
    Column("u", "u_max", um2),
)


def agreement_summary(compared: Agreement) -> RenderableType:
    """Table of the shared parameters, with standard deviations in brackets, and whether sessions disagree."""
    return Group(terminal(_table(compared)), facts(verdicts(compared)))


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
        label = f" ({text})" if (text := unit_label(unit)) else ""
        values = (with_u(factor * value[k], factor * sd[k]) for value, sd in estimates)
        rows.append((compared.names[k] + label, *values, f"{furthest[k]:.1f}"))
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


def iso9283_table(figures: Iso9283) -> RenderableType:
    """The figures, and what differs from the procedure of the standard."""
    if not figures.figures:
        return Group()
    return Group(terminal(Sheet(ISO9283, figures.figures)), facts(under("differs", figures.differs, "dim")))
