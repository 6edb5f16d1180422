"""Tables of a fit, of the entries of its record: for the terminal and for the page."""

import math
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from bayescal.assess.agreement import Agreement, Pair
from bayescal.assess.conformance import FAIL, PASS
from bayescal.calibration import ModelLevel
from bayescal.effects import UNITS
from bayescal.effects.vocabulary import unit_label
from bayescal.predict.crossvalidation import inside95
from bayescal.predict.validation import Validation
from bayescal.reporting import text
from bayescal.reporting.origin import entry
from bayescal.reporting.sheet import Bar, Column, Sheet, as_is, bar_of, inside, of_key, screen, sheet_of_cells
from bayescal.storage.reading import Json

DECISIONS = {PASS: "green", FAIL: "red"}
IDENTIFIABLE = {"determined": "yes", "partly": "weakly", "prior_only": "no"}
MOST_DISTANCES = 5
"""Distances shown without --verbose, those with the largest errors."""
NOT_ARM = ("target", "plane-form")
"""Effects whose parameters are not those of the arm."""
ROLES = {"calibrate": "fitted", "validate": "validation"}


def _ends(ends: Sequence[float], decimals: int = 0, to: str = " .. ") -> str:
    return to.join(text.signed(end, decimals) for end in ends)


DISTANCES = (
    Column("distance", "between", " – ".join),
    Column("certified (mm)", "certified_mm", "{:.3f}".format),
    Column("nominal (µm)", "nominal_error_um", text.signed),
    Column("calibrated (µm)", "calibrated_error_um", lambda error: text.signed(error, 1)),
    Column("u (µm)", "predicted_sd_um", text.uncertainty),
    Column("95 % predicted (µm)", "predicted_interval95_um", lambda ends: _ends(ends, 1, " to ")),
    Column("", "inside95", lambda inside: "within" if inside else "outside"),
)
"""Of the entries `distances` of a record, as those below are of others."""
DIAMETERS = (Column("diameter of", "target"), *DISTANCES[1:4], *DISTANCES[5:])
"""Of the entries `diameters`, which have no u of their own."""
SHORT_DISTANCES = (
    Column("distances", "between", " - ".join),
    *DISTANCES[1:4],
    Column("95 % predicted", "predicted_interval95_um", lambda ends: _ends(ends, 1)),
    Column("", "inside95", inside),
)
"""The same in the terminal."""
TOLERANCE = (
    Column("tolerance", "between", " - ".join),
    Column("error (µm)", "error_um", lambda error: text.signed(error, 1)),
    Column("U = k u (µm)", "U_um", text.uncertainty),
    Column("k", "k", "{:.2f}".format),
    Column("probability within", "probability", text.percent),
    Column("decision", "decision", lambda word: Text(word, DECISIONS.get(word, "yellow"))),
)
FACES = (
    Column("target", "target"),
    Column("contacts", "count"),
    Column("nominal RMS (µm)", "nominal_rms_um", text.length),
    Column("calibrated RMS (µm)", "calibrated_rms_um", text.length),
    Column("maximum (µm)", "calibrated_max_um", text.length),
    Column("expected RMS (µm)", "predicted_rms_um", text.length),
)
PREDICTED = (
    Column("distances between", "over"),
    Column("number", "count"),
    Column("lengths (mm)", "lengths_mm", lambda ends: "{:.0f} to {:.0f}".format(*ends)),
    Column("expected RMS (µm)", "predicted_rms_um", text.uncertainty),
    Column("U = k u (µm)", "expanded_U_um", text.uncertainty),
    Column("k", "k", "{:.2f}".format),
    Column("95 % (µm)", "predicted_interval95_um", text.interval),
    Column("measured RMS (µm)", "measured_rms_um", text.length),
)
ISO9283 = (
    Column("quantity", lambda f: f"{f['symbol']}: {f['name']}"),
    Column("number", "count"),
    Column("mean (µm)", "mean_um", text.length),
    Column("u (µm)", "u_mean_um", text.uncertainty),
    Column("maximum (µm)", "max_um", text.length),
    Column("u (µm)", "u_max_um", text.uncertainty),
)
TESTS = (Column("test", "words"), *(Column(key, key, "{:.3g}".format) for key in ("value", "limit", "p")))


def level_sheet(
    levels: Sequence[Json], columns: Sequence[tuple[str, str]], names: Sequence[str], *more: Column
) -> Sheet:
    """Model levels with a bar of the first column that has values; bars are logarithmic."""
    shown = [(h, key) for h, key in columns if any(step.get(key) is not None for step in levels)]
    every = [step.get(shown[0][1]) for step in levels] if shown else []
    items = [{"name": name, **step} for name, step in zip(names, levels, strict=True)]

    def bar(step: Json) -> Bar:
        value = step.get(shown[0][1])
        return Bar(log_fraction(value, every), text.length(value), step is items[-1])

    errors = [Column(h, of_key(dict.get, key), text.length) for h, key in shown[1:]]
    bars = [Column(shown[0][0], bar, as_is)] if shown else []
    caption = "Errors of validation measurements, µm; bars are logarithmic"
    return Sheet((Column("model", "name"), *bars, *errors, *more), items, caption)


