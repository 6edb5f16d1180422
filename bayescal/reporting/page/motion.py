"""The pages of joint logs, `gap.html` and `report.html`: their sections, each a function of the run."""

from __future__ import annotations

import shlex

import numpy as np

from bayescal.reporting.motion import sheets
from bayescal.reporting.page import section, svg
from bayescal.reporting.page.common import CLIP
from bayescal.reporting.page.gap import FIRST, doubt_of, verdict_of
from bayescal.reporting.text import by_reason, probability
from bayescal.storage.reading import Json

KINDS = (("before", "dot", "Blue: model"), ("after", "check", "orange: with the effects"))
"""Residuals that are drawn: key, class of the style sheet, words."""


def first(run: section.Run) -> section.Section:
    """Verdict, effects with size and place, what to measure next."""
    record = run.record
    tone, sign, word = verdict_of(record)

    def fault(named: Json) -> section.Fault:
        relevant = ("relevant", "yes" if named["relevant"] else "no")
        facts = (("probability", probability(named["probability"])), relevant)
        doubt = doubt_of(named)
        advice = FIRST if doubt or record["verdict"] == "class" else named["remedy"]
        return section.Fault(f"{doubt}{named['text']}", facts, advice)

    steps = _simulator(run, "Write the arm with the effects, for a simulator:") if record["named"] else []
    if record["verdict"] == "null":
        steps = _simulator(run)
    if record.get("next_motions"):
        motions = "Run the motions of next-motions.csv, log them, and diagnose again with the log."
        steps = [*steps, (motions, "")] if record["verdict"] in ("null", "named") else [(motions, ""), *steps]
    return section.FirstScreen(
        word, tone, sign, record["words"], len(record["words"]), fault_title="What is wrong",
        faults=[fault(named) for named in record["named"]],
        next=steps, warnings=record["warnings"], notes=record["next"],
    ).section()  # fmt: skip


def _simulator(run: section.Run, words: str = "Write the arm for a simulator:") -> list[tuple[str, str]]:
    """Steps to an arm in a simulator."""
    folder = shlex.quote(run.folder)
    return [
        (words, f"bayescal export {folder} --to mjcf --out arm.xml"),
        ("Load it in MuJoCo, against the withheld motions:", f"bayescal verify {folder} arm.xml"),
    ]


def torque(run: section.Run) -> section.Section | None:
    """Torque residuals of withheld motions."""
    record = run.record
    expected = section.Text(f"expected: {sheets.EXPECTED}", "quiet")
    tables = sheets.torque_sheet(record), expected, *_course(record)
    return section.blocks("torque", "Withheld motions", *tables)


def _course(record: Json) -> tuple[section.Figures, section.Text] | tuple[()]:
    """Drawings of the residuals in the withheld motion with most error, joint by joint."""
    if "withheld" not in record:  # of an earlier version
        return ()
    w, unit, kinds = record["withheld"], record["unit"], KINDS if record["named"] else KINDS[:1]
    time, drawings = np.array(w["time_s"]), []
    for j, (name, floor) in enumerate(zip(record["joints"], record["noise"][f"floor_{unit}"], strict=True)):
        residuals = [np.array(w[f"{key}_{unit}"][j], float) for key, _, _ in kinds]
        there = np.isfinite(residuals[0])  # it is not at rest
        if not there.any():
            continue
        dots = [(style, time[there], x[there]) for (_, style, _), x in zip(kinds, residuals, strict=True)]
        edge = max(2.5 * floor, 1.05 * float(np.nanquantile(np.abs(residuals), CLIP)))
        labels = "time (s)", f"{name} ({sheets.WORDS[unit]})"
        drawings.append(("", svg.scatter(dots, labels, 2.0 * floor, f"Residuals of {name}", (-edge, edge))))
    words = "; ".join(text for _, _, text in kinds)
    legend = f"Motion {w['motion']}. {words}; triangles: off scale. Grey band: twice the expected residual."
    return section.Figures(tuple(drawings)), section.Text(legend, "quiet")


def replayed(run: section.Run) -> section.Section | None:
    """Withheld motions that a simulator moves by the logged commands, or why there are none."""
    why = sheets.replay_of(run.record).get("not_assessed")
    parts = sheets.tracking_sheet(run.record), section.Text(why) if why else None
    return section.blocks("replay", "Commands replayed in a simulator", *parts)


def places(run: section.Run) -> section.Section | None:
    """Places, amplitudes and probabilities."""
    r = run.record
    tables = (sheets.where_sheet(r), sheets.amplitude_sheet(r), sheets.probability_sheet(r))
    return section.blocks("places", "Where and what", *tables)


def not_assessed(run: section.Run) -> section.Section | None:
    """Effects of which the log does not tell."""
    reasons = tuple((", ".join(names), why) for why, names in by_reason(run.record["missing"]).items())
    return section.blocks("limits", "Not assessed", section.Facts(reasons) if reasons else None)


SECTIONS = (first, torque, replayed, places, not_assessed)


def fitted(run: section.Run) -> section.Section:
    """What is determined, and whether withheld torque errors are as expected."""
    record = run.record
    good, word = True, "Withheld motions have the errors of the fitted ones"
    if record["words"]:
        good, word = False, "The fit does not explain the withheld motions"
    if not record["withheld"]:
        good, word = False, "No motion was withheld"
    total = len(record["parameters"])
    line = f"{record['determined']} of {total} directions of the parameters are determined."
    tone, sign = ("good", "✓") if good else ("warn", "?")
    steps = _simulator(run)
    if record["withheld"] and not good:
        gap = f"bayescal gap {shlex.quote(run.folder)}/dataset"
        steps = [("Look for what the model does not explain:", gap), *steps]
    return section.FirstScreen(word, tone, sign, [line], next=steps, warnings=record["warnings"]).section()


def errors(run: section.Run) -> section.Section | None:
    """Torque errors of withheld motions."""
    return section.blocks("torque", "Withheld motions", sheets.withheld_sheet(run.record))


def parameters(run: section.Run) -> section.Section | None:
    """All parameters, and what is determined only together."""
    together = section.texts(run.record["combinations"], "quiet")
    return section.blocks("parameters", "Parameters", sheets.parameter_sheet(run.record), *together)


FIT_SECTIONS = (fitted, errors, parameters)
