"""Cameras: lens and board of an entry, where both are by a closed form, and what rows cannot be.

A target of kind `camera` is what is fixed in the cell: the camera (`mount: fixed`), or the board of a camera
on the flange (`mount: flange`). The tool of its rows is what the flange carries. Where the place of the
target is not stated with an uncertainty, target and tool are placed by `arm.hand_eye` from the rows. Points
of boards follow from the text of dataset.yaml, in the numbering of OpenCV.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from bayescal.arm import hand_eye
from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.dataset.types import Dataset, Target, Tool
from bayescal.errors import BayescalError
from factors.camera import NAMES, NEAREST, Camera, Lens

LENGTH = r"(\d+(?:\.\d+)?)mm"
FORMS = {
    "charuco": re.compile(rf"charuco:(\d+)x(\d+):{LENGTH}:{LENGTH}"),
    "checkerboard": re.compile(rf"checkerboard:(\d+)x(\d+):{LENGTH}"),
    "apriltag": re.compile(rf"apriltag:(16h5|25h9|36h10|36h11):{LENGTH}"),
}
EXAMPLES = "charuco:7x5:30mm:22mm, checkerboard:9x6:25mm or apriltag:36h11:40mm"
MOST = 100
"""Squares along an edge."""


@dataclass(frozen=True)
class Board:
    """Points (K, 3), m, in the frame of the board; `front` is the sign of its z axis away from who sees it.

    ChArUco and checkerboards: inner corners row by row, x to the right, y down, z into the board. A tag:
    corners clockwise from the upper left, x to the right, y up, z out of the tag. `front` is 0 of a list.
    """

    points: np.ndarray
    front: int
    kind: str = ""
    squares: tuple[int, int] = (0, 0)
    size: float = 0.0
    """m, of a square or a tag."""
    marker: float = 0.0
    """m, of the markers of a ChArUco board."""
    family: str = ""


def board_of(text: str) -> Board:
    """The board of a text, as ``charuco:7x5:30mm:22mm``: squares, their size, and that of the markers.

    Raises
    ------
    ValueError
        With what is wrong.
    """
    kind = text.partition(":")[0]
    match = FORMS[kind].fullmatch(text) if kind in FORMS else None
    if match is None:
        raise ValueError(f"write {EXAMPLES}")
    if kind == "apriltag":
        side = 1e-3 * float(match[2])
        half = 0.5 * side
        points = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
        return Board(points, -1, kind, (1, 1), side, family=match[1])
    across, down, side = int(match[1]), int(match[2]), 1e-3 * float(match[3])
    first = 1 if kind == "charuco" else 0
    columns, rows = across - first, down - first
    if not (2 <= columns <= MOST and 2 <= rows <= MOST):
        raise ValueError("it needs 2 to 100 inner corners along each edge")
    marker = 1e-3 * float(match[4]) if kind == "charuco" else 0.0
    if marker >= side > 0 or side <= 0:
        raise ValueError("its markers are smaller than its squares")
    y, x = np.mgrid[0:rows, 0:columns]
    points = side * np.column_stack([x.ravel() + first, y.ravel() + first, np.zeros(rows * columns)])
    return Board(points, 1, kind, (across, down), side, marker)


def transposed(text: str) -> str:
    """The board with columns and rows interchanged; "" of one that is none, or the same."""
    kind, _, layout = text.partition(":")
    squares, _, sizes = layout.partition(":")
    across, by, down = squares.partition("x")
    return f"{kind}:{down}x{across}:{sizes}" if by and across != down else ""


FLANGE, FIXED = "flange", "fixed"
PINHOLE = ("fx", "fy", "cx", "cy")
"""Values of a camera that are not of the distortion of its lens."""
PIXEL = 0.2
"""px, noise of a corner where none is stated (assumed: subpixel corners scatter by 0.1 to 0.3 px)."""
USUAL = {"focal": 2e-3, "centre": 3.0, "k": 1e-2, "p": 1e-3, "scale": 1e-3, "flatness": 2e-4}
"""Standard uncertainties where none are stated (assumed): of focal lengths, relative; of the image's centre,
px; of the coefficients of the distortion; of the scale of a printed board, relative; of its flatness, m."""
FOREIGN = 0.02
"""Share of the width of a board in an image: RMS misfit from which on corners are not of it (assumed)."""
MEDIAN = 2.0 * np.log(2.0)
"""Median of the square of a normal vector in the plane, in its variance."""
BLURRED, FEWEST_SHARP = 2.0, 8
"""Scatter of an image over that of most, from which on it is blurred, and its fewest corners (assumed)."""
LENS_PASSES, LENS_STEP, LENS_RESTS = 5, 0.1, 1e-3
"""Of Gauss-Newton, of differences in u, and change in u of a lens that rests: the next is a hundredth."""
WILD = 3.0
"""Times the median distance at which a corner has half its weight."""
DECISIONS = 4
"""Passes in which the arm decides between two poses of a flat board."""


def lens_of(t: Target) -> Lens:
    """The lens of a camera.

    Raises
    ------
    BayescalError
        For more coefficients than the lens has.
    """
    model = t.texts.get("lens", "pinhole")
    for key in ("distortion", "u_distortion"):
        if (count := np.size(t.values.get(key, np.nan))) > len(NAMES[model]):
            what = f"`{key}` of `{t.name}` has {count} entries"
            raise BayescalError(what, "dataset.yaml: targets", f"a {model} has {', '.join(NAMES[model])}")
    given = np.atleast_1d(np.asarray(t.values["distortion"], float))
    given = given[~np.isnan(given)]
    coefficients = np.pad(given, (0, len(NAMES[model]) - len(given)))
    focal, centre = (np.array([t.values[f"{of}{axis}"] for axis in "xy"], float) for of in "fc")
    return Lens(model, focal, centre, coefficients)


def board(t: Target) -> Board:
    """The board that a camera sees."""
    if "board" in t.texts:
        return board_of(t.texts["board"])
    return Board(np.asarray(t.values["points"], float), 0)


@dataclass(frozen=True)
class Stated:
    """Standard uncertainties of a camera and its board, as stated or usual.

    Focal lengths (2,) px, centre (2,) px, coefficients (K,), scale of the board along x and y, flatness, m.
    """

    focal: np.ndarray
    centre: np.ndarray
    coefficients: np.ndarray
    scale: float
    flatness: float


def stated(t: Target) -> Stated:
    """The uncertainties of an entry."""
    lens = lens_of(t)

    def given(key: str, usual: np.ndarray | float) -> np.ndarray:
        value = np.asarray(t.values[key], float)
        return np.asarray(usual, float) if np.isnan(value).any() else value

    usual = np.array([USUAL[name[0]] for name in NAMES[lens.model]])
    u_distortion = np.atleast_1d(given("u_distortion", usual))
    return Stated(
        np.broadcast_to(given("u_focal", USUAL["focal"] * lens.focal), 2),
        np.broadcast_to(given("u_centre", USUAL["centre"]), 2),
        np.pad(u_distortion, (0, len(usual) - len(u_distortion))),
        float(given("u_scale", USUAL["scale"])),
        float(given("u_flatness", USUAL["flatness"])),
    )


def camera(t: Target, middle: np.ndarray, read: np.ndarray, pose: np.ndarray, sd: np.ndarray) -> Camera:
    """The measurement kind of C rows.

    Parameters
    ----------
    t : Target
    middle : (3,) m, of the nominal positions of the tool
    read : (C, 3) pixels and the number of the corner
    pose : (3, 4, C) nominal poses of the tool in F0
    sd : (6,) prior standard deviations
    """
    frame = rigid(rpy_matrix(np.asarray(t.values["rpy"])), np.asarray(t.values["xyz"]))
    lens, points = lens_of(t), board(t).points
    corner = points[read[:, 2].astype(int)] if len(read) else np.zeros((0, 3))
    pivot = frame[:3, 3] + frame[:3, :3] @ points.mean(axis=0) if carried(t) else middle
    pixel, scale = np.asfortranarray(read[:, :2]), np.ones(len(read))
    bare = Camera(frame, pivot, corner, pixel, lens, scale, sd, carried(t))
    depth = np.maximum(bare.seen(np.zeros(6), pose)[2], NEAREST) if len(read) else np.ones(0)
    return replace(bare, scale=depth / np.mean(lens.focal))


def flange_poses(dataset: Dataset, readings: np.ndarray) -> np.ndarray:
    """Nominal poses of the flange in F0, (N, 3, 4), at readings (N, n), rad."""
    return frames(chain_of(dataset.robot), link_angles(dataset.robot, readings))[:, -1, :3]


@dataclass(frozen=True)
class Images:
    """What a camera saw of the board, image by image: I of them."""

    image: np.ndarray  # (C,) of each row, from 0
    first: np.ndarray  # (I,) a row of the session of each
    poses: np.ndarray  # (I, 3, 4) of the board in the frame of the camera; nan where unknown
    misfit: np.ndarray  # (I,) RMS of the corners from that pose, over the width of the board in the image
    scatter: np.ndarray  # (I,) px, about that pose: by the median, so that a single corner does not matter
    off: np.ndarray  # (I,) m, from where the arm puts the board; 0 where the corners agree with the arm
    alike: np.ndarray  # (I,) the corners agree with the arm as well as those of most images, or have no pose


def images(dataset: Dataset, target: int, rows: np.ndarray) -> Images:
    """Poses of the board in all images of some rows (C,) of a camera."""
    m = dataset.measurements
    assert m.pixel is not None
    label = np.unique(m.readings[rows].round(9), axis=0, return_inverse=True)[1].ravel()
    keys = [label, m.tool[rows]]
    if m.stop is not None:
        keys.append(np.unique(m.stop[rows], return_inverse=True)[1])
        keys[0] = np.where(m.stop[rows] == "", label, -1)
    image = np.unique(np.column_stack(keys), axis=0, return_inverse=True)[1].ravel()
    t = dataset.targets[target]
    read = np.ascontiguousarray(m.pixel[rows], float)
    lens = lens_of(t)
    poses, misfit, scatter = _poses(
        read.tobytes(), image.astype(np.int64).tobytes(), lens.model, lens_numbers(lens).tobytes(),
        board(t).points.tobytes(),
    )  # fmt: skip
    first = np.full(len(poses), -1)
    first[image[::-1]] = rows[::-1]
    return Images(image, first, poses, misfit, scatter, np.zeros(len(poses)), np.ones(len(poses), bool))


@lru_cache(maxsize=32)  # a lens and its derivatives, with joint readings that are tried in turn
def _poses(
    read: bytes, image: bytes, model: str, numbers: bytes, points: bytes
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses (I, 3, 4), misfits and scatter (I,) by the content of the arrays: they are asked for often."""
    pixel, of, by = np.frombuffer(read).reshape(-1, 3), np.frombuffer(image, np.int64), np.frombuffer(numbers)
    lens = Lens(model, by[:2], by[2:4], by[4:])
    corner = np.frombuffer(points).reshape(-1, 3)[pixel[:, 2].astype(int)]
    xy = lens.directions(pixel[:, :2].T).T
    poses = hand_eye.board_poses(corner, xy, of)
    count = np.bincount(of)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(of, values) / count

    with np.errstate(invalid="ignore", divide="ignore"):
        square = hand_eye.off(poses, corner, xy, of)
        off, spare = mean(square), np.maximum(2 * count - 6, 1) / (2 * count)
        middles = np.array([np.median(square[of == k]) for k in range(len(count))])
        scatter = np.mean(lens.focal) * np.sqrt(middles / MEDIAN / spare)
        middle = np.column_stack([mean(v) for v in xy.T])
        wide = mean(np.sum((xy - middle[of]) ** 2, axis=1))
        return poses, np.sqrt(off / np.maximum(wide, 1e-12)), scatter


