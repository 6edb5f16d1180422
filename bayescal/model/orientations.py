"""Orientations that instruments read in addition to points: rows, uncertainties, tool frames.

Pure functions of a session; `Scene` calls them if it is `oriented`.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import Dataset

USUAL = np.radians(0.01)
"""rad, assumed noise of an orientation if none is stated: that of a laser tracker's 6-DoF probe."""


def posed(dataset: Dataset) -> np.ndarray:
    """Which rows also read the tool's orientation, (N,)."""
    rpy = dataset.measurements.rpy
    return np.zeros(len(dataset.measurements.ids), bool) if rpy is None else ~np.isnan(rpy).any(axis=1)


def read(dataset: Dataset, rows: np.ndarray) -> np.ndarray:
    """Orientations as read, in the frames of their instruments, (C, 3, 3)."""
    assert dataset.measurements.rpy is not None
    return rpy_matrix(dataset.measurements.rpy[rows])


def sigma(dataset: Dataset, count: int) -> np.ndarray:
    """Stated standard uncertainty of a rotation about each axis, (count,), rad; default `USUAL`."""
    stated = dataset.noise.orientation
    return np.full(count, USUAL if stated is None else stated)


def tool_frames(dataset: Dataset, flange: np.ndarray) -> np.ndarray:
    """Nominal orientation of every tool on the flange, (tools, 3, 3).

    If a tool states none, it is the mean over its rows' readings, with the nominal arm and instruments.
    `flange` (N, 3, 3) is in F0.
    """
    m, measured = dataset.measurements, posed(dataset)
    out = np.tile(np.eye(3), (len(dataset.tools), 1, 1))
    for k, tool in enumerate(dataset.tools):
        rows = np.flatnonzero(measured & (m.tool == k))
        if tool.rpy is not None:
            out[k] = rpy_matrix(tool.rpy)
        elif len(rows):
            turns = [np.asarray(dataset.targets[t].values["rpy"]) for t in m.target[rows]]
            seen = rpy_matrix(np.array(turns)) @ read(dataset, rows)
            out[k] = mean_rotation(np.swapaxes(flange[rows], -1, -2) @ seen)
    return out


def mean_rotation(matrices: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) nearest to the mean of rotations (C, 3, 3)."""
    from scipy.spatial.transform import Rotation  # slow to import, and many sessions need none

    return Rotation.from_matrix(matrices).mean().as_matrix()
