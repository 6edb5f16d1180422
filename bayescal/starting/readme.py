"""Text of the README.md beside a new dataset.yaml: what to measure, and how."""

from __future__ import annotations

from bayescal.dataset.table import COLUMNS, JOINT, PLAIN
from bayescal.files import FILL_IN
from bayescal.starting.artefacts import ARTEFACTS
from bayescal.starting.settings import Draft

WARM = 40
"""min of motion before the first contact (assumed: joint temperatures of an arm settle in half an hour)."""


def columns_of(draft: Draft) -> tuple[str, ...]:
    """Columns of measurements.csv: those needed, and those that make more effects assessable."""
    own = {c for name in draft.outlines for c in ARTEFACTS[name].columns}
    named = {"id", "role", "target", "stop", "time_s", "payload_kg", "repeat", *own}
    named |= {"tool"} if len(draft.tools) > 1 else set()
    joints = [f"j{k + 1}_{kind}" for kind in JOINT[:2] for k in range(draft.joints)]
    plain = [c for c in PLAIN if c in named]
    at = next(i for i, c in enumerate(plain) if c not in ("id", "role", "target", "tool"))
    return (*plain[:at], *joints, *plain[at:])


def readme_text(draft: Draft, folder: str) -> str:
    """The content of README.md."""
    lines = [f"# {draft.name}: what to measure", ""]
    lines += [
        f"Robot: {draft.robot}. Artefact: {', '.join(draft.outlines)}.",
        "",
        f"1. Fill in `dataset.yaml`: every value marked `{FILL_IN}`, from certificates and measurements.",
        f"2. `bayescal plan {folder}` proposes the contacts and states the uncertainty to expect of them.",
        "3. Measure, and write one row per contact into `measurements.csv` (or `bayescal import` a log).",
        f"4. `bayescal check {folder}`: what is understood, what is missing, what looks wrong.",
        f"5. `bayescal fit {folder}` and `bayescal gap {folder}`.",
        "",
        *_practice(draft, folder),
        "## Before the first contact",
        "",
        f"- Fasten robot, artefact and tool. Move all joints for {WARM} minutes: a cold arm drifts.",
        "- Calibrate the probe: effective ball radius, repeatability.",
        "- Weigh everything attached to the flange, and find its centre of mass.",
        "",
        "## What to measure",
        "",
    ]
    for name in draft.outlines:
        artefact = ARTEFACTS[name]
        lines += [f"{name}: {artefact.summary}.", "", *(f"- {each}" for each in artefact.measure), ""]
    lines += [
        "In addition:",
        "",
        "- Approach from both directions of every joint, and write the joint velocities: without them",
        "  backlash and latency cannot be assessed.",
        "- Measure in random order, not target after target: a drift is then not mistaken for a place.",
        "- Where the robot is allowed to carry it, measure half of the contacts with an additional mass",
        "  (`payload_kg`): it separates compliance from geometry.",
        "- Vary the wrist: every joint over most of its range.",
        "- Rows with the role `validate` are never fitted. They show the error to expect.",
        "",
        "## Columns of measurements.csv",
        "",
        "| column | meaning |",
        "| --- | --- |",
    ]
    seen = dict.fromkeys(_shown(column, draft.joints) for column in columns_of(draft))
    lines += [f"| {shown} | {COLUMNS[key]} |" for shown, key in seen]
    lines += [
        "",
        "`id`, `target` and the joint readings are needed. Remove an optional column that you cannot fill;",
        "`time_s` has to be filled in every row where it is kept.",
    ]
    return "\n".join(lines) + "\n"


def _practice(draft: Draft, folder: str) -> list[str]:
    """How to practise on a simulated session of the set-up."""
    if not draft.placed:
        return []
    return [
        f"To practise first: `bayescal simulate --setup {folder} --out practice` simulates a session of this",
        "set-up, also before all values are filled in. `check`, `fit` and `gap` read its folder as yours.",
        "",
    ]


def _shown(column: str, n: int) -> tuple[str, str]:
    """How a column is shown, and its key in `COLUMNS`: the columns of all joints are one."""
    if column in COLUMNS:
        return f"`{column}`", column
    kind = column.partition("_")[2]
    return f"`j1_{kind}` ... `j{n}_{kind}`", f"jN_{kind}"
