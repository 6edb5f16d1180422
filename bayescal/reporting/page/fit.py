"""The page of a calibration, `report.html`: its sections, each a function of the run."""

import math
import shlex
from collections.abc import Callable, Iterator

import numpy as np
from markupsafe import Markup

from bayescal.effects import named
from bayescal.estimate.unexplained import AGAIN
from bayescal.fitted.gate import STEPS
from bayescal.reporting import fit as sheets
from bayescal.reporting import page, text
from bayescal.reporting.figures.estimates import levelled
from bayescal.reporting.origin import images_keys, images_sheet
from bayescal.reporting.page import common, svg
from bayescal.reporting.sheet import Column, Sheet, as_is
from bayescal.statistics import rms
from bayescal.storage.reading import Json

PAIRS = 12
MATRIX = 45
"""Most parameters that the matrix of correlations shows."""
LEVELS = ("nominal", "calibrated")
REASONS = 4
"""Failed tests that the first screen names."""


def first(run: page.Run) -> page.Section:
    """Verdict, distance error with U, failed tests, next command."""
    record, verdict = run.record, run.record["verdict"]
    doubts = verdict.get("doubts", ())  # records of earlier versions have none
    good = verdict["explains"] and verdict["validated"] and verdict["determined"] and not doubts
    against = record["use"]["against"]
    tone = "bad" if against or not verdict["explains"] else "good" if good else "warn"
    reasons = sorted(verdict["reasons"], key=lambda c: c["p"] if c["p"] is not None else 1.0)
    faults = [page.Fault(f"not to be used: {reason}") for reason in against]
    concerns = [c for c in (reasons or doubts)[:REASONS] if c["words"] not in against]
    for c in concerns:
        faults.append(page.Fault(c["words"], () if c["p"] is None else (("p", text.p_value(c["p"])),)))
    warnings, notes = _warnings(record)
    return page.FirstScreen(
        verdict["words"][:1].upper() + verdict["words"][1:], tone,
        {"good": "✓", "warn": "?", "bad": "✗"}[tone],
        [_why(run)] if not good else ["Not to be used, for the reasons below."] if against else (),
        keys=[*_keys(record), *images_keys(record)], fault_title="What is wrong", faults=faults,
        next=_next(run), warnings=warnings, notes=notes,
    ).section()  # fmt: skip


def _warnings(record: Json) -> tuple[list[str], list[str]]:
    """Findings that are not among the tests that fail, each once, and other warnings; and the notes."""
    failed = {c["test"] for c in record["verdict"]["reasons"]}
    again = {f["text"] for f in record["findings"] if f["code"] in failed}
    notes = [f["text"] for f in record["findings"] if f["severity"] == "note"]
    others = [w for w in dict.fromkeys(record["warnings"]) if w not in again and w not in notes]
    return others, list(dict.fromkeys(notes))


def _why(run: page.Run) -> str:
    verdict = run.record["verdict"]
    if verdict["explains"] and not verdict["determined"]:
        return "Too few or too similar measurements: the arm is known little better than before. Add more."
    if verdict["explains"] and verdict["validated"]:
        return "U allows for these errors: noise or readings are worse than stated, or an effect is missing."
    if verdict["explains"]:
        return "No independent measurements check the calibration: the errors below are predictions."
    return (
        "The machine differs from the model by more than noise; U includes that, but its cause is not known."
    )


