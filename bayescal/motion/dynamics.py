"""Torques of a serial arm: of rigid bodies, linear in inertial parameters, and of friction in servos."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bayescal.arm.transforms import compiled, cross
from bayescal.logs import Mechanism
from bayescal.logs.types import PAIRS, inertial
from bayescal.robots.schema import SIX
from factors.kind import cross_matrix

REST = np.zeros(3)
PARAMETERS = 10
"""Of a body: mass, first moment (3), inertia about its frame's origin (6)."""


def _times_inertia(v: np.ndarray) -> np.ndarray:
    """Matrices (N, 3, 6) which by the elements of an inertia, as `PAIRS`, give its product with v (N, 3)."""
    out = np.zeros((len(v), 3, len(PAIRS)))
    for k, (i, j) in enumerate(PAIRS):
        out[:, i, k] += v[:, j]
        if i != j:
            out[:, j, k] += v[:, i]
    return out


def turns(m: Mechanism, q: np.ndarray) -> np.ndarray:
    """Rotations (n, N, 3, 3) of every body in the one before it, at joint angles (N, n)."""
    by_axis = cross_matrix(m.axis)[:, None]
    sine, cosine = np.sin(q.T)[..., None, None], np.cos(q.T)[..., None, None]
    return m.place[:, None, :3, :3] @ (np.eye(3) + sine * by_axis + (1.0 - cosine) * (by_axis @ by_axis))


def regressor(
    m: Mechanism, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, gravity: np.ndarray
) -> np.ndarray:
    """Torques by each inertial parameter of each body.

    Recursive Newton-Euler, forward for motion and backward for wrenches (Luh, Walker and Paul, ASME J. Dyn.
    Syst. 102(2), 1980), with the parameters kept apart (Atkeson, An and Hollerbach, IJRR 5(3), 1986).

    Parameters
    ----------
    m : Mechanism
    q, dq, ddq : np.ndarray, shape (N, n)
        Readings, rad, and their derivatives.
    gravity : np.ndarray, shape (3,)
        m/s2, in the base frame.

    Returns
    -------
    np.ndarray, shape (N, n, n, 10)
        N m of each reading, by each parameter of each body, as `bayescal.logs.types.inertial`.
    """
    q, dq, ddq = (x @ m.coupling.T for x in (q, dq, ddq))
    turn = turns(m, q)
    out = np.zeros((len(q), m.n, m.n, PARAMETERS))
    for k, (force, moment) in enumerate(_wrenches(m, turn, dq, ddq, gravity)):
        for j in range(k, -1, -1):
            out[:, j, k] = np.einsum("i,nip->np", m.axis[j], moment)
            if j:
                force, moment = _before(m, turn, j, force, moment)
    return np.einsum("ji,njkp->nikp", m.coupling, out)


