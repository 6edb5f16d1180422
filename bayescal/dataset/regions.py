"""Where contacts on a target may be, random places there, and its body as an obstacle: by the kind of target.

A declaration (`target_kinds.TargetKind`) combines these functions, or functions of its own, as its `Probing`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from bayescal.arm.shapes import FIXED, Box, Capsule, Shape, ball
from bayescal.arm.transforms import cone, cross, rigid
from bayescal.dataset.types import Patch, Target

LOWEST = np.radians(88.0)
"""rad: greatest angle from the top of a sphere to a contact; its stem is below."""
DOWN = np.radians(100.0)
"""rad from upwards: contacts on a cylinder whose normal is lower are on its underside (assumed)."""
ENOUGH = 8
"""Contacts that show where a face can be probed (assumed)."""
STEM, STEM_RADIUS = 0.1, 0.2
"""Assumed: m, length of the stem below the centre of a sphere; radius of a stem, of the sphere's diameter."""
THICK = 0.01
"""m: half of the thickness of a wall, of which only the probed face is known (assumed)."""
POST, BELOW = 0.01, 0.015
"""m: radius of the post of a seat, and its distance below the centre of the ball (assumed)."""


@dataclass(frozen=True)
class Region:
    """The part of a target where contacts may be.

    Of a face: a rectangle with `centre` (3,), m, in F0, and half edges `half` (2, 3), m. Of a cylinder: half
    of its axis, `half` (1, 3). Of a sphere, or of a ball bar about its pivot: a cap about `up` (3,), a unit
    vector, to `widest`, rad, from it; `centre` is that of the sphere. Of a seat: its `centre`, which is left
    along `up`. Of a camera and a board: the origin of what is fixed, and the distances `span` (2,), m,
    between both; `up` is the normal of a fixed board.
    """

    centre: np.ndarray
    half: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    up: np.ndarray = field(default_factory=lambda: np.empty(0))
    widest: float = 0.0
    span: np.ndarray = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Session:
    """What a session says about the region of a target.

    `up` (3,) is the unit vector against gravity, `patch` the stated region, `face` that of a box which the
    faces of the artefact determine, `probed()` the nominal positions (M, 3), m, of the TCP at its contacts.
    """

    up: np.ndarray
    patch: Patch | None = None
    face: Region | None = None
    probed: Callable[[], np.ndarray] = lambda: np.empty((0, 3))


Places = tuple[np.ndarray, np.ndarray]
"""TCP positions (M, 3), m, and outward unit normals (M, 3): nan where nothing is touched."""


