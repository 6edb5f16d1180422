"""Motions that are to be logged next: record, table, and the files of commands."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from bayescal.logs.commands import commands_text
from bayescal.preparing.next_motions import PAUSE, MotionPlan
from bayescal.reporting.motion.record import origin
from bayescal.reporting.shared.origin import plain
from bayescal.reporting.shared.sheet import Column, Sheet, terminal
from bayescal.reporting.shared.text import facts, listed, under
from bayescal.storage.files import json_text
from bayescal.storage.folders import whole
from bayescal.storage.reading import Json
from bayescal.storage.writing import Block, block_lines, flow, flow_list, number, scalar

SCHEMA = "bayescal-plan/1"
PLAN, COMMANDS, PURPOSES = "plan.json", "next-motions.csv", "next-motions.yaml"


def motions_of(plan: MotionPlan) -> list[dict[str, Any]]:
    """The motions as entries of a record."""
    return [
        {
            "id": m.name,
            "kind": m.kind,
            "role": m.role,
            "same_as": m.same_as or m.name,
            "loaded": m.loaded,
            "times": m.times,
            "from_s": float(time[0]),
            "to_s": float(time[-1]),
            "for": list(m.effects),
            "words": m.purpose,
        }
        for m, time in plan.timed
    ]


def plan_record(plan: MotionPlan) -> dict[str, Any]:
    """The contents of plan.json."""
    b = plan.bounds
    record = {
        **origin(SCHEMA, plan.log, 0),
        "rate_hz": 1.0 / plan.step,
        "pause_s": PAUSE,
        "first_pose_deg": np.degrees(b.home),
        "bounds": {
            "lowest_deg": np.degrees(b.low),
            "highest_deg": np.degrees(b.high),
            "speed_degps": np.degrees(b.speed),
            "acceleration_degps2": np.degrees(b.acceleration),
            "torque_Nm": b.torque,
            "clear_of_itself": b.clearance is not None,
        },
        "motions": motions_of(plan),
        "left_out": list(plan.left_out),
        "warnings": list(b.assumed),
    }
    return {key: plain(value) for key, value in record.items()}


def files_of(plan: MotionPlan) -> dict[str, str]:
    """The table of commands and what each motion is for, by the names of the files; none without motions."""
    if not plan.motions:
        return {}
    record = plan_record(plan)
    short = ("lowest_deg", "highest_deg", "speed_degps", "acceleration_degps2", "torque_Nm")
    rounded = {key: [round(x, 3) if x is not None else None for x in record["bounds"][key]] for key in short}
    head: Block = {
        "commands": COMMANDS,
        "of": scalar(plan.log.name),
        "rate_hz": number(record["rate_hz"], 6),
        "pause_s": number(PAUSE),
        "first_pose_deg": flow_list(number(x, 8) for x in record["first_pose_deg"]),
        "bounds": {key: flow_list("null" if x is None else number(x, 8) for x in row)
                   for key, row in rounded.items()},
        "assumed": [scalar(text) for text in record["warnings"]],
        "left_out": [scalar(text) for text in record["left_out"]],
        "motions": [flow(_entry(m)) for m in record["motions"]],
    }  # fmt: skip
    table = commands_text((m.name, time, m.position) for m, time in plan.timed)
    return {COMMANDS: table, PURPOSES: "\n".join([*block_lines(head), ""])}


def _entry(m: Json) -> Iterator[tuple[str, str]]:
    """An entry of `motions` of dataset.yaml, with further keys."""
    yield "id", scalar(m["id"])
    yield from ((key, scalar(m[key])) for key in ("role", "kind", "same_as"))
    yield "loaded", "true" if m["loaded"] else "false"
    yield "times", str(m["times"])
    yield "for", flow_list(map(scalar, m["for"]))
    yield "why", scalar(m["words"])


def motion_sheet(record: Json) -> Sheet:
    """The motions that are to be logged."""
    return Sheet(
        (
            Column("motion", "id"),
            Column("from (s)", "from_s", lambda x: f"{x:.0f}"),
            Column("to (s)", "to_s", lambda x: f"{x:.0f}"),
            Column("payload", "loaded", lambda x: "yes" if x else "no"),
            Column("times", "times"),
            Column("for", "words", words=True),
        ),
        record["motions"],
    )


def plan_summary(record: Json) -> RenderableType:
    """The motions, and what is left out."""
    title = Text.assemble((record["dataset"]["name"], "bold"), f"  {record['robot']}  motions to log next")
    if not record["motions"] and not record["left_out"]:
        return Group(title, "The log lacks no motion.")
    rows = [*under("left out", record["left_out"]), *under("assumed", record["warnings"], "yellow")]
    return Group(title, "", terminal(motion_sheet(record)), facts(rows))


def advice_of(plan: MotionPlan) -> list[str]:
    """The motions in a line, for the advice of a diagnosis."""
    if not plan.motions:
        return list(plan.left_out)
    names = dict.fromkeys(m.same_as or m.name for m in plan.motions)
    return [f"run the {len(plan.motions)} motions of {COMMANDS}: {listed(names)}", *plan.left_out]


def write_plan(plan: MotionPlan, folder: Path, record: Json) -> tuple[str, ...]:
    """Write plan.json and the files of commands atomically; return their names."""
    texts = {PLAN: json_text(record, rows=False), **files_of(plan)}
    with whole(folder, PLAN) as stage:
        for name, text in texts.items():
            (stage / name).write_text(text, encoding="utf-8")
    return tuple(texts)
