"""Several runs side by side: verdicts, distance errors, parameters with their differences, model levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bayescal.gap.result import VALIDATION_CONTACTS
from bayescal.predict.forecast import CENTRES
from bayescal.reporting.page.common import inputs
from bayescal.reporting.page.section import Facts, Run, Section, Text, blocks
from bayescal.reporting.shared import text
from bayescal.reporting.shared.sheet import Bar, Column, Sheet, as_is, of_key, sheet_of_cells
from bayescal.storage.reading import Json

FAR = 2.0
"""Differences above this multiple of their u are marked (k = 2)."""
LEAST = 0.01
"""Least probability, in any run, of an effect that is listed."""

ERRORS = {
    "contacts": ("heldout_planes_rms_um", "heldout_rms_um"),
    "distances": ("distance_rms_um",),
    "points": ("points_rms_um", "point_length_rms_um"),
}
"""Errors of model levels, and their keys in the records of fits and diagnoses."""

VERDICTS = ("dataset", "command", "verdict")
Runs = Sequence[Run]


def labelled(runs: Runs, kind: str = "") -> list[tuple[str, Run]]:
    """The runs (of a kind) with their names: their folders, with numbers where two have the same."""
    return [(f"{k}: {run.folder}", run) for k, run in enumerate(runs, start=1) if kind in ("", run.kind)]


def verdicts(runs: Runs) -> Section | None:
    """What each run says, in words."""

    def verdict(run: Run) -> str:
        return run.record["verdict"]["words"] if run.kind == "fit" else "; ".join(run.record["words"])

    items = [(label, run.name, run.kind, verdict(run)) for label, run in labelled(runs)]
    columns = (Column("run", 0), *(Column(h, k, words=True) for k, h in enumerate(VERDICTS, start=1)))
    hashes = [h for run in runs if (h := run.record["dataset"]["sha256"])]  # none of a session in memory
    same = len(set(hashes)) < len(hashes)
    note = Text(
        "Runs of the same dataset are not independent: their differences come from the model alone, and the "
        "u of a difference below is too large.",
        "warning",
    )
    return blocks("verdicts", "Verdicts", Sheet(columns, items), note if same else None)


def distances(runs: Runs) -> Section | None:
    """Distance errors, expected and measured; U of a fit alone, whose budget states it."""
    items = []
    for label, run in labelled(runs):
        if run.kind == "fit":
            e, checked = run.record["predicted_distance"], run.record["validation"]["distances"]
            largest = max((abs(d["calibrated_error_um"]) for d in checked), default=None)
            items.append({**e, "run": label, "largest": largest})
        else:
            e = {m["what"]: m for m in run.record["gap"]["measured"]}.get("sphere distances") or {}
            between = {"over": CENTRES} if e else {}
            items.append({**e, "run": label, **between, "measured_rms_um": e.get("rms_um")})
    columns = (
        Column("run", "run"),
        Column("between", lambda e: e.get("over"), words=True),
        Column("expected RMS (µm)", lambda e: e.get("predicted_rms_um"), text.uncertainty),
        Column("U = k u (µm)", lambda e: e.get("expanded_U_um"), text.uncertainty),
        Column("measured RMS (µm)", "measured_rms_um", text.length),
        Column("maximum (µm)", lambda e: e.get("largest"), text.length),
        Column("distances", lambda e: e.get("count")),
    )
    return blocks("distances", "Distance errors", Sheet(columns, items))


def effects(runs: Runs) -> Section | None:
    """Probability of every effect, and amplitudes, of diagnoses."""
    some = labelled(runs, "gap")
    if not some:
        return None
    largest: dict[str, float] = {}
    for _, run in some:
        for name, p in run.record["probability"].items():
            largest[name] = max(largest.get(name, 0.0), p or 0.0)
    order = sorted((n for n in largest if largest[n] >= LEAST), key=lambda n: -largest[n])
    probabilities = [Column(label, of_key(_probability, run), as_is) for label, run in some]
    table = Sheet((Column("effect", text.rival), *probabilities), order, "Probability of the effects")
    keys = dict.fromkeys(_key(a) for _, run in some for a in run.record["amplitudes"])
    amplitudes = [Column(label, of_key(_amplitude, run)) for label, run in some]
    name = Column("amplitude", lambda key: f"{key[0]} of {key[1]}: {key[2]}")
    sizes = Sheet((name, *amplitudes), list(keys), "Amplitudes of the named effects, with u")
    return blocks("effects", "Effects", table, sizes)


def _key(a: Json) -> tuple[str, ...]:
    return (a["effect"], a["site"], a["what"], a["unit"])


def _probability(effect: str, run: Run) -> Bar | None:
    p = run.record["probability"].get(effect)
    return None if p is None else Bar(p, text.probability(p))


def _amplitude(key: tuple[str, ...], run: Run) -> str | None:
    amplitudes = (a for a in run.record["amplitudes"] if _key(a) == key)
    return next((text.measured(a["value"], a["u"], a["unit"]) for a in amplitudes), None)


def parameters(runs: Runs) -> Section | None:
    """Parameters of the arm, and their difference from the first calibration with its u."""
    some = labelled(runs, "fit")
    if len(some) < 2:
        return None
    if len({run.robot for _, run in some}) > 1:
        return blocks("parameters", "Parameters", Text("The runs are of different robots: not compared."))
    tables = [{p["name"]: p for p in run.record["parameters"] if p["effect"] != "target"} for _, run in some]
    names = list(dict.fromkeys(name for table in tables for name in table))
    rows = tuple(_compared(name, [table.get(name) for table in tables]) for name in names)
    headings = [label for label, _ in some]
    for label in headings[1:]:
        headings = [*headings, f"difference of {label.partition(':')[0]} from 1 (u)", "difference / u"]
    note = (
        "Differences with their standard uncertainty u, the root of the sum of both squared u (independent "
        f"sessions); dark: above {FAR:g} u"
    )
    return blocks("parameters", "Parameters", sheet_of_cells(("parameter", *headings), rows, note))


def _compared(name: str, each: Sequence[Json | None]) -> tuple[Any, ...]:
    """Estimates of a parameter, and the difference of each from the first."""
    first = each[0]
    cells: list[Any] = [
        text.MISSING if p is None else text.measured(p["estimate"], p["sd"], "") for p in each
    ]
    for other in each[1:]:
        if first is None or other is None or other["unit"] != first["unit"]:
            cells += [text.MISSING, text.MISSING]
            continue
        difference, u = other["estimate"] - first["estimate"], float(np.hypot(other["sd"], first["sd"]))
        ratio = abs(difference) / u if u > 0 else 0.0
        cells += [text.measured(difference, u, ""), Bar(min(ratio / 5.0, 1.0), f"{ratio:.1f}", ratio > FAR)]
    return (text.with_unit(name, next(p["unit"] for p in each if p is not None)), *cells)


def levels(runs: Runs) -> Section | None:
    """Validation errors of each model level in every run."""
    order = list(dict.fromkeys(tuple(step["model"]) for run in runs for step in run.record["ladder"]))
    errors = []
    for what in ERRORS:
        of_runs = [
            {tuple(step["model"]): _error(run, step, what) for step in reversed(run.record["ladder"])}
            for run in runs
        ]
        if any(error is not None for of_run in of_runs for error in of_run.values()):
            errors += [Column(f"{what}, {k}", e.get, text.length) for k, e in enumerate(of_runs, start=1)]
    caption = "RMS of validation measurements, µm; of points the length of the error vector"
    sheet = Sheet((Column("model", text.model_label), *errors), order, caption)
    return blocks("levels", "Model levels", sheet)


def _error(run: Run, step: Json, what: str) -> float | None:
    """RMS error, µm, of a model level; None where the run has no such rows."""
    if what == "contacts" and run.kind == "gap" and run.record["lengths"]["of"] != VALIDATION_CONTACTS:
        return None  # what the record states there is per coordinate
    return next((step[key] for key in ERRORS[what] if step.get(key) is not None), None)


def origins(runs: Runs) -> Section | None:
    """Inputs and versions of every run."""
    parts: list[Text | Facts] = []
    for label, run in labelled(runs):
        section = inputs(run)
        if section is not None:
            parts += [Text(label), *section.context["blocks"]]
    return blocks("inputs", "Inputs and versions", *parts)


SECTIONS: tuple[Callable[[Runs], Section | None], ...] = (
    verdicts, distances, effects, parameters, levels, origins,
)  # fmt: skip
"""Sections of the page of several runs, in their order."""
