"""Whether an arm at given readings, or on a motion, keeps its distance from itself and what is around.

Whether the way to a contact and back is free: the straight path of the ball along the outward normal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.inverse import LEVER
from bayescal.arm.motion import NominalArm
from bayescal.arm.shapes import Capsule
from bayescal.dataset.types import Tool
from bayescal.probing.bodies import arm_capsules
from bayescal.probing.scene import Solid
from bayescal.probing.sweep import Pair, Pairs, signed_distances

ALWAYS = 0.5
"""Links that overlap in more than this share of random configurations are neighbours whose capsules are wider
than the links: not compared. (The MoveIt Setup Assistant excludes pairs that always collide, in the same
way.)"""
SAMPLES = 200
NEAR_EYE, ALONG = 0.06, 40
"""m of a line of sight at both ends that camera and board may have, and points of it that are checked."""
STILL = 1e-9
"""m: a distance that varies by less does not change with the arm."""


@dataclass(frozen=True)
class Clearance:
    """The check of an arm with its tool among solids.

    Use `Clearance.of(robot, tool, solids)`; `among(solids)` for the same arm elsewhere. `self_pairs` are
    the pairs of capsules of the arm that are compared.
    """

    arm: NominalArm
    capsules: tuple[Capsule, ...]
    self_pairs: tuple[tuple[int, int], ...]
    solids: tuple[Solid, ...] = ()

    @classmethod
    def of(
        cls, robot: Robot, tool: Tool, solids: Sequence[Solid] = (), stand: float = 0.0,
        held: Sequence[Capsule] = (),
    ) -> Clearance:  # fmt: skip
        """Prepare the check of a robot with a tool, which holds bodies; parameters as of `arm_capsules`."""
        bare = cls(NominalArm(robot, tool.centre), arm_capsules(robot, tool, stand, held), (), tuple(solids))
        return replace(bare, self_pairs=bare._self_pairs())

    def among(self, solids: Sequence[Solid]) -> Clearance:
        """The same arm among other solids."""
        return replace(self, solids=tuple(solids))

    @cached_property
    def pairs(self) -> tuple[Pair, ...]:
        """All pairs that are compared, solids first. The number of a pair is its position, plus one."""
        out = []
        for s, solid in enumerate(self.solids):
            for k, shape in enumerate(solid.shapes):
                for c, capsule in enumerate(self.capsules):
                    pair = Pair(c, shape, s, surface=k == 0)
                    if capsule.frame > 0 and not (solid.carries and self._rests(pair)):
                        out.append(pair)  # the base does not move
        return (*out, *(Pair(c, self.capsules[other], other=other) for c, other in self.self_pairs))

    @cached_property
    def _table(self) -> Pairs:
        return Pairs(self.arm, self.capsules, self.pairs)

    def collides(self, readings: np.ndarray, touched: np.ndarray | None = None) -> np.ndarray:
        """Check configurations.

        Parameters
        ----------
        readings : np.ndarray, shape (M, n)
            rad.
        touched : np.ndarray of int, shape (M,), optional
            Index of the solid that the ball touches, -1 for none (default). Its surface may be touched by the
            ball and the last part of the stylus. Solids of a placement are compared only with rows that touch
            this placement.

        Returns
        -------
        np.ndarray of int, shape (M,)
            0 if free, otherwise the number of a pair that overlaps.
        """
        return self.hits(readings, readings, 0.0, touched)

    def hits(
        self,
        begin: np.ndarray,
        end: np.ndarray,
        floor: float,
        touched: np.ndarray | None = None,
        slack: np.ndarray | None = None,
    ) -> np.ndarray:
        """Check motions of all joints at the same time from `begin` to `end`, readings (M, n), rad.

        Returns (M,): 0 if all pairs keep the distance `floor`, m, everywhere on a motion, otherwise the
        number of a pair. `touched` as of `collides`; `slack` (M, n), rad: how far joints may be off.
        """
        compared = self._compared(len(begin), touched)
        away, pair = self._table.closest(begin, end, compared, slack, floor, np.inf)
        return np.where(away < floor, pair + 1, 0)

    def distances(self, readings: np.ndarray, touched: np.ndarray | None = None) -> np.ndarray:
        """Smallest signed distances (M,), m, of pairs that must not overlap; parameters as for `collides`.

        inf if there is nothing to compare.
        """
        return self.closest(readings, readings, 0.0, touched)

    def closest(
        self,
        begin: np.ndarray,
        end: np.ndarray,
        tolerance: float,
        touched: np.ndarray | None = None,
        slack: np.ndarray | None = None,
    ) -> np.ndarray:
        """Smallest distances (M,), m, on motions as of `hits`: never too large.

        They are too small by less than `tolerance`, m, or a tenth of them if that is more.
        """
        compared = self._compared(len(begin), touched)
        return self._table.closest(begin, end, compared, slack, -np.inf, tolerance)[0]

    def hidden(self, readings: np.ndarray, eye: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Whether the arm or a solid hides points from an eye, (M,).

        Parameters
        ----------
        readings : np.ndarray, shape (M, n)
            rad.
        eye : np.ndarray, shape (M, 3)
            m in F0.
        seen : np.ndarray, shape (M, K, 3)
            m in F0.

        What is on the flange, and the first and last `NEAR_EYE` of each line, do not count: camera and board.
        """
        length = np.linalg.norm(seen - eye[:, None], axis=2, keepdims=True)
        share = np.linspace(0.0, 1.0, ALONG)[:, None, None, None]
        share = np.clip(share, NEAR_EYE / length, 1.0 - NEAR_EYE / length)
        points = (eye[:, None] + share * (seen - eye[:, None])).transpose(1, 0, 2, 3)
        points = points.reshape(len(readings), -1, 3)
        out = np.zeros(len(readings), bool)
        for solid in self.solids:
            for shape in solid.shapes:
                out |= np.any(signed_distances(shape, points) < 0.0, axis=1)
        frames = self.arm.frames(readings)
        for capsule in self.capsules:
            if capsule.frame <= self.arm.robot.n:
                turn, shift = frames[:, capsule.frame, :3, :3], frames[:, capsule.frame, :3, 3]
                out |= np.any(signed_distances(capsule, (points - shift[:, None]) @ turn) < 0.0, axis=1)
        return out

    def _compared(self, count: int, touched: np.ndarray | None) -> np.ndarray:
        """Which pairs are compared in which rows, (M, P) bool."""
        touched = np.full(count, -1) if touched is None else np.asarray(touched, int)
        placements = np.array([*(solid.placement for solid in self.solids), ""])
        solid = np.array([pair.solid for pair in self.pairs], int)  # -1 for the arm itself, always there
        may = np.array([pair.surface and self.capsules[pair.capsule].probe for pair in self.pairs], bool)
        there = (placements[solid] == "") | (placements[solid] == placements[touched][:, None])
        return there & ~(may & (solid == touched[:, None]))

    def _self_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of capsules of the arm that can collide: not on the same or the next link, nor neighbours.

        Nor pairs whose distance does not change with the arm: no motion brings them together.
        """
        last = self.arm.robot.n  # the flange does not move against the last link
        out = []
        for b, second in enumerate(self.capsules):
            for a, first in enumerate(self.capsules[:b]):
                if min(second.frame, last) - min(first.frame, last) > 1:
                    away = self._anywhere(Pair(a, second, other=b))
                    if np.mean(away < 0) <= ALWAYS and np.ptp(away) >= STILL:
                        out.append((a, b))
        return tuple(out)

    def _rests(self, pair: Pair) -> bool:
        """Whether a capsule always starts within a shape, as a shoulder below the height of the table.

        Or whether its distance does not change with the arm, as that of a shoulder above it.
        """
        capsule = self.capsules[pair.capsule]
        frames = self.arm.frames(self._sample)[:, capsule.frame]
        starts = frames[:, :3, :3] @ capsule.a + frames[:, :3, 3]
        within = bool(np.all(signed_distances(pair.shape, starts) < capsule.radius))
        return within or bool(np.ptp(self._anywhere(pair)) < STILL)

    def _anywhere(self, pair: Pair) -> np.ndarray:
        """Distances (SAMPLES,), m, of a pair at random configurations within the limits."""
        still = np.ones((SAMPLES, 1), bool)
        return Pairs(self.arm, self.capsules, (pair,)).closest(self._sample, self._sample, still)[0]

    @cached_property
    def _sample(self) -> np.ndarray:
        """Random readings (SAMPLES, n), rad."""
        limits = self.arm.robot.limits_within(np.pi)
        angles = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (SAMPLES, len(limits)))
        return self.arm.readings_of(angles)


RETRACT = 0.02
"""m: how far the ball is retracted; touch probes are backed off by 2 to 25 mm before the next approach."""

STOPS = 2  # points that are checked on the path, at equal distances behind the contact
FIRM = 30.0
"""Weight of the path against the orientation of the tool: near a singularity the orientation gives way."""

DAMPING = 0.2
"""Of rotations: those that need joint motions 1 / DAMPING times as large are made by half. With 0.02, a step
near a singularity of the wrist moved the ball by up to 9 mm off its path."""


def path_free(
    clearance: Clearance, readings: np.ndarray, normals: np.ndarray, touched: np.ndarray | None = None
) -> np.ndarray:
    """Check the retract from contacts, which is also their approach, at `STOPS` points of it.

    Parameters
    ----------
    clearance : Clearance
    readings : np.ndarray, shape (M, n)
        Of the contacts, rad.
    normals : np.ndarray, shape (M, 3)
        Outward unit normals of the surface, in F0.
    touched : np.ndarray of int, shape (M,), optional
        As for `Clearance.collides`.

    Returns
    -------
    np.ndarray of int, shape (M,)
        0 if free, otherwise the number of a pair; -1 if the path leaves the joint limits.
    """
    out = np.zeros(len(readings), int)
    retracting = np.array(readings, float)
    arm = clearance.arm
    for _ in range(STOPS):
        retracting = retracted(arm, retracting, RETRACT / STOPS * normals)
        angles = arm.angles_of(retracting)
        within = np.all((angles >= arm.robot.limits[:, 0]) & (angles <= arm.robot.limits[:, 1]), axis=1)
        out[(out == 0) & ~within] = -1
        rows = np.flatnonzero(out == 0)
        if not len(rows):
            break
        out[rows] = clearance.collides(retracting[rows], None if touched is None else touched[rows])
    return out


def retracted(arm: NominalArm, readings: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Readings (M, n), rad, with the ball moved by small `shifts` (M, 3), m, and the tool's orientation kept.

    One damped Jacobian step. Arms with fewer than six joints, and poses near a singularity, keep the path and
    turn the tool a little.
    """
    j = arm.jacobian(arm.frames(readings))
    weight = FIRM / LEVER
    j[:, :3] *= weight
    goal = np.concatenate([weight * shifts, np.zeros_like(shifts)], axis=1)
    square = np.swapaxes(j, 1, 2) @ j + DAMPING**2 * np.eye(arm.robot.n)
    step = np.linalg.solve(square, (np.swapaxes(j, 1, 2) @ goal[..., None]))[..., 0]
    return readings + arm.readings_of(step)
