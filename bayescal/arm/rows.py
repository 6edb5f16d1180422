"""A transform between two joints as one DH row."""

from __future__ import annotations

import numpy as np

from bayescal.arm.transforms import rotation


def split(
    m: np.ndarray, parallel: float = np.radians(5.0)
) -> tuple[tuple[float, float, float], tuple[float, float], tuple[float, float]]:
    """Split a transform into ``Rz Tz`` (before), ``Rx(alpha) Tx(a) Ry(beta)``, and ``Rz Tz`` (behind).

    Between near-parallel axes beta takes the place of a distance along the second axis, which there
    is ill determined; elsewhere beta is zero (Hayati and Mirmirani 1985). Any rigid transform can be
    split so: what stands between two joints is a row, and what it leaves to the joints beside it.

    Parameters
    ----------
    m : np.ndarray, shape (4, 4)
        From one joint's frame to the next, each turning about its z. m and rad.
    parallel : float
        Axes that differ by less count as parallel, rad.

    Returns
    -------
    tuple
        (alpha, a, beta), (angle, length) before, (angle, length) behind. rad and m.
    """
    axis = m[:3, 2]  # the second axis seen from the first
    if np.hypot(axis[0], axis[1]) < np.sin(parallel):
        turn = _small(np.arctan2(m[1, 3], m[0, 3])) if np.hypot(m[0, 3], m[1, 3]) > 1e-12 else 0.0
        r, p = rotation(2, -turn) @ m[:3, :3], rotation(2, -turn) @ m[:3, 3]
        alpha, beta = np.arctan2(-r[1, 2], r[2, 2]), np.arcsin(np.clip(r[0, 2], -1.0, 1.0))
        rest = rotation(1, -beta) @ rotation(0, -alpha) @ r
        before, behind = p[2], 0.0
    else:  # turn about the first axis until the second has no component along x: the common normal
        turn = _small(np.arctan2(axis[0], -axis[1]))
        r, p = rotation(2, -turn) @ m[:3, :3], rotation(2, -turn) @ m[:3, 3]
        alpha, beta = np.arctan2(-r[1, 2], r[2, 2]), 0.0
        rest = rotation(0, -alpha) @ r
        behind = -p[1] / np.sin(alpha)  # p = Tz(before) Tx(a) Rx(alpha) Tz(behind)
        before = p[2] - np.cos(alpha) * behind
    return (
        (float(alpha), float(p[0]), float(beta)),
        (float(turn), float(before)),
        (float(np.arctan2(rest[1, 0], rest[0, 0])), float(behind)),
    )


def _small(turn: float) -> float:
    """Of the two turns half a revolution apart the smaller: a and alpha keep their nominal signs."""
    return float(turn - np.pi * np.round(turn / np.pi))
