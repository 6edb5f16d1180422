"""The page of a calibration, `report.html`: its sections, each a function of the run."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from bayescal.effects.vocabulary import unit_label
from bayescal.reporting.page import rows, svg
from bayescal.reporting.page.fit_first import first
from bayescal.reporting.page.section import (
    MISSING,
    Bar,
    Block,
    Facts,
    Figures,
    Run,
    Section,
    Sheet,
    Text,
    blocks,
    interval,
    length,
    measured,
    share,
    texts,
    uncertainty,
)
from bayescal.reporting.shared.text import model_label, parameter_notes, signed, unsigned_zero

ARM = ("target", "plane-form")
"""Effects whose parameters are not those of the arm."""
PAIRS = 12
MATRIX = 45
"""Most parameters that the matrix of correlations shows."""
LEVELS = {"determined": "yes", "partly": "weakly", "prior_only": "no"}


def levels(run: Run) -> Section | None:
    """Errors of validation measurements by model level."""
    columns = (
        ("contacts RMS", "heldout_planes_rms_um"),
        ("distances RMS", "distance_rms_um"),
        ("maximum", "worst_distance_um"),
        ("points RMS (length)", "points_rms_um"),
        ("mean", "points_mean_um"),
    )
    return blocks("levels", "Model levels", level_sheet(run.record["ladder"], columns))


def level_sheet(levels: Any, columns: tuple[tuple[str, str], ...], names: tuple[str, ...] = ()) -> Sheet:
    """Model levels with a bar of the first column that has values; bars are logarithmic."""
    shown = [(h, key) for h, key in columns if any(step.get(key) is not None for step in levels)]
    sheet_rows = []
    for k, step in enumerate(levels):
        cells: list[Any] = [length(step.get(key)) for _, key in shown]
        if shown:
            every = [s.get(shown[0][1]) for s in levels]
            cells[0] = Bar(log_fraction(every[k], every), cells[0], marked=k == len(levels) - 1)
        sheet_rows.append((names[k] if names else model_label(step["model"]), *cells))
    caption = "Errors of validation measurements, µm; bars are logarithmic"
    return Sheet("model", tuple(h for h, _ in shown), tuple(sheet_rows), caption)


def log_fraction(value: float | None, every: list[float | None]) -> float:
    """Length of a bar on a logarithmic scale that begins at a third of the smallest value."""
    known = [v for v in every if v]
    if not value or not known:
        return 0.0
    low, high = math.log(min(known) / 3.0), math.log(max(known))
    return (math.log(value) - low) / (high - low)


def distances(run: Run) -> Section | None:
    """Certified distances and diameters, measured and predicted; validation targets."""
    validation = run.record["validation"]
    found = Sheet(
        "distance",
        ("certified (mm)", "nominal (µm)", "calibrated (µm)", "u (µm)", "95 % predicted (µm)", ""),
        tuple(
            (
                " – ".join(d["between"]),
                f"{d['certified_mm']:.3f}",
                signed(d["nominal_error_um"]),
                signed(d["calibrated_error_um"], 1),
                uncertainty(d["predicted_sd_um"]),
                _ends(d["predicted_interval95_um"]),
                "within" if d["inside95"] else "outside",
            )
            for d in sorted(validation["distances"], key=lambda d: -abs(d["calibrated_error_um"]))
        ),
        "Errors of certified distances, the largest first",
        shown=10,
    )
    faces = Sheet(
        "target",
        ("contacts", "nominal RMS (µm)", "calibrated RMS (µm)", "maximum (µm)", "expected RMS (µm)"),
        tuple(
            (
                p["target"],
                str(p["count"]),
                length(p["nominal_rms_um"]),
                length(p["calibrated_rms_um"]),
                length(p["calibrated_max_um"]),
                length(p["predicted_rms_um"]),
            )
            for p in validation["planes"]
        ),
        "Validation contacts by target",
    )
    predicted = Sheet(
        "distances between",
        (
            "number",
            "lengths (mm)",
            "expected RMS (µm)",
            "U = k u (µm)",
            "k",
            "95 % (µm)",
            "measured RMS (µm)",
        ),
        tuple(
            (
                d["over"],
                str(d["count"]),
                "{:.0f} to {:.0f}".format(*d["lengths_mm"]),
                uncertainty(d["predicted_rms_um"]),
                uncertainty(d["expanded_U_um"]),
                f"{d.get('k', 2.0):.2f}",
                interval(d["predicted_interval95_um"]),
                length(d["measured_rms_um"]),
            )
            for d in run.record["predicted_distance"]["all"]
        ),
        "Distance errors to expect",
    )
    return blocks("distances", "Distances and validation", predicted, found, faces)


def iso9283(run: Run) -> Section | None:
    """Figures of ISO 9283 from validation data, and what differs from the procedure of the standard."""
    found = run.record.get("iso9283")
    if not found or not found["figures"]:
        return None
    table = Sheet(
        "quantity",
        ("number", "mean (µm)", "u (µm)", "maximum (µm)", "u (µm)"),
        tuple(
            (
                f"{f['symbol']}: {f['name']}",
                str(f["count"]),
                length(f["mean_um"]),
                uncertainty(f["u_mean_um"]),
                length(f["max_um"]),
                uncertainty(f["u_max_um"]),
            )
            for f in found["figures"]
        ),
        "Figures of ISO 9283 from validation measurements; u: standard uncertainty of the measurement",
    )
    lines = ("What differs from the procedure of the standard:", *found["differs_from_norm"])
    return blocks("iso9283", "ISO 9283", table, *texts(lines, "quiet"))


def _ends(ends: list[float]) -> str:
    return f"{signed(ends[0], 1)} to {signed(ends[1], 1)}"


def by_target(run: Run) -> Sheet:
    """Residuals of every target and role."""
    largest = max((r["rms_um"] or 0.0 for r in run.record["residuals"]), default=0.0) or 1.0
    return Sheet(
        "target",
        ("role", "rows", "rejected", "RMS (µm)", "maximum (µm)"),
        tuple(
            (
                r["target"],
                "validation" if r["role"] == "validate" else "fitted",
                str(r["count"]),
                str(r["rejected"]),
                Bar((r["rms_um"] or 0.0) / largest, length(r["rms_um"])),
                length(r["max_um"]),
            )
            for r in run.record["residuals"]
        ),
        "Residuals by target",
        words=(1,),
    )


def parameters(run: Run) -> Section | None:
    """Parameters with prior and posterior."""
    known = run.record["identifiability"]
    state = {name: word for key, word in LEVELS.items() for name in known[key]}

    def entry(p: Any) -> tuple[Any, ...]:
        text = measured(p["estimate"], p["sd"], "")
        decimals = len(text.partition("(")[0].partition(".")[2])
        prior = (p.get("prior_mean", p["nominal"]), p["prior_sd"])
        return (
            p["name"],
            unsigned_zero(f"{p['nominal']:.{decimals}f}"),
            text,
            unit_label(p["unit"]),
            f"{float(format(p['prior_sd'], '.2g')):.9g}",
            svg.prior_posterior(prior, tuple(p["interval95"]), p["estimate"]),
            state.get(p["name"], MISSING),
        )

    headings = ("nominal", "value(u)", "unit", "prior u", "prior and posterior", "identifiable")
    own = [p for p in run.record["parameters"] if p["effect"] not in ARM]
    other = [p for p in run.record["parameters"] if p["effect"] in ARM]
    notes = (
        *parameter_notes(p["effect"] for p in own),
        "band: prior, two standard deviations; line and dot: 95 % interval and estimate, clipped at "
        "±3 prior standard deviations",
    )
    caption = ". ".join(note[:1].upper() + note[1:] for note in notes)
    weak = [f"Weakly identifiable: {d['words']}" for d in known["weak_directions"]]
    return blocks(
        "parameters",
        "Parameters",
        Sheet("parameter", headings, tuple(map(entry, own)), caption, words=(3,)),
        *texts(weak),
        Sheet("parameter", headings, tuple(map(entry, other)), "Targets and faces", words=(3,), shown=0),
    )


def correlations(run: Run) -> Section | None:
    """Correlations of the parameters of the arm."""
    pairs = run.record.get("correlations")
    if not pairs:
        return None
    order = [p["name"] for p in run.record["parameters"]]
    names = sorted({p[side] for p in pairs for side in "ab"}, key=order.index)[:MATRIX]
    values = np.zeros((len(names), len(names)))
    for p in pairs:
        if p["a"] in names and p["b"] in names:
            i, j = names.index(p["a"]), names.index(p["b"])
            values[i, j] = values[j, i] = p["r"]
    drawing = svg.matrix(names, values, "Correlations of the parameters; the table lists the strongest")
    table = Sheet(
        "parameter",
        ("parameter", "correlation"),
        tuple((p["a"], p["b"], signed(p["r"], 3)) for p in pairs),
        "The strongest correlations: only their combination is well known",
        words=(1,),
        shown=PAIRS,
    )
    legend = "Squares: absolute value of 0.3 and above; filled: positive; open: negative."
    return blocks("correlations", "Correlations", Figures((("", drawing),)), Text(legend, "quiet"), table)


def sampler(run: Run) -> Section | None:
    """Whether the posterior draws suffice."""
    s = run.record["sampler"]
    if not s["acceptance"]:
        return blocks(
            "sampler", "Sampler", Text("Gaussian approximation (--samples 0): nothing was sampled.")
        )
    lines = [
        ("state", "converged" if s["converged"] else f"not converged: {s['complaint']}"),
        ("draws", f"{s['draws']} from {s['ensembles']} ensembles of {s['walkers']} walkers"),
        ("effective draws", f"at least {s['ess']['min']:.0f} ({s['ess']['of']}), {s['ess']['counted_on']}"),
        ("R-hat", MISSING if s["rhat"]["max"] is None else f"at most {s['rhat']['max']:.4f}"),
        ("acceptance", ", ".join(f"{name} {rate:.2f}" for name, rate in s["acceptance"].items())),
        ("moves", s["moves"]),
        (
            "Monte Carlo error",
            f"at most {share(s['monte_carlo_error']['largest_over_sd'])} of an uncertainty",
        ),
    ]
    return blocks("sampler", "Sampler", Facts(tuple(lines)))


def outliers(run: Run) -> Section | None:
    """Rejected measurements and what they share, noise, tests."""
    record, noise = run.record, run.record["noise"]
    rejected = record["rejected"]
    words = (
        f"{len(rejected)} measurements were rejected: {', '.join(rejected)}"
        if rejected
        else "No measurement was rejected."
    )
    causes = [
        f"Rejected measurements share {c['label']}: {c['rejected']} of {c['rows_in_group']} (p {c['p']:.1g})"
        for c in record["verdict"]["shared_causes"]
    ]
    repeats = noise["repeats_um"]
    scatter = "" if repeats is None else f", repeated {noise['group']}s {length(repeats)} µm"
    told = (
        f"Noise: residual standard deviation {length(noise['estimated_um'])} µm, stated "
        f"{length(noise['stated_um'])} µm{scatter}."
    )
    tests = Sheet(
        "test",
        ("value", "limit", "p"),
        tuple(
            (
                c["words"],
                *(MISSING if c[key] is None else f"{c[key]:.3g}" for key in ("value", "limit", "p")),
            )
            for c in record["verdict"]["tests"]
        ),
        "Tests of the model",
    )
    parts: list[Block] = [Text(words), *texts(causes, "warning"), Text(told), tests]
    return blocks("outliers", "Outliers, noise and tests", *parts)


SECTIONS: tuple[Callable[[Run], Section | None], ...] = (
    first,
    rows.scene,
    lambda run: rows.residuals(run, by_target(run)),
    distances,
    levels,
    iso9283,
    rows.budget,
    parameters,
    correlations,
    sampler,
    outliers,
    rows.figures,
    rows.inputs,
)
"""Sections of report.html, in their order."""
