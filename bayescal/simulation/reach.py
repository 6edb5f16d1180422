"""Reachable poses: inverse kinematics by damped least squares, limits and obstacles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.arm.chain import Chain, chain_of, frames, link_angles
from bayescal.arm.robot import Robot
from bayescal.arm.transforms import cross

MARGIN = np.radians(4.0)
"""rad: margin to the joint limits, so that a contact can still be closed."""

BEHIND, FLOOR = -0.05, -0.1  # relative to the reach: limits of the arm behind and below the base
PASSES = 25
STEP = 0.4  # rad a pass
LEVER = 0.3  # m: lever arm that weights direction errors against position errors
PLACE, DIRECTION = 1e-8, 1e-6  # m, rad: tolerances of a solution


@dataclass(frozen=True)
class Arm:
    """The nominal arm with its tool, for planning. `tool` (3,) m, in the flange frame."""

    robot: Robot
    tool: np.ndarray

    @cached_property
    def chain(self) -> Chain:
        """The nominal chain."""
        return chain_of(self.robot)

    @cached_property
    def sign(self) -> np.ndarray:
        """Signs (n,) of the diagonal of `link_from_reading`; limits are stated without them."""
        return np.where(np.diag(self.robot.link_from_reading) < 0, -1.0, 1.0)

    @cached_property
    def range(self) -> np.ndarray:
        """Limits (2, n), rad, reduced by the margin; a range of at most one revolution."""
        limits = np.clip(self.robot.limits, -2 * np.pi, 2 * np.pi)
        middle, half = limits.mean(axis=1), np.diff(limits, axis=1)[:, 0] / 2
        half = np.minimum(half - np.minimum(MARGIN, 0.2 * half), np.pi)
        return np.stack([middle - half, middle + half])

    def readings_of(self, angles: np.ndarray) -> np.ndarray:
        """Readings (N, n), rad, of angles (N, n) to which the limits apply."""
        return np.linalg.solve(self.robot.link_from_reading, (angles * self.sign).T).T

    def angles_of(self, readings: np.ndarray) -> np.ndarray:
        """Angles (N, n), rad, to which the limits apply: by `link_from_reading` with a positive diagonal."""
        return readings @ self.robot.link_from_reading.T * self.sign

    def frames(self, readings: np.ndarray) -> np.ndarray:
        """Poses in F0 of all frames and the flange, (N, n + 2, 4, 4)."""
        return frames(self.chain, link_angles(self.robot, readings))

    def ball(self, pose: np.ndarray) -> np.ndarray:
        """Ball centres (N, 3), m, of the poses of `frames`."""
        return pose[:, -1, :3, :3] @ self.tool + pose[:, -1, :3, 3]

    @cached_property
    def reach(self) -> float:
        """Reach of the ball from the origin of the base, m: nearly the maximum over random poses."""
        ball = self.ball(self.frames(self.anywhere(4000, np.random.default_rng(0))))
        return float(np.percentile(np.linalg.norm(ball - self.chain.base[:3, 3], axis=1), 99))

    def beside(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Horizontal positions (..., 2) and heights (...) above the base, m, of points (..., 3) in F0."""
        local = (points - self.chain.base[:3, 3]) @ self.chain.base[:3, :3]
        return local[..., :2], local[..., 2]

    def upright(self, pose: np.ndarray) -> np.ndarray:
        """Which poses (M, n + 2, 4, 4) an operator could choose, (M,).

        No part of the arm is behind the base, seen from the ball, or too far below it.
        """
        flat, height = self.beside(pose[:, 2:, :3, 3])
        to, _ = self.beside(self.ball(pose))
        to = to / np.maximum(np.linalg.norm(to, axis=1), 1e-9)[:, None]
        ahead = np.einsum("mfi,mi->mf", flat, to).min(axis=1)
        return (ahead > BEHIND * self.reach) & (height.min(axis=1) > FLOOR * self.reach)

    def jacobian(self, pose: np.ndarray) -> np.ndarray:
        """Derivatives (N, 6, n) of position (m/rad) and rotation of the ball by the limited angles."""
        axis, origin = pose[:, 1:-1, :3, 2], pose[:, 1:-1, :3, 3]
        slide = cross(axis, self.ball(pose)[:, None] - origin)
        return np.swapaxes(np.concatenate([slide, axis], axis=2), 1, 2) * self.sign

    def anywhere(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Readings (count, n), rad, uniform within the limits."""
        low, high = self.range
        return self.readings_of(rng.uniform(low, high, (count, self.robot.n)))


def inverse(
    arm: Arm, starts: np.ndarray, centres: np.ndarray, axes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Readings for a position of the ball centre and a direction of the z axis of the flange.

    The roll about that direction is free. For an arm with fewer than five joints only the position is solved.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    starts : np.ndarray, shape (M, n)
        Initial readings, rad.
    centres, axes : np.ndarray, shape (M, 3)
        Requested ball centres, m, and directions, in F0.

    Returns
    -------
    readings : np.ndarray, shape (M, n)
        rad, within the limits.
    found : np.ndarray, shape (M,)
        Which of them are solutions.
    """
    n = arm.robot.n
    low, high = arm.range
    angles = np.clip(arm.angles_of(starts), low, high)
    found = np.zeros(len(starts), bool)
    live = np.arange(len(starts))
    rows = 6 if n >= 5 else 3
    for _ in range(PASSES):
        pose = arm.frames(arm.readings_of(angles[live]))
        away = centres[live] - arm.ball(pose)
        own, turn = _turn(pose[:, -1, :3, 2], axes[live])
        good = np.linalg.norm(away, axis=1) < PLACE
        good &= (np.linalg.norm(turn, axis=1) < DIRECTION) | (rows == 3)
        found[live[good]] = True
        keep = ~good
        live, away, turn, own, pose = live[keep], away[keep], turn[keep], own[keep], pose[keep]
        if not len(live):
            break
        j = arm.jacobian(pose)
        j[:, 3:] -= own[:, :, None] * np.einsum("mi,mij->mj", own, j[:, 3:])[:, None]  # the roll is free
        j[:, :3] /= LEVER
        error = np.concatenate([away / LEVER, turn], axis=1)[:, :rows]
        j = j[:, :rows]
        damping = 1e-3 * np.sum(error**2, axis=1) + 1e-10
        square = np.swapaxes(j, 1, 2) @ j + damping[:, None, None] * np.eye(n)
        step = np.linalg.solve(square, np.einsum("mij,mi->mj", j, error)[..., None])[..., 0]
        step *= np.minimum(1.0, STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
        angles[live] = np.clip(angles[live] + step, low, high)
    return arm.readings_of(angles), found


def _turn(own: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vectors (M, 3), rad, from unit vectors `own` to `wanted`."""
    across = cross(own, wanted)
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, np.sum(own * wanted, axis=1))
    return own, across * (angle / np.maximum(sine, 1e-12))[:, None]


def cone(axis: np.ndarray, half_angle: float, rng: np.random.Generator) -> np.ndarray:
    """Unit vectors (M, 3), uniform in the cone of `half_angle` (rad) about each of axis (M, 3)."""
    count = len(axis)
    cosine = rng.uniform(np.cos(half_angle), 1.0, count)
    across = cross(axis, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    return cosine[:, None] * axis + np.sqrt(1 - cosine**2)[:, None] * across
