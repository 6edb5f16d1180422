"""Gravity moments on every frame of the arm, nominal or at the fitted pose."""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import Chain, displaced, frames
from bayescal.arm.robot import Robot
from bayescal.arm.transforms import cross


def gravity_moments(
    robot: Robot,
    chain: Chain,
    q: np.ndarray,
    gravity: np.ndarray,
    load_mass: np.ndarray,
    load_centre: np.ndarray,
    delta: np.ndarray | None = None,
) -> np.ndarray:
    """Moment of the weight of all that a frame carries, about its origin, in its own axes.

    They are computed once a fit, not once an evaluation. At nominal they are off by parts in a thousand:
    enough to put a compliance several standard deviations off, and the rest looks like an error of a
    joint by its angle. So they are computed again where the arm was found to stand. About joint j the
    torque is component z of frame j.

    Parameters
    ----------
    robot : Robot
        With masses and centres of mass.
    chain : Chain
    q : np.ndarray, shape (C, n)
        Nominal link angles, rad.
    gravity : np.ndarray, shape (3,)
        m/s2, in F0.
    load_mass : np.ndarray, shape (C,)
        kg on the flange: tool and payload.
    load_centre : np.ndarray, shape (C, 3)
        Its centre of mass in the flange frame, m.
    delta : np.ndarray, shape (C, n + 2, 6), optional
        Where the frames stand relative to nominal, sag included.

    Returns
    -------
    np.ndarray, shape (C, n + 1, 3)
        N m, for frames 0 (base) to n. That of the base is about the undisplaced frame, in its axes: a stand
        yields about a place that does not move with it.
    """
    assert robot.masses is not None
    assert robot.centres_of_mass is not None
    pose = frames(chain, q, delta)
    n = chain.n
    out = np.empty((len(q), n + 1, 3))
    weight = load_mass[:, None] * gravity  # of all beyond the frame, N, in F0
    where = (pose[:, n + 1, :3, :3] @ load_centre[..., None])[..., 0] + pose[:, n + 1, :3, 3]
    moment = cross(where, weight)  # about F0's origin
    for i in range(n, -1, -1):
        if i > 0:
            # the contract's link frame stands behind the joint's whole row: in standard DH, behind `link`
            centre = np.tile(robot.centres_of_mass[i - 1], (len(q), 1))
            if robot.convention == "dh":
                centre = centre @ chain.link[i, :3, :3].T + chain.link[i, :3, 3]
                if delta is not None:
                    centre = displaced(centre, np.where(np.arange(6) < 2, 0.0, delta[:, i]))
            where = (pose[:, i, :3, :3] @ centre[..., None])[..., 0] + pose[:, i, :3, 3]
            own = robot.masses[i - 1] * gravity
            weight = weight + own
            moment = moment + cross(where, own)
        frame = pose[:, i] if i > 0 else np.broadcast_to(chain.base, (len(q), 4, 4))
        about = moment - cross(frame[:, :3, 3], weight)
        out[:, i] = (np.swapaxes(frame[:, :3, :3], -1, -2) @ about[..., None])[..., 0]
    return out


def torques_on_links(robot: Robot, torques: np.ndarray) -> np.ndarray:
    """Torques on the links from those on the readings, both (C, n), N m.

    If the readings of coupled axes are a matter of display, a motor drives its own link, and only the sense
    of rotation may differ. If a linkage couples the axes, the power is equal: the torques on the readings are
    ``link_from_reading.T`` times those on the links.
    """
    if robot.coupling == "display":
        return torques * np.sign(np.diag(robot.link_from_reading))
    return np.linalg.solve(robot.link_from_reading.T, torques.T).T
