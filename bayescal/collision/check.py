"""Whether an arm at given readings, or on a motion, keeps its distance from itself and what is around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.arm.nominal import NominalArm
from bayescal.arm.robot import Robot
from bayescal.collision.links import arm_capsules
from bayescal.collision.scene import Solid
from bayescal.collision.shapes import Capsule
from bayescal.collision.sweep import Pair, Pairs
from bayescal.dataset.types import Tool

ALWAYS = 0.5
"""Links that overlap in more than this share of random configurations are neighbours whose capsules are wider
than the links: not compared. (The MoveIt Setup Assistant excludes pairs that always collide, in the same
way.)"""
SAMPLES = 200
STILL = 1e-9
"""m: a distance that varies by less does not change with the arm."""


@dataclass(frozen=True)
class Clearance:
    """The check of an arm with its tool among solids.

    Use `Clearance.of(robot, tool, solids)`; `among(solids)` for the same arm elsewhere. `own` are the pairs
    of capsules of the arm that are compared.
    """

    arm: NominalArm
    capsules: tuple[Capsule, ...]
    own: tuple[tuple[int, int], ...]
    solids: tuple[Solid, ...] = ()

    @classmethod
    def of(cls, robot: Robot, tool: Tool, solids: Sequence[Solid] = (), stand: float = 0.0) -> Clearance:
        """Prepare the check of a robot with a tool; `stand` as for `arm_capsules`."""
        bare = cls(NominalArm(robot, tool.centre), arm_capsules(robot, tool, stand), (), tuple(solids))
        return replace(bare, own=bare._own_pairs())

    def among(self, solids: Sequence[Solid]) -> Clearance:
        """The same arm among other solids."""
        return replace(self, solids=tuple(solids))

    @cached_property
    def pairs(self) -> tuple[Pair, ...]:
        """All pairs that are compared, solids first; a reason is the position in it, plus one."""
        out = []
        for s, solid in enumerate(self.solids):
            for k, shape in enumerate(solid.shapes):
                for c, capsule in enumerate(self.capsules):
                    pair = Pair(c, shape, f"{capsule.name} and {solid.name}", s, surface=k == 0)
                    if capsule.frame > 0 and not (solid.carries and self._rests(pair)):
                        out.append(pair)  # the base does not move
        for c, other in self.own:
            a, b = self.capsules[c], self.capsules[other]
            out.append(Pair(c, b, f"{a.name} and {b.name}", other=other))
        return tuple(out)

    @cached_property
    def _table(self) -> Pairs:
        return Pairs(self.arm, self.capsules, self.pairs)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Texts of the answers of `collides`; the first, of 0, is empty."""
        return ("", *(pair.reason for pair in self.pairs))

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
            0 if free, otherwise an index into `reasons`: a pair that overlaps.
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

        Returns (M,): 0 if all pairs keep the distance `floor`, m, everywhere on a motion, otherwise an index
        into `reasons`. `touched` as of `collides`; `slack` (M, n), rad: how far joints may be off the motion.
        """
        away, pair = self._swept(begin, end, touched, slack, floor)
        return np.where(away < floor, pair + 1, 0)

    def distances(self, readings: np.ndarray, touched: np.ndarray | None = None) -> np.ndarray:
        """Smallest signed distances (M,), m, of pairs that must not overlap; parameters as for `collides`.

        inf if there is nothing to compare.
        """
        return self._swept(readings, readings, touched, None, -np.inf, 0.0)[0]

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
        return self._swept(begin, end, touched, slack, -np.inf, tolerance)[0]

    def _swept(
        self,
        begin: np.ndarray,
        end: np.ndarray,
        touched: np.ndarray | None = None,
        slack: np.ndarray | None = None,
        floor: float = 0.0,
        tolerance: float = np.inf,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds from below of the smallest distances (M,), m, on motions, and the pairs that have them (M,).

        A motion that comes nearer than `floor` is given up. Otherwise the bound is at least `floor`, and
        within `tolerance` of the distance, or a tenth of it.
        """
        if not self.pairs:
            return np.full(len(begin), np.inf), np.zeros(len(begin), int)
        compared = self._compared(len(begin), touched)
        return self._table.closest(begin, end, compared, slack, floor, tolerance)

    def _compared(self, count: int, touched: np.ndarray | None) -> np.ndarray:
        """Which pairs are compared in which rows, (M, P) bool."""
        touched = np.full(count, -1) if touched is None else np.asarray(touched, int)
        placements = np.array([*(solid.placement for solid in self.solids), ""])
        solid = np.array([pair.solid for pair in self.pairs])  # -1 for the arm itself, always there
        may = np.array([pair.surface and self.capsules[pair.capsule].probe for pair in self.pairs])
        there = (placements[solid] == "") | (placements[solid] == placements[touched][:, None])
        return there & ~(may & (solid == touched[:, None]))

    def _own_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of capsules of the arm that can collide: not on the same or the next link, nor neighbours."""
        last = self.arm.robot.n  # the flange does not move against the last link
        out = []
        for b, second in enumerate(self.capsules):
            for a, first in enumerate(self.capsules[:b]):
                apart = min(second.frame, last) - min(first.frame, last) > 1
                if apart and np.mean(self._anywhere(Pair(a, second, "", other=b)) < 0) <= ALWAYS:
                    out.append((a, b))
        return tuple(out)

    def _rests(self, pair: Pair) -> bool:
        """Whether a capsule always starts within a shape, as a shoulder below the height of the table.

        Or whether its distance does not change with the arm, as that of a shoulder above it.
        """
        capsule = self.capsules[pair.capsule]
        frames = self.arm.frames(self._sample)[:, capsule.frame]
        starts = frames[:, :3, :3] @ capsule.a + frames[:, :3, 3]
        within = bool(np.all(pair.shape.distance(starts) < capsule.radius))
        return within or bool(np.ptp(self._anywhere(pair)) < STILL)

    def _anywhere(self, pair: Pair) -> np.ndarray:
        """Distances (SAMPLES,), m, of a pair at random configurations within the limits."""
        still = np.ones((SAMPLES, 1), bool)
        return Pairs(self.arm, self.capsules, (pair,)).closest(self._sample, self._sample, still)[0]

    @cached_property
    def _sample(self) -> np.ndarray:
        """Random readings (SAMPLES, n), rad."""
        limits = np.clip(self.arm.robot.limits, -np.pi, np.pi)
        angles = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (SAMPLES, len(limits)))
        return self.arm.readings_of(angles)