def blur(dataset: Dataset, target: int, rows: np.ndarray) -> np.ndarray:
    """Factor (C,) on the noise of corners of blurred images: the scatter about the pose of their image.

    No error of an arm matters to it. 1 of all images that are not plainly worse than most, and of such with
    few corners.
    """
    seen = images(dataset, target, rows)
    enough = (np.bincount(seen.image) >= FEWEST_SHARP) & np.isfinite(seen.scatter)
    usual = np.median(seen.scatter[enough]) if enough.any() else 1.0
    factor = np.ones(len(seen.scatter))
    factor[enough] = seen.scatter[enough] / max(float(usual), 1e-6)
    return np.where(factor > BLURRED, factor, 1.0)[seen.image]


def closed_form(
    dataset: Dataset, target: int, rows: np.ndarray, readings: np.ndarray
) -> tuple[Images, np.ndarray, hand_eye.HandEye | None]:
    """The images of some rows, which of them have a pose, and the hand-eye of these at readings (N, n)."""
    seen = images(dataset, target, rows)
    good = np.isfinite(seen.poses).all(axis=(1, 2)) & (seen.misfit < FOREIGN)
    if np.sum(good) < hand_eye.FEWEST_IMAGES:
        return seen, good, None
    t, m = dataset.targets[target], dataset.measurements
    assert m.pixel is not None
    on_flange, flange = carried(t), flange_poses(dataset, readings[seen.first[good]])

    def solved(poses: np.ndarray) -> hand_eye.HandEye:
        return hand_eye.hand_eye(flange, hand_eye.inverse(poses) if on_flange else poses)

    poses, some = seen.poses[good], good[seen.image]
    pixel = m.pixel[rows[some]]
    corner = board(t).points[pixel[:, 2].astype(int)]
    xy = lens_of(t).directions(np.ascontiguousarray(pixel[:, :2].T, float)).T
    image = (np.cumsum(good) - 1)[seen.image[some]]
    solution = solved(poses)
    for _ in range(DECISIONS):
        decided = hand_eye.decided(poses, solution.predicted(flange, on_flange), corner, xy, image)
        if np.all(decided == poses):
            break
        poses, solution = decided, solved(decided)
    every, off, alike = seen.poses.copy(), np.zeros(len(good)), ~good
    every[good], predicted = poses, solution.predicted(flange, on_flange)
    agrees = hand_eye.as_good(predicted, poses, corner, xy, image)
    alike[good] = hand_eye.as_good(predicted, poses, corner, xy, image, as_most=True)
    off[good] = np.where(agrees, 0.0, solution.away)
    return replace(seen, poses=every, off=off, alike=alike), good, solution


