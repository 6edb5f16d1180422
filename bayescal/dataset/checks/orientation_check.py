"""Plausibility of orientations: between two rows they rotate as far as the arm does, in any frame."""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset.table import Table
from bayescal.dataset.types import Dataset

FEWEST = 4
"""Rows of one tool on one instrument from which their turns can be judged."""
APART = np.radians(5.0)
"""What arm and reading may typically differ by: no arm is nominally so wrong, and no instrument."""


def check(dataset: Dataset, table: Table) -> None:
    """Refuse orientations in another unit or convention than the contract's.

    How far a frame turns between two rows depends neither on the instrument's frame nor on how the tool
    stands on the flange.
    """
    rows = dataset.measurements
    if rows.rpy is None:
        return
    flange = frames(chain_of(dataset.robot), link_angles(dataset.robot, rows.readings))[:, -1, :3, :3]
    read = np.flatnonzero(np.isfinite(rows.rpy).all(axis=1))
    for target, tool in np.unique(np.stack([rows.target[read], rows.tool[read]], axis=1), axis=0):
        at = read[(rows.target[read] == target) & (rows.tool[read] == tool)]
        if len(at) < FEWEST:
            continue
        seen, turned = _from_row_to_row(rpy_matrix(rows.rpy[at])), _from_row_to_row(flange[at])
        off = float(np.median(np.abs(seen - turned)))
        if off > APART:
            what = (
                f"orientations that `{dataset.targets[target].name}` read turn from row to row by "
                f"{np.degrees(off):.0f} deg more or less than the arm"
            )
            raise table.error(at[0], what, "check rx_deg, ry_deg, rz_deg: degrees, R = Rz(rz) Ry(ry) Rx(rx)")


def _from_row_to_row(turns: np.ndarray) -> np.ndarray:
    """Angles (C - 1,), rad, between successive rotations (C, 3, 3)."""
    from scipy.spatial.transform import Rotation  # slow to import, and many sessions need none

    rotations = Rotation.from_matrix(turns)
    return np.asarray((rotations[1:] * rotations[:-1].inv()).magnitude())
