"""The motions of a plan, whatever the controller: as steps of a probing program, and as tables.

Every contact is three motions: to its approach, along a line to the contact, and back. Where nothing is
touched (a tracker's point), it is one. The contacts are those of the nominal arm with the nominal targets.
Motions from one approach to the next are by joint angles, past further points where they would collide.

In a probing program a contact is a motion by joint angles to its approach, a line to the point where the
search begins, and a guarded motion along the same line until the probe triggers or its end is reached, beyond
the surface where the nominal arm expects it. The readings at the trigger are kept, and the tool retracts to
the approach. Nothing else than the guarded motion may touch: an earlier contact stops the program, and so
does none at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.inverse import descend, poses_apart, to_frames
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import length, rpy_of
from bayescal.dataset.table import RPY, XYZ, csv_text, joint_columns
from bayescal.planning.result import Plan
from bayescal.programs.text import ANGLE, Number, digits, lengths_of
from bayescal.programs.tools import nominal_arm

PASS, STOP, APPROACH, CONTACT, RETRACT, MEASURE = "pass", "stop", "approach", "contact", "retract", "measure"
"""Motions: past an obstacle; to a raised pose, where the arm waits until `Plan.changes` of the row is done;
three of a contact; the last where nothing is touched."""
AHEAD = 10e-3
"""m before the expected surface where the guarded motion begins, if the approach is not nearer (assumed: more
than the error of an arm and of a target that was placed by hand)."""
SHARES = (1.0, 0.5, 0.25, 0.0)
"""Of the way beyond the surface: the largest that the arm can reach is taken."""


@dataclass(frozen=True)
class Motion:
    """A motion of the arm for a row of the planned session: its kind, and readings (n,), rad, at its end."""

    row: int
    kind: str
    readings: np.ndarray


def motions(plan: Plan) -> Iterator[Motion]:
    """All motions of a plan, in the order of probing.

    Of each row: those of `Plan.leave` (the last is a `STOP`), those of `Plan.via`, and those of its contact.
    The first row begins with a `STOP` even if nothing is to be changed: the session begins there, and the arm
    is brought there by hand.
    """
    readings = plan.session.measurements.readings
    for row, (away, contact) in enumerate(zip(plan.approach, readings, strict=True)):
        leave = _points(plan.leave, row)
        for k, point in enumerate(leave, start=1):
            yield Motion(row, STOP if k == len(leave) else PASS, point)
        for point in _points(plan.via, row):
            yield Motion(row, PASS, point)
        if np.array_equal(away, contact):
            yield Motion(row, MEASURE, contact)
        else:
            yield Motion(row, APPROACH, away)
            yield Motion(row, CONTACT, contact)
            yield Motion(row, RETRACT, away)


def _points(ways: Sequence[np.ndarray | None], row: int) -> Sequence[np.ndarray]:
    """Readings that are passed on a way of a row; none where it is not known."""
    points = ways[row] if ways else None
    return () if points is None else tuple(points)


@dataclass(frozen=True)
class Guarded:
    """Guarded motions of N rows: readings (N, n), rad, where they begin and end; m (N,) past the surface."""

    begin: np.ndarray
    end: np.ndarray
    beyond: np.ndarray


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
        begin[rows], reached = line.at_share(np.maximum(1 - AHEAD / line.length, 0.0), np.arange(len(rows)))
        begin[rows[~reached]] = plan.approach[rows[~reached]]
        open_ = np.arange(len(rows))
        for share in SHARES:
            readings, reached = line.at_share(1 + share * beyond / line.length[open_], open_)
            good = rows[open_[reached]]
            end[good], far[good] = readings[reached], share * beyond
            open_ = open_[~reached]
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
        away, contact = (arm.tool_poses(arm.frames(q)) for q in (approach, readings))
        return cls(arm, away, *poses_apart(away, contact), readings)

    @property
    def length(self) -> np.ndarray:
        """m, (M,)."""
        return length(self.way)

    def at_share(self, share: np.ndarray, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Readings (K, n), rad, of motions `some` (K,) at shares (K,) of their ways, and which are found."""
        from scipy.spatial.transform import Rotation  # slow to import

        arm, goals = self.arm, self.away[some]
        goals[:, :3, 3] += share[:, None] * self.way[some]
        turn = Rotation.from_rotvec(share[:, None] * self.turn[some]).as_matrix()
        goals[:, :3, :3] = turn @ goals[:, :3, :3]
        near = arm.angles_of(self.near[some])
        angles, converged = descend(to_frames(arm, goals), near, *arm.robot.limits.T)
        return arm.readings_of(angles), converged


