"""Free motions of an arm at one place: among the solids that are there at the same time, with one tool.

The nominal arm of a search: within the joint limits by a margin, and where an operator would put it.
"""

import pickle
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from bayescal.arm.chain import Robot
from bayescal.arm.motion import NominalArm
from bayescal.probing.clearance import Clearance

MARGIN = np.radians(4.0)
"""rad, m: margin to the joint limits, so that a contact can still be closed."""

DIRECTED = 6
"""Joints from which on a tool can have any direction at a place: the last of five turns it about itself."""
CONE, CONE_OF_FEW = np.radians(60.0), np.radians(100.0)
"""rad: greatest angle of the z axis of a tool that states none to the inward normal (assumed): of an arm
of `DIRECTED` joints or more, and of one of fewer, which touches a wall with the side of the ball."""

BEHIND, FLOOR = -0.05, -0.1  # relative to the reach: limits of the arm behind and below the base


def cone_of(robot: Robot) -> float:
    """Working cone of a tool that states none: greatest angle to the inward normal, rad."""
    return CONE if robot.n >= DIRECTED else CONE_OF_FEW


@dataclass(frozen=True, eq=False)
class Arm(NominalArm):
    """The nominal arm with its tool, for planning: where it can be, and where an operator would put it.

    Arms of equal content are equal, so that positions that depend on the arm alone are searched once.
    """

    @cached_property
    def content(self) -> bytes:
        """All numbers of the robot and the tool."""
        robot = [getattr(self.robot, field.name) for field in fields(self.robot)]
        return pickle.dumps([*robot, self.tool, self.tool_axes])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Arm) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)

    @cached_property
    def range(self) -> np.ndarray:
        """Limits (2, n), rad or m, reduced by the margin; a range of at most one revolution."""
        most, limits = np.where(self.robot.slides, np.inf, np.pi), self.robot.limits_within(2 * np.pi)
        middle, half = limits.mean(axis=1), np.diff(limits, axis=1)[:, 0] / 2
        half = np.minimum(half - np.minimum(MARGIN, 0.2 * half), most)
        return np.stack([middle - half, middle + half])

    @cached_property
    def _lead(self) -> tuple[int, np.ndarray]:
        """Number of prismatic joints that carry all others, and frame (4, 4) of the last, at mid-range."""
        lead = int(np.argmin(self.robot.slides))  # 0 too if all joints slide
        return lead, self.frames(self.readings_of(self.range.mean(axis=0)[None]))[0, lead]

    @cached_property
    def mount(self) -> np.ndarray:
        """Pose (4, 4) in F0 of what carries the first revolute joint: base, or carriage at mid-range."""
        lead, carriage = self._lead
        return carriage @ self.chain.link[lead] if lead else self.chain.base

    def travel(self, pose: np.ndarray) -> np.ndarray:
        """Shifts (M, 3), m, of the carriage from mid-range at poses (M, n + 2, 4, 4); zeros without one."""
        lead, carriage = self._lead
        return pose[:, lead, :3, 3] - carriage[:3, 3] if lead else np.zeros((len(pose), 3))

    @cached_property
    def reach(self) -> float:
        """Reach of the ball from the origin of the mount, m: nearly the maximum over random poses."""
        pose = self.frames(self.anywhere(4000, np.random.default_rng(0)))
        ball = self.ball(pose) - self.travel(pose)
        return float(np.percentile(np.linalg.norm(ball - self.mount[:3, 3], axis=1), 99))

    def beside(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Horizontal positions (..., 2) and heights (...) above the mount, m, of points (..., 3) in F0."""
        local = (points - self.mount[:3, 3]) @ self.mount[:3, :3]
        return local[..., :2], local[..., 2]

    def upright(self, pose: np.ndarray) -> np.ndarray:
        """Which poses (M, n + 2, 4, 4) an operator could choose, (M,).

        No part of the arm is behind the base, seen from the ball, or too far below it.
        """
        travel = self.travel(pose)
        flat, height = self.beside(pose[:, self._lead[0] + 2 :, :3, 3] - travel[:, None])
        to, _ = self.beside(self.ball(pose) - travel)
        to = to / np.maximum(np.linalg.norm(to, axis=1), 1e-9)[:, None]
        ahead = np.einsum("mfi,mi->mf", flat, to).min(axis=1)
        return (ahead > BEHIND * self.reach) & (height.min(axis=1) > FLOOR * self.reach)

    def anywhere(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Readings (count, n), rad, uniform within the limits."""
        low, high = self.range
        return self.readings_of(rng.uniform(low, high, (count, self.robot.n)))


CLEAR = 5e-3
"""m: smallest clearance of motions where none is stated (assumed: some times what an arm that is not
calibrated is off)."""
RATE = np.radians(45.0)
"""rad/s, m/s: mean velocity of a joint between contacts (assumed: a quarter of that of a small arm)."""
NODES = 1500  # random configurations, of which the motion may pass some
AT_ONCE = 8  # of them that are tried at once, those of the shortest way first
MOST = 48
"""Configurations that are tried alone, before several of them one after the other are."""
NEIGHBOURS = 8  # of each configuration, to which motions are considered
CHAINED = (400, 60), (NODES, 250)
"""Configurations of which a way may pass several, and how many of them are considered next to its ends; the
second where no way is found with the first."""
ROUNDS = 200  # of a search for a way over several configurations
RAISED = 0.1
"""m: distance of the tool from all solids where the arm waits for a change, if it can be had (assumed)."""
HUBS = 300  # raised configurations between which motions are checked
LINKED = 12  # of those that are connected, to one of which a free motion must exist
TOLERANCE = 1e-3
"""m: by how much the clearance of a way may be stated too small, if less than a tenth of it."""


def seconds_between(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Times (...), s, of motions between readings (..., n), rad."""
    return np.abs(end - begin).max(axis=-1, initial=0.0) / RATE


@dataclass(frozen=True, eq=False)
class Place:
    """An arm with its tool among the solids that are there at the same time.

    `anywhere` (K, n), rad, are readings of which motions may pass some; `floor`, m, is the smallest clearance
    of a motion.
    """

    clearance: Clearance
    anywhere: np.ndarray
    floor: float

    def free(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Which motions from `begin` to `end`, readings (M, n), rad, keep the clearance, (M,)."""
        return self.clearance.hits(begin, end, self.floor) == 0

    @cached_property
    def nodes(self) -> np.ndarray:
        """Random readings (K, n), rad, that are free."""
        some = self.anywhere[:NODES]
        return some[self.free(some, some)]

    @cached_property
    def raised(self) -> np.ndarray:
        """Readings (K, n), rad, at which the arm can wait, with its tool far from all solids."""
        away = np.minimum(self.away(self.nodes), RAISED)
        return self.nodes[away >= np.quantile(away, 0.9)] if len(away) else self.nodes

    def away(self, readings: np.ndarray) -> np.ndarray:
        """Distances (M,), m, of the tool from all solids at readings (M, n); -1 where the arm is not free."""
        tool = tuple(c for c in self.clearance.capsules if c.frame > self.clearance.arm.robot.n)
        away = replace(self.clearance, capsules=tool, self_pairs=()).distances(readings)
        return np.where(self.free(readings, readings), away, -1.0)

    def linked(self, readings: np.ndarray) -> np.ndarray:
        """Whether a free motion from each of readings (M, n), rad, leads to one of `hubs`, (M,)."""
        out, count = np.zeros(len(readings), bool), min(LINKED, len(self.hubs))
        near = _neighbours(self.hubs, readings, count)
        for k in range(count):
            rows = np.flatnonzero(~out)
            out[rows] = self.free(readings[rows], self.hubs[near[rows, k]])
        return out

    @cached_property
    def hubs(self) -> np.ndarray:
        """The most raised configurations (K, n) that free motions connect."""
        some = self.raised[:HUBS]
        near = _neighbours(some, some, min(NEIGHBOURS, len(some)))
        a, b = np.repeat(np.arange(len(some)), near.shape[1]), near.ravel()
        ok = self.free(some[a], some[b])
        joined = csr_matrix((ok[ok], (a[ok], b[ok])), (len(some), len(some)))
        label = connected_components(joined, directed=False)[1]
        return some[label == np.bincount(label).argmax()] if len(some) else some

    def ways(self, begin: np.ndarray, end: np.ndarray) -> list[np.ndarray | None]:
        """Readings (K, n), rad, to pass between readings (M, n), most often none; None if no way is found.

        Where the motion is not free, the configurations of the shortest ways are tried, for all motions at
        once; then several of them one after the other.
        """
        free = self.free(begin, end)
        out: list[np.ndarray | None] = [begin[:0] if direct else None for direct in free]
        detour = seconds_between(begin[:, None], self.nodes) + seconds_between(self.nodes, end[:, None])
        order = np.argsort(detour, axis=1, kind="stable")
        rows = np.flatnonzero(~free)
        for first in range(0, min(MOST, order.shape[1]), AT_ONCE):
            k = order[rows, first : first + AT_ONCE]
            move, some = np.repeat(rows, k.shape[1]), self.nodes[k.ravel()]
            ok = self.free(begin[move], some)
            ok[ok] = self.free(some[ok], end[move[ok]])
            for m in np.unique(move[ok]):
                out[m] = some[[int(np.argmax(ok & (move == m)))]]
            rows = np.array([m for m in rows if out[m] is None], int)
        for count, ends in CHAINED:
            for m, way in zip(rows, self._chained(begin[rows], end[rows], count, ends), strict=True):
                out[m] = way
            rows = np.array([m for m in rows if out[m] is None], int)
        return out

    def _chained(self, begin: np.ndarray, end: np.ndarray, count: int, ends: int) -> list[np.ndarray | None]:
        """As `ways`, past several configurations: the shortest way whose motions are all found free.

        Only the motions of ways that are the shortest yet are checked (Bohlin and Kavraki 2000, "Path
        planning using lazy PRM").
        """
        nodes, cost, verified = self._graph(count)
        n = len(nodes)
        out: list[np.ndarray | None] = [None] * len(begin)
        if n < 2:
            return out
        costs = np.full((len(begin), n + 2, n + 2), np.inf)  # from the begin, n, and to the end, n + 1
        costs[:, n, :n] = _nearest(seconds_between(begin[:, None], nodes), ends)
        costs[:, :n, n + 1] = _nearest(seconds_between(nodes, end[:, None]), ends)
        sure = np.zeros(costs.shape, bool)
        searched = list(range(len(begin)))
        for _ in range(ROUNDS):
            asked: list[tuple[int, int, int]] = []
            for m in list(searched):
                costs[m, :n, :n], sure[m, :n, :n] = cost, verified
                path = _shortest(costs[m], n)
                new = [(m, i, j) for i, j in pairwise(path) if not sure[m, i, j]]
                asked += new
                if not new:
                    searched.remove(m)
                    out[m] = nodes[path[1:-1]] if path else None
            if not asked:
                break
            points = {m: np.concatenate([nodes, begin[[m]], end[[m]]]) for m, _, _ in asked}
            a, b = (np.array([points[e[0]][e[k]] for e in asked]) for k in (1, 2))
            for (m, i, j), free in zip(asked, self.free(a, b), strict=True):
                shared = max(i, j) < n
                for x, y in ((i, j), (j, i)) if shared else ((i, j),):
                    times, checked = (cost, verified) if shared else (costs[m], sure[m])
                    checked[x, y] = True
                    times[x, y] = times[x, y] if free else np.inf
        return out

    @cached_property
    def _graphs(self) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        return {}

    def _graph(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes (n, k), times of motions between near ones (n, n), inf for others, and which were checked."""
        if count in self._graphs:
            return self._graphs[count]
        nodes = np.concatenate([self.hubs, self.nodes])[:count]
        times = seconds_between(nodes[:, None], nodes)
        far = times > np.sort(times, axis=1)[:, : NEIGHBOURS + 1].max(axis=1, initial=0.0)[:, None]
        self._graphs[count] = nodes, np.where(far & far.T, np.inf, times), np.zeros(times.shape, bool)
        return self._graphs[count]


def _neighbours(among: np.ndarray, readings: np.ndarray, count: int) -> np.ndarray:
    """The `count` nearest of `among` (K, n) to each of readings (M, n), (M, count), the nearest first."""
    if not count:
        return np.empty((len(readings), 0), int)
    return np.asarray(cKDTree(among).query(readings, count, p=np.inf)[1]).reshape(len(readings), count)


def _nearest(times: np.ndarray, count: int) -> np.ndarray:
    """Times (M, n), inf except for the `count` shortest of each row."""
    count = min(count, times.shape[1])
    return np.where(times <= np.partition(times, count - 1, axis=1)[:, count - 1, None], times, np.inf)


def _shortest(times: np.ndarray, first: int) -> list[int]:
    """The shortest path from `first` to the point after it, by times (n, n); empty if there is none."""
    there = np.isfinite(times) & (times > 0)
    ends = np.append(0, np.cumsum(np.count_nonzero(there, axis=1)))
    graph = csr_matrix((times[there], np.nonzero(there)[1], ends), times.shape)
    _, predecessors = dijkstra(graph, indices=np.array([first]), return_predecessors=True)
    before = predecessors[0]
    path = [first + 1]
    while path[-1] != first:
        if before[path[-1]] < 0:
            return []
        path.append(int(before[path[-1]]))
    return path[::-1]
