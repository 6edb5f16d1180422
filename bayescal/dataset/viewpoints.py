"""Where a camera sees its board well: random poses of the tool, and whether the board is in view at a pose.

The tool of a camera of `mount: flange` is the camera, of `mount: fixed` the board.
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.hand_eye import inverse, product
from bayescal.arm.shapes import Box, Capsule, Shape, ball
from bayescal.arm.transforms import cone, rigid, rpy_matrix
from bayescal.dataset.cameras import FLANGE, board, lens_of
from bayescal.dataset.regions import Region, Session
from bayescal.dataset.types import Target
from bayescal.errors import BayescalError

STEEPEST = np.radians(50.0)
"""rad: greatest angle between the line of sight and the normal of the board (assumed: beyond it corners are
found badly, and a tag not at all)."""
NEARER, FARTHER = 0.5, 2.0
"""Of the smallest and the largest distance between camera and board in a session: distances of a plan."""
LARGEST, SMALLEST = 0.9, 0.25
"""Length of a board over the shorter edge of the image at the distances of a plan without a session."""
EDGE = 0.05
"""Of the size of the image: the distance of corners from its edges."""
DRAWN = 8
"""Poses that are drawn for each that is tried, to have as many as possible with the board in view."""
ASIDE = 0.6
"""Of half the image: how far the board may be from the middle (radius)."""
UNDONE = 1e-4
"""Change of a direction by distortion and its inverse, from which on it is beyond the lens."""
BODY, THICK = 0.04, 5e-3
"""m, assumed: radius of a fixed camera, and half of the thickness of a board."""
STRIPS = 6.0
"""Half of the width of a carried board over the radius of the capsules that contain it, where it is large."""
OUT, STEEP, FAR = (
    "the board not within the image",
    f"the board seen at more than {np.degrees(STEEPEST):.0f} deg",
    "camera and board too near or too far from each other",
)


def size_of(t: Target) -> np.ndarray:
    """Width and height (2,) of the images, px; twice the optical axis where they are not stated."""
    size = np.asarray(t.values["size"], float)
    return 2.0 * lens_of(t).centre if np.isnan(size).any() else size


def _outward(t: Target) -> float:
    """Sign of the z axis of the board towards who sees it; a list of points is like a printed board."""
    return -float(board(t).front or 1)


def _distances(t: Target) -> np.ndarray:
    """Smallest and largest distance (2,), m, at which the board has a sensible share of the image."""
    points = board(t).points
    length = float(np.max(np.ptp(points, axis=0)))
    return np.mean(lens_of(t).focal) * length / (np.min(size_of(t)) * np.array([LARGEST, SMALLEST]))


def region(t: Target, session: Session) -> Region:
    """What is fixed, with the distances (2,), m, between camera and board.

    Raises
    ------
    BayescalError
        If it is not known where it is.
    """
    place, rpy = np.asarray(t.values["xyz"], float), np.asarray(t.values["rpy"], float)
    if np.isnan(place).any() or np.isnan(rpy).any():
        fixed = "board" if t.texts["mount"] == FLANGE else "camera"
        what = f"where the {fixed} of `{t.name}` is cannot be told"
        state = "state `xyz_mm`, `rpy_deg`, and those of the tool"
        remedy = f"plan `--after` a session of some images, or {state}"
        raise BayescalError(what, "dataset.yaml: targets", remedy)
    span, seen = _distances(t), session.probed()
    if len(seen):
        apart = np.linalg.norm(seen - place, axis=1)
        span = np.array([NEARER * apart.min(), FARTHER * apart.max()])
    up = rpy_matrix(rpy)[:, 2] * _outward(t) if t.texts["mount"] == FLANGE else np.empty(0)
    return Region(place, up=up, span=span)


def aims(t: Target, place: Region, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random poses (count, 3, 4) of the tool in F0, from which as many as possible have the board in view.

    Uniform are the direction in which the board is seen within `STEEPEST` of its normal, the logarithm of the
    distance, and the roll about the line of sight.
    """
    some, size, lens = DRAWN * count, size_of(t), lens_of(t)
    points = board(t).points
    middle = 0.5 * (points.max(axis=0) + points.min(axis=0))
    # in the frame of the camera: where the middle of the board is, and its axes
    angle, radius = rng.uniform(0, 2 * np.pi, some), ASIDE * np.sqrt(rng.uniform(0, 1, some))
    pixel = 0.5 * size[:, None] * (1 + radius * np.array([np.cos(angle), np.sin(angle)]))
    sight = np.column_stack([*lens.directions(pixel), np.ones(some)])
    sight /= np.linalg.norm(sight, axis=1)[:, None]
    far = np.exp(rng.uniform(np.log(place.span[0]), np.log(place.span[1]), some))
    z = _outward(t) * cone(-sight, STEEPEST, rng)
    x = np.cross(z, rng.normal(size=(some, 3)))
    x /= np.linalg.norm(x, axis=1)[:, None]
    axes = np.stack([x, np.cross(z, x), z], axis=-1)
    shift = far[:, None] * sight - axes @ middle
    seen = np.concatenate([axes, shift[..., None]], axis=-1)
    fixed = rigid(rpy_matrix(np.asarray(t.values["rpy"])), place.centre)[:3]
    tool = product(fixed, inverse(seen) if t.texts["mount"] == FLANGE else seen)
    bad = faults(t, place, tool) != ""
    return tool[np.argsort(bad, kind="stable")[:count]]


