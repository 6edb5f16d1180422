"""Statics: gravity's wrench on every frame at which an arm yields, nominal or at the pose where it stands."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.arm.chain import Chain, Robot, displaced, frames
from bayescal.arm.transforms import cross

AT_ONCE = 8192
"""Rows whose poses are held in memory: those of a session would be its largest arrays."""


@dataclass(frozen=True)
class Stance:
    """Where an arm stands relative to nominal: displacements of its frames, (N, n + 2, 6), rad and m.

    `delta` are all of them, deflection included. `yields` are those of them that vary from row to row: of a
    modified DH row, the constant ones place the next joint on the link, and these move the link itself too.
    """

    delta: np.ndarray
    yields: np.ndarray

    def at_rows(self, rows: np.ndarray) -> Stance:
        """The stances of some rows."""
        return Stance(self.delta[rows], self.yields[rows])


@dataclass(frozen=True)
class Loads:
    """Gravity's wrench on frames 0 (base) to n, (C, n + 1, 3) each: `moments`, N m, and `weights`, N.

    They are components along x, y and z, of all that a frame carries: the generalised forces of its turns and
    slides, each along its own axis. About joint j the torque is component z of the moment of frame j. All are
    linear in the masses.
    """

    moments: np.ndarray
    weights: np.ndarray

    def torques(self, slides: np.ndarray) -> np.ndarray:
        """Torques (C, n), N m, about the joints, and forces, N, along those that slide, (n,)."""
        turning = self.moments[:, 1:, 2]
        return np.where(slides, self.weights[:, 1:, 2], turning) if slides.any() else turning


@dataclass(frozen=True)
class Hinges:
    """Axes x, y and z of frames 0 to n in F0, and the origin of each, m, (C, n + 1, 3, 3): a row an axis."""

    axes: np.ndarray
    origins: np.ndarray
    ground: int = 0  # the link that stands still; 0: F0

    def loads(self, moment: np.ndarray, weight: np.ndarray) -> Loads:
        """Loads by the moment about F0's origin, N m, and the weight, N, beyond each frame, (C, n + 1, 3)."""
        weight = weight[:, :, None]
        about = moment[:, :, None] - cross(self.origins, weight)
        return Loads(np.sum(self.axes * about, axis=-1), np.sum(self.axes * weight, axis=-1))

    @cached_property
    def arms(self) -> np.ndarray:
        """Moments, m, that a unit force on F0's origin along x, y and z has about each axis, reversed."""
        return cross(self.axes, self.origins)

    def by_mass(self, body: int, weight: np.ndarray, centre: np.ndarray, turn: np.ndarray) -> list[Loads]:
        """Loads by a mass that frames 0 to `body` carry, and by a shift of it along each axis of its frame.

        Parameters
        ----------
        body : int
        weight : np.ndarray, shape (C, 3)
            N, in F0.
        centre : np.ndarray, shape (C, 3)
            In F0, m.
        turn : np.ndarray, shape (C, 3, 3)
            Orientation in F0 of its frame.

        Returns
        -------
        list of Loads
            Four: by the mass, and by each of the shifts, per m.
        """
        if body < self.ground:  # on the side of F0: the joints between it and the ground carry it, reversed
            count, of, weight = len(self.axes), slice(body + 1, self.ground + 1), -weight
        else:
            count, of = len(self.axes), slice(self.ground + 1 if self.ground else 0, body + 1)
        moment = np.stack([cross(centre, weight), *(cross(turn[:, :, k], weight) for k in range(3))], axis=-1)
        axes, arms = (x[:, of].reshape(count, -1, 3) for x in (self.axes, self.arms))
        pull, moments = axes @ weight[..., None], axes @ moment
        moments[..., :1] -= arms @ weight[..., None]  # a shift adds no weight
        out = []
        for k, weights in enumerate((pull, *3 * [np.zeros_like(pull)])):
            loads = np.zeros((2, *self.axes.shape[:-1]))
            width = of.stop - of.start
            loads[:, :, of] = np.stack([moments[..., k], weights[..., 0]]).reshape(2, count, width, 3)
            out.append(Loads(*loads))
        return out


def hinges(chain: Chain, pose: np.ndarray, delta: np.ndarray | None = None) -> Hinges:
    """Hinges of an arm with the poses (C, n + 2, 4, 4) of `frames`, at displacements (C, n + 2, 6).

    A frame yields in the order of its displacement, Rz Tz Rx Tx Ry Ty: its y axis is behind the turn about x
    and the slide along it. Those of the base do not move: a stand yields about a place of its own.
    """
    n, place = chain.n, pose[:, : chain.n + 1].copy()
    place[:, 0] = chain.base
    axes = np.swapaxes(place[..., :3, :3], -1, -2).copy()
    origins = np.repeat(place[..., None, :3, 3], 3, axis=-2)
    if delta is not None:
        turn, slide = delta[:, 1 : n + 1, 2, None], delta[:, 1 : n + 1, 3, None]
        axes[:, 1:, 1] = np.cos(turn) * axes[:, 1:, 1] + np.sin(turn) * axes[:, 1:, 2]
        origins[:, 1:, 1] += slide * axes[:, 1:, 0]
    return Hinges(axes, origins, 0 if chain.ground is None else chain.ground.link)