def log_fraction(value: float | None, every: list[float | None]) -> float:
    """Length of a bar on a logarithmic scale that begins at a third of the smallest value."""
    positive = [v for v in every if v]
    if not value or not positive:
        return 0.0
    low, high = math.log(min(positive) / 3.0), math.log(max(positive))
    return (math.log(value) - low) / (high - low)


VALIDATION = (
    ("planes", "contacts RMS", "contacts.rms", text.um),
    ("distances", "distances RMS", "distance_errors.rms", text.um),
    ("distances", "maximum", "distance_errors.maximum", text.um),
    ("distances", "95 % predicted", "distance_errors.interval95", lambda ends: _ends(text.UM * ends)),
    ("points", "points RMS", "point_lengths.rms", text.um),
    ("points", "mean", "point_lengths.mean", text.um),
    ("points", "maximum", "point_lengths.maximum", text.um),
    ("turns", "angles mean (mdeg)", "turn_angles.mean", lambda mean: text.two_digits(text.MDEG * mean)),
)
"""Kinds of validation measurement, and of each the heading, the attribute and the text of a column."""


def validation_table(levels: Sequence[ModelLevel]) -> Sheet:
    """Errors of validation measurements by model level."""
    last = levels[-1].validation
    columns = (
        Column("validation (µm)", "effects", text.model_label),
        *(
            Column(heading, attrgetter(f"validation.{errors}"), shown)
            for kind, heading, errors, shown in VALIDATION
            if getattr(last, kind)
        ),
        Column("within 95 %", "validation", _within),
    )
    return Sheet(columns, levels)


def _within(v: Validation) -> str:
    """How many values of validation measurements lie within their 95 % prediction intervals."""
    hits = [np.atleast_1d(inside95(d.error, d.predicted)) for d in v.distances]
    hits += [inside95(c.residuals, c.predicted).ravel() for c in (*v.planes, *v.points, *v.turns)]
    return f"{100 * np.mean(np.concatenate(hits)):.0f} %" if hits else text.MISSING


def distance_table(distances: Sequence[Json], every: bool) -> Sheet:
    """Errors of certified distances; the largest alone unless `every`."""
    order = sorted(range(len(distances)), key=lambda k: -abs(distances[k]["calibrated_error_um"]))
    if every or len(order) <= MOST_DISTANCES:
        return Sheet(SHORT_DISTANCES, distances)
    shown = [distances[k] for k in sorted(order[:MOST_DISTANCES])]
    caption = f"the {len(shown)} largest errors of {len(order)}; --verbose: all"
    return Sheet(SHORT_DISTANCES, shown, caption)


def by_target(residuals: Sequence[Json]) -> Sheet:
    """Residuals of every target and role."""
    columns = (
        Column("target", "target"),
        Column("role", lambda r: ROLES[r["role"]], words=True),
        Column("rows", "count"),
        Column("rejected", "rejected"),
        Column("RMS (µm)", bar_of(residuals, "rms_um"), as_is),
        Column("maximum (µm)", "max_um", text.length),
    )
    return Sheet(columns, residuals, "Residuals by target")


def states(identifiability: Json) -> dict[str, str]:
    """Whether each parameter is identifiable: "yes", "weakly" or "no"."""
    return {name: word for key, word in IDENTIFIABLE.items() for name in identifiability[key]}


def parameter_columns(identifiability: Json) -> tuple[Column, ...]:
    """Columns of `parameters` of a record."""
    state = states(identifiability)

    def value(p: Json) -> str:
        return text.measured(p["estimate"], p["sd"], "")

    return (
        Column("parameter", "name"),
        Column("nominal", lambda p: text.as_precise(p["nominal"], value(p))),
        Column("value(u)", value),
        Column("unit", "unit", unit_label, words=True),
        Column("prior u", "prior_sd", lambda sd: f"{float(f'{sd:.2g}'):.9g}"),
        Column("identifiable", lambda p: state.get(p["name"])),
    )


def parameter_table(parameters: Sequence[Json], identifiability: Json, every: bool) -> Sheet:
    """Parameters with standard uncertainties; with `every` those of the targets too."""
    shown = [p for p in parameters if every or p["effect"] not in NOT_ARM]
    columns = parameter_columns(identifiability)
    notes = "\n".join(text.parameter_notes([p["effect"] for p in parameters]))

    def style(p: Any) -> str:
        return "yellow" if columns[-1].value(p) == "no" else ""

    return Sheet(columns, shown, notes, style=style)


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
        values = (text.with_u(factor * value[k], factor * sd[k]) for value, sd in estimates)
        rows.append((text.with_unit(compared.names[k], unit), *values, f"{furthest[k]:.1f}"))
    headings = ("parameter by session", *compared.alone, "together", "difference / u")
    caption = f"the {MOST} of {len(compared.names)} that differ most; all are in fit.json"
    return sheet_of_cells(headings, rows, caption if len(shown) < len(compared.names) else "")


def verdicts(compared: Agreement) -> text.Facts:
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
    most = [k for k in np.argsort(-np.abs(pair.apart)) if abs(pair.apart[k]) > FAR][:SHOWN]
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
