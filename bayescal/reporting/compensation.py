"""What a compensation prints."""

from __future__ import annotations

import numpy as np
from rich.console import Group, RenderableType

from bayescal.exporting.compensate.compensation import Compensation
from bayescal.exporting.fitted import FittedArm
from bayescal.reporting.shared.text import MM, facts, model_label, um2

SHOWN = 5
"""Targets without solution, and notes, that are listed."""


def compensation_summary(arm: FittedArm, done: Compensation) -> RenderableType:
    """The verdict if it is bad, numbers of targets, errors before, uncertainty, what has no solution."""
    good = [own for own in done.found if not own.reason]
    rows = [
        *([("warning", done.warning, "bold red")] if done.warning else []),
        ("compensation", f"{done.source}: {len(done.found)} targets, poses in {done.frame}", "bold"),
        ("arm", f"{arm.dataset.robot.name}, {model_label(arm.effects)}", ""),
    ]
    if good:
        error, u, most = (np.array([getattr(own, key) for own in good]) for key in ("error", "u", "expanded"))
        rows.append(
            ("nominal error", f"mean {MM * error.mean():.3f} mm, maximum {MM * error.max():.3f} mm", "")
        )
        middle, high, expanded = (um2(float(x)) for x in (np.median(u), u.max(), np.median(most)))
        text = f"u of a point {middle} µm (median), {high} µm (maximum); U {expanded} µm (median, 95 %)"
        rows.append(("uncertainty", text, ""))
        outside = sum(not own.inside for own in good)
        text = "all targets are inside" if not outside else f"{outside} of {len(good)} targets are outside"
        rows.append(("probed region", text, "yellow" if outside else ""))
    lacking = [
        f"{target.where}: {own.reason}"
        for target, own in zip(done.targets, done.found, strict=True)
        if own.reason
    ]
    rows += [("note", note, "yellow") for note in arm.use.notes if note not in arm.use.warnings]
    rows += [("no solution" if k == 0 else "", text, "red") for k, text in enumerate(_some(lacking))]
    rows += [("kept" if k == 0 else "", text, "yellow") for k, text in enumerate(_some(list(done.notes)))]
    return Group(facts(rows))


def _some(texts: list[str]) -> list[str]:
    more = len(texts) - SHOWN
    return texts if more <= 0 else [*texts[:SHOWN], f"and {more} more"]