def gravity_in_f0(
    chain: Chain, pose: np.ndarray, gravity: np.ndarray, stance: Stance | None = None
) -> np.ndarray:
    """Gravity in F0, m/s2: as stated, (3,); of a chain through two arms (C, 3), by the poses of `frames`."""
    ground = chain.ground
    if ground is None:
        return gravity
    down = np.broadcast_to(ground.place[:3, :3] @ gravity, (len(pose), 3))
    if stance is not None:
        turns = np.where(np.arange(6) % 2 == 0, stance.yields[:, ground.link], 0.0)
        down = displaced(down, np.where(np.arange(6) < 2, 0.0, turns))
    return np.asarray((pose[:, ground.link, :3, :3] @ down[..., None])[..., 0])


def gravity_loads(
    robot: Robot,
    chain: Chain,
    q: np.ndarray,
    gravity: np.ndarray,
    load_mass: np.ndarray,
    load_centre: np.ndarray,
    stance: Stance | None = None,
) -> Loads:
    """Moments and weights of all that each frame carries.

    They are computed at one pose, not in every evaluation; `model.equilibrium` finds the pose.

    Parameters
    ----------
    robot : Robot
        With masses and centres of mass.
    chain : Chain
    q : np.ndarray, shape (C, n)
        Nominal link angles, rad.
    gravity : np.ndarray, shape (3,)
        m/s2, in F0; of a chain through two arms in the frame of its ground.
    load_mass : np.ndarray, shape (C,)
        kg on the flange: tool and payload.
    load_centre : np.ndarray, shape (C, 3)
        Its centre of mass in the flange frame, m.
    stance : Stance, optional
        Where the arm stands; default: nominal.
    """
    assert robot.masses is not None
    if len(q) > AT_ONCE:
        parts = []
        for start in range(0, len(q), AT_ONCE):
            rows = np.arange(start, min(start + AT_ONCE, len(q)))
            there = None if stance is None else stance.at_rows(rows)
            part = gravity_loads(robot, chain, q[rows], gravity, load_mass[rows], load_centre[rows], there)
            parts.append((part.moments, part.weights))
        return Loads(*map(np.concatenate, zip(*parts, strict=True)))
    n, delta = chain.n, None if stance is None else stance.delta
    pose = frames(chain, q, delta)
    gravity = gravity_in_f0(chain, pose, gravity, stance)
    moment, weight = np.empty((len(q), n + 1, 3)), np.empty((len(q), n + 1, 3))
    beyond = load_mass[:, None] * gravity
    pull = cross(placed(pose[:, n + 1], load_centre), beyond)  # about F0's origin
    for i in range(n, -1, -1):
        if i > 0:
            force = robot.masses[i - 1] * gravity
            beyond = beyond + force
            pull = pull + cross(placed(pose[:, i], centre_of_mass(robot, chain, i, stance)), force)
        moment[:, i], weight[:, i] = pull, beyond
    if chain.ground is not None:  # it bears all: what a joint before it carries is on the side of F0
        mass, centre = chain.ground.load
        held, of = mass * gravity, slice(1, chain.ground.link + 1)
        moment[:, of] -= (pull + cross(np.broadcast_to(centre, held.shape), held))[:, None]
        weight[:, of] -= (beyond + held)[:, None]
        moment[:, 0] = weight[:, 0] = 0.0
    return hinges(chain, pose, delta).loads(moment, weight)


def centre_of_mass(robot: Robot, chain: Chain, i: int, stance: Stance | None = None) -> np.ndarray:
    """Centre of mass of link i (from 1) in its frame, (C, 3) or (3,), m: it tilts with its bearing.

    The contract's link frame stands behind the joint's whole row: in standard DH behind `link`.
    """
    assert robot.centres_of_mass is not None
    centre = robot.centres_of_mass[i - 1]
    delta = None if stance is None else stance.yields
    if robot.convention == "dh":
        centre = chain.link[i, :3, :3] @ centre + chain.link[i, :3, 3]
        delta = None if stance is None else stance.delta
    return centre if delta is None else displaced(centre, np.where(np.arange(6) < 2, 0.0, delta[:, i]))


def placed(pose: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Points x (C, 3) or (3,), m, of frames with the poses (C, 4, 4) in F0, (C, 3)."""
    return (pose[:, :3, :3] @ x[..., None])[..., 0] + pose[:, :3, 3]


def torques_on_links(robot: Robot, torques: np.ndarray) -> np.ndarray:
    """Torques on the links from those on the readings, both (C, n), N m.

    If the readings of coupled axes are a matter of display, a motor drives its own link, and only the sense
    of rotation may differ. If a linkage couples the axes, the power is equal: the torques on the readings are
    ``link_from_reading.T`` times those on the links.
    """
    if robot.coupling == "display":
        return torques * np.sign(np.diag(robot.link_from_reading))
    return np.linalg.solve(robot.link_from_reading.T, torques.T).T