def _keys(record: Json) -> Iterator[tuple[str, str, str]]:
    expected, validation = record["predicted_distance"], record["validation"]
    low, high = expected["lengths_mm"]
    over = f"{expected['count']} distances, {low:.0f} to {high:.0f} mm, between {expected['over']}"
    yield (
        "Distance error, expected",
        f"U = {text.uncertainty(expected['expanded_U_um'])} µm (k = {expected['k']:.2f})",
        f"RMS {text.uncertainty(expected['predicted_rms_um'])} µm, 95 %: "
        f"{text.interval(expected['predicted_interval95_um'])} µm; {over}",
    )
    if checked := validation["distances"]:
        before, after = (np.array([d[f"{level}_error_um"] for d in checked]) for level in LEVELS)
        most = _change(float(np.max(np.abs(before))), float(np.max(np.abs(after))))
        within = f"{sum(bool(d['inside95']) for d in checked)} of {len(checked)} certified distances"
        detail = f"maximum {most}; {within} within the 95 % prediction interval"
        yield "Distance error, nominal → calibrated", f"{_change(rms(before), rms(after))} RMS", detail
    if validation["points"]["count"]:
        p = validation["points"]
        mean = _change(p["nominal_mean_um"], p["calibrated_mean_um"])
        most = _change(p["nominal_max_um"], p["calibrated_max_um"])
        detail = f"maximum {most}; {p['count']} validation points"
        yield "Point error, nominal → calibrated", f"{mean} mean", detail
    if planes := validation["planes"]:
        count = sum(p["count"] for p in planes)
        squares = (sum(p["count"] * p[f"{level}_rms_um"] ** 2 for p in planes) for level in LEVELS)
        change = _change(*(math.sqrt(total / count) for total in squares))
        largest = max(p["calibrated_max_um"] for p in planes)
        detail = f"maximum now {text.length(largest)} µm; {count} validation contacts"
        yield "Contact error, nominal → calibrated", f"{change} RMS", detail
    if decided := record["acceptance"]:
        value = f"{decided['decision']} at {decided['tolerance_mm']:g} mm"
        yield "Tolerance (ISO 14253-1)", value, decided["why"]


def _change(before: float, after: float) -> str:
    return f"{text.length(before)} → {text.length(after)} µm"


def _next(run: page.Run) -> list[tuple[str, str]]:
    folder, use = shlex.quote(run.folder), run.record["use"]
    words = STEPS[use["next"]][:1].upper() + STEPS[use["next"]][1:] + "."
    options = text.model_options(run.record["model"], run.record.get("without", ()))
    gap = f"bayescal gap {run.datasets}{options}"
    if use["next"] == "gap":
        return [(words, gap)]
    if use["next"] != "use":
        return [(words, "")]
    rigid = all(named(name)[0].dimensions for name in run.record["model"])  # all that a URDF holds
    export = f"bayescal export {folder} --to"
    cameras = [("Export where camera and board are.", f"{export} hand-eye")]
    return [
        (words, f"{export} {'urdf' if rigid else 'mjcf'}"),
        *(cameras if run.record.get("images") else []),
        ("Check whether effects remain that the model lacks.", gap),
    ]


def levels(run: page.Run) -> page.Section | None:
    """Errors of validation measurements by model level."""
    columns = (
        ("contacts RMS", "heldout_planes_rms_um"),
        ("distances RMS", "distance_rms_um"),
        ("maximum", "worst_distance_um"),
        ("points RMS (length)", "points_rms_um"),
        ("mean", "points_mean_um"),
    )
    if not levelled(run.record):
        return None
    names = [text.model_label(step["model"]) for step in run.record["ladder"]]
    return page.blocks("levels", "Model levels", sheets.level_sheet(run.record["ladder"], columns, names))


def distances(run: page.Run) -> page.Section | None:
    """Certified distances and diameters, measured and predicted; validation targets."""
    validation = run.record["validation"]
    ranked = sorted(validation["distances"], key=lambda d: -abs(d["calibrated_error_um"]))
    return page.blocks(
        "distances",
        "Distances and validation",
        Sheet(sheets.PREDICTED, run.record["predicted_distance"]["all"], "Distance errors to expect"),
        Sheet(sheets.DISTANCES, ranked, "Errors of certified distances, the largest first", 10),
        Sheet(sheets.DIAMETERS, validation["diameters"], "Errors of certified diameters", 10),
        Sheet(sheets.FACES, validation["planes"], "Validation contacts by target"),
        images_sheet(run.record),
    )


def iso9283(run: page.Run) -> page.Section | None:
    """Figures of ISO 9283 from validation data, and what differs from the procedure of the standard."""
    record = run.record["iso9283"]
    if not record["figures"]:
        return None
    caption = "Figures of ISO 9283 from validation measurements; u: standard uncertainty of the measurement"
    lines = ("What differs from the procedure of the standard:", *record["differs_from_norm"])
    table = Sheet(sheets.ISO9283, record["figures"], caption)
    return page.blocks("iso9283", "ISO 9283", table, *page.texts(lines, "quiet"))