def _wrenches(
    m: Mechanism, turn: np.ndarray, dq: np.ndarray, ddq: np.ndarray, gravity: np.ndarray,
    base: np.ndarray = REST,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:  # fmt: skip
    """Of each body force and moment (N, 3, 10) about its origin by its parameters, in its frame."""
    count = len(dq)
    rate, turning = np.zeros((count, 3)), np.tile(base, (count, 1))  # angular velocity and acceleration
    pull = np.tile(-np.asarray(gravity, float), (count, 1))  # acceleration of the origin
    for k in range(m.n):
        to_body = np.swapaxes(turn[k], 1, 2)
        origin = m.place[k, :3, 3]
        pull = pull + cross(turning, origin) + cross(rate, cross(rate, origin))
        pull, rate, turning = (np.einsum("nij,nj->ni", to_body, v) for v in (pull, rate, turning))
        spin = m.axis[k] * dq[:, k, None]
        turning = turning + cross(rate, spin) + m.axis[k] * ddq[:, k, None]
        rate = rate + spin
        force, moment = np.zeros((2, count, 3, PARAMETERS))
        wheel = cross_matrix(rate)
        force[:, :, 0] = pull
        force[:, :, 1:4] = cross_matrix(turning) + wheel @ wheel
        moment[:, :, 1:4] = -cross_matrix(pull)
        moment[:, :, 4:] = _times_inertia(turning) + wheel @ _times_inertia(rate)
        yield force, moment


def _before(
    m: Mechanism, turn: np.ndarray, j: int, force: np.ndarray, moment: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A wrench (N, 3, ...) of a body's frame in the frame before it; of the first body, in the base."""
    force = turn[j] @ force
    return force, turn[j] @ moment + cross_matrix(m.place[j, :3, 3]) @ force


@dataclass(frozen=True)
class Loads:
    """What bodies and a payload ask of joints and base; N rows."""

    joints: np.ndarray  # (N, n) N m
    base: np.ndarray  # (N, 3) N m, about its origin, along its axes
    tool: np.ndarray  # (N, 3) N, by 1 kg at the payload's centre of mass, along the axes of the last body

    @classmethod
    def of(
        cls, m: Mechanism, motion: Sequence[np.ndarray], gravity: np.ndarray, inertials: np.ndarray,
        payload: np.ndarray, turning: np.ndarray = REST,
    ) -> Loads:  # fmt: skip
        """Of a motion: readings, rad, and their derivatives, each (N, n).

        Bodies have `inertials` (n, 10), the payload (N,) is in kg; `turning` (3,) is an angular
        acceleration of the base, rad/s2. The signs are those of what accelerates the bodies.
        """
        q, dq, ddq = (x @ m.coupling.T for x in motion)
        turn, unit = turns(m, q), payload_of(m)
        every = [*_wrenches(m, turn, dq, ddq, gravity, turning)]
        joints, total = np.zeros_like(q), (np.zeros((len(q), 3, 1)),) * 2
        for k in range(m.n - 1, -1, -1):
            of_tool = payload[:, None] * unit if k == m.n - 1 else 0.0
            by = np.broadcast_to(inertials[k] + of_tool, (len(q), PARAMETERS))[..., None]
            force, moment = (t + x @ by for t, x in zip(total, every[k], strict=True))
            joints[:, k] = moment[..., 0] @ m.axis[k]
            total = _before(m, turn, k, force, moment)
        return cls(joints @ m.coupling, total[1][..., 0], every[-1][0] @ unit)


def inertial_of(body: np.ndarray) -> np.ndarray:
    """Linear parameters (10,), as `inertial`, of a body: mass, centre, and inertia about it."""
    return inertial(body[0], body[1:4], body[4 + SIX])


def payload_of(m: Mechanism) -> np.ndarray:
    """Inertial parameters (10,) that a payload of 1 kg adds to the last body."""
    return inertial(1.0, m.payload_centre, m.payload_gyration**2 * np.eye(3))


def carried(by: np.ndarray, inertials: np.ndarray, m: Mechanism, payload: np.ndarray) -> np.ndarray:
    """Torques (N, n) of bodies with `inertials` (n, 10) and of a payload (N,), kg, by their `regressor`."""
    return np.einsum("njkp,kp->nj", by, inertials) + by[:, :, -1] @ payload_of(m) * payload[:, None]


def inertia_matrix(m: Mechanism, inertials: np.ndarray, q: np.ndarray, payload: np.ndarray) -> np.ndarray:
    """Inertia matrices (N, n, n) of links and payloads (N,), kg, at poses q (N, n), without rotors; kg m2."""
    poses, turning = np.repeat(q, m.n, axis=0), np.tile(np.eye(m.n), (len(q), 1))
    by = regressor(m, poses, np.zeros_like(poses), turning, np.zeros(3))
    return carried(by, inertials, m, np.repeat(payload, m.n)).reshape(-1, m.n, m.n)


SUBSTEPS = 8
"""Of the integration of a joint between two rows (assumed)."""
STEPS, CLOSE = 8, 1e-9
"""Of Newton's method in each at most, and the torque over the largest friction at which it ends (cost)."""


class Followed(NamedTuple):
    """What servos do by their commands, (N, n) each."""

    position: np.ndarray  # rad
    friction: np.ndarray  # over its largest, -1 to 1


@compiled()
def followed(
    command: np.ndarray, load: np.ndarray, drive: np.ndarray, first: np.ndarray, step: float
) -> np.ndarray:
    """Motion of servos that follow commands, by an implicit integration of each joint.

    Friction is its largest times a hyperbolic tangent of the speed over that of the reversal: where this is
    small, friction holds the joint.

    Parameters
    ----------
    command, load : np.ndarray, shape (N, n)
        rad; N m, of links and payload.
    drive : np.ndarray, shape (5, n)
        Stiffness, Coulomb and viscous friction, inertia of the rotor, speed of the reversal; SI, positive.
    first : np.ndarray, shape (n,)
        Positions at the first row, where the joints rest.
    step : float
        s, between rows.

    Returns
    -------
    np.ndarray, shape (2, N, n)
        As `Followed`.
    """
    rows, n = command.shape
    out = np.zeros((2, rows, n))
    small = step / SUBSTEPS
    for j in range(n):
        stiffness, most, viscous, inertia, slow = drive[:, j]
        keeps = inertia / small
        heavy = viscous + stiffness * small + keeps
        q, v = first[j], 0.0
        for k in range(rows):
            before = max(k - 1, 0)
            rise = command[k, j] - command[before, j]
            for part in range(1, SUBSTEPS + 1):
                x = part / SUBSTEPS
                w = load[before, j] + x * (load[k, j] - load[before, j])
                pull = stiffness * (command[before, j] + x * rise - q) - w + keeps * v
                # Newton's method from below: the function is concave
                size = max((abs(pull) - most) / heavy, abs(pull) / (heavy + most / slow))
                for _ in range(STEPS):
                    way = np.tanh(size / slow)
                    excess = abs(pull) - most * way - heavy * size
                    if excess < CLOSE * most:
                        break
                    size += excess / (most / slow * (1.0 - way**2) + heavy)
                v, way = np.copysign(size, pull), np.copysign(way, pull)
                q += small * v
            out[:, k, j] = q, way
    return out
