"""Position of an instrument, and of its reflector on the flange: a rigid fit to the nominal arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.robot import Robot
from bayescal.arm.transforms import rigid_alignment

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
