"""Measured orientations of an import: from the columns of the log, and compared with the nominal arm."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import Dataset
from bayescal.errors import BayescalError
from bayescal.importing.columns import Columns, first
from bayescal.importing.frame import flanges
from bayescal.importing.rotations import CONVENTIONS, matrices, not_rotations, roll_pitch_yaw

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