def is_stated(of: Target | Tool) -> bool:
    """Whether a place is stated with an uncertainty."""
    return of.u is not None or of.u_angle is not None


def carried(t: Target) -> bool:
    """Whether the camera is on the flange and the board fixed, or the other way round."""
    return t.texts["mount"] == FLANGE


def placed(dataset: Dataset, target: int, tool: int | None, solution: hand_eye.HandEye) -> Dataset:
    """The session with a target, and a tool if one is given, at the places that a hand-eye has."""
    if tool is not None:
        tools, pose = list(dataset.tools), solution.on_flange
        tools[tool] = replace(tools[tool], centre=pose[:, 3], rpy=rpy_of(pose[:, :3]))
        dataset = replace(dataset, tools=tuple(tools))
    pose = solution.fixed
    return restated(dataset, target, values={"xyz": pose[:, 3], "rpy": rpy_of(pose[:, :3])})


def restated(
    dataset: Dataset, target: int, *, values: Mapping[str, Any] = {}, texts: Mapping[str, str] = {}
) -> Dataset:
    """The session with some values and texts of a target stated otherwise."""
    t, targets = dataset.targets[target], list(dataset.targets)
    targets[target] = replace(t, values={**t.values, **values}, texts={**t.texts, **texts})
    return replace(dataset, targets=tuple(targets))


