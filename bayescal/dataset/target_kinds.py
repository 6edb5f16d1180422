"""Kinds of target, each declared once: keys of dataset.yaml, measurement kind, what rows must have.

The schema, the checks of a dataset, the writer, the scene, the model and the planner read `KINDS` alone. A
further kind is a file in `factors/` and an entry here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import cameras, image_checks, regions
from bayescal.dataset.cameras import board_of
from bayescal.dataset.regions import Probing, vector
from bayescal.dataset.types import Dataset, Target
from bayescal.storage.files import Document, NotNegative, Number, Positive, Vector
from factors.camera import Camera, Instrument
from factors.contacts import Cylinder, Distance, FixedPoint, Plane, Sphere
from factors.kind import Kind

if TYPE_CHECKING:
    from bayescal.dataset.table import Table

LOOSE, LOOSE_ANGLE = 50e-3, 0.2
"""m, rad: the contract's prior of a target that states none."""
DIAMETER_SD = 1e-3
"""m, of a diameter that no certificate states."""


def _a_board(text: str) -> str:
    try:
        board_of(text)
    except ValueError as error:
        raise PydanticCustomError("not_a_board", "not a board", {"remedy": str(error)}) from None
    return text


Pair = tuple[Positive, Positive]
Coefficients = Annotated[tuple[Number, ...], Field(min_length=4, max_length=5)]
BoardText = Annotated[str, AfterValidator(_a_board)]
CAMERA = {
    "mount": Literal["fixed", "flange"], "xyz_mm": Vector, "rpy_deg": Vector,
    "lens": Literal["pinhole", "fisheye"], "size_px": Pair, "fx_px": Positive, "fy_px": Positive,
    "cx_px": Number, "cy_px": Number, "distortion": Coefficients, "u_focal_px": NotNegative,
    "u_centre_px": NotNegative,
    "u_distortion": Annotated[tuple[NotNegative, ...], Field(min_length=4, max_length=5)], "board": BoardText,
    "points_mm": Annotated[tuple[Vector, ...], Field(min_length=4)], "u_scale": NotNegative,
    "u_flatness_mm": NotNegative,
}  # fmt: skip
"""Keys of a camera."""


@dataclass(frozen=True)
class Seen:
    """What the measurement kind of a target is made of beside its entry, for M of its rows.

    Parameters
    ----------
    middle : (3,) m, in F0
        The mean of the nominal TCP positions of its fitted measurements.
    radius : (M,) m
        Of the ball of each row's tool, 0 without one.
    read : (M,) or (M, 3), or None
        What the rows read in the column that the kind names, SI, nan where a cell is empty.
    pose : (3, 4, M), or None
        Nominal poses of the tool in F0, for a kind that judges them.
    """

    middle: np.ndarray
    radius: np.ndarray
    read: np.ndarray | None
    pose: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class TargetKind:
    """One kind of target.

    Parameters
    ----------
    name : str
        As ``kind`` in dataset.yaml.
    summary : str
        One line.
    keys : mapping
        Keys of its entry with the type of their value; beside these each has ``u_mm`` and ``u_rad``.
    build : callable
        The measurement kind of a target as some rows see it.
    form : str
        What it is to a certificate of two targets: of `factors.certificate.FORMS`.
    place : callable
        A nominal point of it in F0, (3,), m.
    optional : tuple of str
        Keys that may be left out.
    direction : str
        The key of its unit vector; "" for a point.
    certificates : tuple of str
        Certificates of one target that may name it.
    reads : str
        The field of `Measurements` that its rows read (``xyz``, ``length``, ``pixel``), or "". Rows may
        leave a length empty where the target states one.
    noise : str
        Whose stated noise its residuals have: ``contact``, ``point`` or ``pixel``.
    usual : float
        That noise where a session states none, in its unit; nan: it must be stated.
    posed : bool
        It judges poses of the tool, not points, and its residuals have a scale of their own.
    misfit : callable, optional
        How far some rows of a session are off at some readings, m, if its place is found from its rows.
    prepared : callable, optional
        The session with its place found from its rows, which it checks.
    touched : bool
        A ball meets a surface: the tool of every row has a ball, and the slope of the residual is the outward
        normal.
    flat : bool
        The surface is a plane, whose form may be in error.
    metric : bool
        Its rows read a length, so that they say how long the arm is.
    placed : bool
        Its nominal place is known roughly; False of a frame that is found from its rows.
    centred : bool
        Its description has a ``centre``, which the first three components of its state displace: certified
        distances between such targets are validated.
    located : bool
        Its validation measurements locate it; its distances and its diameter are validated, not these rows.
    planned : Probing, optional
        Where contacts on it may be, for a plan; without it the kind cannot be planned.
    """

    name: str
    summary: str
    keys: Mapping[str, Any]
    build: Callable[[Target, Seen], Kind]
    form: str
    place: Callable[[Target], np.ndarray]
    optional: tuple[str, ...] = ()
    direction: str = ""
    certificates: tuple[str, ...] = ()
    reads: str = ""
    noise: str = "contact"
    touched: bool = False
    flat: bool = False
    metric: bool = False
    placed: bool = True
    centred: bool = False
    located: bool = False
    planned: Probing | None = None
    usual: float = float("nan")
    posed: bool = False
    misfit: Callable[[Dataset, int, np.ndarray, np.ndarray], np.ndarray] | None = None
    prepared: Callable[[Dataset, int, Table, Document], Dataset] | None = None

    @property
    def probing(self) -> Probing:
        """How contacts on it are planned; anywhere where it says nothing."""
        return self.planned or Probing()

    @property
    def of_instrument(self) -> bool:
        """Whether an instrument reads its rows: every row then has an error of its own."""
        return self.noise != "contact"


