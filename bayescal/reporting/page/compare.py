"""Several runs side by side: verdicts, distance errors, parameters with their differences, model levels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bayescal.effects.vocabulary import unit_label
from bayescal.gap.result import VALIDATION_CONTACTS
from bayescal.predict.forecast import CENTRES
from bayescal.reporting.page.rows import inputs
from bayescal.reporting.page.section import (
    MISSING,
    Bar,
    Facts,
    Run,
    Section,
    Sheet,
    Text,
    blocks,
    length,
    measured,
    uncertainty,
)
from bayescal.reporting.shared.text import model_label, probability, rival

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

Runs = Sequence[Run]


def labels(runs: Runs) -> tuple[str, ...]:
    """Names of the runs: their folders, with numbers where two have the same."""
    return tuple(f"{k}: {run.folder}" for k, run in enumerate(runs, start=1))


def verdicts(runs: Runs) -> Section | None:
    """What each run says, in words."""
    table = Sheet(
        "run",
        ("dataset", "command", "verdict"),
        tuple(
            (
                label,
                run.name,
                run.kind,
                run.record["verdict"]["words"] if run.kind == "fit" else "; ".join(run.record["words"]),
            )
            for label, run in zip(labels(runs), runs, strict=True)
        ),
        words=(1, 2, 3),
    )
    hashes = [h for run in runs if (h := run.record["dataset"]["sha256"])]  # none of a session in memory
    same = len(set(hashes)) < len(hashes)
    note = Text(
        "Runs of the same dataset are not independent: their differences come from the model alone, and the "
        "u of a difference below is too large.",
        "warning",
    )
    return blocks("verdicts", "Verdicts", table, note if same else None)


def distances(runs: Runs) -> Section | None:
    """Distance errors, expected and measured; U of a fit alone, whose budget states it."""
    entries = []
    for label, run in zip(labels(runs), runs, strict=True):
        if run.kind == "fit":
            e, checked = run.record["predicted_distance"], run.record["validation"]["distances"]
            largest = max((abs(d["calibrated_error_um"]) for d in checked), default=None)
            over, measured = e["over"], e["measured_rms_um"]
        else:
            e = {m["what"]: m for m in run.record["gap"]["measured"]}.get("sphere distances") or {}
            over, largest, measured = CENTRES if e else MISSING, None, e.get("rms_um")
        entries.append(
            (
                label,
                over,
                uncertainty(e.get("predicted_rms_um")),
                uncertainty(e.get("expanded_U_um")),
                length(measured),
                length(largest),
                str(e.get("count", MISSING)),
            )
        )
    headings = (
        "between", "expected RMS (µm)", "U = k u (µm)", "measured RMS (µm)", "maximum (µm)", "distances",
    )  # fmt: skip
    return blocks("distances", "Distance errors", Sheet("run", headings, tuple(entries), words=(1,)))


def effects(runs: Runs) -> Section | None:
    """Probability of every effect, and amplitudes, of diagnoses."""
    some = [(label, run) for label, run in zip(labels(runs), runs, strict=True) if run.kind == "gap"]
    if not some:
        return None
    largest: dict[str, float] = {}
    for _, run in some:
        for name, p in run.record["probability"].items():
            largest[name] = max(largest.get(name, 0.0), p or 0.0)
    order = sorted((n for n in largest if largest[n] >= LEAST), key=lambda n: -largest[n])
    table = Sheet(
        "effect",
        tuple(label for label, _ in some),
        tuple(
            (rival(n), *(_probability(run.record["probability"].get(n)) for _, run in some)) for n in order
        ),
        "Probability of the effects",
    )
    every = [(label, a) for label, run in some for a in run.record["amplitudes"]]
    keys = dict.fromkeys((a["effect"], a["site"], a["what"], a["unit"]) for _, a in every)
    sizes = Sheet(
        "amplitude",
        tuple(label for label, _ in some),
        tuple(
            (
                f"{effect} of {site}: {what}",
                *(_amplitude(run.record["amplitudes"], (effect, site, what, unit)) for _, run in some),
            )
            for effect, site, what, unit in keys
        ),
        "Amplitudes of the named effects, with u",
    )
    return blocks("effects", "Effects", table, sizes)


def _probability(value: float | None) -> Any:
    return MISSING if value is None else Bar(value, probability(value))


def _amplitude(amplitudes: Sequence[Mapping[str, Any]], key: tuple[str, ...]) -> str:
    found = [a for a in amplitudes if (a["effect"], a["site"], a["what"], a["unit"]) == key]
    return measured(found[0]["value"], found[0]["u"], found[0]["unit"]) if found else MISSING


def parameters(runs: Runs) -> Section | None:
    """Parameters of the arm, and their difference from the first calibration with its u."""
    some = [(label, run) for label, run in zip(labels(runs), runs, strict=True) if run.kind == "fit"]
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
    return blocks("parameters", "Parameters", Sheet("parameter", tuple(headings), rows, note))


def _compared(name: str, each: Sequence[Mapping[str, Any] | None]) -> tuple[Any, ...]:
    unit = next(p["unit"] for p in each if p is not None)
    cells: list[Any] = [MISSING if p is None else measured(p["estimate"], p["sd"], "") for p in each]
    first = each[0]
    for other in each[1:]:
        if first is None or other is None or other["unit"] != first["unit"]:
            cells += [MISSING, MISSING]
            continue
        difference = other["estimate"] - first["estimate"]
        u = float(np.hypot(other["sd"], first["sd"]))
        ratio = abs(difference) / u if u > 0 else 0.0
        cells += [measured(difference, u, ""), Bar(min(ratio / 5.0, 1.0), f"{ratio:.1f}", ratio > FAR)]
    label = unit_label(unit)
    return (f"{name} ({label})" if label else name, *cells)


def levels(runs: Runs) -> Section | None:
    """Validation errors of each model level in every run."""
    order = list(dict.fromkeys(tuple(step["model"]) for run in runs for step in run.record["ladder"]))
    shown = [
        what
        for what in ERRORS
        if any(_error(run, s, what) is not None for run in runs for s in run.record["ladder"])
    ]
    entries = []
    for model in order:
        cells = []
        for what in shown:
            for run in runs:
                step: Mapping[str, Any] = next(
                    (s for s in run.record["ladder"] if tuple(s["model"]) == model), {}
                )
                cells.append(length(_error(run, step, what)))
        entries.append((model_label(model), *cells))
    numbers = range(1, len(runs) + 1)
    headings = tuple(f"{what}, {k}" for what in shown for k in numbers)
    caption = "RMS of validation measurements, µm; of points the length of the error vector"
    return blocks("levels", "Model levels", Sheet("model", headings, tuple(entries), caption))


def _error(run: Run, step: Mapping[str, Any], what: str) -> float | None:
    """RMS error, µm, of a model level; None where the run has no such rows."""
    if what == "contacts" and run.kind == "gap" and run.record["lengths"]["of"] != VALIDATION_CONTACTS:
        return None  # what the record states there is per coordinate
    return next((step[key] for key in ERRORS[what] if step.get(key) is not None), None)


def origins(runs: Runs) -> Section | None:
    """Inputs and versions of every run."""
    parts: list[Text | Facts] = []
    for label, run in zip(labels(runs), runs, strict=True):
        section = inputs(run)
        if section is not None:
            parts += [Text(label), *section.context["blocks"]]
    return blocks("inputs", "Inputs and versions", *parts)


SECTIONS: tuple[Callable[[Runs], Section | None], ...] = (
    verdicts, distances, effects, parameters, levels, origins,
)  # fmt: skip
"""Sections of the page of several runs, in their order."""
