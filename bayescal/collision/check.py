"""Whether an arm at given readings collides with itself or with what stands around it, and its clearance.

For most pairs of shapes, bounds of their distance decide: from the distance of the middle of a capsule,
computed for all configurations at once. Only pairs that the bounds leave undecided are computed exactly
(`exact`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.arm.nominal import NominalArm
from bayescal.arm.robot import Robot
from bayescal.arm.transforms import length
from bayescal.collision.exact import distances, overlap
from bayescal.collision.links import arm_capsules
from bayescal.collision.scene import Solid
from bayescal.collision.shapes import Capsule, Shape
from bayescal.dataset.types import Tool

ALWAYS = 0.5
"""Links that overlap in more than this share of random configurations are neighbours whose capsules are wider
than the links: not compared. (The MoveIt Setup Assistant excludes pairs that always collide, in the same
way.)"""
SAMPLES = 200


@dataclass(frozen=True)
class Pair:
    """Two shapes that must not overlap: a capsule of the arm (its index), and one of a solid or of the arm.

    `solid` is the index of the solid, -1 if the other is part of the arm, with index `other`. `surface`: the
    shape is the surface that a contact touches.
    """

    capsule: int
    shape: Shape
    reason: str
    solid: int = -1
    other: int = -1
    surface: bool = False


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
            0 if free, otherwise an index into `reasons`: the first pair that is found to overlap.
        """
        if not self.pairs:
            return np.zeros(len(readings), int)
        at = _Placed(self, readings)
        lower, upper = at.bounds()
        compared = self._compared(len(readings), touched)
        sure = compared & (upper < 0)
        out = np.where(sure.any(axis=1), np.argmax(sure, axis=1) + 1, 0)
        undecided = compared & (lower < 0)
        for k in np.flatnonzero(undecided[out == 0].any(axis=0)):
            left = np.flatnonzero(undecided[:, k] & (out == 0))
            if len(left):
                out[left[overlap(*at.of(self.pairs[k], left))]] = k + 1
        return out

    def distances(self, readings: np.ndarray, touched: np.ndarray | None = None) -> np.ndarray:
        """Smallest signed distances (M,), m, of pairs that must not overlap; parameters as for `collides`.

        inf if there is nothing to compare.
        """
        if not self.pairs:
            return np.full(len(readings), np.inf)
        at = _Placed(self, readings)
        lower, upper = at.bounds()
        compared = self._compared(len(readings), touched)
        lower = np.where(compared, lower, np.inf)
        best = np.where(compared, upper, np.inf).min(axis=1)
        for k in np.argsort(np.median(lower, axis=0)):
            left = np.flatnonzero(lower[:, k] < best)
            if len(left):
                best[left] = np.minimum(best[left], distances(*at.of(self.pairs[k], left)))
        return best

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
                if apart and self._overlapping(Pair(a, second, "", other=b)) <= ALWAYS:
                    out.append((a, b))
        return tuple(out)

    def _overlapping(self, pair: Pair) -> float:
        """In which share of random configurations the two shapes of a pair overlap."""
        return float(overlap(*self._anywhere.of(pair, np.arange(SAMPLES))).mean())

    def _rests(self, pair: Pair) -> bool:
        """Whether a capsule always starts within a shape, as a shoulder below the height of the table."""
        capsule, frames = (
            self.capsules[pair.capsule],
            self._anywhere.frames[:, self.capsules[pair.capsule].frame],
        )
        starts = frames[:, :3, :3] @ capsule.a + frames[:, :3, 3]
        return bool(np.all(pair.shape.distance(starts) < capsule.radius))

    @cached_property
    def _anywhere(self) -> _Placed:
        """The arm at random configurations within its limits."""
        limits = np.clip(self.arm.robot.limits, -np.pi, np.pi)
        angles = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (SAMPLES, len(limits)))
        return _Placed(self, self.arm.readings_of(angles))


class _Placed:
    """The capsules of an arm at M configurations, by the poses of their middles in F0, (M, C, 4, 4)."""

    def __init__(self, clearance: Clearance, readings: np.ndarray) -> None:
        self.clearance = clearance
        self.frames = clearance.arm.frames(readings)
        capsules = clearance.capsules
        own = np.array([c.pose for c in capsules]).reshape(-1, 4, 4)
        self.poses = self.frames[:, [c.frame for c in capsules]] @ own

    def of(self, pair: Pair, rows: np.ndarray) -> tuple[Capsule, np.ndarray, Shape, np.ndarray | None]:
        """A pair in some rows, as `exact` takes it."""
        others = self.poses[rows, pair.other] if pair.other >= 0 else None
        return self.clearance.capsules[pair.capsule], self.poses[rows, pair.capsule], pair.shape, others

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds (M, P) of the signed distances of all pairs, m."""
        capsules, pairs = self.clearance.capsules, self.clearance.pairs
        middle = self.poses[:, :, :3, 3]
        radius, half = np.array([(c.radius, 0.5 * c.length) for c in capsules]).T
        by_shape = {id(pair.shape): pair.shape for pair in pairs if pair.other < 0}
        away = {key: shape.distance(middle) for key, shape in by_shape.items()}
        upper = np.empty((len(middle), len(pairs)))
        first = np.array([pair.capsule for pair in pairs])
        second = np.array([pair.other for pair in pairs])
        for k, pair in enumerate(pairs):
            if pair.other < 0:
                upper[:, k] = away[id(pair.shape)][:, pair.capsule]
        own = second >= 0
        apart = length(middle[:, first[own]] - middle[:, second[own]])
        upper[:, own] = apart - radius[second[own]]
        upper -= radius[first]
        return upper - half[first] - np.where(own, half[second], 0.0), upper
