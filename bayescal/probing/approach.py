"""Objects in the workspace: a granite cube and an artefact with spheres, nominal and true.

Search for contacts: arm configurations that touch a face or a sphere, and their approach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.arm.inverse import PASSES
from bayescal.arm.transforms import rigid
from bayescal.probing.clearance import Clearance, path_free
from bayescal.probing.reach import Arm, cone, inverse
from bayescal.probing.scene import Solid
from bayescal.probing.shapes import Box

SIZE = 0.2286  # m, the cube's edge: 9 inches
DIAMETER = 0.0508  # m, of the spheres: 2 inches
U_DISTANCE, U_ANGLE = 3e-6, 1.2e-5  # m, rad: of the cube's certificate
U_SPHERE = 1e-6  # m: of a sphere's diameter, and of a distance between spheres
LONGEST = 0.3  # m, between spheres of the artefact

FACES = {
    "+x": (0, 1.0), "-x": (0, -1.0), "+y": (1, 1.0), "-y": (1, -1.0), "+z": (2, 1.0)
}  # fmt: skip
"""Axis and sign of the faces that can be touched: the cube stands on the sixth."""


@dataclass(frozen=True)
class Cube:
    """A cube by its centre (3,), m, and the directions of its edges: columns of `axes` (3, 3), in F0."""

    centre: np.ndarray
    axes: np.ndarray

    def normal(self, face: str) -> np.ndarray:
        """Outward unit normal (3,) of a face."""
        axis, sign = FACES[face]
        return sign * self.axes[:, axis]

    def offset(self, face: str) -> float:
        """Distance of a face from the origin of F0 along its normal, m."""
        return float(self.normal(face) @ self.centre) + SIZE / 2

    def on(self, face: str, count: int, rng: np.random.Generator) -> np.ndarray:
        """Points (count, 3), m, distributed over a face, away from its edges."""
        axis, _ = FACES[face]
        flat = rng.uniform(-0.43, 0.43, (count, 3)) * SIZE
        flat[:, axis] = 0.0
        return self.centre + flat @ self.axes.T + 0.5 * SIZE * self.normal(face)

    @property
    def solid(self) -> Solid:
        """The cube as an obstacle."""
        return Solid("cube", (Box(rigid(self.axes, self.centre), np.full(3, SIZE / 2)),))

    def inside(self, points: np.ndarray, margin: float) -> np.ndarray:
        """Which of points (..., 3) are in the cube, or nearer to it than the margin, m."""
        return np.all(np.abs((points - self.centre) @ self.axes) < SIZE / 2 + margin, axis=-1)


def layout(spheres: int, longest: float) -> np.ndarray:
    """Sphere centres (spheres, 3), m, on the artefact: two at its ends, the others beside them."""
    between = np.arange(1, max(spheres - 1, 1))
    x = np.concatenate([[-0.5, 0.5], between / max(spheres - 1, 1) - 0.5])
    y = np.concatenate([[0.0, 0.0], 0.225 * (-1.0) ** (between - 1)])
    return longest * np.stack([x, y, 0 * x], axis=1)[:spheres]


SPEED = 5e-3  # m/s of the ball when it touches
TILT = np.radians(60.0)  # maximum angle between the z axis of the flange and the inward normal
SLANT = np.radians(25.0)  # maximum angle between the path of the ball and the normal
FASTEST = np.radians(12.0)  # rad/s: maximum joint velocity; faster joints are near a singularity
TURNING = np.radians(0.25)  # rad/s: joint velocities that rotate the arm about the centre of the ball
STARTS = 8  # per contact
LOWEST = np.radians(88.0)  # maximum angle from the top of a sphere to a contact
PROBES = 16  # contacts that are tested in a configuration of the arm
TOPS = 3  # configurations of the arm that are tried for a sphere
LEAST = 0.25  # share of the contacts on a sphere that must be reached in one configuration
LOCAL = 12  # steps of a search that starts near its goal; those that converge need 3 to 10
RETRACT, STOPS = 0.02, 2  # m: path of the ball from a contact that is checked, at so many points


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
    clearance: Clearance,
    touched: np.ndarray,
    centres: np.ndarray,
    normals: np.ndarray,
    rng: np.random.Generator,
    starts: np.ndarray | None = None,
) -> tuple[np.ndarray, Contacts]:
    """A contact at each requested ball centre, where a solution is found.

    Parameters
    ----------
    arm : Arm
        Contacts have random tool directions.
    clearance : Clearance
        The check of collisions, at the contact and along its retract.
    touched : np.ndarray of int, shape (M,)
        Indices of the solids of `clearance` that are touched.
    centres, normals : np.ndarray, shape (M, 3)
        Ball centres, m, and outward normals of the surface.
    rng : np.random.Generator
        Of starts, directions and approaches.
    starts : np.ndarray, shape (M, n), optional
        Initial readings of each search, to keep the configuration of the arm; random if not given.

    Returns
    -------
    which : np.ndarray, shape (K,)
        Indices of the centres for which a contact was found, in ascending order.
    contacts : Contacts
        The K contacts.
    """
    tries, passes = (STARTS, PASSES) if starts is None else (1, LOCAL)
    index = np.repeat(np.arange(len(centres)), tries)
    begin = arm.anywhere(len(index), rng) if starts is None else starts
    axes = cone(-normals[index], TILT, rng)
    readings, found = inverse(arm, begin, centres[index], axes, passes)
    index, readings = index[found], readings[found]
    pose = arm.frames(readings)
    steep = np.sum(pose[:, -1, :3, 2] * -normals[index], axis=1) >= np.cos(TILT) - 1e-6
    fit = np.flatnonzero(steep & arm.upright(pose))
    velocity, slow = approach(arm, pose[fit], normals[index[fit]], rng)
    index, readings, velocity = index[fit[slow]], readings[fit[slow]], velocity[slow]
    rows = _first_free(clearance, touched[index], normals[index], readings, index)
    return index[rows], Contacts(readings[rows], velocity[rows])


def _first_free(
    clearance: Clearance, touched: np.ndarray, normals: np.ndarray, readings: np.ndarray, index: np.ndarray
) -> np.ndarray:
    """The first row of each value of `index` (M,) without collision: rows, ordered by that value."""
    left, out = np.arange(len(index)), []
    while len(left):
        rows = left[np.unique(index[left], return_index=True)[1]]
        left = np.setdiff1d(left, rows)
        rows = rows[clearance.collides(readings[rows], touched[rows]) == 0]
        rows = rows[path_free(clearance, readings[rows], normals[rows], touched[rows], RETRACT, STOPS) == 0]
        left = left[~np.isin(index[left], index[rows])]
        out.append(rows)
    found = np.concatenate([*out, np.empty(0, int)])
    return found[np.argsort(index[found])]


def on_face(
    arm: Arm,
    clearance: Clearance,
    cube: Cube,
    face: str,
    radius: float,
    count: int,
    rng: np.random.Generator,
) -> tuple[float, Contacts]:
    """The share of `count` random points of a face that a ball of `radius`, m, reaches, and its contacts.

    The cube is the first solid of `clearance`.
    """
    normals = np.tile(cube.normal(face), (count, 1))
    centres = cube.on(face, count, rng) + radius * normals
    which, found = contacts(arm, clearance, np.zeros(count, int), centres, normals, rng)
    return len(which) / max(count, 1), found


@dataclass(frozen=True)
class Spheres:
    """S spheres to touch: their solids (indices (S,)), centres (S, 3), m; the direction up (3,).

    `reach` is the radius of sphere and ball together, m.
    """

    solids: np.ndarray
    centres: np.ndarray
    up: np.ndarray
    reach: float

    def __getitem__(self, rows: np.ndarray) -> Spheres:
        return Spheres(self.solids[rows], self.centres[rows], self.up, self.reach)


def from_above(
    arm: Arm, clearance: Clearance, spheres: Spheres, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Configurations that touch spheres from above: the sphere of each (H,), readings (H, n)."""
    index = np.repeat(np.arange(len(spheres.solids)), TOPS)
    tops = np.tile(spheres.up, (len(index), 1))
    goals = spheres.centres[index] + spheres.reach * tops
    which, found = contacts(arm, clearance, spheres.solids[index], goals, tops, rng)
    return index[which], found.readings