def faults(t: Target, place: Region, tool: np.ndarray) -> np.ndarray:
    """Why the board is not in view at poses (M, 3, 4) of the tool in F0, or "", (M,)."""
    fixed = rigid(rpy_matrix(np.asarray(t.values["rpy"])), place.centre)[:3]
    seen = product(inverse(tool), fixed) if t.texts["mount"] == FLANGE else product(inverse(fixed), tool)
    points, lens, size = board(t).points, lens_of(t), size_of(t)
    middle = 0.5 * (points.max(axis=0) + points.min(axis=0))
    at = np.einsum("mij,kj->mik", seen[:, :, :3], points) + seen[:, :, 3:]
    sight = seen[:, :, :3] @ middle + seen[:, :, 3]
    far = np.linalg.norm(sight, axis=1)
    out = np.full(len(tool), "", object)
    facing = -_outward(t) * np.sum(seen[:, :, 2] * sight, axis=1) / far
    out[facing < np.cos(STEEPEST + 1e-6)] = STEEP
    # the origin of the board, not its middle, gave the distances of a session
    wide = float(np.linalg.norm(middle))
    out[(far < place.span[0] - wide) | (far > place.span[1] + wide)] = FAR
    before = at[:, 2].min(axis=1) > 0.0
    xy = np.where(before[:, None, None], at[:, :2] / np.where(before[:, None, None], at[:, 2:], 1.0), 0.0)
    pixel = lens.pixels(xy)
    margin = EDGE * size[:, None]
    inside = np.all((pixel > margin) & (pixel < size[:, None] - margin), axis=(1, 2)) & before
    back = lens.directions(np.moveaxis(pixel, 0, 1).reshape(2, -1)).reshape(2, len(tool), -1)
    inside &= np.max(np.abs(np.moveaxis(back, 0, 1) - xy), axis=(1, 2)) < UNDONE
    out[~inside] = OUT
    return out


def sights(t: Target, place: Region, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From the camera (M, 3) to the outermost points of the board (M, K, 3) in F0, at poses of the tool."""
    fixed = np.broadcast_to(rigid(rpy_matrix(np.asarray(t.values["rpy"])), place.centre)[:3], tool.shape)
    eye, seen = (tool, fixed) if t.texts["mount"] == FLANGE else (fixed, tool)
    low, high = board(t).points.min(axis=0), board(t).points.max(axis=0)
    ends = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in {low[2], high[2]}]
    )
    return eye[:, :, 3], np.einsum("mij,kj->mki", seen[:, :, :3], ends) + seen[:, None, :, 3]


def _plate(t: Target) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half edges (3,), m, of the board with a margin of a square, in its frame."""
    b, points = board(t), board(t).points
    low, high = points.min(axis=0) - b.size, points.max(axis=0) + b.size
    half = np.maximum(0.5 * (high - low), THICK)
    half[2] = THICK + 0.5 * float(np.ptp(points[:, 2]))
    local = 0.5 * (low + high)
    local[2] = float(np.mean(points[:, 2])) - _outward(t) * THICK
    return local, half


def obstacle(t: Target, place: Region) -> tuple[Shape, ...]:
    """The board as a plate, or the body of a fixed camera."""
    if t.texts["mount"] != FLANGE:
        return (ball(place.centre, BODY),)
    local, half = _plate(t)
    turn = rpy_matrix(np.asarray(t.values["rpy"]))
    return (Box(rigid(turn, place.centre + turn @ local), half),)


def held(t: Target) -> tuple[Capsule, ...]:
    """The body of a camera on the flange, or a board that is carried: parallel capsules that contain it."""
    if t.texts["mount"] == FLANGE:
        return (Capsule(0, np.zeros(3), np.zeros(3), BODY, "camera"),)
    local, half = _plate(t)
    short, along = sorted((0, 1), key=lambda axis: half[axis])
    radius = max(2.0 * half[2], half[short] / STRIPS)
    wide = np.sqrt(radius**2 - half[2] ** 2)  # half of what a capsule covers of the plate across
    count = int(np.ceil(half[short] / wide))
    out = []
    for across in half[short] * (2.0 * np.arange(count) + 1.0 - count) / count:
        middle = local.copy()
        middle[short] += across
        end = half[along] * np.eye(3)[along]
        out.append(Capsule(0, middle - end, middle + end, float(radius), "board"))
    return tuple(out)


def corners(t: Target) -> int:
    """Number of corners of the board, which are the rows of an image."""
    return len(board(t).points)
