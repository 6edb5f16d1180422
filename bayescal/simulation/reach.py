"""Where the arm can go: inverse kinematics by damped least squares, and what stands in its way."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.arm.chain import Chain, chain_of, frames, link_angles
from bayescal.arm.robot import Robot

MARGIN = np.radians(4.0)
"""rad: how far from its limits a joint stays, so that a contact can still be closed."""

BEHIND, FLOOR = -0.05, -0.1  # of the reach: how far behind and below the base the arm may be
PASSES = 25
STEP = 0.4  # rad a pass
LEVER = 0.3  # m: arm at which a wrong direction weighs as much as a wrong place
PLACE, DIRECTION = 1e-8, 1e-6  # m, rad: good enough to start a contact from


@dataclass(frozen=True)
class Arm:
    """The nominal arm with its tool, as far as a planner needs it. `tool` (3,) m, in the flange frame."""

    robot: Robot
    tool: np.ndarray

    @cached_property
    def chain(self) -> Chain:
        """The nominal chain."""
        return chain_of(self.robot)

    @cached_property
    def sign(self) -> np.ndarray:
        """Signs (n,) of the diagonal of `link_from_reading`: limits are told without them."""
        return np.where(np.diag(self.robot.link_from_reading) < 0, -1.0, 1.0)

    @cached_property
    def range(self) -> np.ndarray:
        """Limits (2, n), rad, less the margin, and no more than one turn in all."""
        limits = np.clip(self.robot.limits, -2 * np.pi, 2 * np.pi)
        middle, half = limits.mean(axis=1), np.diff(limits, axis=1)[:, 0] / 2
        half = np.minimum(half - np.minimum(MARGIN, 0.2 * half), np.pi)
        return np.stack([middle - half, middle + half])

    def readings_of(self, angles: np.ndarray) -> np.ndarray:
        """Readings (N, n), rad, of angles (N, n) in the terms of the limits."""
        return np.linalg.solve(self.robot.link_from_reading, (angles * self.sign).T).T

    def angles_of(self, readings: np.ndarray) -> np.ndarray:
        """What the limits limit, (N, n), rad: rows of `link_from_reading`, the diagonal's sign taken out."""
        return readings @ self.robot.link_from_reading.T * self.sign

    def frames(self, readings: np.ndarray) -> np.ndarray:
        """Poses in F0 of all frames and the flange, (N, n + 2, 4, 4)."""
        return frames(self.chain, link_angles(self.robot, readings))

    def ball(self, pose: np.ndarray) -> np.ndarray:
        """Ball centres (N, 3), m, of the poses of `frames`."""
        return pose[:, -1, :3, :3] @ self.tool + pose[:, -1, :3, 3]

    @cached_property
    def reach(self) -> float:
        """How far from the base's origin the ball comes, m: nearly the farthest of many places."""
        ball = self.ball(self.frames(self.anywhere(4000, np.random.default_rng(0))))
        return float(np.percentile(np.linalg.norm(ball - self.chain.base[:3, 3], axis=1), 99))

    def beside(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (..., 2) on the base's floor and heights (...) above it, m, of points (..., 3) in F0."""
        local = (points - self.chain.base[:3, 3]) @ self.chain.base[:3, :3]
        return local[..., :2], local[..., 2]

    def upright(self, pose: np.ndarray) -> np.ndarray:
        """Which poses (M, n + 2, 4, 4) are such as an operator would choose, (M,).

        The arm faces what it touches (nothing of it is behind the base, as the ball sees it) and
        keeps off the floor.
        """
        flat, height = self.beside(pose[:, 2:, :3, 3])
        to, _ = self.beside(self.ball(pose))
        to = to / np.maximum(np.linalg.norm(to, axis=1), 1e-9)[:, None]
        ahead = np.einsum("mfi,mi->mf", flat, to).min(axis=1)
        return (ahead > BEHIND * self.reach) & (height.min(axis=1) > FLOOR * self.reach)

    def jacobian(self, pose: np.ndarray) -> np.ndarray:
        """Derivatives (N, 6, n) of the ball's place (m/rad) and turn by the angles of the limits."""
        axis, origin = pose[:, 1:-1, :3, 2], pose[:, 1:-1, :3, 3]
        slide = np.cross(axis, self.ball(pose)[:, None] - origin)
        return np.swapaxes(np.concatenate([slide, axis], axis=2), 1, 2) * self.sign

    def anywhere(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Readings (count, n), rad, uniform within the limits."""
        low, high = self.range
        return self.readings_of(rng.uniform(low, high, (count, self.robot.n)))


def inverse(
    arm: Arm, starts: np.ndarray, centres: np.ndarray, axes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Readings that bring the ball's centre to a place and the flange's z to a direction.

    The roll about that direction is left to the start. An arm of fewer than five joints is brought
    to the place only.

    Parameters
    ----------
    arm : Arm
        The nominal one.
    starts : np.ndarray, shape (M, n)
        Readings to begin from, rad.
    centres, axes : np.ndarray, shape (M, 3)
        Wanted ball centres, m, and directions, in F0.

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
    across = np.cross(own, wanted)
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, np.sum(own * wanted, axis=1))
    return own, across * (angle / np.maximum(sine, 1e-12))[:, None]


def cone(axis: np.ndarray, half_angle: float, rng: np.random.Generator) -> np.ndarray:
    """Unit vectors (M, 3), uniform in the cone of `half_angle` (rad) about each of axis (M, 3)."""
    count = len(axis)
    cosine = rng.uniform(np.cos(half_angle), 1.0, count)
    across = np.cross(axis, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    return cosine[:, None] * axis + np.sqrt(1 - cosine**2)[:, None] * across
