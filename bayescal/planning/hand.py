"""An arm with one of its tools among the solids of a setup: joint angles that bring the tool to places."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from bayescal.arm.inverse import LEVER, PASSES, descend, to_axes, to_frames, to_points
from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import Dataset
from bayescal.planning.place import Place
from bayescal.planning.pool import CLEAR
from bayescal.planning.sites import Sites
from bayescal.probing.approach import FASTEST, SPEED
from bayescal.probing.clearance import RETRACT, Clearance
from bayescal.probing.reach import Arm
from bayescal.probing.scene import Scene

TURNING = np.radians(2.0)
"""rad: rotation of the tool during the approach, about a random axis. It lets every joint come to a contact
from both sides; without it the direction of a joint would follow from the pose alone."""
STARTS = 30_000
"""Random configurations, of which one near the wanted place and direction begins a search."""
NEAREST = 8  # of them, from which it is drawn, so that all branches of the inverse kinematics are found
LINE = 2e-3
"""m: smallest clearance on the line to a contact, of all but the end of the stylus from the surface."""

UNREACHED = "no joint angles within the limits"
BENT = "configuration folded behind or below the base"
OUTSIDE = "tool outside its working cone"
STUCK = "no straight approach within the limits"
EVERY = "@"  # no name of a placement
ITSELF = "the arm itself"
WALLED = "no collision-free path to it"
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
    """The nominal arm with one tool, the solids around it, and the working cone of the tool, rad.

    `floor`, m, is the smallest clearance of its motions.
    """

    arm: Arm
    clearance: Clearance
    cone: float
    floor: float = CLEAR

    @classmethod
    def of(cls, dataset: Dataset, tool: int, scene: Scene, cone: float, floor: float = CLEAR) -> Hand:
        """The hand of a tool of a session, by its index."""
        own = dataset.tools[tool]
        axes = np.eye(3) if own.rpy is None else rpy_matrix(own.rpy)
        clearance = Clearance.of(dataset.robot, own, scene.solids)
        return cls(Arm(dataset.robot, own.centre, axes), clearance, cone, floor)

    def place(self, label: str) -> Place:
        """The place while a placement of the artefact is there; `EVERY`: all of them."""
        if label not in self._places:
            there = [  # what is not there has no shapes, and keeps its index
                replace(
                    s, placement="", shapes=s.shapes if label == EVERY or s.placement in ("", label) else ()
                )
                for s in self.clearance.solids
            ]
            self._places[label] = Place(self.clearance.among(there), self.anywhere, self.floor)
        return self._places[label]

    @cached_property
    def _places(self) -> dict[str, Place]:
        return {}

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
        by_hand: bool = False,
    ) -> Reached:
        """Joint angles at places, with a straight approach, that neither collide nor are near a singularity.

        From the approach a free motion leads to a raised pose, except of contacts that may be reached
        `by_hand`. What is not part of a placement is reached at each of them.

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
        own = np.array([*(s.placement for s in self.clearance.solids), ""], object)[touched[rows]]
        for label in set(own):
            some = rows[own == label]
            place = self.place(label or EVERY)
            reason[some] = self._collisions(place, readings[some], approach[some], touched[some])
            some = some[reason[some] == ""]
            if len(some) and not by_hand:
                reason[some[~place.linked(approach[some])]] = WALLED
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
        begin = arm.angles_of(readings)
        angles, found = self._posed(goals, begin, arm.range)
        reason = np.where(found, "", STUCK).astype(object)
        rate = np.abs(angles - begin).max(axis=1) / (RETRACT / SPEED)
        self._drop(reason, rate > FASTEST, FAST)
        return arm.readings_of(angles), reason

    def _collisions(
        self, place: Place, readings: np.ndarray, approach: np.ndarray, touched: np.ndarray
    ) -> np.ndarray:
        """What each row comes too near to on the line from its approach to the contact, or ""."""
        out = np.full(len(readings), "", object)
        names = self._texts(place.clearance)
        still = readings, readings, min(LINE, self.floor), touched
        for check in (still, (approach, approach, self.floor, None), None):
            rows = np.flatnonzero(out == "")
            if check is None:
                hit = self.line_hits(place.clearance, readings[rows], approach[rows], touched[rows])
            else:
                begin, end, floor, solid = check
                solid = None if solid is None else solid[rows]
                hit = place.clearance.hits(begin[rows], end[rows], floor, solid)
            out[rows] = names[hit]
        return out

    def line_hits(
        self, clearance: Clearance, readings: np.ndarray, approach: np.ndarray, touched: np.ndarray
    ) -> np.ndarray:
        """As `Clearance.hits` on the lines of the tool from approaches to contacts, readings (M, n), rad."""
        out = np.zeros(len(readings), int)
        for begin, end, slack in self.line(readings, approach):
            rows = np.flatnonzero(out == 0)
            floor = min(LINE, self.floor)
            out[rows] = clearance.hits(begin[rows], end[rows], floor, touched[rows], slack[rows])
        return out

    def line(
        self, readings: np.ndarray, approach: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Lines of the tool from contacts to approaches, (M, n), rad, as motions of the joints.

        Each is two motions, through its middle: begin, end, and by how much joints may be off (M, n), rad:
        twice what the curvature by the three points gives. A line along which no joint angles are found in
        the middle is as far off as from one end to the other.
        """
        arm = self.arm
        begin, end = (arm.tool_poses(arm.frames(at)) for at in (readings, approach))
        turn = Rotation.from_matrix(np.swapaxes(begin[:, :3, :3], 1, 2) @ end[:, :3, :3]).as_rotvec()
        goals = begin.copy()
        goals[:, :3, :3] = begin[:, :3, :3] @ Rotation.from_rotvec(0.5 * turn).as_matrix()
        goals[:, :3, 3] = 0.5 * (begin[:, :3, 3] + end[:, :3, 3])
        start = 0.5 * (readings + approach)
        angles, found = self._posed(goals, arm.angles_of(start), np.array([[-np.inf], [np.inf]]))
        middle = np.where(found[:, None], arm.readings_of(angles), start)
        off = 0.25 * np.abs(readings - 2 * middle + approach)
        off = np.where(found[:, None], off, np.abs(approach - readings))
        yield readings, middle, off
        yield middle, approach, off

    def _posed(
        self, goals: np.ndarray, begin: np.ndarray, limits: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Angles (M, n), rad, at poses (M, 4, 4) of the tool, as far as it has joints; which are found."""
        low, high = np.broadcast_to(limits, (2, self.arm.robot.n))
        return descend(to_frames(self.arm, goals), begin, low, high, PASSES // 2)

    def _texts(self, clearance: Clearance) -> np.ndarray:
        """Text of each answer of a clearance."""
        others = [clearance.solids[p.solid].name if p.solid >= 0 else ITSELF for p in clearance.pairs]
        short = [name.partition("@")[0].partition(".")[0] or "the artefact" for name in others]
        return np.array(["", *(f"collision with {name}" for name in short)], object)
