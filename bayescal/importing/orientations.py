"""Orientations and positions that are not stated, compared with and estimated from the nominal arm."""

from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.hand_eye import angle
from bayescal.arm.transforms import FAR, common_rotation, rigid_alignment, rpy_matrix, rpy_of
from bayescal.dataset import Dataset, Target
from bayescal.dataset.cameras import flange_poses
from bayescal.errors import BayescalError, listed
from bayescal.importing.columns import Columns, first
from bayescal.importing.units import CONVENTIONS, matrices, not_rotations, roll_pitch_yaw

PASSES = 20
"""Turns of frames and TCP positions; what is left then is far below an arm's errors."""

LEAST = 1e-4
"""m: misfits below this weigh in full."""

GENTLE = 1e-6
"""Weight, against all points', that keeps a reflector at the flange where nothing tells its place."""


@dataclass(frozen=True)
class Sightings:
    """N rows that instruments saw: nominal flanges, points, and which instrument and tool each is of."""

    flange: np.ndarray  # (N, 3, 4) in F0
    seen: np.ndarray  # (N, 3) m, in the instrument's own frame
    station: np.ndarray  # (N,) int
    tool: np.ndarray  # (N,) int


def fit(rows: Sightings, centres: np.ndarray, stated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit instruments' frames, and the TCP positions that are not stated, to the nominal arm.

    A linear fit in which the rotations are any matrices starts it; then frames and TCP positions in turn,
    each in closed form, with Cauchy weights, so that a few wild rows do not carry a frame away.

    Parameters
    ----------
    rows : Sightings
    centres : np.ndarray, shape (T, 3)
        TCP positions, m, in the flange frame; those not stated may be anything.
    stated : np.ndarray of bool, shape (T,)

    Returns
    -------
    tuple of np.ndarray
        The frames (S, 4, 4) in F0 and the centres (T, 3), m.
    """
    turn, origin = rows.flange[:, :3, :3], rows.flange[:, :3, 3]
    centres = centres.astype(float)
    if not stated.all():
        centres[~stated] = _start(rows, centres, stated)[~stated]
    weight = np.ones(len(origin))
    stations = [rows.station == s for s in range(rows.station.max() + 1)]
    frame_of = np.tile(np.eye(4), (len(stations), 1, 1))
    for _ in range(PASSES):
        p = origin + np.einsum("nij,nj->ni", turn, centres[rows.tool])
        for s, of_station in enumerate(stations):
            frame_of[s] = rigid_alignment(p[of_station], rows.seen[of_station], weight[of_station])
        frame = frame_of[rows.station]
        goal = np.einsum("nij,nj->ni", frame[:, :3, :3], rows.seen) + frame[:, :3, 3]
        for t in np.flatnonzero(~stated):
            of_tool = rows.tool == t
            back = np.einsum("nji,nj->ni", turn[of_tool], goal[of_tool] - origin[of_tool])
            centres[t] = weight[of_tool] @ back / weight[of_tool].sum()
        off = np.linalg.norm(origin + np.einsum("nij,nj->ni", turn, centres[rows.tool]) - goal, axis=1)
        weight = 1 / (1 + (off / max(LEAST, 2 * float(np.median(off)))) ** 2)
    return frame_of, centres


def _start(rows: Sightings, centres: np.ndarray, stated: np.ndarray) -> np.ndarray:
    """Centres (T, 3) of ``origin + turn c = M seen + t`` with any matrices M: linear least squares."""
    turn, b = rows.flange[:, :3, :3], rows.flange[:, :3, 3].copy()
    count, frames_, tools = len(b), 12 * (rows.station.max() + 1), len(stated)
    a = np.zeros((count, 3, frames_ + 3 * tools))
    row, scale = np.arange(count), max(float(np.abs(rows.seen).max()), 1e-9)
    for axis in range(3):
        for k in range(3):
            a[row, axis, 12 * rows.station + 3 * axis + k] = rows.seen[:, k] / scale
        a[row, axis, 12 * rows.station + 9 + axis] = 1.0
    for t in range(tools):
        of_tool = rows.tool == t
        if stated[t]:
            b[of_tool] += turn[of_tool] @ centres[t]
        else:
            a[of_tool, :, frames_ + 3 * t : frames_ + 3 * t + 3] = -turn[of_tool]
    ridge = np.sqrt(GENTLE * count) * np.eye(a.shape[2])[frames_:]
    equations = np.concatenate([a.reshape(-1, a.shape[2]), ridge])
    x = np.linalg.lstsq(equations, np.concatenate([b.ravel(), np.zeros(len(ridge))]), rcond=None)[0]
    return x[frames_:].reshape(tools, 3)


APART = np.radians(5.0)
"""Typical difference between arm and reading that no nominal arm has: another convention."""

MIRRORED = np.radians(10.0)
"""Angle from the common frame from which on a single orientation is a mistake."""

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
    angles = _angles(dataset, matrices(values, convention))
    words = CONVENTIONS[convention].words
    if np.isnan(angles).all():
        return f"orientations are read as {words}; too few to compare them with the arm", True
    if (off := float(np.nanmedian(angles))) <= APART:
        within = f"within {np.degrees(off):.2g} deg (median) of the nominal arm"
        far = np.flatnonzero(angles > max(MIRRORED, FAR * off))
        if len(far):
            ids = listed([dataset.measurements.ids[row] for row in far], 6)
            within += f"; {len(far)} are turned by {np.degrees(np.median(angles[far])):.0f} deg: {ids}"
            within += " (poses of a flat tag may be mirrored; leave these rows out)"
        return f"orientations are read as {words}: {within}", True
    kind = CONVENTIONS[convention].count, CONVENTIONS[convention].angles
    alike = [name for name, other in CONVENTIONS.items() if (other.count, other.angles) == kind]
    others = {name: float(np.nanmedian(_angles(dataset, matrices(values, name)))) for name in alike}
    best = min(others, key=lambda name: others[name])
    what = f"orientations as {convention} differ from the nominal arm by {np.degrees(off):.0f} deg (median)"
    if others[best] < APART:
        what += f", as {best} by {np.degrees(others[best]):.2g} deg"
    return what, False


def _stated(columns: Columns) -> tuple[str, np.ndarray | None]:
    """The convention, and the numbers (N, count) of the log, or None."""
    angles = ("rx", "ry", "rz")
    column = columns.said.get("rotation")
    if column is None:
        return "rpy", columns.block(angles)
    if clash := next((key for key in angles if key in columns.cells), ""):
        raise BayescalError(f"`rotation` and `{clash}` are both mapped", columns.name, "keep one of them")
    count = CONVENTIONS[column.turn].count
    return column.turn, columns.block([f"rotation{i}" for i in range(count)])


def _angles(dataset: Dataset, turns: np.ndarray) -> np.ndarray:
    """Angles (N,), rad, of each row from the tool's stated frame or the rows' mean; nan where unknown."""
    rows = dataset.measurements
    placed = np.array([t.values.get("rpy") is not None for t in dataset.targets])
    usable = np.flatnonzero(np.isfinite(turns).all(axis=(1, 2)) & placed[rows.target])
    flange = flange_poses(dataset, rows.readings)[:, :, :3]
    off = np.full(len(rows.ids), np.nan)
    for tool in np.unique(rows.tool[usable]):
        mine = usable[rows.tool[usable] == tool]
        if len(mine) < FEWEST:
            continue
        frame = np.array([rpy_matrix(dataset.targets[t].values["rpy"]) for t in rows.target[mine]])
        between = flange[mine].transpose(0, 2, 1) @ frame @ turns[mine]
        rpy = dataset.tools[tool].rpy
        off[mine] = common_rotation(between)[1] if rpy is None else angle(rpy_matrix(rpy), between)
    return off


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
        stated = np.array([t.name not in self.tools for t in dataset.tools])
        flange = flange_poses(dataset, rows.readings[mine])
        sightings = Sightings(flange, rows.xyz[mine], station.ravel(), rows.tool[mine])
        frames, centres = fit(sightings, np.array([t.centre for t in dataset.tools]), stated)
        targets = list(dataset.targets)
        for index, frame in zip(used, frames, strict=True):
            place: dict[str, np.ndarray | float] = {"xyz": frame[:3, 3], "rpy": rpy_of(frame[:3, :3])}
            targets[index] = Target(targets[index].name, "instrument", place)
        tools = tuple(replace(t, centre=c) for t, c in zip(dataset.tools, centres, strict=True))
        return replace(dataset, targets=tuple(targets), tools=tools)
