"""An arm with one of its tools among the solids of a setup: joint angles that bring the tool to places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from bayescal.arm.inverse import LEVER, PASSES, descend, to_axes, to_points, to_poses
from bayescal.arm.transforms import rpy_matrix
from bayescal.collision import Clearance, Scene
from bayescal.collision.path import RETRACT
from bayescal.dataset import Dataset
from bayescal.planning.sites import Sites
from bayescal.simulation.probing import FASTEST, SPEED
from bayescal.simulation.reach import Arm

TURNING = np.radians(2.0)
"""rad: rotation of the tool during the approach, about a random axis. It lets every joint come to a contact
from both sides; without it the direction of a joint would follow from the pose alone."""
STARTS = 30_000
"""Random configurations, of which one near the wanted place and direction begins a search."""
NEAREST = 8  # of them, from which it is drawn, so that all branches of the inverse kinematics are found

UNREACHED = "no joint angles within the limits"
BENT = "configuration folded behind or below the base"
OUTSIDE = "tool outside its working cone"
STUCK = "no straight approach within the limits"
ITSELF = "the arm itself"
FAST = "a joint too fast on the approach: near a singularity"


@dataclass(frozen=True)
class Reached:
    """Readings (M, n) of contacts and their approach, rad, at M places, and why a place has none, or ""."""

    readings: np.ndarray
    approach: np.ndarray
    reason: np.ndarray

    def __len__(self) -> int:
        return len(self.readings)

    def __getitem__(self, rows: np.ndarray) -> Reached:
        return Reached(self.readings[rows], self.approach[rows], self.reason[rows])

    @staticmethod
    def join(parts: Sequence[Reached]) -> Reached:
        """All of them, in order."""
        names = ("readings", "approach", "reason")
        return Reached(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @property
    def velocity(self) -> np.ndarray:
        """Joint velocities (M, n), rad/s, of the approach at `SPEED`; 0 where there is none."""
        return (self.readings - self.approach) / (RETRACT / SPEED)

    @property
    def good(self) -> np.ndarray:
        """Indices of the contacts."""
        return np.flatnonzero(self.reason == "")


@dataclass(frozen=True)
class Hand:
    """The nominal arm with one tool, the solids around it, and the working cone of the tool, rad."""

    arm: Arm
    clearance: Clearance
    cone: float

    @classmethod
    def of(cls, dataset: Dataset, tool: int, scene: Scene, cone: float) -> Hand:
        """The hand of a tool of a session, by its index."""
        own = dataset.tools[tool]
        axes = np.eye(3) if own.rpy is None else rpy_matrix(own.rpy)
        return cls(Arm(dataset.robot, own.centre, axes), Clearance.of(dataset.robot, own, scene.solids), cone)

    @cached_property
    def anywhere(self) -> np.ndarray:
        """Random readings (K, n), rad, of arms that are not folded behind or below the base."""
        readings = self.arm.anywhere(STARTS, np.random.default_rng(0))
        return readings[self.arm.upright(self.arm.frames(readings))]

    @cached_property
    def points(self) -> np.ndarray:
        """TCP positions of `anywhere`, (K, 3), m."""
        return self.arm.ball(self.arm.frames(self.anywhere))

    @cached_property
    def _near(self) -> cKDTree:
        axes = self.arm.tool_axis(self.arm.frames(self.anywhere))
        return cKDTree(np.concatenate([self.points / LEVER, axes], axis=1))

    def starts(self, sites: Sites, rng: np.random.Generator) -> np.ndarray:
        """Readings (M, n), rad, at which the tool is roughly at each place, in a random branch."""
        wanted = np.concatenate([sites.points / LEVER, sites.axes], axis=1)
        near = np.asarray(self._near.query(wanted, k=NEAREST)[1])
        return self.anywhere[near[np.arange(len(near)), rng.integers(NEAREST, size=len(near))]]

    def reach(
        self,
        sites: Sites,
        touched: np.ndarray,
        rng: np.random.Generator,
        starts: np.ndarray | None = None,
        turning: float = TURNING,
    ) -> Reached:
        """Joint angles at places, with a straight approach, that neither collide nor are near a singularity.

        Parameters
        ----------
        sites : Sites
        touched : np.ndarray of int, shape (M,)
            Index of the solid that each place is on, -1 for none.
        rng : np.random.Generator
        starts : np.ndarray, shape (M, n), optional
            Readings, rad, where each search begins; random if not given.
        turning : float
            Rotation of the tool during the approach, rad.
        """
        arm = self.arm
        begin = self.starts(sites, rng) if starts is None else starts
        free = np.isnan(sites.normals[:, 0])  # nothing is touched
        angles, found = self._solved(sites, arm.angles_of(begin), free)
        readings = arm.readings_of(angles)
        reason = np.where(found, "", UNREACHED).astype(object)
        approach = readings.copy()
        pose = arm.frames(readings)
        inward = np.sum(arm.tool_axis(pose) * -sites.normals, axis=1)
        self._drop(reason, ~free & (inward < np.cos(self.cone) - 1e-6), OUTSIDE)
        self._drop(reason, ~arm.upright(pose), BENT)
        rows = np.flatnonzero((reason == "") & ~free)
        if len(rows):
            approach[rows], reason[rows] = self._approach(
                readings[rows], pose[rows], sites[rows], rng, turning
            )
        rows = np.flatnonzero(reason == "")
        reason[rows] = self._collisions(readings[rows], approach[rows], touched[rows])
        return Reached(readings, approach, reason)

    @staticmethod
    def _drop(reason: np.ndarray, bad: np.ndarray, why: str) -> None:
        reason[bad & (reason == "")] = why

    def _solved(self, sites: Sites, begin: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles (M, n), rad, at places, and which are found; the direction is free in rows `free` (M,)."""
        arm, angles, found = self.arm, begin.copy(), np.zeros(len(begin), bool)
        free = free | (arm.robot.n < 5)
        for rows, directed in ((np.flatnonzero(free), False), (np.flatnonzero(~free), True)):
            points = sites.points[rows]
            task = to_axes(arm, points, sites.axes[rows]) if directed else to_points(arm, points)
            angles[rows], found[rows] = descend(task, begin[rows], *arm.range)
        return angles, found

    def _approach(
        self,
        readings: np.ndarray,
        pose: np.ndarray,
        sites: Sites,
        rng: np.random.Generator,
        turning: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Readings (M, n) at `RETRACT` off along the normals, and why there are none, or ""."""
        arm, goals = self.arm, self.arm.tool_poses(pose)
        axis = rng.normal(size=(len(pose), 3))
        axis /= np.linalg.norm(axis, axis=1)[:, None]
        goals[:, :3, :3] = Rotation.from_rotvec(turning * axis).as_matrix() @ goals[:, :3, :3]
        goals[:, :3, 3] += RETRACT * sites.normals
        if arm.robot.n >= 6:
            task = to_poses(arm, goals)
        elif arm.robot.n == 5:
            task = to_axes(arm, goals[:, :3, 3], goals[:, :3, 2])
        else:
            task = to_points(arm, goals[:, :3, 3])
        begin = arm.angles_of(readings)
        angles, found = descend(task, begin, arm.range[0], arm.range[1], PASSES // 2)
        reason = np.where(found, "", STUCK).astype(object)
        rate = np.abs(angles - begin).max(axis=1) / (RETRACT / SPEED)
        self._drop(reason, rate > FASTEST, FAST)
        return arm.readings_of(angles), reason

    def _collisions(self, readings: np.ndarray, approach: np.ndarray, touched: np.ndarray) -> np.ndarray:
        """With what each row collides at the contact, half way and at the end of its approach, or ""."""
        out = np.full(len(readings), "", object)
        for share in (0.0, 0.5, 1.0):
            rows = np.flatnonzero(out == "")
            at = readings[rows] + share * (approach[rows] - readings[rows])
            out[rows] = self._texts[self.clearance.collides(at, touched[rows])]
        return out

    @cached_property
    def _texts(self) -> np.ndarray:
        """Text of each answer of the clearance."""
        solids = self.clearance.solids
        others = [solids[pair.solid].name if pair.solid >= 0 else ITSELF for pair in self.clearance.pairs]
        short = [name.partition("@")[0].partition(".")[0] or "the artefact" for name in others]
        return np.array(["", *(f"collision with {name}" for name in short)], object)
