"""Rigid-body torque of a serial arm: a regressor in the inertial parameters (Newton-Euler, all rows at once).

Inertial parameters of a link, in its frame: mass, first moments (3), inertia about the origin of the frame
(xx yy zz xy xz yz); SI. Source: Khalil and Dombre, Modeling, Identification and Control of Robots, chapter 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

Z = np.array([0.0, 0.0, 1.0])
PARTS = 10
"""Inertial parameters of a link."""


@dataclass(frozen=True)
class Chain:
    """Revolute joints about their z axes: origin (n, 3), m, roll, pitch, yaw (n, 3), rad, in the parent."""

    origin: np.ndarray
    rpy: np.ndarray

    @property
    def turns(self) -> np.ndarray:
        """Fixed rotations of the joints in their parents (n, 3, 3)."""
        return Rotation.from_euler("xyz", self.rpy).as_matrix()


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of (rows, 3): `numpy.cross` is slower."""
    (a0, a1, a2), (b0, b1, b2) = np.broadcast_to(a, b.shape).T, b.T
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=1)


def _inertia_rows(w: np.ndarray) -> np.ndarray:
    """Return the matrices (rows, 3, 6) with which the six moments of inertia give the vector I w."""
    out = np.zeros((len(w), 3, 6))
    for row, column, of in ((0, 0, 0), (0, 3, 1), (0, 4, 2), (1, 1, 1), (1, 3, 0), (1, 5, 2)):
        out[:, row, column] = w[:, of]
    for column, of in ((2, 2), (4, 0), (5, 1)):
        out[:, 2, column] = w[:, of]
    return out


def _motion(
    chain: Chain, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, gravity: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Return rotation to the parent, angular velocity, angular and linear acceleration of each link."""
    n, out = len(q), []
    w, dw, a = np.zeros((n, 3)), np.zeros((n, 3)), np.broadcast_to(-gravity, (n, 3))
    for j, (origin, fixed) in enumerate(zip(chain.origin, chain.turns, strict=True)):
        c, s = np.cos(q[:, j]), np.sin(q[:, j])
        turn = np.stack([np.outer(c, fixed[:, 0]) + np.outer(s, fixed[:, 1]),
                         np.outer(c, fixed[:, 1]) - np.outer(s, fixed[:, 0]),
                         np.broadcast_to(fixed[:, 2], (n, 3))], axis=2)  # fmt: skip
        at = np.broadcast_to(origin, (n, 3))
        a = a + _cross(dw, at) + _cross(w, _cross(w, at))
        w, dw, a = (np.einsum("nij,ni->nj", turn, v) for v in (w, dw, a))
        dw = dw + np.outer(ddq[:, j], Z) + _cross(w, np.outer(dq[:, j], Z))
        w = w + np.outer(dq[:, j], Z)
        out.append((turn, w, dw, a))
    return out


def _wrench(w: np.ndarray, dw: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return force and moment (rows, 3, 10) of a link about its origin, by inertial parameter."""
    n = len(w)
    force, moment = np.zeros((n, 3, PARTS)), np.zeros((n, 3, PARTS))
    force[:, :, 0] = a
    for k, unit in enumerate(np.eye(3)):
        e = np.broadcast_to(unit, (n, 3))
        force[:, :, 1 + k] = _cross(dw, e) + _cross(w, _cross(w, e))
        moment[:, :, 1 + k] = _cross(e, a)
    turning = _inertia_rows(w)
    moment[:, :, 4:] = _inertia_rows(dw)
    for k in range(6):
        moment[:, :, 4 + k] += _cross(w, turning[:, :, k])
    return force, moment


def regressor(
    chain: Chain,
    q: np.ndarray,
    dq: np.ndarray,
    ddq: np.ndarray,
    gravity: Sequence[float] | np.ndarray,
    links: Sequence[int] | None = None,
) -> np.ndarray:
    """Return torque by joint and inertial parameter.

    Parameters
    ----------
    chain : Chain
        The arm.
    q, dq, ddq : numpy.ndarray
        Positions, velocities, accelerations (rows, n), rad and s.
    gravity : array of float
        In the frame of the base, m/s2.
    links : sequence of int, optional
        The links whose parameters are columns; by default all.

    Returns
    -------
    numpy.ndarray
        (rows, n, 10 per link), N m per unit of the parameter.
    """
    rows, size = q.shape
    links = range(size) if links is None else links
    moved = _motion(chain, q, dq, ddq, np.asarray(gravity, dtype=float))
    out = np.zeros((rows, size, PARTS * len(links)))
    for slot, i in enumerate(links):
        force, moment = _wrench(*moved[i][1:])
        axis, arm = np.broadcast_to(Z, (rows, 3)), np.zeros((rows, 3))  # of joint j, in the frame of link i
        frame = np.broadcast_to(np.eye(3), (rows, 3, 3))  # from link j to link i
        for j in range(i, -1, -1):
            lever = _cross(axis, arm)
            out[:, j, PARTS * slot : PARTS * (slot + 1)] = np.einsum("ni,nik->nk", axis, moment) + np.einsum(
                "ni,nik->nk", lever, force
            )
            if j:
                arm = arm + np.einsum("nij,nj->ni", frame, moved[j][0].transpose(0, 2, 1) @ chain.origin[j])
                frame = frame @ moved[j][0].transpose(0, 2, 1)
                axis = frame[:, :, 2]
    return out


def about_origin(mass: np.ndarray, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return inertial parameters (n, 10): masses (n), centres (n, 3), inertia about these (n, 3, 3)."""
    far = np.sum(centre**2, axis=1)[:, None, None] * np.eye(3) - centre[:, :, None] * centre[:, None, :]
    full = inertia + mass[:, None, None] * far
    six = full[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.concatenate([mass[:, None], mass[:, None] * centre, six], axis=1)
