"""The nominal arm of a search: within the joint limits by a margin, and where an operator would put it."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from bayescal.arm.inverse import PASSES, descend, to_axes, to_frames, to_points
from bayescal.arm.motion import NominalArm

MARGIN = np.radians(4.0)
"""rad, m: margin to the joint limits, so that a contact can still be closed."""

DIRECTED = 6
"""Joints from which on a tool can have any direction at a place: the last of five turns it about itself."""

BEHIND, FLOOR = -0.05, -0.1  # relative to the reach: limits of the arm behind and below the base


@dataclass(frozen=True, eq=False)
class Arm(NominalArm):
    """The nominal arm with its tool, for planning: where it can be, and where an operator would put it.

    Arms of equal content are equal, so that positions that depend on the arm alone are searched once.
    """

    @cached_property
    def content(self) -> bytes:
        """All numbers of the robot and the tool."""
        robot = [getattr(self.robot, field.name) for field in fields(self.robot)]
        return pickle.dumps([*robot, self.tool, self.tool_axes])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Arm) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)

    @cached_property
    def range(self) -> np.ndarray:
        """Limits (2, n), rad or m, reduced by the margin; a range of at most one revolution."""
        most, limits = np.where(self.robot.slides, np.inf, np.pi), self.robot.limits_within(2 * np.pi)
        middle, half = limits.mean(axis=1), np.diff(limits, axis=1)[:, 0] / 2
        half = np.minimum(half - np.minimum(MARGIN, 0.2 * half), most)
        return np.stack([middle - half, middle + half])

    @cached_property
    def _lead(self) -> tuple[int, np.ndarray]:
        """Number of prismatic joints that carry all others, and frame (4, 4) of the last, at mid-range."""
        lead = int(np.argmin(self.robot.slides))  # 0 too if all joints slide
        return lead, self.frames(self.readings_of(self.range.mean(axis=0)[None]))[0, lead]

    @cached_property
    def mount(self) -> np.ndarray:
        """Pose (4, 4) in F0 of what carries the first revolute joint: base, or carriage at mid-range."""
        lead, carriage = self._lead
        return carriage @ self.chain.link[lead] if lead else self.chain.base

    def travel(self, pose: np.ndarray) -> np.ndarray:
        """Shifts (M, 3), m, of the carriage from mid-range at poses (M, n + 2, 4, 4); zeros without one."""
        lead, carriage = self._lead
        return pose[:, lead, :3, 3] - carriage[:3, 3] if lead else np.zeros((len(pose), 3))

    @cached_property
    def reach(self) -> float:
        """Reach of the ball from the origin of the mount, m: nearly the maximum over random poses."""
        pose = self.frames(self.anywhere(4000, np.random.default_rng(0)))
        ball = self.ball(pose) - self.travel(pose)
        return float(np.percentile(np.linalg.norm(ball - self.mount[:3, 3], axis=1), 99))

    def beside(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Horizontal positions (..., 2) and heights (...) above the mount, m, of points (..., 3) in F0."""
        local = (points - self.mount[:3, 3]) @ self.mount[:3, :3]
        return local[..., :2], local[..., 2]

    def upright(self, pose: np.ndarray) -> np.ndarray:
        """Which poses (M, n + 2, 4, 4) an operator could choose, (M,).

        No part of the arm is behind the base, seen from the ball, or too far below it.
        """
        travel = self.travel(pose)
        flat, height = self.beside(pose[:, self._lead[0] + 2 :, :3, 3] - travel[:, None])
        to, _ = self.beside(self.ball(pose) - travel)
        to = to / np.maximum(np.linalg.norm(to, axis=1), 1e-9)[:, None]
        ahead = np.einsum("mfi,mi->mf", flat, to).min(axis=1)
        return (ahead > BEHIND * self.reach) & (height.min(axis=1) > FLOOR * self.reach)

    def anywhere(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Readings (count, n), rad, uniform within the limits."""
        low, high = self.range
        return self.readings_of(rng.uniform(low, high, (count, self.robot.n)))


def inverse(
    arm: Arm,
    starts: np.ndarray,
    points: np.ndarray,
    axes: np.ndarray,
    passes: int = PASSES,
    free: np.ndarray | bool = False,
    turns: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Readings for a position of the TCP and a direction of the z axis of the tool, or for its orientation.

    Parameters
    ----------
    arm : Arm
        The nominal arm. With fewer than `DIRECTED` joints only the position is solved.
    starts : np.ndarray, shape (M, n)
        Initial readings, rad.
    points, axes : np.ndarray, shape (M, 3)
        Requested positions, m, and directions, in F0.
    passes : int
        Maximum number of steps.
    free : np.ndarray of bool, shape (M,)
        Rows of which only the position is solved.
    turns : np.ndarray, shape (M, 3, 3), optional
        Orientations of the tool in F0, as far as the arm has joints; where nan, the roll is free.

    Returns
    -------
    readings : np.ndarray, shape (M, n)
        rad, within the limits.
    solved : np.ndarray, shape (M,)
        Which of them are solutions.
    """
    angles, solved = arm.angles_of(starts), np.zeros(len(starts), bool)
    free, (low, high) = np.broadcast_to(free, len(starts)) | (arm.robot.n < DIRECTED), arm.range
    turned = np.zeros(len(starts), bool) if turns is None else np.isfinite(turns).all(axis=(1, 2))
    goals = np.tile(np.eye(4), (len(starts), 1, 1))
    goals[:, :3, 3] = points
    goals[turned, :3, :3] = np.eye(3) if turns is None else turns[turned]
    for rows, task in (
        (r := np.flatnonzero(free & ~turned), to_points(arm, points[r])),
        (r := np.flatnonzero(~free & ~turned), to_axes(arm, points[r], axes[r])),
        (r := np.flatnonzero(turned), to_frames(arm, goals[r])),
    ):
        angles[rows], solved[rows] = descend(task, angles[rows], low, high, passes)
    return arm.readings_of(angles), solved
