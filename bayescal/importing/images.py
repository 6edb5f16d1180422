"""Images of a board and the joint readings at them, to a session of a camera: corners by OpenCV.

Where no template states the lens, it follows from the images (`cv2.calibrateCamera`). Whether the camera or
the board is on the flange is decided by the images: with the wrong one they fit no arm.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.hand_eye import FEWEST_IMAGES
from bayescal.dataset import Dataset, Noise, Target, Tool, read_dataset, write_dataset
from bayescal.dataset.boards import Board, board_of
from bayescal.dataset.cameras import FIXED, FLANGE, LEVER, closed_form
from bayescal.dataset.read import SETTINGS, no_rows, read_settings
from bayescal.dataset.table import Table, check_groups, check_names, joint_columns, read_cells
from bayescal.dataset.target_kinds import CAMERA
from bayescal.dataset.types import Measurements
from bayescal.errors import BayescalError, listed
from bayescal.importing.ask import Request
from bayescal.robots import load_robot
from bayescal.storage.files import stem_of
from bayescal.storage.locks import scratch

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


@dataclass(frozen=True)
class Found:
    """Corners of a board in an image: pixels (K, 2) and their numbers (K,)."""

    name: str
    pixel: np.ndarray
    number: np.ndarray


@dataclass(frozen=True)
class ImageDraft:
    """A session before it is written, and the picture of what was found."""

    dataset: Dataset
    picture: bytes
    headline: str
    notes: tuple[str, ...]
    understood: tuple[str, ...] = ()
    wrong: str = ""


def convert_images(request: Request) -> ImageDraft:
    """Find a board in images, and join its corners with the joint readings.

    Raises
    ------
    BayescalError
        Without OpenCV; for an image that cannot be read or has another size, a board that is not found,
        markers of another board, and images without joint readings.
    """
    cv2 = opencv()
    try:
        board = board_of(request.board)
    except ValueError as error:
        raise BayescalError(f"`{request.board}` is no board", "--board", str(error)) from None
    base = _base(request)
    readings = _readings(request, base.robot)
    images, size = _images(cv2, request.log, readings)
    seen, how = _detected(cv2, images, board, request)
    used = [f for f in seen if len(f.number) >= min(FEWEST, len(board.points))]
    if len(used) < FEWEST_IMAGES:
        what = f"the board is found in {len(used)} of {len(seen)} images"
        raise BayescalError(
            what, str(request.log), f"{FEWEST_IMAGES} are needed; check --board and the light"
        )
    left = sorted({f.name for f in seen} - {f.name for f in used})
    notes = [f"board not found in: {listed(left, 6)}"] if left else []
    session, lens = _session(cv2, request, base, board, used, readings, size)
    picture = _picture(cv2, images, used)
    text = f"{len(used)} images of {len(seen)}, {sum(len(f.number) for f in used)} corners, {how}"
    return ImageDraft(session, picture, text, (*notes, *lens))


def opencv() -> Any:
    """OpenCV, or the command that installs it."""
    try:
        import cv2
    except ImportError:
        remedy = "install it: `pip install bayescal[camera]`"
        raise BayescalError("images need OpenCV", "--board", remedy) from None
    return cv2


def write_images(draft: ImageDraft, folder: Path, force: bool = False) -> None:
    """Write the session and the picture of what was found; `force`: also one that cannot be.

    Raises
    ------
    BayescalError
        Where the session breaks the format, or its images fit no arm.
    """
    with scratch("bayescal-import") as place:
        write_dataset(draft.dataset, place / "trial")
        read_dataset(place / "trial", judge=not force)
    write_dataset(draft.dataset, folder)
    (folder / PICTURE).write_bytes(draft.picture)


def _base(request: Request) -> Dataset:
    """The template, or an empty session of a robot."""
    if request.template is not None:
        path = request.template / SETTINGS if request.template.is_dir() else request.template
        return read_settings(path, assume=True)[0]
    if not request.robot:
        raise BayescalError("the robot is not stated", "--robot", "name it, or give a --template")
    robot, _ = load_robot(request.robot, allow_xacro=request.allow_xacro)
    gravity, tool = np.array([0.0, 0.0, -9.81]), Tool("on-flange", np.zeros(3))
    return Dataset(
        request.name or request.log.name, Path(), robot, request.robot, request.readings, gravity, (tool,),
        Noise(), (), (), no_rows(robot.n),
    )  # fmt: skip


def _readings(request: Request, robot: Robot) -> Table:
    """The table of joint readings: image, j1_deg ..., and perhaps j1_degps ..., time_s."""
    if not request.joints:
        raise BayescalError("no joint readings", "--joints", "give a table: image, j1_deg, j2_deg, ...")
    path = Path(request.joints)
    if not path.is_file():
        raise BayescalError("no such file", request.joints, "give the table of joint readings")
    needed = ("image", *joint_columns("deg", robot.n))

    def check(header: list[str], where: str) -> None:
        check_names(header, where)
        lacking = [c for c in needed if c not in header]
        if lacking:
            raise BayescalError(f"column `{lacking[0]}` is missing", where, f"needed: {listed(needed, 12)}")
        check_groups(header, where, [joint_columns("degps", robot.n)])

    return read_cells(path, check)


def _images(cv2: Any, folder: Path, readings: Table) -> tuple[dict[str, np.ndarray], tuple[int, int]]:
    """Grey images by their names, in the order of the table, and their common width and height."""
    if not folder.is_dir():
        raise BayescalError("no such folder of images", str(folder), "give the folder")
    there = {p.name: p for p in sorted(folder.iterdir()) if p.suffix.lower() in KINDS}
    by_stem = {p.stem: p for p in there.values()}
    out: dict[str, np.ndarray] = {}
    for row, name in enumerate(readings.cells["image"]):
        path = there.get(name) or by_stem.get(name)
        if path is None:
            raise readings.error(row, f"no image `{name}` in {folder}", "check the column `image`")
        if name in out:
            raise readings.error(row, f"image `{name}` is given twice", "keep one row")
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            raise BayescalError(
                "not an image that can be read", str(path), "leave its row out, or save it again"
            )
        first = next(iter(out.values()), grey)
        if grey.shape != first.shape:
            what = (
                f"{grey.shape[1]} x {grey.shape[0]} px, the others have {first.shape[1]} x {first.shape[0]}"
            )
            raise BayescalError(what, str(path), "import images of one resolution")
        out[name] = grey
    height, width = next(iter(out.values())).shape
    return out, (width, height)


def _detected(
    cv2: Any, images: dict[str, np.ndarray], board: Board, request: Request
) -> tuple[list[Found], str]:
    """Corners in every image, and how they were found."""
    if board.kind == "checkerboard":
        return [_checkerboard(cv2, name, grey, board) for name, grey in images.items()], "checkerboard"
    if board.kind == "apriltag":
        family = getattr(cv2.aruco, f"DICT_APRILTAG_{board.family.upper()}")
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(family), _subpixel(cv2))
        return [_tag(detector, name, grey) for name, grey in images.items()], f"tags {board.family}"
    some = list(images.values())[:: max(len(images) // TRIED, 1)][:TRIED]
    ids = {text: _markers(cv2, text, some) for text in DICTIONARIES}
    text = max(ids, key=lambda name: len(ids[name]))
    layouts = [
        cv2.aruco.CharucoBoard(board.squares, board.size, board.marker, _dictionary(cv2, text)) for _ in "ab"
    ]
    layouts[1].setLegacyPattern(True)
    own = set(np.ravel(layouts[0].getIds()).tolist())
    if len(other := set(ids[text]) - own) > 1:
        what = f"markers up to {max(other)} are seen; {request.board} has 0 to {max(own)}"
        raise BayescalError(what, "--board", "another board: count its squares")
    detectors = [cv2.aruco.CharucoDetector(layout) for layout in layouts]
    for detector in detectors:
        detector.setDetectorParameters(_subpixel(cv2))
    best = max(detectors, key=lambda d: sum(len(_charuco(d, "", grey).number) for grey in some))
    how = f"markers {text}{', pattern of OpenCV before 4.6' if best is detectors[1] else ''}"
    return [_charuco(best, name, grey) for name, grey in images.items()], how


def _dictionary(cv2: Any, text: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{text}"))


def _markers(cv2: Any, text: str, some: Iterable[np.ndarray]) -> list[int]:
    """Numbers of all markers of a dictionary that are seen."""
    detector, out = cv2.aruco.ArucoDetector(_dictionary(cv2, text)), list[int]()
    for grey in some:
        ids = detector.detectMarkers(grey)[1]
        out += [] if ids is None else np.ravel(ids).tolist()
    return out


def _subpixel(cv2: Any) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return parameters


def _charuco(detector: Any, name: str, grey: np.ndarray) -> Found:
    corners, numbers, _, _ = detector.detectBoard(grey)
    if numbers is None or corners is None:
        return _none(name)
    return Found(name, np.reshape(corners, (-1, 2)).astype(float), np.ravel(numbers))


def _checkerboard(cv2: Any, name: str, grey: np.ndarray, board: Board) -> Found:
    good, corners = cv2.findChessboardCornersSB(grey, board.squares, flags=cv2.CALIB_CB_ACCURACY)
    if not good:
        return _none(name)
    pixel = corners.reshape(-1, 2).astype(float)
    columns, rows = board.squares
    first, second = pixel[columns - 1] - pixel[0], pixel[(rows - 1) * columns] - pixel[0]
    if first[0] * second[1] - first[1] * second[0] < 0:  # x to the right, y down, as seen from the front
        pixel = pixel.reshape(rows, columns, 2)[:, ::-1].reshape(-1, 2)
    return Found(name, pixel, np.arange(len(pixel)))


def _tag(detector: Any, name: str, grey: np.ndarray) -> Found:
    corners, ids, _ = detector.detectMarkers(grey)
    if ids is None or not len(ids):
        return _none(name)
    return Found(name, np.reshape(corners[0], (4, 2)).astype(float), np.arange(4))


def _none(name: str) -> Found:
    return Found(name, np.zeros((0, 2)), np.zeros(0, int))


def _session(
    cv2: Any, request: Request, base: Dataset, board: Board, used: Sequence[Found], readings: Table,
    size: tuple[int, int],
) -> tuple[Dataset, tuple[str, ...]]:  # fmt: skip
    """The session, with the mount that the images fit, and what a user should know of the lens."""
    rows = {name: k for k, name in enumerate(readings.cells["image"])}
    place = np.repeat([rows[f.name] for f in used], [len(f.number) for f in used])
    n, number = base.robot.n, np.concatenate([f.number for f in used])

    def column(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values[place]

    joints = readings.block(joint_columns("deg", n), needed=True)
    assert joints is not None
    m = Measurements(
        tuple(f"{readings.cells['image'][k]}:{c}" for k, c in zip(place, number, strict=True)),
        np.full(len(place), "calibrate"), np.zeros(len(place), int), np.zeros(len(place), int), joints[place],
        np.arange(len(place)) + 2,
        velocity=column(readings.block(joint_columns("degps", n), needed=True)),
        pixel=np.column_stack([np.concatenate([f.pixel for f in used]), number]),
        stop=np.array([readings.cells["image"][k] for k in place]),
        time=column(readings.optional("time_s", needed=True)),
    )  # fmt: skip
    stated = [t for t in base.targets if t.kind == "camera"]
    if stated:
        target, notes = replace(stated[0], texts=dict(stated[0].texts) | {"board": request.board}), ()
        own = np.asarray(target.values["size"], float)
        if not np.isnan(own).any() and tuple(own) != size:
            what = f"images have {size[0]} x {size[1]} px, the camera of the template {own[0]:g} x {own[1]:g}"
            raise BayescalError(what, str(request.log), "give the calibration of this resolution")
        return replace(base, targets=(target,), measurements=m), notes
    values: dict[str, Any] = {
        stem_of(key)[0]: np.nan for key in CAMERA if key not in ("mount", "lens", "board")
    }
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


def _misfit(d: Dataset) -> float:
    """How far most images are off the nominal arm, m."""
    found = closed_form(d, 0, np.arange(len(d.measurements.ids)), d.measurements.readings)[2]
    return np.inf if found is None else float(np.median(np.hypot(found.off, LEVER * found.turned)))


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


def _picture(cv2: Any, images: dict[str, np.ndarray], used: Sequence[Found]) -> bytes:
    """A mosaic of images with the corners that were found, as JPEG."""
    tiles = []
    for f in used[:: max(-(-len(used) // MOSAIC), 1)]:
        grey = images[f.name]
        shrink = TILE / grey.shape[1]
        tile = cv2.cvtColor(cv2.resize(grey, (TILE, round(grey.shape[0] * shrink))), cv2.COLOR_GRAY2BGR)
        for (u, v), k in zip(f.pixel * shrink, f.number, strict=True):
            first = k == f.number.min()
            cv2.circle(
                tile, (round(u), round(v)), 4 if first else 2, (0, 0, 255) if first else (0, 200, 0), -1
            )
        cv2.putText(tile, f.name[:30], (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 120, 0), 1)
        tiles.append(tile)
    across = min(6, len(tiles))
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % across)
    mosaic = np.vstack([np.hstack(tiles[k : k + across]) for k in range(0, len(tiles), across)])
    return bytes(cv2.imencode(".jpg", mosaic)[1].tobytes())