def parameters(run: page.Run) -> page.Section | None:
    """Parameters with prior and posterior."""

    def drawing(p: Json) -> Markup:
        prior = (p["prior_mean"], p["prior_sd"])
        return svg.prior_posterior(prior, tuple(p["interval95"]), p["estimate"])

    *first, identifiable = sheets.parameter_columns(run.record["identifiability"])
    columns = (*first, Column("prior and posterior", drawing, as_is), identifiable)
    of_arm = [p for p in run.record["parameters"] if p["effect"] not in sheets.NOT_ARM]
    other = [p for p in run.record["parameters"] if p["effect"] in sheets.NOT_ARM]
    notes = (
        *text.parameter_notes([p["effect"] for p in of_arm]),
        "band: prior, two standard deviations; line and dot: 95 % interval and estimate, clipped at "
        "±3 prior standard deviations",
    )
    caption = "; ".join(notes)
    weak = [f"Weakly identifiable: {d['words']}" for d in run.record["identifiability"]["weak_directions"]]
    return page.blocks(
        "parameters",
        "Parameters",
        Sheet(columns, of_arm, caption),
        *page.texts(weak),
        Sheet(columns, other, "Targets and faces", 0),
    )


def correlations(run: page.Run) -> page.Section | None:
    """Correlations of the parameters of the arm."""
    pairs = run.record["correlations"]
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
    columns = (
        Column("parameter", "a"),
        Column("parameter", "b", words=True),
        Column("correlation", "r", lambda r: text.signed(r, 3)),
    )
    caption = "The strongest correlations: only their combination is well known"
    table = Sheet(columns, pairs, caption, PAIRS)
    legend = page.Text("Squares: absolute value of 0.3 and above; filled: positive; open: negative.", "quiet")
    return page.blocks("correlations", "Correlations", page.Figures((("", drawing),)), legend, table)


def sampler(run: page.Run) -> page.Section | None:
    """Whether the posterior draws suffice."""
    s = run.record["sampler"]
    if not s["acceptance"]:
        none = page.Text("Gaussian approximation (--samples 0): nothing was sampled.")
        return page.blocks("sampler", "Sampler", none)
    error = text.share(s["monte_carlo_error"]["largest_over_sd"])
    lines = (
        ("state", "converged" if s["converged"] else f"not converged: {s['complaint']}"),
        ("draws", f"{s['draws']} from {s['ensembles']} ensembles of {s['walkers']} walkers"),
        ("effective draws", f"at least {s['ess']['min']:.0f} ({s['ess']['of']}), {s['ess']['counted_on']}"),
        ("R-hat", text.MISSING if s["rhat"]["max"] is None else f"at most {s['rhat']['max']:.4f}"),
        ("acceptance", ", ".join(f"{name} {rate:.2f}" for name, rate in s["acceptance"].items())),
        ("moves", s["moves"]),
        ("Monte Carlo error", f"at most {error} of an uncertainty"),
    )
    return page.blocks("sampler", "Sampler", page.Facts(lines))


def outliers(run: page.Run) -> page.Section | None:
    """Rejected measurements and what they share, noise, tests."""
    record, noise = run.record, run.record["noise"]
    rejected = record["rejected"]
    words = f"{len(rejected)} measurements were rejected: {', '.join(rejected)}"
    causes = [
        f"Rejected measurements share {c['label']}: {c['rejected']} of {c['rows_in_group']} (p {c['p']:.1g})"
        for c in record["verdict"]["shared_causes"]
    ]
    repeats = noise["repeats_um"]
    scatter = "" if repeats is None else f", {AGAIN[noise['group']]} {text.length(repeats)} µm"
    of_noise = (
        f"Noise: residual standard deviation {text.length(noise['estimated_um'])} µm, stated "
        f"{text.length(noise['stated_um'])} µm{scatter}."
    )
    tests = Sheet(sheets.TESTS, record["verdict"]["tests"], "Tests of the model")
    words = words if rejected else "No measurement was rejected."
    lines = (page.Text(words), *page.texts(causes, "warning"), page.Text(of_noise))
    return page.blocks("outliers", "Outliers, noise and tests", *lines, tests)


SECTIONS: tuple[Callable[[page.Run], page.Section | None], ...] = (
    first, common.scene, lambda run: common.residuals(run, sheets.by_target(run.record["residuals"])),
    distances, levels, iso9283, common.budget, parameters, correlations, sampler, outliers, common.figures,
    common.inputs,
)  # fmt: skip
"""Sections of report.html, in their order."""
