"""The page of the diagnosis of a joint log, `gap.html`: its sections, each a function of the run."""

from __future__ import annotations

from bayescal.reporting.motion import sheets
from bayescal.reporting.page.gap import VERDICTS
from bayescal.reporting.page.section import Facts, Fault, FirstScreen, Run, Section, blocks, texts
from bayescal.reporting.shared.text import by_reason, probability


def first(run: Run) -> Section:
    """Verdict, effects with size and place, what to measure next."""
    record = run.record
    tone, sign, word = VERDICTS[record["verdict"]]
    faults = [
        Fault(
            named["text"],
            (
                ("probability", probability(named["probability"])),
                ("relevant", "yes" if named["relevant"] else "no"),
            ),
            named["remedy"],
        )
        for named in record["named"]
    ]
    return FirstScreen(
        word, tone, sign, record["words"], len(record["words"]), fault_title="What is wrong", faults=faults,
        warnings=record["warnings"], notes=record["next"],
    ).section()  # fmt: skip


def torque(run: Run) -> Section | None:
    """Torque residuals of withheld motions."""
    return blocks("torque", "Torque on withheld motions", sheets.torque_sheet(run.record))


def places(run: Run) -> Section | None:
    """Places, amplitudes and probabilities."""
    r = run.record
    return blocks(
        "places",
        "Where and what",
        sheets.where_sheet(r),
        sheets.amplitude_sheet(r),
        sheets.probability_sheet(r),
    )


def not_assessed(run: Run) -> Section | None:
    """Effects of which the log does not tell, and what to log next."""
    reasons = tuple((", ".join(names), why) for why, names in by_reason(run.record["missing"]).items())
    return blocks("limits", "Not assessed", Facts(reasons) if reasons else None, *texts(run.record["next"]))


SECTIONS = (first, torque, places, not_assessed)