def on_spheres(
    arm: Arm,
    clearance: Clearance,
    spheres: Spheres,
    homes: tuple[np.ndarray, np.ndarray],
    count: int,
    rng: np.random.Generator,
) -> list[Contacts] | None:
    """Contacts distributed over the upper half of each sphere, each in a single configuration of the arm.

    Parameters
    ----------
    arm : Arm
    clearance : Clearance
    spheres : Spheres
    homes : tuple of np.ndarray
        Configurations to start from, as `from_above` finds them.
    count : int
        Number of contacts on each sphere.
    rng : np.random.Generator
        For all random choices.

    Returns
    -------
    list of Contacts or None
        None where too little of a sphere can be reached.
    """

    def around(
        sphere: np.ndarray, readings: np.ndarray, tries: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Contacts]:
        """Contacts in random directions from every configuration: its index, normals, contacts."""
        index = np.repeat(np.arange(len(sphere)), tries)
        own = sphere[index]
        normals = cone(np.tile(spheres.up, (len(index), 1)), LOWEST, rng)
        goals = spheres.centres[own] + spheres.reach * normals
        which, found = contacts(arm, clearance, spheres.solids[own], goals, normals, rng, readings[index])
        return index[which], normals[which], found

    sphere, readings = homes
    index, _, _ = around(sphere, readings, np.full(len(sphere), PROBES))
    shares = np.bincount(index, minlength=len(sphere)) / PROBES
    numbers = np.arange(len(spheres.solids))
    best = np.array([int(np.argmax(np.where(sphere == k, shares, -1.0))) for k in numbers])
    if not np.all((sphere[best] == numbers) & (shares[best] >= LEAST)):
        return None
    tries = (2 * count / shares[best]).astype(int)
    index, normals, found = around(numbers, readings[best], tries)
    out = []
    for k in numbers:
        rows = np.flatnonzero(index == k)
        if len(rows) < 1.2 * count:
            return None
        rows = rows[spread(normals[rows], count)]
        # with contacts on one side only the centre would not be identifiable
        own = normals[rows] - normals[rows].mean(axis=0)
        if np.linalg.svd(own, compute_uv=False)[-1] / np.sqrt(count) <= 0.2:
            return None
        out.append(found[rows])
    return out


def spread(points: np.ndarray, count: int) -> np.ndarray:
    """Indices (count,) of points (M, 3) that lie far from each other, each the farthest from those before."""
    chosen = [0]
    away = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)