@dataclass(frozen=True)
class Probing:
    """How contacts on a kind of target are planned.

    Parameters
    ----------
    region : callable, optional
        region(target, session) -> the region, None if its extent is not known; without it, contacts are
        wherever the arm reaches.
    places : callable, optional
        places(target, region, radius, count, rng) -> random places of the centre of a ball of `radius`, m;
        without it, or where it returns None, they are in the volume of interest.
    obstacle : callable, optional
        obstacle(target, region) -> shapes in F0, of which the first is touched; none without it.
    sizes : tuple of str
        The lengths that a stated region has; it can be stated of kinds with a direction alone.
    aims : callable, optional
        aims(target, region, count, rng) -> random poses (count, 3, 4) of the tool in F0, not `places`.
    faults : callable, optional
        faults(target, region, poses (M, 3, 4)) -> why a pose of the tool is of no use, or "", (M,).
    points : callable
        points(target) -> number of rows that are measured at a pose, as of an image; one by default.
    sights : callable, optional
        sights(target, region, poses (M, 3, 4)) -> from where (M, 3) to where (M, K, 3), m in F0, the view is
        to be free at poses of the tool.
    held : callable
        held(target) -> what the flange carries beside the tool: capsules in its frame.
    """

    region: Callable[[Target, Session], Region | None] | None = None
    places: Callable[[Target, Region, float, int, np.random.Generator], Places | None] | None = None
    obstacle: Callable[[Target, Region], tuple[Shape, ...]] | None = None
    sizes: tuple[str, ...] = ()
    aims: Callable[[Target, Region, int, np.random.Generator], np.ndarray] | None = None
    faults: Callable[[Target, Region, np.ndarray], np.ndarray] | None = None
    points: Callable[[Target], int] = lambda target: 1
    sights: Callable[[Target, Region, np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None
    held: Callable[[Target], tuple[Capsule, ...]] = lambda target: ()


def vector(target: Target, key: str) -> np.ndarray:
    """A vector (3,) of the entry of a target."""
    return np.asarray(target.values[key], float)


def edges(normal: np.ndarray, along: np.ndarray | None = None) -> np.ndarray:
    """Directions (2, 3) of the width and the height of a rectangle across a unit normal (3,).

    The width is nearest to `along`, or to the axis of F0 that comes first of those along the face.
    """
    if along is None:
        along = np.eye(3)[1 if np.argmax(np.abs(normal)) == 0 else 0]
    width = along - (along @ normal) * normal
    width = width / np.linalg.norm(width)
    return np.stack([width, np.cross(normal, width)])


def face(target: Target, session: Session) -> Region | None:
    """The stated rectangle of a plane, else the face of a box, else the rectangle of its contacts."""
    normal, offset = vector(target, "normal"), float(target.values["offset"])
    if (patch := session.patch) is not None:
        centre = patch.centre - (normal @ patch.centre - offset) * normal
        return Region(centre, 0.5 * patch.size[:, None] * edges(normal, patch.along))
    if session.face is not None or len(points := session.probed()) < ENOUGH:
        return session.face
    across = edges(normal)
    place = points @ across.T
    low, high = place.min(axis=0), place.max(axis=0)
    return Region(0.5 * (low + high) @ across + offset * normal, 0.5 * (high - low)[:, None] * across)


def side(target: Target, session: Session) -> Region | None:
    """The stated length of a cylinder, else that between its contacts."""
    axis, point = vector(target, "axis"), vector(target, "point")
    if (patch := session.patch) is not None:
        place, half = float((patch.centre - point) @ axis), 0.5 * float(patch.size[0])
    elif len(points := session.probed()) < ENOUGH:
        return None
    else:
        along = (points - point) @ axis
        place, half = 0.5 * float(along.min() + along.max()), 0.5 * float(np.ptp(along))
    return Region(point + place * axis, half * axis[None], session.up)


def cap(target: Target, session: Session) -> Region:
    """All about a centre but its underside."""
    return Region(vector(target, "centre"), up=session.up, widest=LOWEST)


def on_face(target: Target, region: Region, radius: float, count: int, rng: np.random.Generator) -> Places:
    """All over a face."""
    normals = np.tile(vector(target, "normal"), (count, 1))
    return region.centre + rng.uniform(-1, 1, (count, 2)) @ region.half + radius * normals, normals


def on_sphere(target: Target, region: Region, radius: float, count: int, rng: np.random.Generator) -> Places:
    """All over the cap of a sphere."""
    normals = _in_cap(region, count, rng)
    return region.centre + (0.5 * float(target.values["diameter"]) + radius) * normals, normals


def on_side(target: Target, region: Region, radius: float, count: int, rng: np.random.Generator) -> Places:
    """All over a cylinder, but on its underside."""
    normals = cross(np.tile(vector(target, "axis"), (count, 1)), rng.normal(size=(count, 3)))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals[normals @ region.up < np.cos(DOWN)] *= -1
    along = rng.uniform(-1, 1, (count, 1)) @ region.half
    return region.centre + along + (0.5 * float(target.values["diameter"]) + radius) * normals, normals


def in_seat(target: Target, region: Region, radius: float, count: int, rng: np.random.Generator) -> Places:
    """The centre of a seat, which is left upwards."""
    return np.tile(region.centre, (count, 1)), np.tile(region.up, (count, 1))


def about_pivot(
    target: Target, region: Region, radius: float, count: int, rng: np.random.Generator
) -> Places | None:
    """At the length of a bar from its pivot; None of a wire, which has any length."""
    length = float(target.values["length"])
    if np.isnan(length):
        return None
    return region.centre + length * _in_cap(region, count, rng), np.full((count, 3), np.nan)


def _in_cap(region: Region, count: int, rng: np.random.Generator) -> np.ndarray:
    return cone(np.tile(region.up, (count, 1)), region.widest, rng)


def stemmed(centre: np.ndarray, diameter: float, up: np.ndarray) -> tuple[Shape, ...]:
    """A sphere on a stem: centre (3,) and diameter in m, `up` (3,) the unit vector opposite to the stem."""
    return ball(centre, 0.5 * diameter), Capsule(FIXED, centre, centre - STEM * up, STEM_RADIUS * diameter)


def sphere(target: Target, region: Region) -> tuple[Shape, ...]:
    """A sphere on its stem."""
    return stemmed(region.centre, float(target.values["diameter"]), region.up)


def wall(target: Target, region: Region) -> tuple[Shape, ...]:
    """A thin wall behind a face."""
    normal, half = vector(target, "normal"), np.linalg.norm(region.half, axis=1)
    axes = np.column_stack([*(region.half / half[:, None]), normal])
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return (Box(rigid(axes, region.centre - THICK * normal), np.append(half, THICK)),)


def pin(target: Target, region: Region) -> tuple[Shape, ...]:
    """A cylinder with round ends."""
    radius, half = 0.5 * float(target.values["diameter"]), region.half[0]
    return (Capsule(FIXED, region.centre - half, region.centre + half, radius, target.name),)


def post(target: Target, region: Region) -> tuple[Shape, ...]:
    """Below a seat, or the pivot of a ball bar."""
    top = region.centre - (BELOW + POST) * region.up
    return (Capsule(FIXED, top, top - STEM * region.up, POST, target.name),)
