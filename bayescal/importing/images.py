"""Images of a board and the joint readings at them, to a session of a camera: corners by OpenCV.

Where no template states the lens, it follows from the images (`cv2.calibrateCamera`). Whether the camera or
the board is on the flange is decided by the images: with the wrong one they fit no arm.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.hand_eye import FEWEST_IMAGES, half_turns
from bayescal.dataset import Dataset, Target, Tool
from bayescal.dataset.cameras import FIXED, FLANGE, Board, board_of, closed_form, flange_poses
from bayescal.dataset.cameras import images as images_of
from bayescal.dataset.table import Table, check_groups, check_names, joint_columns, read_cells
from bayescal.dataset.target_kinds import CAMERA
from bayescal.dataset.types import Measurements
from bayescal.errors import BayescalError, listed
from bayescal.importing.ask import Request, base_of
from bayescal.importing.convert import Draft, roles_of
from bayescal.storage.files import stem_of
from bayescal.storage.reading import library

APPLY = ("board", "joints", "robot", "template", "readings", "name", "validate", "allow_xacro")
"""Options of images."""
KINDS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")
"""Suffixes of images."""
DICTIONARIES = ("4X4_250", "5X5_250", "6X6_250", "7X7_250", "ARUCO_ORIGINAL")
"""Markers of ChArUco boards that are tried."""
TRIED = 4
"""Images on which dictionaries are tried."""
FEWEST = 6
"""Corners from which an image is used."""
PICTURE = "found.jpg"
MOSAIC, TILE = 36, 320
"""Images of the picture of what was found, and the width of each, px."""
MOST_CALIBRATED = 40
"""Images from which a lens is calibrated, spread over all (cost)."""


Corners = tuple[np.ndarray, np.ndarray]
"""Corners of a board in an image: pixels (K, 2) and their numbers (K,)."""
NONE = np.zeros((0, 2)), np.zeros(0, int)
Pixels = Callable[[Any, Path], np.ndarray]
"""Reads an image, (height, width), by OpenCV."""


@dataclass(frozen=True)
class Found:
    """Corners of a board in an image: pixels (K, 2) and their numbers (K,)."""

    name: str
    pixel: np.ndarray
    number: np.ndarray


def convert_images(request: Request) -> Draft:
    """Find a board in images, and join its corners with the joint readings.

    Raises
    ------
    BayescalError
        Without OpenCV; for an image that cannot be read or has another size, a board that is not found,
        markers of another board, and joint readings without an image.
    """
    cv2 = library("cv2", "images need OpenCV", "--board", "install it: `pip install bayescal[camera]`")
    try:
        board = board_of(request.board)
    except ValueError as error:
        raise BayescalError(f"`{request.board}` is no board", "--board", str(error)) from None
    request.refuse_other(APPLY, "images")
    if not request.robot and request.template is None:
        raise BayescalError("the robot is not stated", "--robot", "name it, or give a --template")
    base = base_of(request)
    readings = _readings(request, base.robot)
    images = _images(request.log, readings)
    size, seen, how = _detected(cv2, images, board, request)
    used = [f for f in seen if len(f.number) >= min(FEWEST, len(board.points))]
    if len(used) < FEWEST_IMAGES:
        what = f"the board is found in {len(used)} of {len(seen)} images"
        remedy = f"{FEWEST_IMAGES} are needed; check --board and the light"
        if np.mean([len(f.number) > 0 for f in _detected(cv2, images, board, request, _flipped)[1]]) > 0.5:
            what, remedy = f"{what}: they are mirrored", "save them as the camera takes them"
        raise BayescalError(what, str(request.log), remedy)
    without_board = sorted({f.name for f in seen} - {f.name for f in used})
    notes = [f"board not found in: {listed(without_board, 6)}"] if without_board else []
    if unread := sorted({p.name for p in _files(request.log)} - {p.name for p in images.values()}):
        notes.append(f"without joint readings, not used: {listed(unread, 6)}")
    rows = {name: k for k, name in enumerate(readings.cells["image"])}
    place = np.repeat([rows[f.name] for f in used], [len(f.number) for f in used])
    session, lens = _session(cv2, request, base, board, used, readings, place, size)
    if request.board.startswith("checkerboard") and (turned := _turned(session)):
        used = [replace(f, pixel=f.pixel[::-1]) if f.name in turned else f for f in used]
        session, lens = _session(cv2, request, base, board, used, readings, place, size)
        words = f"numbered from the other end of the board, as the arm tells: {listed(sorted(turned), 6)}"
        notes.append(words)
    session, roles = roles_of(request, session, False)
    text = f"{len(used)} images of {len(seen)}, {sum(len(f.number) for f in used)} corners, {how}"
    return Draft(
        session, text, (*notes, *lens, roles), log=readings.name, line=readings.line[place],
        beside={PICTURE: _picture(cv2, images, used)},
    )  # fmt: skip


def _readings(request: Request, robot: Robot) -> Table:
    """The table of joint readings: image, j1_deg ..., and perhaps j1_degps ..., time_s.

    Without `image` the ids of a plan are the names of its images.
    """
    if not request.joints:
        raise BayescalError("no joint readings", "--joints", "give a table: image, j1_deg, j2_deg, ...")
    path = Path(request.joints)
    if not path.is_file():
        raise BayescalError("no such file", request.joints, "give the table of joint readings")
    angles = joint_columns("deg", robot.units)

    def check(header: list[str], where: str) -> None:
        check_names(header, where)
        needed = ("id" if "image" not in header and "id" in header else "image", *angles)
        lacking = [c for c in needed if c not in header]
        if lacking:
            raise BayescalError(f"column `{lacking[0]}` is missing", where, f"needed: {listed(needed, 12)}")
        check_groups(header, where, [joint_columns("degps", robot.units)])

    table = read_cells(path, check)
    return replace(table, cells={"image": table.cells.get("id", ()), **table.cells})


def _images(folder: Path, readings: Table) -> dict[str, Path]:
    """Files of the images by their names in the table, in its order."""
    if not folder.is_dir():
        raise BayescalError("no such folder of images", str(folder), "give the folder")
    there = {p.name: p for p in _files(folder)}
    by_stem = {p.stem: p for p in there.values()}
    out: dict[str, Path] = {}
    for row, name in enumerate(readings.cells["image"]):
        path = there.get(name) or by_stem.get(name)
        if path is None:
            raise readings.error(row, f"no image `{name}` in {folder}", "check the column `image`")
        if path in out.values():
            raise readings.error(row, f"image `{name}` is given twice", "keep one row")
        out[name] = path
    return out


def _files(folder: Path) -> list[Path]:
    """Files of images in a folder, by name."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in KINDS)


