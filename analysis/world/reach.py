"""Readings that bring the ball to a place: the nominal arm, solved in closed form."""

from __future__ import annotations

import numpy as np

from analysis.world.arm import LIMITS, nominal

A2, A3, A4, D4, D6 = 0.075, 0.3, 0.075, 0.32, 0.08
STRETCHED = 0.96  # beyond, the arm hardly moves outwards


def _rz(t: np.ndarray) -> np.ndarray:
    c, s, o, e = np.cos(t), np.sin(t), np.zeros_like(t), np.ones_like(t)
    return np.stack([c, -s, o, s, c, o, o, o, e], axis=-1).reshape(*t.shape, 3, 3)


def _rx(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def readings(ball: np.ndarray, turn: np.ndarray, flip: np.ndarray) -> np.ndarray:
    """Return joint readings (n, 6), NaN out of reach.

    Parameters
    ----------
    ball : numpy.ndarray
        Required centre of the ball (n, 3).
    turn : numpy.ndarray
        Orientation of the flange (n, 3, 3).
    flip : numpy.ndarray
        True: the other of the wrist's two ways (n).
    """
    flange = ball - turn @ nominal().tool
    wrist = flange - D6 * turn[:, :, 2]
    j1 = np.arctan2(wrist[:, 1], wrist[:, 0])
    r, z = np.hypot(wrist[:, 0], wrist[:, 1]) - A2, wrist[:, 2]
    fore, bend, far = np.hypot(D4, A4), np.arctan2(A4, D4), np.hypot(r, z)
    far[far > STRETCHED * (A3 + fore)] = np.nan
    with np.errstate(invalid="ignore"):
        inner = np.arccos((A3**2 + far**2 - fore**2) / (2 * A3 * far))
    lift = np.arctan2(z, r) + inner  # of the upper arm over the horizon, elbow up
    j2 = np.pi / 2 - lift
    j3 = np.arctan2(z - A3 * np.sin(lift), r - A3 * np.cos(lift)) - bend
    r3 = _rz(j1) @ _rx(-np.pi / 2) @ _rz(-j3 - np.pi / 2)
    e = np.swapaxes(r3 @ _rx(-np.pi / 2), -1, -2) @ turn
    way = np.where(flip, -1.0, 1.0)
    t4 = np.arctan2(way * e[:, 1, 2], way * e[:, 0, 2])
    b = np.arctan2(way * np.hypot(e[:, 0, 2], e[:, 1, 2]), e[:, 2, 2])
    t6 = np.arctan2(way * e[:, 2, 1], -way * e[:, 2, 0])
    return np.stack([j1, j2, j3, -t4, b, -t6], axis=-1)


def within(q: np.ndarray) -> np.ndarray:
    """Return which readings the arm can take, well off its limits and its singular wrist."""
    q = np.nan_to_num(q, nan=9.0)
    held = q.copy()
    held[:, 2] = q[:, 1] + q[:, 2]
    margin = np.radians(3)
    ok = np.all((held > LIMITS[:, 0] + margin) & (held < LIMITS[:, 1] - margin), axis=1)
    return ok & (np.abs(np.sin(q[:, 4])) > 0.25)


def joints_in_space(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return elbow and wrist (n, 3) of the nominal arm."""
    out = []
    for far in (0.0, 1.0):
        lift = np.pi / 2 - q[:, 1]
        r = A2 + A3 * np.cos(lift) + far * (D4 * np.cos(q[:, 2]) - A4 * np.sin(q[:, 2]))
        z = A3 * np.sin(lift) + far * (D4 * np.sin(q[:, 2]) + A4 * np.cos(q[:, 2]))
        out.append(np.stack([r * np.cos(q[:, 0]), r * np.sin(q[:, 0]), z], axis=-1))
    return out[0], out[1]
