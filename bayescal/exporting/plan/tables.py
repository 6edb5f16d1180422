"""Motions as tables: readings for the controller, joints for RoboDK, nominal poses for any other program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from bayescal.arm.nominal import NominalArm
from bayescal.arm.transforms import rpy_of
from bayescal.dataset.table import RPY, XYZ, joint_columns
from bayescal.exporting.compensate.formats.program import degrees_of, digits, lengths_of
from bayescal.exporting.compensate.formats.robodk import ROBODK as TABLE_OF_JOINTS
from bayescal.exporting.compensate.solve import nominal_arm
from bayescal.exporting.compensate.table import csv_text
from bayescal.exporting.plan.format import Format, Motion, motions, payload_of
from bayescal.planning.result import Plan

OF = ("id", "motion", "target", "tool")
"""First columns of a table: the contact and its motion."""


def _of(plan: Plan, motion: Motion) -> list[str]:
    session, m = plan.session, plan.session.measurements
    row = motion.row
    return [m.ids[row], motion.kind, session.targets[m.target[row]].name, session.tools[m.tool[row]].name]


def _readings(plan: Plan) -> str:
    """Readings as the controller shows them, deg."""
    return csv_text(
        [*OF, *joint_columns("deg", plan.session.robot.n), "payload_kg"],
        [
            [
                *_of(plan, motion),
                *map(digits, degrees_of(motion.readings)),
                f"{payload_of(plan, motion.row):g}",
            ]
            for motion in motions(plan)
        ],
    )


def _robodk(plan: Plan) -> str:
    """Joints in the first columns, as RoboDK reads them, and the name of the motion."""
    return csv_text(
        [*(f"J{k}" for k in range(1, plan.session.robot.n + 1)), "Name"],
        [
            [*map(digits, TABLE_OF_JOINTS.joints(motion.readings)), " ".join(_of(plan, motion)[:2])]
            for motion in motions(plan)
        ],
    )


def _poses(plan: Plan) -> str:
    """Nominal poses of the tool's frame in F0, and the readings that select the configuration of the arm."""
    n = plan.session.robot.n
    arms = [nominal_arm(plan.session.robot, tool) for tool in plan.session.tools]

    def rows() -> Iterable[Sequence[str]]:
        for motion in motions(plan):
            pose = _pose(arms[plan.session.measurements.tool[motion.row]], motion.readings)
            turn = [f"{angle:.5f}" for angle in np.degrees(rpy_of(pose[:3, :3]))]
            yield [
                *_of(plan, motion), *map(digits, lengths_of(pose)), *turn,
                *map(digits, degrees_of(motion.readings)), f"{payload_of(plan, motion.row):g}",
            ]  # fmt: skip

    return csv_text([*OF, *XYZ, *RPY, *joint_columns("deg", n), "payload_kg"], rows())


def _pose(arm: NominalArm, readings: np.ndarray) -> np.ndarray:
    return arm.tool_poses(arm.frames(readings[None]))[0]


def _table(name: str, file: str, text: Callable[[Plan], str], summary: str) -> Format:
    return Format(name, lambda plan, probe: {file: text(plan)}, summary)


CSV = _table("csv", "plan-joints.csv", _readings, "CSV of readings in deg, as the controller shows them")
ROBODK = _table("robodk", "plan-robodk.csv", _robodk, "RoboDK CSV: joints in deg in the first columns")
POSES = _table(
    "poses", "plan-poses.csv", _poses, "CSV of nominal poses of the tool's frame in F0, with the readings"
)
