"""Measured orientations of an import: from the columns of the log, and compared with the nominal arm.

Position of an instrument, and of its reflector on the flange: a rigid fit to the nominal arm.

Positions of instruments and reflectors that are not stated, estimated with the nominal arm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import Robot, chain_of, frames, link_angles
from bayescal.arm.transforms import rigid_alignment, rpy_matrix, rpy_of
from bayescal.dataset import Dataset, Target
from bayescal.errors import BayescalError
from bayescal.importing.columns import Columns, first
from bayescal.importing.rotations import CONVENTIONS, matrices, not_rotations, roll_pitch_yaw

PASSES = 20
"""Turns of frames and TCP positions; what is left then is far below an arm's errors."""

LEAST = 1e-4
"""m: misfits below this weigh in full."""

GENTLE = 1e-6
"""Weight, against all points', that keeps a reflector at the flange where nothing tells its place."""


def flanges(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Nominal poses of the flange in F0, (N, 4, 4), of readings (N, n), rad."""
    return frames(chain_of(robot), link_angles(robot, readings))[:, -1]


@dataclass(frozen=True)
class Sightings:
    """N rows that instruments saw: nominal flanges, points, and which instrument and tool each is of."""

    flange: np.ndarray  # (N, 4, 4) in F0
    seen: np.ndarray  # (N, 3) m, in the instrument's own frame
    station: np.ndarray  # (N,) int
    tool: np.ndarray  # (N,) int


def fit(rows: Sightings, centres: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit instruments' frames, and the TCP positions that are not known, to the nominal arm.

    A linear fit in which the rotations are any matrices starts it; then frames and TCP positions in turn,
    each in closed form, with Cauchy weights, so that a few wild rows do not carry a frame away.

    Parameters
    ----------
    rows : Sightings
    centres : np.ndarray, shape (T, 3)
        TCP positions, m, in the flange frame; those not known may be anything.
    known : np.ndarray of bool, shape (T,)

    Returns
    -------
    tuple of np.ndarray
        The frames (S, 4, 4) in F0 and the centres (T, 3), m.
    """
    turn, origin = rows.flange[:, :3, :3], rows.flange[:, :3, 3]
    centres = centres.astype(float)
    if not known.all():
        centres[~known] = _start(rows, centres, known)[~known]
    weight = np.ones(len(origin))
    stations = [rows.station == s for s in range(rows.station.max() + 1)]
    frame_of = np.tile(np.eye(4), (len(stations), 1, 1))
    for _ in range(PASSES):
        p = origin + np.einsum("nij,nj->ni", turn, centres[rows.tool])
        for s, at in enumerate(stations):
            frame_of[s] = rigid_alignment(p[at], rows.seen[at], weight[at])
        own = frame_of[rows.station]
        goal = np.einsum("nij,nj->ni", own[:, :3, :3], rows.seen) + own[:, :3, 3]
        for t in np.flatnonzero(~known):
            at = rows.tool == t
            back = np.einsum("nji,nj->ni", turn[at], goal[at] - origin[at])
            centres[t] = weight[at] @ back / weight[at].sum()
        off = np.linalg.norm(origin + np.einsum("nij,nj->ni", turn, centres[rows.tool]) - goal, axis=1)
        weight = 1 / (1 + (off / max(LEAST, 2 * float(np.median(off)))) ** 2)
    return frame_of, centres


def _start(rows: Sightings, centres: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Centres (T, 3) of ``origin + turn c = M seen + t`` with any matrices M: linear least squares."""
    turn, b = rows.flange[:, :3, :3], rows.flange[:, :3, 3].copy()
    count, frames_, tools = len(b), 12 * (rows.station.max() + 1), len(known)
    a = np.zeros((count, 3, frames_ + 3 * tools))
    row, scale = np.arange(count), max(float(np.abs(rows.seen).max()), 1e-9)
    for axis in range(3):
        for k in range(3):
            a[row, axis, 12 * rows.station + 3 * axis + k] = rows.seen[:, k] / scale
        a[row, axis, 12 * rows.station + 9 + axis] = 1.0
    for t in range(tools):
        at = rows.tool == t
        if known[t]:
            b[at] += turn[at] @ centres[t]
        else:
            a[at, :, frames_ + 3 * t : frames_ + 3 * t + 3] = -turn[at]
    ridge = np.sqrt(GENTLE * count) * np.eye(a.shape[2])[frames_:]
    equations = np.concatenate([a.reshape(-1, a.shape[2]), ridge])
    x = np.linalg.lstsq(equations, np.concatenate([b.ravel(), np.zeros(len(ridge))]), rcond=None)[0]
    return x[frames_:].reshape(tools, 3)


APART = np.radians(5.0)
"""Typical difference between arm and reading that no nominal arm has: another convention."""

FEWEST = 4
"""Rows from which the orientations of a tool can be judged."""


def measured(columns: Columns) -> np.ndarray | None:
    """Roll, pitch, yaw (N, 3), rad, that the log states in any convention; None if it states none.

    Raises
    ------
    BayescalError
        For numbers that are no rotation, and for two statements of the same.
    """
    convention, values = _stated(columns)
    if values is None:
        return None
    bad, what = not_rotations(values, convention)
    remedy = "check the columns and the convention of `rotation`"
    first(columns, bad, lambda row: f"{_few(values[row])} is not {what}", remedy)
    return roll_pitch_yaw(matrices(values, convention)) if convention != "rpy" else values


def compared(dataset: Dataset, columns: Columns) -> tuple[str, bool]:
    """Compare the orientations with the nominal arm.

    Between the frames of flange and tool there is one rotation for each tool, whatever the row: as stated, or
    the mean.

    Returns
    -------
    tuple of str and bool
        The convention and the typical difference in words, "" without orientations; and whether they agree.
        If they do not, the words name the convention that agrees, if there is one.
    """
    convention, values = _stated(columns)
    if values is None:
        return "", True
    off, words = _error(dataset, matrices(values, convention)), CONVENTIONS[convention].words
    if off is None:
        return f"orientations are read as {words}; too few to compare them with the arm", True
    if off <= APART:
        within = f"within {np.degrees(off):.2g} deg (median) of the nominal arm"
        return f"orientations are read as {words}: {within}", True
    same = CONVENTIONS[convention].count, CONVENTIONS[convention].angles
    others = {
        name: error
        for name, other in CONVENTIONS.items()
        if (other.count, other.angles) == same
        and (error := _error(dataset, matrices(values, name))) is not None
    }
    best = min(others, key=lambda name: others[name])
    what = f"orientations as {convention} differ from the nominal arm by {np.degrees(off):.0f} deg (median)"
    if others[best] < APART:
        what += f", as {best} by {np.degrees(others[best]):.2g} deg"
    return what, False


def _stated(columns: Columns) -> tuple[str, np.ndarray | None]:
    """The convention, and the numbers (N, count) of the log, or None."""
    plain = [key for key in ("rx", "ry", "rz") if key in columns.numbers]
    column = columns.said.get("rotation")
    if column is None:
        if not plain:
            return "", None
        if len(plain) < 3:
            missing = next(key for key in ("rx", "ry", "rz") if key not in plain)
            what = f"`{missing}` is not mapped, `{plain[0]}` is"
            raise BayescalError(what, columns.name, "map all of rx, ry, rz, or none")
        return "rpy", np.column_stack([columns.numbers[key] for key in plain])
    if plain:
        raise BayescalError(f"`rotation` and `{plain[0]}` are both mapped", columns.name, "keep one of them")
    count = CONVENTIONS[column.turn].count
    return column.turn, np.column_stack([columns.numbers[f"rotation{i}"] for i in range(count)])


def _error(dataset: Dataset, turns: np.ndarray) -> float | None:
    """Median angle, rad, from the tool's stated frame or the rows' mean to that of each; None for too few."""
    rows = dataset.measurements
    at = np.flatnonzero(np.isfinite(turns).all(axis=(1, 2)))
    placed = [t.values.get("rpy") is not None for t in dataset.targets]
    at = at[np.array(placed)[rows.target[at]]]
    flange = flanges(dataset.robot, rows.readings)[:, :3, :3]
    off = []
    for tool in np.unique(rows.tool[at]):
        mine = at[rows.tool[at] == tool]
        if len(mine) < FEWEST:
            continue
        frame = np.array([rpy_matrix(dataset.targets[t].values["rpy"]) for t in rows.target[mine]])
        between = Rotation.from_matrix(flange[mine].transpose(0, 2, 1) @ frame @ turns[mine])
        rpy = dataset.tools[tool].rpy
        stated = between.mean() if rpy is None else Rotation.from_matrix(rpy_matrix(rpy))
        off.append((stated.inv() * between).magnitude())
    return float(np.median(np.concatenate(off))) if off else None


def _few(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.6g}" for v in values) + ")"


UNPLACED_FEWEST = {False: 4, True: 6}
"""Rows of one instrument needed to place it, and to place a reflector with it."""


@dataclass(frozen=True)
class Loose:
    """Names of the instruments and tools that are found from the rows themselves."""

    targets: tuple[str, ...] = ()
    tools: tuple[str, ...] = ()

    def check(self, dataset: Dataset) -> None:
        """Refuse too few rows to find these from."""
        rows = dataset.measurements
        fewest = UNPLACED_FEWEST[bool(self.tools)]
        for index, target in enumerate(dataset.targets):
            count = int((rows.target == index).sum())
            if target.name in self.targets and count < fewest:
                what = f"{count} points of `{target.name}` do not determine its position"
                raise BayescalError(what, "", f"give at least {fewest}, or a --template with its position")

    def settled(self, dataset: Dataset) -> Dataset:
        """The dataset with these where its rows and the nominal arm put them."""
        rows = dataset.measurements
        if not self.targets or rows.xyz is None:
            return dataset
        mine = np.array([t.name in self.targets for t in dataset.targets])[rows.target]
        mine &= np.isfinite(rows.xyz).all(axis=1)
        used, station = np.unique(rows.target[mine], return_inverse=True)
        known = np.array([t.name not in self.tools for t in dataset.tools])
        sightings = Sightings(
            flanges(dataset.robot, rows.readings[mine]), rows.xyz[mine], station.ravel(), rows.tool[mine]
        )
        frames, centres = fit(sightings, np.array([t.centre for t in dataset.tools]), known)
        targets = list(dataset.targets)
        for index, frame in zip(used, frames, strict=True):
            place: dict[str, np.ndarray | float] = {"xyz": frame[:3, 3], "rpy": rpy_of(frame[:3, :3])}
            targets[index] = Target(targets[index].name, "instrument", place)
        tools = tuple(replace(t, centre=c) for t, c in zip(dataset.tools, centres, strict=True))
        return replace(dataset, targets=tuple(targets), tools=tools)
