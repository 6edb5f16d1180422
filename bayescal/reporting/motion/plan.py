"""Motions that are to be logged next: record, table, and the files of commands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import RenderableType

from bayescal.logs.write import commands_text
from bayescal.preparing.next_motions import PAUSE, MotionPlan
from bayescal.reporting.motion.record import origin
from bayescal.reporting.motion.sheets import headed
from bayescal.reporting.shared.origin import plain
from bayescal.reporting.shared.sheet import Column, Sheet, screen, terminal
from bayescal.reporting.shared.text import listed, under
from bayescal.storage.files import json_text
from bayescal.storage.folders import filled
from bayescal.storage.reading import Json

SCHEMA = "bayescal-plan/1"
STATED = ("rate_hz", "pause_s", "first_pose_deg", "bounds", "warnings", "left_out", "motions")
"""Keys of plan.json that are also beside the commands."""
PLAN, COMMANDS, PURPOSES = "plan.json", "next-motions.csv", "next-motions.yaml"


def motions_of(plan: MotionPlan) -> list[dict[str, Any]]:
    """The motions as entries of a record."""
    return [
        {"id": m.name, "kind": m.purpose.kind, "role": m.purpose.role, "same_as": m.same_as or m.name,
         "loaded": m.loaded, "times": m.purpose.times, "from_s": round(float(time[0]), 6),
         "to_s": round(float(time[-1]), 6), "for": list(m.purpose.effects), "words": m.purpose.words}
        for m, time in plan.timed
    ]  # fmt: skip


def plan_record(plan: MotionPlan) -> dict[str, Any]:
    """The contents of plan.json."""
    b = plan.bounds
    sizes = {
        "lowest_deg": np.degrees(b.low),
        "highest_deg": np.degrees(b.high),
        "speed_degps": np.degrees(b.speed),
        "acceleration_degps2": np.degrees(b.acceleration),
        "torque_Nm": b.torque,
    }
    bounds = {key: [round(x, 3) if np.isfinite(x) else None for x in v.tolist()] for key, v in sizes.items()}
    record = {
        **origin(SCHEMA, b.log, 0),
        "rate_hz": round(1.0 / b.step, 6),
        "pause_s": PAUSE,
        "first_pose_deg": np.degrees(b.home),
        "bounds": {**bounds, "clear_of_itself": b.clearance is not None},
        "motions": motions_of(plan),
        "left_out": list(plan.left_out),
        "warnings": list(b.assumed),
    }
    return {key: plain(value) for key, value in record.items()}


def files_of(plan: MotionPlan) -> dict[str, str]:
    """The table of commands and what each motion is for, by the names of the files; none without motions."""
    if not plan.motions:
        return {}
    record = {"commands": COMMANDS} | {key: plan_record(plan)[key] for key in STATED}
    table = commands_text((m.name, time, m.position) for m, time in plan.timed)
    text = yaml.safe_dump(record, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    return {COMMANDS: table, PURPOSES: text}


def motion_sheet(record: Json) -> Sheet:
    """The motions that are to be logged."""
    columns = (
        Column("motion", "id"),
        Column("from (s)", "from_s", lambda x: f"{x:.0f}"),
        Column("to (s)", "to_s", lambda x: f"{x:.0f}"),
        Column("payload", "loaded", lambda x: "yes" if x else "no"),
        Column("times", "times"),
        Column("for", "words", words=True),
    )
    return Sheet(columns, record["motions"])


def plan_summary(record: Json) -> RenderableType:
    """The motions, and what is left out."""
    title = headed(record["dataset"]["name"], record["robot"], "motions to log next")
    if not record["motions"] and not record["left_out"]:
        return screen(title, "The log lacks no motion.")
    rows = [*under("left out", record["left_out"]), *under("assumed", record["warnings"], "yellow")]
    return screen(title, "", terminal(motion_sheet(record)), rows)


def advice_of(plan: MotionPlan) -> list[str]:
    """The motions in a line, for the advice of a diagnosis."""
    if not plan.motions:
        return list(plan.left_out)
    names = dict.fromkeys(m.same_as or m.name for m in plan.motions)
    return [f"run the {len(plan.motions)} motions of {COMMANDS}: {listed(names)}", *plan.left_out]


def write_plan(plan: MotionPlan, folder: Path, record: Json) -> tuple[str, ...]:
    """Write plan.json and the files of commands atomically; return their names."""
    return filled(folder, {PLAN: json_text(record, rows=False), **files_of(plan)})
