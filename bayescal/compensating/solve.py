"""Readings that put the tool of a fitted arm on its targets.

First the nominal model: all solutions of its inverse kinematics, and the nearest of them to the readings that
a target states, to the target before in a program, or to the poses of the session. From there the fitted arm
is brought to the target by the same search, with all fitted effects acting at the readings of each step.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.arm import inverse
from bayescal.arm.motion import NominalArm
from bayescal.compensating.position import BASE, Frame, Region, frame_of, uncertainty
from bayescal.fitted.arm import FittedArm, Poses
from bayescal.programs.text import Corrected, Target
from bayescal.programs.tools import Working, tool_of

MOVED = np.radians(0.01)
"""rad: a joint that moves less keeps its direction, as its lost motion is not crossed (assumed)."""
SECOND = 1e-3
"""s: time of a motion for its velocity; every motion that counts is far above a standstill."""


def compensated(
    arm: FittedArm,
    targets: Sequence[Target],
    *,
    frame: str = BASE,
    tool: str | None = None,
    tcp: np.ndarray | None = None,
    time: float | None = None,
    row: str | None = None,
    in_sequence: bool = False,
) -> list[Corrected]:
    """Correct targets for all fitted effects of an arm.

    Parameters
    ----------
    arm : FittedArm
    targets : sequence of Target
        In the order in which they are visited: the direction of motion follows from the one before.
    frame : str
        Of the poses: `base` (F0), or a target that was fitted.
    tool : str, optional
        Name of the tool where a target states none; needed if the session has several.
    tcp : np.ndarray, shape (6,), optional
        Pose of a working tool that the session does not have; see `tools.tool_of`.
    time, row : optional
        State of the arm; see `FittedArm.at`.
    in_sequence : bool
        A target that states no readings takes the solution nearest to the target before.

    Raises
    ------
    BayescalError
        For a frame or tool that does not exist.
    """
    each = {name: tool_of(arm, name, tcp) for name in dict.fromkeys(t.tool or tool for t in targets)}
    workings = {w.tool.name: w for w in each.values()}
    tools = [workings[each[t.tool or tool].tool.name] for t in targets]
    arm = tools[0].arm if tools else arm
    stand = frame_of(arm, frame)
    goals = np.array([_goal(t, w.nominal, stand) for t, w in zip(targets, tools, strict=True)])
    start = _nominal(arm, targets, tools, goals, in_sequence)
    velocity = _velocities(targets, tools, goals, [s.nominal for s in start])
    out = list(start)
    region = Region.of(arm)
    for name, working in workings.items():
        mine = [k for k, s in enumerate(start) if not s.reason and tools[k] is working]
        if mine:
            before = arm.at(
                np.array([start[k].nominal for k in mine]), tool=name, direction=velocity[mine],
                payload_kg=np.array([targets[k].payload for k in mine]), time=time, row=row,
            )  # fmt: skip
            done = _fitted(working, stand, region, before, velocity[mine], goals[mine])
            for k, one in zip(mine, done, strict=True):
                out[k] = one if one.reason else replace(one, solutions=start[k].solutions)
    return out


def _goal(target: Target, nominal: NominalArm, frame: Frame) -> np.ndarray:
    """The pose (4, 4) of the tool's frame in F0 that a target asks for."""
    if target.pose is not None:
        return frame.fitted @ target.pose
    assert target.readings is not None, "a target has a pose or readings"
    return nominal.tool_poses(nominal.frames(target.readings[None]))[0]


def _nominal(
    arm: FittedArm, targets: Sequence[Target], tools: Sequence[Working], goals: np.ndarray, in_sequence: bool
) -> list[Corrected]:
    """The nominal solution of every target, or the reason why it has none."""
    session = np.unique(arm.dataset.measurements.readings, axis=0)
    by_pose: dict[int, np.ndarray] = {}
    for name in dict.fromkeys(w.tool.name for w in tools):
        mine = [k for k, t in enumerate(targets) if t.pose is not None and tools[k].tool.name == name]
        starts = [targets[k].readings if targets[k].readings is not None else session[0] for k in mine]
        if mine:
            every = inverse.solutions(tools[mine[0]].nominal, goals[mine], np.array(starts)[:, None])
            by_pose |= dict(zip(mine, every, strict=True))
    out: list[Corrected] = []
    readings: np.ndarray | None
    before: np.ndarray | None = None
    for k, (target, working, goal) in enumerate(zip(targets, tools, goals, strict=True)):
        nominal = working.nominal
        if target.pose is None:
            assert target.readings is not None
            if reason := inverse.beyond_limits(nominal, nominal.angles_of(target.readings[None])[0]):
                out.append(Corrected(reason))
                continue
            candidates, readings = np.empty((0, nominal.robot.n)), target.readings
        else:
            candidates, last = by_pose[k], before[None] if in_sequence and before is not None else session
            references = last if target.readings is None else target.readings[None]
            readings = inverse.nearest(nominal, candidates, references, target.admits)
            if readings is None and not target.strict:
                readings = inverse.nearest(nominal, candidates, references)
        if readings is not None:
            count = None if target.pose is None else len(candidates)
            out.append(Corrected(nominal=readings, solutions=count))
            before = readings
        elif target.admits is not None and inverse.nearest(nominal, candidates, session) is not None:
            out.append(Corrected("no solution has the configuration that is stated there"))
        else:
            out.append(Corrected(inverse.without_solution(nominal, goal, candidates)))
    return out