def lens_numbers(lens: Lens) -> np.ndarray:
    """Focal lengths, centre, px, and coefficients (K,)."""
    return np.concatenate([lens.focal, lens.centre, lens.coefficients])


def with_lens(dataset: Dataset, target: int, values: np.ndarray) -> Dataset:
    """The session with other numbers (K,) of the lens of a camera."""
    new = dict(zip(PINHOLE, values[:4].tolist(), strict=True))
    return restated(dataset, target, values=new | {"distortion": values[4:]})


def best_lens(
    dataset: Dataset, target: int, rows: np.ndarray, readings: np.ndarray, width: float
) -> np.ndarray | None:
    """Numbers (K,) of the lens that agrees best with the arm at readings (N, n); None without a hand-eye.

    Their prior is normal, with `width` times the stated u. A lens that is stated roughly puts the board
    centimetres from where the arm has it, image by image. Hand-eye and lens follow in turn: Gauss-Newton in
    the deviations over u, with derivatives by differences, Cauchy weights of corners, and an image as one
    measurement, because what the nominal arm is off is common to its corners.
    """
    u = stated(dataset.targets[target])
    start = lens_numbers(lens_of(dataset.targets[target]))
    sd = width * np.concatenate([u.focal, u.centre, u.coefficients])
    z, free = np.zeros(len(sd)), np.flatnonzero(sd)

    def off(deviations: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        return pixels_off(with_lens(dataset, target, start + sd * deviations), target, rows, readings)

    for _ in range(LENS_PASSES):
        if (now := off(z)) is None:
            return None
        ahead = [off(z + LENS_STEP * np.eye(len(sd))[k]) for k in free]
        slopes = np.stack([(now if one is None else one)[0] - now[0] for one in ahead]) / LENS_STEP
        size = np.linalg.norm(now[0], axis=1)
        usual = max(float(np.median(size)), 1e-6)
        weight = 1.0 / (1.0 + (size / (WILD * usual)) ** 2) / np.bincount(now[1])[now[1]] / usual**2
        normal = np.einsum("kci,lci,c->kl", slopes, slopes, weight) + np.eye(len(free))
        step = np.linalg.solve(normal, np.einsum("kci,ci,c->k", slopes, now[0], weight) + z[free])
        z[free] -= step
        if np.max(np.abs(step)) < LENS_RESTS:
            break
    return np.asarray(start + sd * z)


def pixels_off(
    dataset: Dataset, target: int, rows: np.ndarray, readings: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners (C, 2) less where the hand-eye has them, px, and their images (C,)."""
    t, m = dataset.targets[target], dataset.measurements
    seen, _, solution = closed_form(dataset, target, rows, readings)
    if solution is None or m.pixel is None:
        return None
    poses = solution.predicted(flange_poses(dataset, readings[seen.first]), carried(t))
    return m.pixel[rows, :2] - projected(t, poses[seen.image], m.pixel[rows, 2]), seen.image


def projected(t: Target, poses: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Corners (C, 2), px, by their numbers (C,) and the poses (C, 3, 4) of the board in the camera."""
    corner = board(t).points[number.astype(int)]
    points = np.einsum("cij,cj->ci", poses[..., :3], corner) + poses[..., 3]
    return lens_of(t).pixels((points[:, :2] / points[:, 2:]).T).T