def _grey(cv2: Any, path: Path) -> np.ndarray:
    """An image, (height, width)."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise BayescalError("not an image that can be read", str(path), "leave its row out, or save it again")
    return np.asarray(grey)


def _flipped(cv2: Any, path: Path) -> np.ndarray:
    """The mirror image of an image, (height, width)."""
    return np.ascontiguousarray(_grey(cv2, path)[:, ::-1])


def _detected(
    cv2: Any, images: dict[str, Path], board: Board, request: Request, pixels: Pixels = _grey
) -> tuple[tuple[int, int], list[Found], str]:
    """Common width and height of images, corners in each, and how they were found; one image in memory."""
    find, how = _detector(cv2, images, board, request, pixels)
    height, width = pixels(cv2, next(iter(images.values()))).shape
    detections = []
    for name, path in images.items():
        grey = pixels(cv2, path)
        if grey.shape != (height, width):
            what = f"{grey.shape[1]} x {grey.shape[0]} px, the others have {width} x {height}"
            raise BayescalError(what, str(path), "import images of one resolution")
        detections.append(Found(name, *find(grey)))
    return (width, height), detections, how


def _detector(
    cv2: Any, images: dict[str, Path], board: Board, request: Request, pixels: Pixels
) -> tuple[Callable[[np.ndarray], Corners], str]:
    """What finds the corners of the board in an image, and how."""
    if board.kind == "checkerboard":
        return partial(_checkerboard, cv2, board), "checkerboard"
    if board.kind == "apriltag":
        family = _dictionary(cv2, f"APRILTAG_{board.family.upper()}")
        detector = cv2.aruco.ArucoDetector(family, _subpixel(cv2))
        tags = sorted({k for path in images.values() for k in _tags(detector, pixels(cv2, path))})
        if len(tags) > 1:
            what = f"tags {listed(list(map(str, tags)), 6)} are seen: it is not stated which is the board"
            raise BayescalError(what, "--board", "cover the others, or use a board of many corners")
        return partial(_tag, detector), f"tag {board.family}"
    some = [pixels(cv2, path) for path in list(images.values())[:: max(len(images) // TRIED, 1)][:TRIED]]
    finders = {text: cv2.aruco.ArucoDetector(_dictionary(cv2, text)) for text in DICTIONARIES}
    ids = {text: [k for grey in some for k in _tags(finder, grey)] for text, finder in finders.items()}
    text = max(ids, key=lambda name: len(ids[name]))
    sizes = (board.squares, board.size, board.marker)
    layouts = [cv2.aruco.CharucoBoard(*sizes, _dictionary(cv2, text)) for _ in "ab"]
    layouts[1].setLegacyPattern(True)
    expected = set(np.ravel(layouts[0].getIds()).tolist())
    if len(other := set(ids[text]) - expected) > 1:
        what = f"markers up to {max(other)} are seen; {request.board} has 0 to {max(expected)}"
        raise BayescalError(what, "--board", "another board: count its squares")
    detectors = [cv2.aruco.CharucoDetector(layout) for layout in layouts]
    for detector in detectors:
        detector.setDetectorParameters(_subpixel(cv2))
    best = max(detectors, key=lambda d: sum(len(_charuco(d, grey)[1]) for grey in some))
    how = f"markers {text}{', pattern of OpenCV before 4.6' if best is detectors[1] else ''}"
    return partial(_charuco, best), how


def _dictionary(cv2: Any, text: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{text}"))


def _subpixel(cv2: Any) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return parameters


def _charuco(detector: Any, grey: np.ndarray) -> Corners:
    corners, numbers, _, _ = detector.detectBoard(grey)
    if numbers is None or corners is None:
        return NONE
    return np.reshape(corners, (-1, 2)).astype(float), np.ravel(numbers)


def _checkerboard(cv2: Any, board: Board, grey: np.ndarray) -> Corners:
    good, corners = cv2.findChessboardCornersSB(grey, board.squares, flags=cv2.CALIB_CB_ACCURACY)
    if not good:
        return NONE
    pixel = corners.reshape(-1, 2).astype(float)
    columns, rows = board.squares
    first, second = pixel[columns - 1] - pixel[0], pixel[(rows - 1) * columns] - pixel[0]
    if first[0] * second[1] - first[1] * second[0] < 0:  # x to the right, y down, as seen from the front
        pixel = pixel.reshape(rows, columns, 2)[:, ::-1].reshape(-1, 2)
    return pixel, np.arange(len(pixel))


def _tags(detector: Any, grey: np.ndarray) -> dict[int, np.ndarray]:
    """Corners (4, 2), px, of the tags in an image, by their numbers."""
    corners, ids, _ = detector.detectMarkers(grey)
    numbers = [] if ids is None else np.ravel(ids).tolist()
    return {k: np.reshape(c, (4, 2)).astype(float) for k, c in zip(numbers, corners, strict=True)}


def _tag(detector: Any, grey: np.ndarray) -> Corners:
    return next(((pixel, np.arange(4)) for pixel in _tags(detector, grey).values()), NONE)


def _session(
    cv2: Any, request: Request, base: Dataset, board: Board, used: Sequence[Found], readings: Table,
    place: np.ndarray, size: tuple[int, int],
) -> tuple[Dataset, tuple[str, ...]]:  # fmt: skip
    """The session, with the mount that the images fit, and what a user should know of the lens.

    `place` (N,) is the row of the readings of each corner.
    """
    units, number = base.robot.units, np.concatenate([f.number for f in used])

    def column(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values[place]

    joints = readings.block(joint_columns("deg", units), needed=True)
    assert joints is not None
    m = Measurements(
        tuple(f"{readings.cells['image'][k]}:{c}" for k, c in zip(place, number, strict=True)),
        np.full(len(place), "calibrate"), np.zeros(len(place), int), np.zeros(len(place), int), joints[place],
        np.arange(len(place)) + 2,
        velocity=column(readings.block(joint_columns("degps", units), needed=True)),
        pixel=np.column_stack([np.concatenate([f.pixel for f in used]), number]),
        stop=np.array([readings.cells["image"][k] for k in place]),
        time=column(readings.optional("time_s")),
    )  # fmt: skip
    base = replace(base, tools=base.tools or (Tool("on-flange", np.zeros(3)),))
    stated = [t for t in base.targets if t.kind == "camera"]
    if len(stated) > 1 or len(stated) < len(base.targets):
        what = f"the template has {len(base.targets)} targets"
        raise BayescalError(what, "--template", "images are of one camera: leave the others out")
    if stated:
        target, notes = replace(stated[0], texts=dict(stated[0].texts) | {"board": request.board}), ()
        stated_size = np.asarray(target.values["size"], float)
        if not np.isnan(stated_size).any() and tuple(stated_size) != size:
            what = f"images have {size[0]} x {size[1]} px, "
            what += f"the camera of the template {stated_size[0]:g} x {stated_size[1]:g}"
            raise BayescalError(what, str(request.log), "give the calibration of this resolution")
        return replace(base, targets=(target,), measurements=m), notes
    numbers = [key for key in CAMERA if key not in ("mount", "lens", "board")]
    values: dict[str, Any] = dict.fromkeys((stem_of(key)[0] for key in numbers), np.nan)
    lens, rms = _calibrated(cv2, board, used, size)
    values |= lens | {"size": np.array(size, float)}
    note = f"lens from these images: fx {lens['fx']:.1f}, fy {lens['fy']:.1f} px, RMS {rms:.2f} px"
    choices = []
    for on in (FLANGE, FIXED):
        target = Target("camera", "camera", values, texts={"mount": on, "board": request.board})
        choices.append(replace(base, targets=(target,), measurements=m))
    best = min(choices, key=_misfit)
    mount = best.targets[0].texts["mount"]
    return best, (note, f"mount: {mount} (images are {1e3 * _misfit(best):.1f} mm off the nominal arm)")


def _turned(d: Dataset) -> set[str]:
    """Images in which a checkerboard is numbered from its other end: after half a turn it looks alike."""
    m = d.measurements
    assert m.stop is not None
    rows = np.arange(len(m.ids))
    seen = images_of(d, 0, rows)
    good = np.isfinite(seen.poses).all(axis=(1, 2))
    first = seen.first[good]
    turned = half_turns(flange_poses(d, m.readings[first]), seen.poses[good])
    return set(m.stop[first[turned]].tolist())


def _misfit(d: Dataset) -> float:
    """How far most images are off the nominal arm, m."""
    solution = closed_form(d, 0, np.arange(len(d.measurements.ids)), d.measurements.readings)[2]
    return np.inf if solution is None else solution.misfit


def _calibrated(
    cv2: Any, board: Board, used: Sequence[Found], size: tuple[int, int]
) -> tuple[dict[str, Any], float]:
    """Focal lengths, optical axis and distortion from the images, and the RMS, px."""
    some = used[:: max(len(used) // MOST_CALIBRATED, 1)]
    points = [board.points[f.number].astype(np.float32) for f in some]
    pixels = [f.pixel.astype(np.float32) for f in some]
    flags = cv2.CALIB_FIX_K3
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(points, pixels, size, None, None, flags=flags)
    lens = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    return {k: float(v) for k, v in lens.items()} | {"distortion": np.ravel(distortion)[:5]}, float(rms)


def _picture(cv2: Any, images: dict[str, Path], used: Sequence[Found]) -> bytes:
    """A mosaic of images with the corners that were found, as JPEG."""
    tiles = []
    for f in used[:: max(-(-len(used) // MOSAIC), 1)]:
        grey = _grey(cv2, images[f.name])
        shrink = TILE / grey.shape[1]
        tile = cv2.cvtColor(cv2.resize(grey, (TILE, round(grey.shape[0] * shrink))), cv2.COLOR_GRAY2BGR)
        for (u, v), k in zip(f.pixel * shrink, f.number, strict=True):
            size, colour = (4, (0, 0, 255)) if k == f.number.min() else (2, (0, 200, 0))
            cv2.circle(tile, (round(u), round(v)), size, colour, -1)
        cv2.putText(tile, f.name[:30], (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 120, 0), 1)
        tiles.append(tile)
    across = min(6, len(tiles))
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % across)
    mosaic = np.vstack([np.hstack(tiles[k : k + across]) for k in range(0, len(tiles), across)])
    return bytes(cv2.imencode(".jpg", mosaic)[1].tobytes())
