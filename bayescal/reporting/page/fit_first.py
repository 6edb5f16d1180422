"""The first screen of report.html: verdict, distance error with U, failed tests, next command."""

from __future__ import annotations

import math
import shlex
from typing import Any

import numpy as np

from bayescal.fitted.gate import STEPS
from bayescal.reporting.page.section import Fault, Run, Section, interval, length, uncertainty
from bayescal.reporting.shared.text import p_value

REASONS = 4
"""Failed tests that the first screen names."""


def first(run: Run) -> Section:
    """Verdict, distance error with U, failed tests, next command."""
    record, verdict = run.record, run.record["verdict"]
    good = verdict["explains"] and verdict["validated"] and verdict.get("determined", True)
    against = _use(run)["against"]
    tone = "bad" if against or not verdict["explains"] else "good" if good else "warn"
    reasons = sorted(verdict["reasons"], key=lambda c: c["p"] if c["p"] is not None else 1.0)
    faults = [Fault(f"not to be used: {reason}") for reason in against]
    faults += [
        Fault(c["words"], () if c["p"] is None else (("p", p_value(c["p"])),))
        for c in reasons[:REASONS]
        if c["words"] not in against
    ]
    warnings, notes = _warnings(record)
    context = {
        "tone": tone,
        "sign": {"good": "✓", "warn": "?", "bad": "✗"}[tone],
        "word": verdict["words"][:1].upper() + verdict["words"][1:],
        "lines": [_why(run)] if not good else ["Not to be used, for the reasons below."] if against else (),
        "most": 1,
        "keys": _keys(record),
        "fault_title": "What is wrong",
        "faults": faults,
        "arm": None,
        "arm_caption": "",
        "next": _next(run),
        "warnings": warnings,
        "notes": notes,
    }
    return Section("result", "", "first.html.j2", context)


def _warnings(record: Any) -> tuple[list[str], list[str]]:
    """Findings that are not among the tests that fail, each once, and other warnings; and the notes."""
    told = {c["test"] for c in record["verdict"]["reasons"]}
    again = {f["text"] for f in record["findings"] if f["code"] in told}
    notes = [f["text"] for f in record["findings"] if f["severity"] == "note"]
    rest = [text for text in dict.fromkeys(record["warnings"]) if text not in again and text not in notes]
    return rest, list(dict.fromkeys(notes))


def _why(run: Run) -> str:
    verdict = run.record["verdict"]
    if verdict["explains"] and not verdict.get("determined", True):
        return "Too few or too similar measurements: the arm is known little better than before. Add more."
    if verdict["explains"]:
        return "No independent measurements check the calibration: the errors below are predictions."
    return (
        "The machine differs from the model by more than noise; U includes that, but its cause is not known."
    )


def _keys(record: Any) -> list[tuple[str, str, str]]:
    expected, validation = record["predicted_distance"], record["validation"]
    low, high = expected["lengths_mm"]
    over = f"{expected['count']} distances, {low:.0f} to {high:.0f} mm, between {expected['over']}"
    out = [
        (
            "Distance error, expected",
            f"U = {uncertainty(expected['expanded_U_um'])} µm (k = {expected.get('k', 2.0):.2f})",
            f"RMS {uncertainty(expected['predicted_rms_um'])} µm, 95 %: "
            f"{interval(expected['predicted_interval95_um'])} µm; {over}",
        )
    ]
    pairs = [(d["nominal_error_um"], d["calibrated_error_um"]) for d in validation["distances"]]
    if pairs:
        within = sum(bool(d["inside95"]) for d in validation["distances"])
        words = f"{within} of {len(pairs)} certified distances within the 95 % prediction interval"
        out.append(_change("Distance error, nominal → calibrated", np.array(pairs), words))
    if validation["points"]["count"]:
        p = validation["points"]
        value = f"{length(p['nominal_mean_um'])} → {length(p['calibrated_mean_um'])} µm mean"
        most = f"maximum {length(p['nominal_max_um'])} → {length(p['calibrated_max_um'])} µm"
        detail = f"{most}; {p['count']} validation points"
        out.append(("Point error, nominal → calibrated", value, detail))
    if validation["planes"]:
        count = sum(p["count"] for p in validation["planes"])
        before, after = (
            math.sqrt(sum(p["count"] * p[f"{level}_rms_um"] ** 2 for p in validation["planes"]) / count)
            for level in ("nominal", "calibrated")
        )
        largest = max(p["calibrated_max_um"] for p in validation["planes"])
        detail = f"maximum now {length(largest)} µm; {count} validation contacts"
        value = f"{length(before)} → {length(after)} µm RMS"
        out.append(("Contact error, nominal → calibrated", value, detail))
    if decided := record["acceptance"]:
        value = f"{decided['decision']} at {decided['tolerance_mm']:g} mm"
        out.append(("Tolerance (ISO 14253-1)", value, decided["why"]))
    return out


def _change(name: str, errors: np.ndarray, words: str) -> tuple[str, str, str]:
    """RMS and maximum of errors (N, 2), µm, before and after."""
    (was, most_was), (now, most) = (
        (length(float(np.sqrt(np.mean(e**2)))), length(float(np.max(np.abs(e))))) for e in errors.T
    )
    return name, f"{was} → {now} µm RMS", f"maximum {most_was} → {most} µm; {words}"


def _next(run: Run) -> list[tuple[str, str]]:
    folder, use = shlex.quote(run.folder), _use(run)
    words = STEPS[use["next"]][:1].upper() + STEPS[use["next"]][1:] + "."
    if use["next"] == "gap":
        sessions = run.record["dataset"].get("sessions") or ()
        parts = [f"{folder}/dataset/{k}" for k in range(1, len(sessions) + 1)] or [f"{folder}/dataset"]
        return [(words, f"bayescal gap {' '.join(parts)}")]
    if use["next"] != "use":
        return [(words, "")]
    return [
        (words, f"bayescal export {folder} --to urdf"),
        ("Check whether effects remain that the model lacks.", f"bayescal gap {folder}/dataset"),
    ]


def _use(run: Run) -> dict[str, Any]:
    """What may be used of the fit; an earlier version did not state it."""
    use: dict[str, Any] = run.record.get("use", {"against": [], "next": "use"})
    return use
