"""Groups of rows that may share a cause: target, tool, direction of motion, pose, period of time, slip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.model.scene import Scene

SHORTEST = 4
"""Rows of the shortest stretch of time, and of the smallest neighbourhood of a pose."""
COARSEST = 8
"""A joint's range is looked at in parts of 1/8, 1/4 and 1/2 of its rows."""
SLIPS = 400
"""Rows of a tool or target at which a slip is tried: all of most sessions (cost)."""
CENTRES = 200
"""At most so many poses whose neighbourhoods are looked at."""
MOST_ENTRIES = 4_000_000
"""Rows of all slips of a tool, and twice those of all neighbourhoods: sessions of more than 10 000 rows have
fewer of them."""


@dataclass(frozen=True)
class Group:
    """Rows that have something in common."""

    kind: str  # target, tool, session, role, payload, direction of motion, joint range, pose, slip, ...
    label: str
    rows: np.ndarray  # (K,) positions among the rows that were given, in order


def groups_of(scene: Scene, rows: np.ndarray) -> tuple[Group, ...]:
    """All groups of some rows of a session that hold some, but not all, of them."""
    every = (*_named(scene, rows), *_directions(scene, rows), *_ranges(scene, rows),
             *_neighbourhoods(scene, rows), *_stretches(scene, rows), *_slips(scene, rows))  # fmt: skip
    return tuple(g for g in every if 0 < len(g.rows) < len(rows))


def _named(scene: Scene, rows: np.ndarray) -> Iterator[Group]:
    d, m = scene.dataset, scene.dataset.measurements
    target = m.target[rows]
    columns: dict[str, np.ndarray] = {
        "target": np.array([t.name for t in d.targets])[target],
        "tool": np.array([t.name for t in d.tools])[m.tool[rows]],
        "session": np.array([t.session for t in d.targets])[target],
        "role": m.role[rows],
    }
    if m.payload is not None:
        columns["payload"] = np.array([f"{kg:g} kg" for kg in m.payload[rows]])
    for kind, values in columns.items():
        for value in np.unique(values):
            yield Group(kind, str(value), np.flatnonzero(values == value))


def _directions(scene: Scene, rows: np.ndarray) -> Iterator[Group]:
    velocity = scene.dataset.measurements.velocity
    if velocity is None:
        return
    names = scene.dataset.robot.joint_names
    for name, v in zip(names, velocity[rows].T, strict=True):
        for sign, way in ((1.0, "positive"), (-1.0, "negative")):
            yield Group("direction of motion", f"{way} motion of {name}", np.flatnonzero(sign * v > 0))


def _ranges(scene: Scene, rows: np.ndarray) -> Iterator[Group]:
    readings, names = scene.dataset.measurements.readings[rows], scene.dataset.robot.joint_names
    for name, q in zip(names, np.degrees(readings).T, strict=True):
        order = np.argsort(q, kind="stable")
        for start, stop in _windows(len(rows), max(len(rows) // COARSEST, SHORTEST)):
            part = order[start:stop]
            label = f"{name} from {q[part[0]]:.0f} to {q[part[-1]]:.0f} deg"
            yield Group("joint range", label, np.sort(part))


def _neighbourhoods(scene: Scene, rows: np.ndarray) -> Iterator[Group]:
    from scipy.spatial import cKDTree  # slow to import, and without many outliers not needed

    m = scene.dataset.measurements
    readings = m.readings[rows]
    # each joint by its own spread: a wrist turns further than a shoulder
    at = readings / np.maximum(np.std(readings, axis=0), 1e-6)
    tree, size = cKDTree(at), SHORTEST
    centres = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _affordable(CENTRES, rows))).astype(int))
    while size <= len(rows) // 4:
        near = np.asarray(tree.query(at[centres], k=size)[1])
        for centre, mine in zip(centres, near, strict=True):
            yield Group("pose", f"poses near that of row {m.ids[rows[centre]]}", np.sort(mine))
        size *= 2


def _stretches(scene: Scene, rows: np.ndarray) -> Iterator[Group]:
    m = scene.dataset.measurements
    order = np.argsort(rows if m.time is None else m.time[rows], kind="stable")
    for start, stop in _windows(len(rows), SHORTEST):
        part = order[start:stop]
        label = f"rows {m.ids[rows[part[0]]]} to {m.ids[rows[part[-1]]]}"
        yield Group("stretch of time", label, np.sort(part))


def _slips(scene: Scene, rows: np.ndarray) -> Iterator[Group]:
    """All rows of a tool or a target from one row on, and all before: what a slip of it separates."""
    d, m = scene.dataset, scene.dataset.measurements
    time = rows if m.time is None else m.time[rows]
    for kind, of, names in (("tool", m.tool, d.tools), ("target", m.target, d.targets)):
        for k in np.unique(of[rows]):
            own = np.flatnonzero(of[rows] == k)
            own = own[np.argsort(time[own], kind="stable")]
            possible = max(len(own) - 2 * SHORTEST + 1, 0)
            at = np.linspace(SHORTEST, len(own) - SHORTEST, min(possible, _affordable(SLIPS, rows)))
            for first in np.unique(at.astype(int)):
                row, name = m.ids[rows[own[first]]], names[k].name
                yield Group("slip", f"{kind} {name} from row {row} on", np.sort(own[first:]))
                yield Group("slip", f"{kind} {name} before row {row}", np.sort(own[:first]))


def _affordable(most: int, rows: np.ndarray) -> int:
    """At most `most` groups, of which each may have a good part of all rows."""
    return max(min(most, MOST_ENTRIES // len(rows)), 1)


def _windows(count: int, shortest: int) -> Iterator[tuple[int, int]]:
    """Windows of `shortest` rows and its doubles up to half of all, each half over the one before."""
    size = shortest
    while size <= count // 2:
        for start in range(0, count - size // 2, max(size // 2, 1)):
            yield start, min(start + size, count)
        size *= 2