@dataclass(frozen=True)
class Step:
    """A step of a program: what it is, its texts, and readings (n,), rad, by name.

    `kind` is ``stop`` (text), ``pass`` (at), ``measure`` (at) or ``contact`` (approach, begin, end); all have
    the texts `id` and `target`; a contact has `short`, of its search. `number` is that of the row, from 1.
    """

    kind: str
    number: int
    texts: dict[str, str]
    readings: dict[str, np.ndarray] = field(default_factory=dict)


def steps(plan: Plan, guard: Guarded) -> Iterator[Step]:
    """All steps of a probing program, in order; the first motion begins where the person has put the arm."""
    session, m = plan.session, plan.session.measurements
    row = -1
    for motion in motions(plan):
        k, first = motion.row, motion.row != row
        texts = {"id": m.ids[k], "target": session.targets[m.target[k]].name}
        if row < 0:
            angles = ", ".join(f"{angle:.0f}" for angle in np.degrees(motion.readings))
            text = f"jog the arm manually near to J1 to J{len(m.readings[0])} = {angles} deg"
            yield Step(STOP, k + 1, texts | {"text": text})
        row = k
        change = plan.changes[k] if plan.changes else ""
        if first and change and not _points(plan.leave, k):
            yield Step(STOP, k + 1, texts | {"text": change})
        if first and plan.by_hand and plan.by_hand[k]:  # no collision-free path from the contact before
            yield Step(STOP, k + 1, texts | {"text": plan.by_hand[k]})
        if motion.kind in (PASS, STOP):
            yield Step(PASS, k + 1, texts, {"at": motion.readings})
            if motion.kind == STOP and change:
                yield Step(STOP, k + 1, texts | {"text": change})
        elif motion.kind == MEASURE:
            yield Step(MEASURE, k + 1, texts, {"at": motion.readings})
        elif motion.kind == APPROACH:
            readings = {"approach": motion.readings, "begin": guard.begin[k], "end": guard.end[k]}
            less = guard.beyond[k] < guard.beyond.max()
            short = f", search to {1e3 * guard.beyond[k]:g} mm beyond" if less else ""
            yield Step(CONTACT, k + 1, texts | {"short": short}, readings)


MOTION = ("id", "motion", "target", "tool")
"""First columns of a table of motions."""


def _motion_cells(plan: Plan, motion: Motion) -> list[str]:
    session, m, row = plan.session, plan.session.measurements, motion.row
    return [m.ids[row], motion.kind, session.targets[m.target[row]].name, session.tools[m.tool[row]].name]


def _joints(robot: Robot, readings: np.ndarray) -> list[str]:
    return [digits(Number(x, ANGLE)) for x in robot.shown(readings).tolist()]


def _reading_cells(plan: Plan, motion: Motion) -> list[str]:
    """Readings in deg or mm, as the controller shows them, and the payload beyond the tool, kg."""
    session, payload = plan.session, plan.session.measurements.payload
    mass = 0.0 if payload is None else float(payload[motion.row])
    return [*_joints(session.robot, motion.readings), f"{mass:g}"]


def readings_table(plan: Plan) -> str:
    """Readings as the controller shows them, deg."""
    columns = [*MOTION, *joint_columns("deg", plan.session.robot.units), "payload_kg"]
    return csv_text(columns, ([*_motion_cells(plan, m), *_reading_cells(plan, m)] for m in motions(plan)))


def robodk_table(plan: Plan) -> str:
    """Joints in the first columns, as RoboDK reads them (deg, mm), and the name of the motion."""
    columns = [*(f"J{k}" for k in range(1, plan.session.robot.n + 1)), "Name"]
    return csv_text(columns, (
        [*_joints(plan.session.robot, motion.readings), " ".join(_motion_cells(plan, motion)[:2])]
        for motion in motions(plan)
    ))  # fmt: skip


def poses_table(plan: Plan) -> str:
    """Nominal poses of the tool's frame in F0, and the readings that select the configuration of the arm."""
    arms = [nominal_arm(plan.session.robot, tool) for tool in plan.session.tools]

    def rows() -> Iterable[Sequence[str]]:
        for motion in motions(plan):
            arm = arms[plan.session.measurements.tool[motion.row]]
            pose = arm.tool_poses(arm.frames(motion.readings[None]))[0]
            turn = [f"{angle:.5f}" for angle in np.degrees(rpy_of(pose[:3, :3]))]
            lengths = map(digits, lengths_of(pose))
            yield [*_motion_cells(plan, motion), *lengths, *turn, *_reading_cells(plan, motion)]

    joints = joint_columns("deg", plan.session.robot.units)
    return csv_text([*MOTION, *XYZ, *RPY, *joints, "payload_kg"], rows())