def seen(
    dataset: Dataset, target: int, rows: np.ndarray, middle: np.ndarray, pose: np.ndarray | None = None
) -> Seen:
    """What a target's kind is made of for some rows of a dataset; `pose` as of `Seen`."""
    m = dataset.measurements
    reads = KINDS[dataset.targets[target].kind].reads
    read = getattr(m, reads) if reads else None
    radius = np.array([t.ball_radius or 0.0 for t in dataset.tools])[m.tool[rows]]
    return Seen(middle, radius, None if read is None else read[rows], pose)


def plannable(dataset: Dataset) -> bool:
    """Whether contacts can be chosen: with one arm, at targets whose kinds are planned."""
    return dataset.robot.ground is None and all(kind.planned is not None for kind in kinds_of(dataset))


def kinds_of(dataset: Dataset) -> tuple[TargetKind, ...]:
    """The declared kind of every target."""
    return tuple(KINDS[t.kind] for t in dataset.targets)


def place_sd(t: Target) -> float:
    """Standard uncertainty of a target's place, m."""
    return LOOSE if t.u is None else t.u


def angle_sd(t: Target) -> float:
    """Standard uncertainty of a target's direction, rad."""
    return LOOSE_ANGLE if t.u_angle is None else t.u_angle


def _plane(t: Target, seen: Seen) -> Plane:
    normal = vector(t, "normal")
    pivot = seen.middle - (normal @ seen.middle - t.values["offset"]) * normal
    return Plane(normal, pivot, seen.radius, np.array([angle_sd(t), angle_sd(t), place_sd(t)]))


def _sphere(t: Target, seen: Seen) -> Sphere:
    sd = np.array([place_sd(t)] * 3 + [DIAMETER_SD])
    return Sphere(vector(t, "centre"), float(t.values["diameter"]), seen.radius, sd)


def _cylinder(t: Target, seen: Seen) -> Cylinder:
    axis, point = vector(t, "axis"), vector(t, "point")
    point = point + axis * (axis @ (seen.middle - point))
    sd = np.array([angle_sd(t)] * 2 + [place_sd(t)] * 2 + [DIAMETER_SD])
    return Cylinder(point, axis, float(t.values["diameter"]), seen.radius, sd)