def _velocities(
    targets: Sequence[Target],
    tools: Sequence[Working],
    goals: np.ndarray,
    nominal: Sequence[np.ndarray | None],
) -> np.ndarray:
    """Velocities of the readings on arrival (M, n), rad/s; 0 where the direction is not known.

    Of a motion by joint angles it is the difference from the target before; along a straight line, that of
    its end. A joint that does not move keeps its direction, as the lost motion in its gear stays where it is.
    """
    out = np.zeros((len(targets), tools[0].nominal.robot.n if tools else 0))
    last: int | None = None
    for k, (target, readings) in enumerate(zip(targets, nominal, strict=True)):
        if readings is None:
            continue
        way = np.zeros(len(readings))
        if last is not None:
            before = nominal[last]
            assert before is not None
            way = readings - before
            if target.straight:
                way = _end_of_line(tools[k].nominal, goals[last], goals[k], readings)
            way = np.where(np.abs(way) > MOVED, way, MOVED * np.sign(out[last]))
        out[k] = way / SECOND if target.velocity is None else target.velocity
        last = k
    return out


def _end_of_line(arm: NominalArm, start: np.ndarray, goal: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """Motion of the readings (n,), rad, at the end of a straight line between two poses (4, 4).

    Its size is that of the whole line at this rate.
    """
    away, turn = inverse.poses_apart(start[None], goal[None])
    jacobian = arm.jacobian(arm.frames(readings[None]))[0]
    angles = np.linalg.pinv(jacobian, rcond=1e-6) @ np.concatenate([away[0], turn[0]])
    return arm.readings_of(angles[None])[0]


def _fitted(
    working: Working, frame: Frame, region: Region, before: Poses, velocity: np.ndarray, goals: np.ndarray
) -> list[Corrected]:
    """Corrected targets of one tool, from the poses `before` at their nominal solutions."""
    nominal = working.nominal

    def reached(readings: np.ndarray, which: np.ndarray) -> np.ndarray:
        return before.again(which, readings=readings, command=readings).tool_frames(nominal.tool_axes)

    low, high = nominal.robot.limits.T
    begin = nominal.angles_of(before.readings)
    low, high = np.minimum(low, begin.min(axis=0)), np.maximum(high, begin.max(axis=0))
    angles, converged = inverse.descend(inverse.to_poses(nominal, goals, reached), begin, low, high)
    readings = nominal.readings_of(angles)
    poses = before.again(readings=readings, command=readings)
    spread = uncertainty(working, frame, poses, velocity)
    inside = region.contains(working.probed(poses), readings)
    error = np.linalg.norm(before.points - goals[:, :3, 3], axis=1)
    stated = np.linalg.inv(frame.nominal) @ nominal.tool_poses(nominal.frames(readings))
    return [
        Corrected(
            readings=readings[k], pose=stated[k], nominal=before.readings[k], u=float(spread.u[k]),
            error=float(error[k]), inside=bool(inside[k]), expanded=float(spread.expanded[k]),
        )
        if converged[k]
        else Corrected(_stuck(nominal, angles[k]))
        for k in range(len(goals))
    ]  # fmt: skip


def _stuck(arm: NominalArm, angles: np.ndarray) -> str:
    """Why the fitted arm does not come from the nominal solution to the target."""
    low, high = arm.robot.limits.T
    names = [arm.robot.joint_names[k] for k in np.flatnonzero((angles <= low) | (angles >= high))]
    if names:
        return f"the correction takes {', '.join(names)} beyond its limit"
    return "the correction does not converge: the pose is near a singularity"
