"""The probing sequence of a plan, whatever the controller: steps with their readings, in order.

A contact is a motion by joint angles to its approach, a line to the point where the search begins, and a
guarded motion along the same line until the probe triggers or its end is reached, beyond the surface where
the nominal arm expects it. The readings at the trigger are kept, and the tool retracts to the approach.
Nothing else than the guarded motion may touch: an earlier contact stops the program, and so does none at all.

Motions as tables: readings for the controller, joints for RoboDK, nominal poses for any other program.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayescal.arm.inverse import descend, poses_apart, to_frames
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import length, rpy_of
from bayescal.compensating.compensation import csv_text
from bayescal.compensating.solve import nominal_arm
from bayescal.dataset.table import RPY, XYZ, joint_columns
from bayescal.exporting.plan.format import (
    APPROACH,
    MEASURE,
    PASS,
    STOP,
    Format,
    Motion,
    closed,
    motions,
    payload_of,
)
from bayescal.planning.result import Plan
from bayescal.programs.text import ROBODK as TABLE_OF_JOINTS
from bayescal.programs.text import degrees_of, digits, lengths_of

AHEAD = 10e-3
"""m before the expected surface where the guarded motion begins, if the approach is not nearer (assumed: more
than the error of an arm and of a target that was placed by hand)."""
SHARES = (1.0, 0.5, 0.25, 0.0)
"""Of the way beyond the surface: the largest that the arm can reach is taken."""


@dataclass(frozen=True)
class Guarded:
    """Guarded motions of N rows: readings (N, n), rad, where they begin and end; m (N,) past the surface."""

    begin: np.ndarray
    end: np.ndarray
    beyond: np.ndarray


@dataclass(frozen=True)
class Step:
    """A step of a program: what it is, its texts, and readings (n,), rad, by name.

    `kind` is ``stop`` (text), ``pass`` (at), ``measure`` (at) or ``contact`` (approach, begin, end); all have
    the texts `id`, `target`, and `number`, that of the row from 1; a contact has `short`, of its search.
    """

    kind: str
    texts: dict[str, str]
    readings: dict[str, np.ndarray] = field(default_factory=dict)


def guarded(plan: Plan, beyond: float) -> Guarded:
    """Where guarded motions begin and end, on the line from each approach through its contact.

    The rotation of the tool continues as before, so that the contact itself is at the planned readings.

    Parameters
    ----------
    plan : Plan
    beyond : float
        m beyond the contact, or less where the arm cannot reach that.
    """
    m = plan.session.measurements
    begin, end, far = m.readings.copy(), m.readings.copy(), np.zeros(len(m.ids))
    touching = np.any(plan.approach != m.readings, axis=1)
    for k, tool in enumerate(plan.session.tools):
        rows = np.flatnonzero(touching & (m.tool == k))
        if not len(rows):
            continue
        line = _Line.of(nominal_arm(plan.session.robot, tool), plan.approach[rows], m.readings[rows])
        begin[rows], there = line.at(np.maximum(1 - AHEAD / line.length, 0.0), np.arange(len(rows)))
        begin[rows[~there]] = plan.approach[rows[~there]]
        left = np.arange(len(rows))
        for share in SHARES:
            found, there = line.at(1 + share * beyond / line.length[left], left)
            good = rows[left[there]]
            end[good], far[good] = found[there], share * beyond
            left = left[~there]
    return Guarded(begin, end, far)


@dataclass(frozen=True)
class _Line:
    """Straight motions of M tools to their contacts.

    Poses at the approach, (M, 4, 4); the way (M, 3), m, and the rotation (M, 3), rad, from there; readings
    (M, n), rad, of the contact.
    """

    arm: NominalArm
    away: np.ndarray
    way: np.ndarray
    turn: np.ndarray
    near: np.ndarray

    @classmethod
    def of(cls, arm: NominalArm, approach: np.ndarray, readings: np.ndarray) -> _Line:
        """Of readings (M, n), rad, at the approach and at the contact."""
        away, at = (arm.tool_poses(arm.frames(q)) for q in (approach, readings))
        way, turn = poses_apart(away, at)
        return cls(arm, away, way, turn, readings)

    @property
    def length(self) -> np.ndarray:
        """m, (M,)."""
        return length(self.way)

    def at(self, share: np.ndarray, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Readings (K, n), rad, of motions `some` (K,) at shares (K,) of their ways, and which are found."""
        from scipy.spatial.transform import Rotation  # slow to import

        arm, goals = self.arm, self.away[some]
        goals[:, :3, 3] += share[:, None] * self.way[some]
        goals[:, :3, :3] = (
            Rotation.from_rotvec(share[:, None] * self.turn[some]).as_matrix() @ goals[:, :3, :3]
        )
        angles, found = descend(to_frames(arm, goals), arm.angles_of(self.near[some]), *arm.robot.limits.T)
        return arm.readings_of(angles), found


def steps(plan: Plan, guard: Guarded) -> Iterator[Step]:
    """All steps of a probing program, in order; the first motion begins where the person has put the arm."""
    session, m = plan.session, plan.session.measurements
    row = -1
    for motion in motions(plan):
        k, first = motion.row, motion.row != row
        texts = {"id": m.ids[k], "target": session.targets[m.target[k]].name, "number": str(k + 1)}
        if row < 0:
            at = ", ".join(f"{angle:.0f}" for angle in np.degrees(motion.readings))
            yield Step(
                "stop",
                texts | {"text": f"jog the arm manually near to J1 to J{len(m.readings[0])} = {at} deg"},
            )
        row = k
        change = plan.changes[k] if plan.changes else ""
        leave = plan.leave[k] if plan.leave else None
        if first and change and (leave is None or not len(leave)):
            yield Step("stop", texts | {"text": change})
        if first and closed(plan, k):
            yield Step("stop", texts | {"text": plan.by_hand[k]})
        if motion.kind in (PASS, STOP):
            yield Step("pass", texts, {"at": motion.readings})
            if motion.kind == STOP and change:
                yield Step("stop", texts | {"text": change})
        elif motion.kind == MEASURE:
            yield Step("measure", texts, {"at": motion.readings})
        elif motion.kind == APPROACH:
            readings = {"approach": motion.readings, "begin": guard.begin[k], "end": guard.end[k]}
            less = guard.beyond[k] < guard.beyond.max()
            short = f", search to {1e3 * guard.beyond[k]:g} mm beyond" if less else ""
            yield Step("contact", texts | {"short": short}, readings)


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
