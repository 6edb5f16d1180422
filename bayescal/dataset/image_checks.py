"""Images of a camera by target: what they cannot be, and where a camera sees its board.

The tool of a camera of `mount: flange` is the camera, of `mount: fixed` the board.
"""

from __future__ import annotations

from itertools import product as product_of
from typing import TYPE_CHECKING

import numpy as np

from bayescal.arm import hand_eye
from bayescal.arm.hand_eye import inverse, product
from bayescal.arm.shapes import Box, Capsule, Shape, ball
from bayescal.arm.transforms import cone, rigid, rpy_matrix
from bayescal.dataset import cameras
from bayescal.dataset.regions import Region, Session
from bayescal.dataset.types import Dataset, Target
from bayescal.errors import BayescalError
from bayescal.storage.files import Document

if TYPE_CHECKING:
    from bayescal.dataset.table import Table

OTHER_SIZE = 0.04
"""Relative error of the size of a board that no print has (assumed)."""
FEWEST_IMAGES = 4
"""Images from which a hand-eye is judged."""
STILL = 6.0
"""deg: joints that vary by less do not tell where things are; a full turn in rad is 6.3 (convention)."""
MISFIT = 0.05
"""m: by which most images must fit the arm."""


def misfit(dataset: Dataset, target: int, rows: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """How far the images of some rows (C,) are off, m, with camera and board at their best; 0 if unknown.

    The lens is taken within its stated u, as the images have it.
    """
    seen, good, _ = cameras.closed_form(dataset, target, rows, readings)
    if np.sum(good) < FEWEST_IMAGES:
        return np.zeros(len(rows))
    off = seen.off
    if np.max(off) > MISFIT >= np.median(off):  # most images agree: the lens may be stated roughly
        lens = cameras.best_lens(dataset, target, rows, readings, 1.0)
        if lens is not None:
            other = cameras.with_lens(dataset, target, lens)
            off = np.minimum(off, cameras.closed_form(other, target, rows, readings)[0].off)
    return off[seen.image]


def prepared(dataset: Dataset, target: int, table: Table, document: Document) -> Dataset:
    """The session with a camera and its board placed by its rows, or what is wrong with these.

    Raises
    ------
    BayescalError
        With the line, for corners that are not of the board or of the image; for a board of another size,
        mirrored or numbered otherwise; and where neither the rows nor dataset.yaml say where things are.
    """
    t, m = dataset.targets[target], dataset.measurements
    rows = np.flatnonzero(m.target == target)
    where = document.where(("targets", t.name))
    if not len(rows):
        return dataset
    assert m.pixel is not None
    _check_rows(t, rows, m.pixel, table)
    _check_doubled(dataset, target, rows, table)
    rough = not (np.isnan(t.values["xyz"]).any() or np.isnan(t.values["rpy"]).any())
    if t.u is not None and rough:
        return dataset
    used = rows[m.tool[rows] == np.bincount(m.tool[rows]).argmax()]
    seen, _, solution = cameras.closed_form(dataset, target, used, m.readings)
    _check_board(dataset, target, used, seen, where)
    if solution is None or not solution.determined:
        if rough:
            return dataset
        what = f"the images of `{t.name}` do not tell where camera and board are"
        remedy = "add images with the flange turned about two axes, or `xyz_mm` and `rpy_deg`"
        turning = np.ptp(m.readings[used], axis=0)[~dataset.robot.slides]
        if len(turning) and (most := float(np.degrees(turning.max()))) < STILL:
            what += f": no joint reading varies by more than {most:.2g} deg"
            remedy = f"are the readings deg, as the columns say? or {remedy}"
        raise BayescalError(what, where, remedy)
    _check_arm(dataset, target, used, solution, where)
    k = int(m.tool[used[0]])
    return cameras.placed(dataset, target, None if cameras.is_stated(dataset.tools[k]) else k, solution)


def _check_rows(t: Target, rows: np.ndarray, pixel: np.ndarray, table: Table) -> None:
    count, of_rows = len(cameras.board(t).points), np.isin(np.arange(len(pixel)), rows)
    read = np.where(of_rows[:, None], pixel, np.nan)
    number = read[:, 2]
    wrong = of_rows & ((number != np.round(number)) | (number < 0) | (number >= count))
    what = f"`point` is {{point}}, but the board of `{t.name}` has points 0 to {count - 1}"
    table.first(wrong, what, "check `board`, or the numbers of the corners")
    if not np.isnan(size := np.asarray(t.values["size"], float)).any():
        outside, turned = (np.any((uv < -1) | (uv > size), axis=1) for uv in (read[:, :2], read[:, 1::-1]))
        stated = f"images of `{t.name}` have {size[0]:g} x {size[1]:g} px"
        what = f"a corner at ({{u_px}}, {{v_px}}) px, but {stated}"
        remedy = "the calibration of the camera is of another resolution: give that of these images"
        if not turned.any():
            what += "; with both columns interchanged all corners are inside"
            remedy = "exchange the headings `u_px` (to the right) and `v_px` (down)"
        table.first(outside, what, remedy)


def _check_doubled(dataset: Dataset, target: int, rows: np.ndarray, table: Table) -> None:
    """Refuse a point that a named image has twice."""
    m = dataset.measurements
    assert m.pixel is not None
    if m.stop is None:
        return
    named = rows[m.stop[rows] != ""]
    image = np.unique(m.stop[named], return_inverse=True)[1]
    keys = np.column_stack([image, m.tool[named], m.pixel[named, 2].astype(int)])
    first, of = np.unique(keys, axis=0, return_index=True, return_inverse=True)[1:]
    again = np.flatnonzero(first[of.ravel()] != np.arange(len(named)))
    if len(again):
        row, other = named[again[0]], m.ids[named[first[of.ravel()[again[0]]]]]
        more = f", and {len(again) - 1} more rows repeat a point of their image" if len(again) > 1 else ""
        what = f"point {int(m.pixel[row, 2])} is twice in image `{m.stop[row]}` (as row `{other}`){more}"
        raise table.error(row, what, "correct `point` or `stop`, or remove one of both rows")


def _check_board(dataset: Dataset, target: int, rows: np.ndarray, seen: cameras.Images, where: str) -> None:
    t, m = dataset.targets[target], dataset.measurements
    some = np.isfinite(seen.poses).all(axis=(1, 2))
    if not some.any():
        return
    if np.mean(seen.misfit[some] < cameras.FOREIGN) < 0.5:
        fit = int(np.sum(seen.misfit[some] < cameras.FOREIGN))
        what = f"the corners of {fit} of {len(seen.misfit)} images of `{t.name}` fit its board"
        order = "the order of the corners"
        remedy = f"check the number of squares, {order}, and the resolution of the calibration"
        if other := cameras.transposed(t.texts.get("board", "")):
            session = cameras.restated(dataset, target, texts={"board": other})
            then = cameras.closed_form(session, target, rows, m.readings)[0]
            if (many := int(np.sum(then.misfit < cameras.FOREIGN))) > 0.5 * len(then.misfit):
                what += f", those of {many} images a board {other}"
                remedy = f"write `board: {other}`, or check {order}"
        raise BayescalError(what, where, remedy)
    front = cameras.board(t).front
    good = some & (seen.misfit < cameras.FOREIGN)
    if front and np.mean(front * seen.poses[good, 2, 2] < 0) > 0.5:
        what = f"`{t.name}` sees its board from behind: the image or the order of its corners is mirrored"
        remedy = "number corners row by row from the upper left, as docs/cameras.md says"
        raise BayescalError(what, where, remedy)


def _check_arm(
    dataset: Dataset, target: int, rows: np.ndarray, solution: hand_eye.HandEye, where: str
) -> None:
    """Refuse the other mount, and a board of another size."""
    t, m = dataset.targets[target], dataset.measurements
    off = solution.misfit
    if off > MISFIT:
        other = cameras.FIXED if cameras.carried(t) else cameras.FLANGE
        session = cameras.restated(dataset, target, texts={"mount": other})
        swapped = cameras.closed_form(session, target, rows, m.readings)[2]
        assert swapped is not None
        if swapped.misfit < off / 3:
            both = f"{1e3 * off:.0f} mm off; {1e3 * swapped.misfit:.1f} mm"
            what = f"the images of `{t.name}` are {both} if its mount is"
            raise BayescalError(f"{what} `{other}`", where, f"write `mount: {other}`")
    factor = board_factor(dataset, target, rows)
    if abs(factor - 1.0) > OTHER_SIZE:
        flange, poses, _ = _poses_of(dataset, target, rows)
        if hand_eye.hand_eye(flange, poses * [1.0, 1.0, 1.0, factor]).misfit > off / 3:
            return  # nor with one of another size: `plausibility` says what may be wrong
        size = 1e3 * cameras.board(t).size
        like = f" (squares of {factor * size:.2g} mm, not {size:g} mm)" if size else ""
        what = f"the board of `{t.name}` looks {factor:.3f} times as large as stated{like}"
        raise BayescalError(what, where, "measure the board, and write its size")


def _poses_of(
    dataset: Dataset, target: int, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, hand_eye.HandEye | None]:
    """Poses (I, 3, 4) of the flange, of what it carries in what is fixed, and the hand-eye of both."""
    readings = dataset.measurements.readings
    seen, good, solution = cameras.closed_form(dataset, target, rows, readings)
    poses, flange = seen.poses[good], cameras.flange_poses(dataset, readings[seen.first[good]])
    return flange, inverse(poses) if cameras.carried(dataset.targets[target]) else poses, solution


def board_factor(dataset: Dataset, target: int, rows: np.ndarray) -> float:
    """Size of the board over its stated one, as the motions of the arm tell; 1 where they do not."""
    flange, poses, solution = _poses_of(dataset, target, rows)
    if solution is None:
        return 1.0
    # F_R x + f = Z_R (s q) + z, in which distances in the images are to the scale s of the board
    turned = poses[:, :, 3] @ solution.fixed[:, :3].T
    near = (solution.off <= 3 * np.median(solution.off) + 1e-9).astype(float)[:, None]
    fixed = np.broadcast_to(-np.eye(3), (len(flange), 3, 3))
    rows_of = np.concatenate([flange[:, :, :3], fixed, -turned[:, :, None]], axis=2)
    design = (rows_of * near[:, None]).reshape(-1, 7)
    if np.linalg.cond(design) > 1e4:
        return 1.0
    return float(np.linalg.lstsq(design, (-flange[:, :, 3] * near).ravel(), rcond=None)[0][6])


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
OUT, FAR = "the board not within the image", "camera and board too near or too far from each other"
STEEP = f"the board seen at more than {np.degrees(STEEPEST):.0f} deg"


def size_of(t: Target) -> np.ndarray:
    """Width and height (2,) of the images, px; twice the optical axis where they are not stated."""
    size = np.asarray(t.values["size"], float)
    return 2.0 * cameras.lens_of(t).centre if np.isnan(size).any() else size


def _outward(t: Target) -> float:
    """Sign of the z axis of the board towards who sees it; a list of points is like a printed board."""
    return -float(cameras.board(t).front or 1)


def _distances(t: Target) -> np.ndarray:
    """Smallest and largest distance (2,), m, at which the board has a sensible share of the image."""
    length = float(np.max(np.ptp(cameras.board(t).points, axis=0)))
    return np.mean(cameras.lens_of(t).focal) * length / (np.min(size_of(t)) * np.array([LARGEST, SMALLEST]))


def region(t: Target, session: Session) -> Region:
    """What is fixed, with the distances (2,), m, between camera and board.

    Raises
    ------
    BayescalError
        If it is not known where it is.
    """
    place, rpy = np.asarray(t.values["xyz"], float), np.asarray(t.values["rpy"], float)
    if np.isnan(place).any() or np.isnan(rpy).any():
        fixed = "board" if cameras.carried(t) else "camera"
        what = f"where the {fixed} of `{t.name}` is cannot be told"
        state = "state `xyz_mm`, `rpy_deg`, and those of the tool"
        remedy = f"plan `--after` a session of some images, or {state}"
        raise BayescalError(what, "dataset.yaml: targets", remedy)
    span, seen = _distances(t), session.probed()
    if len(seen):
        apart = np.linalg.norm(seen - place, axis=1)
        span = np.array([NEARER * apart.min(), FARTHER * apart.max()])
    up = rpy_matrix(rpy)[:, 2] * _outward(t) if cameras.carried(t) else np.empty(0)
    return Region(place, up=up, span=span)


def aims(t: Target, place: Region, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random poses (count, 3, 4) of the tool in F0, from which as many as possible have the board in view.

    Uniform are the direction in which the board is seen within `STEEPEST` of its normal, the logarithm of the
    distance, and the roll about the line of sight.
    """
    some, size, lens, middle = DRAWN * count, size_of(t), cameras.lens_of(t), _middle(t)
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
    tool = product(_fixed(t, place), inverse(seen) if cameras.carried(t) else seen)
    return tool[np.argsort(faults(t, place, tool) != "", kind="stable")[:count]]


def _middle(t: Target) -> np.ndarray:
    """Middle (3,), m, of the board in its frame."""
    points = cameras.board(t).points
    return 0.5 * (points.max(axis=0) + points.min(axis=0))


def _fixed(t: Target, place: Region) -> np.ndarray:
    """Pose (3, 4) in F0 of what is fixed."""
    return rigid(rpy_matrix(np.asarray(t.values["rpy"])), place.centre)[:3]


def faults(t: Target, place: Region, tool: np.ndarray) -> np.ndarray:
    """Why the board is not in view at poses (M, 3, 4) of the tool in F0, or "", (M,)."""
    fixed, middle = _fixed(t, place), _middle(t)
    seen = product(inverse(tool), fixed) if cameras.carried(t) else product(inverse(fixed), tool)
    points, lens, size = cameras.board(t).points, cameras.lens_of(t), size_of(t)
    in_camera = np.einsum("mij,kj->mik", seen[:, :, :3], points) + seen[:, :, 3:]
    sight = seen[:, :, :3] @ middle + seen[:, :, 3]
    far = np.linalg.norm(sight, axis=1)
    out = np.full(len(tool), "", object)
    facing = -_outward(t) * np.sum(seen[:, :, 2] * sight, axis=1) / far
    out[facing < np.cos(STEEPEST + 1e-6)] = STEEP
    # the origin of the board, not its middle, gave the distances of a session
    wide = float(np.linalg.norm(middle))
    out[(far < place.span[0] - wide) | (far > place.span[1] + wide)] = FAR
    before = in_camera[:, 2].min(axis=1) > 0.0
    shown = before[:, None, None]
    xy = np.where(shown, in_camera[:, :2] / np.where(shown, in_camera[:, 2:], 1.0), 0.0)
    pixel = lens.pixels(xy)
    margin = EDGE * size[:, None]
    inside = np.all((pixel > margin) & (pixel < size[:, None] - margin), axis=(1, 2)) & before
    back = lens.directions(np.moveaxis(pixel, 0, 1).reshape(2, -1)).reshape(2, len(tool), -1)
    inside &= np.max(np.abs(np.moveaxis(back, 0, 1) - xy), axis=(1, 2)) < UNDONE
    out[~inside] = OUT
    return out


def sights(t: Target, place: Region, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From the camera (M, 3) to the outermost points of the board (M, K, 3) in F0, at poses of the tool."""
    fixed, points = np.broadcast_to(_fixed(t, place), tool.shape), cameras.board(t).points
    eye, seen = (tool, fixed) if cameras.carried(t) else (fixed, tool)
    ends = np.unique(list(product_of(*zip(points.min(axis=0), points.max(axis=0), strict=True))), axis=0)
    return eye[:, :, 3], np.einsum("mij,kj->mki", seen[:, :, :3], ends) + seen[:, None, :, 3]


def _plate(t: Target) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half edges (3,), m, of the board with a margin of a square, in its frame."""
    b, points = cameras.board(t), cameras.board(t).points
    low, high = points.min(axis=0) - b.size, points.max(axis=0) + b.size
    half = np.maximum(0.5 * (high - low), THICK)
    half[2] = THICK + 0.5 * float(np.ptp(points[:, 2]))
    local = 0.5 * (low + high)
    local[2] = float(np.mean(points[:, 2])) - _outward(t) * THICK
    return local, half


def obstacle(t: Target, place: Region) -> tuple[Shape, ...]:
    """The board as a plate, or the body of a fixed camera."""
    if not cameras.carried(t):
        return (ball(place.centre, BODY),)
    local, half = _plate(t)
    turn = rpy_matrix(np.asarray(t.values["rpy"]))
    return (Box(rigid(turn, place.centre + turn @ local), half),)


def held(t: Target) -> tuple[Capsule, ...]:
    """The body of a camera on the flange, or a board that is carried: parallel capsules that contain it."""
    if cameras.carried(t):
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
    return len(cameras.board(t).points)