def _distance(t: Target, seen: Seen) -> Distance:
    length = np.full(len(seen.radius), t.values.get("length", np.nan), float)
    if seen.read is not None:
        length = np.where(np.isnan(seen.read), length, seen.read)
    return Distance(vector(t, "centre"), length, np.full(3, place_sd(t)))


def _instrument(t: Target, seen: Seen) -> Instrument:
    assert seen.read is not None
    frame = rigid(rpy_matrix(vector(t, "rpy")), vector(t, "xyz"))
    sd = np.array([angle_sd(t)] * 3 + [place_sd(t)] * 3)
    return Instrument(frame, seen.middle, seen.read, sd)


def _camera(t: Target, seen: Seen) -> Camera:
    assert seen.read is not None
    assert seen.pose is not None
    sd = np.array([angle_sd(t)] * 3 + [place_sd(t)] * 3)
    return cameras.camera(t, seen.middle, seen.read, seen.pose, sd)


def _centre(t: Target) -> np.ndarray:
    return vector(t, "centre")


_KINDS = (
    TargetKind(
        "plane", "``n.x = offset`` on the surface, n outward",
        {"normal": Vector, "offset_mm": Number}, _plane,
        form="plane", place=lambda t: t.values["offset"] * vector(t, "normal"), direction="normal",
        certificates=("flat",), touched=True, flat=True,
        planned=Probing(regions.face, regions.on_face, regions.wall, ("width", "height")),
    ),
    TargetKind(
        "sphere", "a sphere, probed on its surface", {"centre_mm": Vector, "diameter_mm": Positive}, _sphere,
        form="point", place=_centre, certificates=("diameter",), touched=True, centred=True, located=True,
        planned=Probing(regions.cap, regions.on_sphere, regions.sphere),
    ),
    TargetKind(
        "cylinder", "a cylinder, probed on its side",
        {"point_mm": Vector, "axis": Vector, "diameter_mm": Positive}, _cylinder,
        form="axis", place=lambda t: vector(t, "point"), direction="axis", certificates=("diameter",),
        touched=True, planned=Probing(regions.side, regions.on_side, regions.pin, ("length",)),
    ),
    TargetKind(
        "fixed-point", "a nest that locates the ball centre repeatably", {"centre_mm": Vector},
        lambda t, seen: FixedPoint(vector(t, "centre"), np.full(3, place_sd(t))),
        form="point", place=_centre, centred=True,
        planned=Probing(regions.cap, regions.in_seat, regions.post),
    ),
    TargetKind(
        "distance", "a ball bar or a wire: the ball's centre at a length from a fixed pivot",
        {"centre_mm": Vector, "length_mm": Positive}, _distance,
        form="point", place=_centre, optional=("length_mm",), reads="length", metric=True,
        planned=Probing(regions.cap, regions.about_pivot, regions.post),
    ),
    TargetKind(
        "instrument", "the frame of a tracker or a camera in F0, which reads points and orientations",
        {"xyz_mm": Vector, "rpy_deg": Vector}, _instrument,
        form="point", place=lambda t: vector(t, "xyz"), reads="xyz", noise="point", metric=True, placed=False,
        planned=Probing(),
    ),
    TargetKind(
        "camera", "a camera and a board, of which one is on the flange", CAMERA, _camera,
        form="point", place=lambda t: vector(t, "xyz"),
        optional=tuple(key for key in CAMERA if key not in ("mount", "fx_px", "fy_px", "cx_px", "cy_px")),
        reads="pixel", noise="pixel", usual=cameras.PIXEL, metric=True, placed=False, posed=True,
        misfit=image_checks.misfit, prepared=image_checks.prepared,
        planned=Probing(
            image_checks.region, obstacle=image_checks.obstacle, aims=image_checks.aims,
            faults=image_checks.faults, points=image_checks.corners, sights=image_checks.sights,
            held=image_checks.held,
        ),
    ),
)  # fmt: skip
KINDS: dict[str, TargetKind] = {kind.name: kind for kind in _KINDS}
"""Every kind, by its name in dataset.yaml."""
