"""The nominal arm with its tool: poses, slopes by the joints, and the limits of the joints."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bayescal.arm.chain import Chain, chain_of, frames, link_angles
from bayescal.arm.robot import Robot
from bayescal.arm.transforms import cross


@dataclass(frozen=True)
class NominalArm:
    """The nominal arm with a tool: its point (3,) m, and the orientation of its frame (3, 3), on the flange.

    Joint limits apply to `angles`: readings times `link_from_reading`, with the signs of the diagonal taken
    out. Inverse kinematics moves in these angles.
    """

    robot: Robot
    tool: np.ndarray
    tool_axes: np.ndarray = field(default_factory=lambda: np.eye(3))

    @cached_property
    def chain(self) -> Chain:
        """The nominal chain."""
        return chain_of(self.robot)

    @cached_property
    def sign(self) -> np.ndarray:
        """Signs (n,) of the diagonal of `link_from_reading`; limits are stated without them."""
        return np.where(np.diag(self.robot.link_from_reading) < 0, -1.0, 1.0)

    @cached_property
    def reading_from_link(self) -> np.ndarray:
        """Inverse of the robot's `link_from_reading`, (n, n)."""
        return np.linalg.inv(self.robot.link_from_reading)

    def readings_of(self, angles: np.ndarray) -> np.ndarray:
        """Readings (N, n), rad, of angles (N, n) to which the limits apply."""
        return (angles * self.sign) @ self.reading_from_link.T

    def angles_of(self, readings: np.ndarray) -> np.ndarray:
        """Angles (N, n), rad, to which the limits apply: by `link_from_reading` with a positive diagonal."""
        return readings @ self.robot.link_from_reading.T * self.sign

    def frames(self, readings: np.ndarray) -> np.ndarray:
        """Poses in F0 of all frames and the flange, (N, n + 2, 4, 4)."""
        return frames(self.chain, link_angles(self.robot, readings))

    def ball(self, pose: np.ndarray) -> np.ndarray:
        """TCP positions (N, 3), m, of the poses of `frames`."""
        return pose[:, -1, :3, :3] @ self.tool + pose[:, -1, :3, 3]

    def tool_axis(self, pose: np.ndarray) -> np.ndarray:
        """Directions (N, 3) in F0 of the z axis of the tool's frame, of the poses of `frames`."""
        return pose[:, -1, :3, :3] @ self.tool_axes[:, 2]

    def tool_poses(self, pose: np.ndarray) -> np.ndarray:
        """Poses of the tool's frame in F0, (N, 4, 4), of the poses of `frames`."""
        out = np.zeros((len(pose), 4, 4))
        out[:, :3, :3] = pose[:, -1, :3, :3] @ self.tool_axes
        out[:, :3, 3] = self.ball(pose)
        out[:, 3, 3] = 1.0
        return out

    def jacobian(self, pose: np.ndarray) -> np.ndarray:
        """Derivatives (N, 6, n) of the TCP (m/rad) and of its rotation by the limited angles."""
        axis, origin = pose[:, 1:-1, :3, 2], pose[:, 1:-1, :3, 3]
        slide = cross(axis, self.ball(pose)[:, None] - origin)
        return np.swapaxes(np.concatenate([slide, axis], axis=2), 1, 2) * self.sign
