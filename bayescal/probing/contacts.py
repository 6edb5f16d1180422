"""The search for contacts: readings at which a tool is at places on targets, reached without a collision.

One search (`reach`) serves simulated sessions and plans. They differ in the way to a contact: in a
simulated session the ball moves at given joint velocities (`Moving`), in a plan the tool moves straight
from a pose off the surface, to which a free motion must lead (`Straight`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from bayescal.arm.inverse import LEVER, PASSES, descend, to_axes, to_frames, to_points
from bayescal.arm.transforms import cone, rpy_matrix
from bayescal.dataset.types import Dataset
from bayescal.probing.clearance import RETRACT, Clearance, path_free
from bayescal.probing.motions import CLEAR, DIRECTED, Arm, Place
from bayescal.probing.scene import Scene, held_by

SPEED = 5e-3  # m/s of the ball when it touches
FASTEST = np.radians(12.0)  # rad/s, m/s: maximum joint velocity; faster joints are near a singularity
TURNING = np.radians(2.0)
"""rad: rotation of the tool during the approach, about a random axis. It lets every joint come to a contact
from both sides; without it the direction of a joint would follow from the pose alone."""
SLANT = np.radians(25.0)  # maximum angle between the path of a moving ball and the normal
SPIN = np.radians(0.25)  # rad/s: joint velocities that rotate the arm about the centre of a moving ball
STARTS = 30_000
"""Random configurations, of which one near the wanted place and direction begins a search."""
NEAREST = 8  # of them, from which it is drawn, so that all branches of the inverse kinematics are found
LINE = 2e-3
"""m: smallest clearance on the line to a contact, of all but the end of the stylus from the surface."""
EVERY = "@"  # no name of a placement
ITSELF = "the arm itself"

UNREACHED = "no joint angles within the limits"
BENT = "configuration folded behind or below the base"
OUTSIDE = "tool outside its working cone"
STUCK = "no straight approach within the limits"
WALLED = "no collision-free path to it"
FAST = "a joint too fast on the approach: near a singularity"
NEAR = "a collision at the contact or on its retract"
SPARE = "not needed"


class Rows:
    """Base of dataclasses whose fields are arrays of equal length."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))  # type: ignore[arg-type]

    def __getitem__(self, rows: np.ndarray | slice) -> Self:
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))  # type: ignore[arg-type]

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """All rows of all parts, in order."""
        columns = (np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls))  # type: ignore[arg-type]
        return cls(*columns)


@dataclass(frozen=True)
class Sites(Rows):
    """M places to bring the TCP to.

    Attributes
    ----------
    points : np.ndarray, shape (M, 3)
        TCP positions in F0, m.
    normals : np.ndarray, shape (M, 3)
        Outward unit normals, along which the tool leaves; nan where nothing is touched.
    axes : np.ndarray, shape (M, 3)
        Directions of the z axis of the tool: to be had where something is touched, else only a start.
    turns : np.ndarray, shape (M, 3, 3)
        Orientations of the tool in F0 that are to be had, as far as the arm has joints; nan where any may be.
    fault : np.ndarray of object, shape (M,)
        Why a place is of no use, or "".
    touched : np.ndarray of int, shape (M,)
        Index of the solid that each place is on, -1 for none.
    """

    points: np.ndarray
    normals: np.ndarray
    axes: np.ndarray
    turns: np.ndarray
    fault: np.ndarray
    touched: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, normals: np.ndarray, axes: np.ndarray, touched: np.ndarray) -> Sites:
        """Places with free orientation about the axes."""
        turns, fault = np.full((len(points), 3, 3), np.nan), np.full(len(points), "", object)
        return cls(points, normals, axes, turns, fault, touched)

    @property
    def free(self) -> np.ndarray:
        """Where nothing is touched, (M,)."""
        return np.isnan(self.normals[:, 0])


