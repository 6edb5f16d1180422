"""Whether an arm at given readings collides with itself or with what stands around it, and its clearance.

For most pairs of shapes, bounds of their distance decide: from the distance of the middle of a capsule,
computed for all configurations at once. Only pairs that the bounds leave undecided are computed exactly
(`exact`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.arm.nominal import NominalArm
from bayescal.arm.robot import Robot
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
                    if capsule.frame > 0 and not (solid.carries and self._overlapping(pair) == 1.0):
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
        at = _Placed(self, readings)
        out = np.zeros(len(readings), int)
        undecided = []
        for k, pair, rows in self._rows(len(readings), touched):
            lower, upper = at.bounds(pair, rows)
            out[rows[(upper < 0) & (out[rows] == 0)]] = k + 1
            undecided.append((k, pair, rows[(lower < 0) & (upper >= 0)]))
        for k, pair, rows in undecided:
            left = rows[out[rows] == 0]
            if len(left):
                out[left[overlap(*at.of(pair, left))]] = k + 1
        return out

    def distances(self, readings: np.ndarray, touched: np.ndarray | None = None) -> np.ndarray:
        """Smallest signed distances (M,), m, of pairs that must not overlap; parameters as for `collides`.

        inf if there is nothing to compare.
        """
        at = _Placed(self, readings)
        best = np.full(len(readings), np.inf)
        rest = []
        for _, pair, rows in self._rows(len(readings), touched):
            lower, upper = at.bounds(pair, rows)
            best[rows] = np.minimum(best[rows], upper)
            rest.append((lower, pair, rows))
        for lower, pair, rows in sorted(rest, key=lambda item: float(np.median(item[0]))):
            left = rows[lower < best[rows]]
            if len(left):
                best[left] = np.minimum(best[left], distances(*at.of(pair, left)))
        return best

    def _rows(self, count: int, touched: np.ndarray | None) -> Iterator[tuple[int, Pair, np.ndarray]]:
        """Each pair with its number and the indices of the rows, of M, in which it is compared."""
        touched = np.full(count, -1) if touched is None else np.asarray(touched, int)
        placements = np.array([*(solid.placement for solid in self.solids), ""])[touched]
        everywhere = np.arange(count)
        of_solid = [
            everywhere if solid.placement == "" else np.flatnonzero(placements == solid.placement)
            for solid in self.solids
        ]
        for k, pair in enumerate(self.pairs):
            rows = everywhere if pair.solid < 0 else of_solid[pair.solid]
            if pair.surface and self.capsules[pair.capsule].probe:
                rows = rows[touched[rows] != pair.solid]
            if len(rows):
                yield k, pair, rows

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

    @cached_property
    def _anywhere(self) -> _Placed:
        """The arm at random configurations within its limits."""
        limits = np.clip(self.arm.robot.limits, -np.pi, np.pi)
        angles = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (SAMPLES, len(limits)))
        return _Placed(self, self.arm.readings_of(angles))


class _Placed:
    """The capsules of an arm at M configurations, by the poses of their middles in F0."""

    def __init__(self, clearance: Clearance, readings: np.ndarray) -> None:
        frames = clearance.arm.frames(readings)
        self.capsules = clearance.capsules
        self.poses = [frames[:, c.frame] @ c.pose for c in self.capsules]

    def of(self, pair: Pair, rows: np.ndarray) -> tuple[Capsule, np.ndarray, Shape, np.ndarray | None]:
        """A pair in some rows, as `exact` takes it."""
        others = self.poses[pair.other][rows] if pair.other >= 0 else None
        return self.capsules[pair.capsule], self.poses[pair.capsule][rows], pair.shape, others

    def bounds(self, pair: Pair, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the signed distance of a pair in some rows, m."""
        capsule, middle = self.capsules[pair.capsule], self.poses[pair.capsule][rows, :3, 3]
        half = 0.5 * capsule.length
        if pair.other >= 0:
            other = self.capsules[pair.other]
            half += 0.5 * other.length
            apart = np.linalg.norm(middle - self.poses[pair.other][rows, :3, 3], axis=1) - other.radius
        else:
            apart = pair.shape.distance(middle)
        return apart - capsule.radius - half, apart - capsule.radius
