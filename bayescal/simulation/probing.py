"""Search for contacts: arm configurations that touch a face or a sphere, and their approach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.simulation.reach import Arm, cone, inverse
from bayescal.simulation.scenery import Cube, clear

SPEED = 5e-3  # m/s of the ball when it touches
TILT = np.radians(60.0)  # maximum angle between the z axis of the flange and the inward normal
SLANT = np.radians(25.0)  # maximum angle between the path of the ball and the normal
FASTEST = np.radians(12.0)  # rad/s: maximum joint velocity; faster joints are near a singularity
TURNING = np.radians(0.25)  # rad/s: joint velocities that rotate the arm about the centre of the ball
STARTS = 8  # per contact
LOWEST = np.radians(88.0)  # maximum angle from the top of a sphere to a contact
PROBES = 16  # contacts that are tested in a configuration of the arm


@dataclass(frozen=True)
class Contacts:
    """M contacts at nominal geometry: readings (M, n), rad, and velocities (M, n), rad/s."""

    readings: np.ndarray
    velocity: np.ndarray

    def __len__(self) -> int:
        return len(self.readings)

    def __getitem__(self, rows: np.ndarray | slice) -> Contacts:
        return Contacts(self.readings[rows], self.velocity[rows])


def join(parts: list[Contacts]) -> Contacts:
    """Contacts of all parts, in order."""
    return Contacts(np.concatenate([p.readings for p in parts]), np.concatenate([p.velocity for p in parts]))


def approach(
    arm: Arm, pose: np.ndarray, normal: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Joint velocities (M, n), rad/s, of the approach to each contact, and whether they are slow enough.

    The ball approaches at `SPEED`, at most `SLANT` from the normal (M, 3) of the surface. The arm also
    rotates slowly about the ball, so that every joint moves in both directions during a session.
    """
    n = arm.robot.n
    j = arm.jacobian(pose)[:, :3]
    pseudo = np.linalg.pinv(j, rcond=1e-6)
    drive = (pseudo @ (SPEED * cone(-normal, SLANT, rng))[..., None])[..., 0]
    free = np.eye(n) - pseudo @ j
    spin = (free @ rng.normal(0, TURNING, (len(pose), n, 1)))[..., 0]
    slow = np.abs(drive).max(axis=1) < FASTEST
    return arm.readings_of(drive + spin), slow


def contacts(
    arm: Arm,
    centres: np.ndarray,
    normals: np.ndarray,
    cube: Cube,
    spheres: np.ndarray,
    rng: np.random.Generator,
    starts: np.ndarray | None = None,
) -> tuple[np.ndarray, Contacts]:
    """A contact at each requested ball centre, where a solution is found.

    Parameters
    ----------
    arm : Arm
        Contacts have random tool directions.
    centres, normals : np.ndarray, shape (M, 3)
        Ball centres, m, and outward normals of the surface.
    cube : Cube
        Obstacle.
    spheres : np.ndarray, shape (K, 3)
        Centres of spheres that are obstacles, m.
    rng : np.random.Generator
        Of starts, directions and approaches.
    starts : np.ndarray, shape (M, n), optional
        Initial readings of each search, to keep the configuration of the arm; random if not given.

    Returns
    -------
    which : np.ndarray, shape (K,)
        Indices of the centres for which a contact was found.
    contacts : Contacts
        The K contacts.
    """
    count = len(centres)
    tries = STARTS if starts is None else 1
    index = np.repeat(np.arange(count), tries)
    begin = arm.anywhere(len(index), rng) if starts is None else starts
    inward = -normals[index]
    readings, found = inverse(arm, begin, centres[index], cone(inward, TILT, rng))
    pose = arm.frames(readings)
    found &= np.sum(pose[:, -1, :3, 2] * inward, axis=1) >= np.cos(TILT) - 1e-6
    found &= arm.upright(pose) & clear(pose, arm.ball(pose), cube, spheres)
    velocity, slow = approach(arm, pose, normals[index], rng)
    good = np.flatnonzero(found & slow)
    which, first = np.unique(index[good], return_index=True)
    return which, Contacts(readings[good[first]], velocity[good[first]])


def on_face(
    arm: Arm, cube: Cube, face: str, radius: float, count: int, rng: np.random.Generator
) -> tuple[float, Contacts]:
    """The share of `count` random points of a face that a ball of `radius`, m, reaches, and its contacts."""
    normals = np.tile(cube.normal(face), (count, 1))
    centres = cube.on(face, count, rng) + radius * normals
    which, found = contacts(arm, centres, normals, cube, np.empty((0, 3)), rng)
    return len(which) / max(count, 1), found


def on_sphere(
    arm: Arm,
    cube: Cube,
    spheres: np.ndarray,
    which: int,
    reach: float,
    count: int,
    rng: np.random.Generator,
) -> Contacts | None:
    """Contacts distributed over the upper half of a sphere, in a single configuration of the arm.

    Parameters
    ----------
    arm : Arm
    cube : Cube
        Obstacle.
    spheres : np.ndarray, shape (K, 3)
        Centres of all spheres, m.
    which : int
        Index of the sphere that is touched.
    reach : float
        Radius of sphere and ball, m.
    count : int
        Number of contacts.
    rng : np.random.Generator
        For all random choices.

    Returns
    -------
    Contacts or None
        None where too little of the sphere can be reached.
    """
    up = cube.axes[:, 2]
    tops = np.tile(up, (3, 1))
    _, homes = contacts(arm, spheres[which] + reach * tops, tops, cube, spheres, rng)
    if not len(homes):
        return None

    def around(homes: np.ndarray, tries: int) -> tuple[np.ndarray, np.ndarray, Contacts]:
        """Contacts in random directions from every configuration: its index, normals, contacts."""
        index = np.repeat(np.arange(len(homes)), tries)
        normals = cone(np.tile(up, (len(index), 1)), LOWEST, rng)
        goals = spheres[which] + reach * normals
        found, own = contacts(arm, goals, normals, cube, spheres, rng, homes[index])
        return index[found], normals[found], own

    index, _, _ = around(homes.readings, PROBES)
    shares = np.bincount(index, minlength=len(homes)) / PROBES
    if shares.max() < 0.25:
        return None
    best = homes.readings[[int(np.argmax(shares))]]
    _, normals, found = around(best, int(2 * count / shares.max()))
    if len(found) < 1.2 * count:
        return None
    chosen = spread(normals, count)
    normals = normals[chosen]
    # with contacts on one side only the centre would not be identifiable
    weakest = np.linalg.svd(normals - normals.mean(axis=0), compute_uv=False)[-1] / np.sqrt(count)
    return found[chosen] if weakest > 0.2 else None


def spread(points: np.ndarray, count: int) -> np.ndarray:
    """Indices (count,) of points (M, 3) that lie far from each other, each the farthest from those before."""
    chosen = [0]
    away = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)