@dataclass(frozen=True)
class Contacts(Rows):
    """Readings (M, n), rad, at M places, their velocities (M, n), rad/s, the readings of the approach (M, n).

    `reason` (M,) says why a place has no contact, or "". Where nothing is touched the approach is the row
    itself, and the velocity is 0.
    """

    readings: np.ndarray
    velocity: np.ndarray
    approach: np.ndarray
    reason: np.ndarray

    @classmethod
    def none(cls, joints: int) -> Contacts:
        """No contacts (M = 0) of an arm with some joints."""
        empty = np.empty((0, joints))
        return cls(empty, empty, empty, np.empty(0, object))

    @property
    def good(self) -> np.ndarray:
        """Indices of the contacts."""
        return np.flatnonzero(self.reason == "")


def inverse(arm: Arm, starts: np.ndarray, sites: Sites, passes: int) -> tuple[np.ndarray, np.ndarray]:
    """Readings (M, n), rad, within the limits, with the TCP at places, and which of them are solutions, (M,).

    The tool has the axes of the places, or their orientations where they have some; of arms with fewer than
    `DIRECTED` joints, and where nothing is touched, only the position is solved. Searches of at most `passes`
    steps begin at readings `starts` (M, n), rad.
    """
    angles, solved, (low, high) = arm.angles_of(starts), np.zeros(len(starts), bool), arm.range
    turned = np.isfinite(sites.turns).all(axis=(1, 2))
    directed = ~turned & ~sites.free & (arm.robot.n >= DIRECTED)
    goals = np.tile(np.eye(4), (len(starts), 1, 1))
    goals[:, :3, 3] = sites.points
    goals[turned, :3, :3] = sites.turns[turned]
    for rows, task in (
        (r := np.flatnonzero(~directed & ~turned), to_points(arm, sites.points[r])),
        (r := np.flatnonzero(directed), to_axes(arm, sites.points[r], sites.axes[r])),
        (r := np.flatnonzero(turned), to_frames(arm, goals[r])),
    ):
        angles[rows], solved[rows] = descend(task, angles[rows], low, high, passes)
    return arm.readings_of(angles), solved


def reach(
    way: Way, sites: Sites, starts: np.ndarray, rng: np.random.Generator, number: np.ndarray, passes: int
) -> Contacts:
    """Readings at places, with an approach, that neither collide nor are near a singularity.

    Parameters
    ----------
    way : Moving or Straight
        Its `approach` gives readings and velocities (M, n) of the approach, and why there is none, or "". Its
        `collisions` state what each contact or its approach collides with, or "", (M,).
    sites : Sites
    starts : np.ndarray, shape (M, n)
        Readings, rad, where each search begins.
    rng : np.random.Generator
        Of the approaches.
    number : np.ndarray of int, shape (M,)
        Sites of one number serve for one contact: the first that is free is taken.
    passes : int
        Maximum number of steps of the inverse kinematics.
    """
    arm = way.hand.arm
    readings, solved = inverse(arm, starts, sites, passes)
    reason = np.where(sites.fault != "", sites.fault, np.where(solved, "", UNREACHED)).astype(object)
    pose = arm.frames(readings)
    inward = np.sum(arm.tool_axis(pose) * -sites.normals, axis=1)
    reason[(reason == "") & ~sites.free & (inward < np.cos(way.hand.cone) - 1e-6)] = OUTSIDE
    reason[(reason == "") & ~arm.upright(pose)] = BENT
    out = Contacts(readings, np.zeros(readings.shape), readings.copy(), reason)
    rows = np.flatnonzero((reason == "") & ~sites.free)
    if len(rows):
        approach = way.approach(readings[rows], pose[rows], sites[rows], rng)
        out.approach[rows], out.velocity[rows], reason[rows] = approach
    waiting = np.flatnonzero(reason == "")
    while len(waiting):
        rows = waiting[np.unique(number[waiting], return_index=True)[1]]
        reason[rows] = way.collisions(out[rows], sites[rows])
        waiting = np.setdiff1d(waiting, rows)
        served = np.isin(number[waiting], number[rows[reason[rows] == ""]])
        reason[waiting[served]] = SPARE
        waiting = waiting[~served]
    return out


@dataclass(frozen=True)
class Moving:
    """The ball approaches at `SPEED`, at most `SLANT` from the normal of the surface.

    The arm also rotates slowly about the ball, so that every joint moves in both directions in a session.
    """

    hand: Hand

    def approach(
        self, readings: np.ndarray, pose: np.ndarray, sites: Sites, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `reach`; the approach is the contact itself."""
        arm = self.hand.arm
        n, jacobian = arm.robot.n, arm.jacobian(pose)[:, :3]
        pseudo = np.linalg.pinv(jacobian, rcond=1e-6)
        drive = (pseudo @ (SPEED * cone(-sites.normals, SLANT, rng))[..., None])[..., 0]
        still = np.eye(n) - pseudo @ jacobian
        spin = (still @ rng.normal(0, SPIN, (len(pose), n, 1)))[..., 0]
        slow = np.abs(drive).max(axis=1) < FASTEST
        return readings, arm.readings_of(drive + spin), np.where(slow, "", FAST).astype(object)

    def collisions(self, contacts: Contacts, sites: Sites) -> np.ndarray:
        """See `reach`."""
        clearance = self.hand.clearance
        free = clearance.collides(contacts.readings, sites.touched) == 0
        rows = np.flatnonzero(free)
        hit = path_free(clearance, contacts.readings[rows], sites.normals[rows], sites.touched[rows])
        free[rows] = hit == 0
        return np.where(free, "", NEAR).astype(object)


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
        carried = dataset.tools[tool]
        axes = np.eye(3) if carried.rpy is None else rpy_matrix(carried.rpy)
        clearance = Clearance.of(dataset.robot, carried, scene.solids, held=held_by(dataset, tool))
        return cls(Arm(dataset.robot, carried.centre, axes), clearance, cone, floor)

    def place(self, label: str) -> Place:
        """The place while a placement of the artefact is there; `EVERY`: all of them."""
        if label not in self._places:
            there = []
            for s in self.clearance.solids:  # what is not there has no shapes, and keeps its index
                shapes = s.shapes if label == EVERY or s.placement in ("", label) else ()
                there.append(replace(s, placement="", shapes=shapes))
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

    def line(
        self, readings: np.ndarray, approach: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Lines of the tool from contacts to approaches, (M, n), rad, as motions of the joints.

        Each is two motions, through its middle: begin, end, and by how much joints may be off (M, n), rad:
        twice what the curvature by the three points gives. A line along which no joint angles are found in
        the middle is as far off as from one end to the other.
        """
        arm = self.arm
        begin, end = (arm.tool_poses(arm.frames(q)) for q in (readings, approach))
        turn = Rotation.from_matrix(np.swapaxes(begin[:, :3, :3], 1, 2) @ end[:, :3, :3]).as_rotvec()
        goals = begin.copy()
        goals[:, :3, :3] = begin[:, :3, :3] @ Rotation.from_rotvec(0.5 * turn).as_matrix()
        goals[:, :3, 3] = 0.5 * (begin[:, :3, 3] + end[:, :3, 3])
        start = 0.5 * (readings + approach)
        angles, solved = self.posed(goals, arm.angles_of(start), np.array([[-np.inf], [np.inf]]))
        middle = np.where(solved[:, None], arm.readings_of(angles), start)
        off = 0.25 * np.abs(readings - 2 * middle + approach)
        off = np.where(solved[:, None], off, np.abs(approach - readings))
        yield readings, middle, off
        yield middle, approach, off

    def posed(
        self, goals: np.ndarray, begin: np.ndarray, limits: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Angles (M, n), rad, at poses (M, 4, 4) of the tool, or at their points alone; which are solved.

        An arm of fewer than `DIRECTED` joints turns its tool on a line: not every direction is had beside it.
        """
        low, high = np.broadcast_to(limits, (2, self.arm.robot.n))
        directed = self.arm.robot.n >= DIRECTED
        task = to_frames(self.arm, goals) if directed else to_points(self.arm, goals[:, :3, 3])
        return descend(task, begin, low, high, PASSES // 2)


@dataclass(frozen=True)
class Straight:
    """The tool moves straight along the normal, from `RETRACT` off, and turns by `turning`, rad, on the way.

    A free motion leads from there to a raised pose, except of contacts that may be reached `by_hand`. What is
    not part of a placement is reached at each of them.
    """

    hand: Hand
    turning: float = TURNING
    by_hand: bool = False

    def reach(self, sites: Sites, rng: np.random.Generator, starts: np.ndarray | None = None) -> Contacts:
        """Contacts at places; searches begin at random if no starts are given."""
        begin = self.hand.starts(sites, rng) if starts is None else starts
        return reach(self, sites, begin, rng, np.arange(len(sites)), PASSES)

    def approach(
        self, readings: np.ndarray, pose: np.ndarray, sites: Sites, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `reach`."""
        arm, goals = self.hand.arm, self.hand.arm.tool_poses(pose)
        axis = rng.normal(size=(len(pose), 3))
        axis /= np.linalg.norm(axis, axis=1)[:, None]
        goals[:, :3, :3] = Rotation.from_rotvec(self.turning * axis).as_matrix() @ goals[:, :3, :3]
        goals[:, :3, 3] += RETRACT * sites.normals
        begin, seconds = arm.angles_of(readings), RETRACT / SPEED
        start = begin if arm.robot.n >= DIRECTED else begin + self.turning * rng.normal(size=begin.shape)
        angles, solved = self.hand.posed(goals, start, arm.range)
        fast = np.abs(angles - begin).max(axis=1) / seconds > FASTEST
        off = arm.readings_of(angles)
        reason = np.where(solved, np.where(fast, FAST, ""), STUCK).astype(object)
        return off, (readings - off) / seconds, reason

    def collisions(self, contacts: Contacts, sites: Sites) -> np.ndarray:
        """See `reach`."""
        out, touched = np.full(len(contacts), "", object), sites.touched
        labels = np.array([*(s.placement for s in self.hand.clearance.solids), ""], object)[touched]
        for label in set(labels):
            rows = np.flatnonzero(labels == label)
            place = self.hand.place(label or EVERY)
            out[rows] = self._on_line(place, contacts[rows], touched[rows])
            rows = rows[out[rows] == ""]
            if len(rows) and not self.by_hand:
                out[rows[~place.linked(contacts.approach[rows])]] = WALLED
        return out

    def _on_line(self, place: Place, contacts: Contacts, touched: np.ndarray) -> np.ndarray:
        """What each row comes too near to on the line from its approach to the contact, or ""."""
        clearance, floor = place.clearance, min(LINE, self.hand.floor)
        out = np.zeros(len(contacts), int)
        off, nothing = contacts.approach, np.full(len(contacts), -1)
        for readings, least, solid in ((contacts.readings, floor, touched), (off, self.hand.floor, nothing)):
            rows = np.flatnonzero(out == 0)
            out[rows] = clearance.hits(readings[rows], readings[rows], least, solid[rows])
        rows = np.flatnonzero(out == 0)
        for begin, end, slack in self.hand.line(contacts.readings[rows], off[rows]):
            clear = out[rows] == 0
            hit = clearance.hits(begin[clear], end[clear], floor, touched[rows[clear]], slack[clear])
            out[rows[clear]] = hit
        others = [clearance.solids[p.solid].name if p.solid >= 0 else ITSELF for p in clearance.pairs]
        short = [name.partition("@")[0].partition(".")[0] or "the artefact" for name in others]
        return np.array(["", *(f"collision with {name}" for name in short)], object)[out]


Way = Moving | Straight
"""How a tool comes to its contacts."""
