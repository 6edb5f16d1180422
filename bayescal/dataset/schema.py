"""dataset.yaml as pydantic models, in the file's units; one model a kind of target and certificate."""

import datetime
from contextlib import suppress
from functools import lru_cache
from typing import Annotated, Any, Literal, Union, get_args

from pydantic import AfterValidator, Field, create_model
from pydantic_core import PydanticCustomError

from bayescal.dataset.solids import SolidEntry
from bayescal.dataset.table import MEANINGS
from bayescal.dataset.target_kinds import KINDS, TargetKind
from bayescal.storage.files import Keys, MaybeKnown, Name, NotNegative, Number, Positive, Uncertain, Vector

SCHEMA = "bayescal-dataset/1"


class ToolEntry(Keys):
    """A point carried by the flange: the centre of a stylus ball, or of a reflector."""

    centre_mm: Vector
    """Centre of the ball or reflector in the flange frame, nominal."""
    ball_radius_mm: NotNegative | None = None
    """Effective radius of the stylus ball, as calibrated; needed to touch surfaces."""
    mass_kg: NotNegative = 0.0
    """Total mass attached to the flange while the tool is used; required for compliance."""
    centre_of_mass_mm: Vector | None = None
    """Centre of that mass in the flange frame; default: the centre of the ball."""
    rpy_deg: Vector | None = None
    """Roll, pitch, yaw of the tool frame in the flange frame: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    u_mm: MaybeKnown | None = None
    """Standard uncertainty of each coordinate of `centre_mm`; 0: known; default 5 mm."""
    u_rad: MaybeKnown | None = None
    """Standard uncertainty of the orientation; 0: known; default 0.2 rad."""


class HeldEntry(Keys):
    """What the first arm of a chain through two arms carries: the object that is measured."""

    mass_kg: Positive
    """Its mass, with all that attaches it to the flange."""
    centre_of_mass_mm: Vector
    """Centre of this mass in F0."""


class NoiseEntry(Keys):
    """Stated standard uncertainties (k = 1)."""

    contact_mm: Uncertain | None = None
    """Repeatability of a contact along the surface normal; required for contacts."""
    point_mm: Uncertain | None = None
    """Standard uncertainty of a coordinate read by an instrument; required for instruments."""
    joint_deg: MaybeKnown = 0.0
    """Noise of a joint reading."""
    slide_mm: MaybeKnown | None = None
    """Noise of the reading of a prismatic joint."""
    pixel_px: Uncertain | None = None
    """Standard uncertainty of a coordinate of a corner in an image; default 0.2 px."""
    orientation_deg: Uncertain | None = None
    """Standard uncertainty of an orientation that an instrument reads, about each axis."""


class Loose(Keys):
    """Keys of every target: how well its nominal place is known."""

    u_mm: MaybeKnown | None = None
    """Standard uncertainty of the nominal position; 0: known; default 50 mm."""
    u_rad: MaybeKnown | None = None
    """Standard uncertainty of the nominal direction; 0: known; default 0.2 rad."""


Pair = Annotated[list[str], Field(min_length=2, max_length=2)]


class Parallel(Keys):
    """Two faces or axes are parallel, at a certified distance."""

    kind: Literal["parallel"]
    faces: Pair
    """Names of two targets: planes or cylinders."""
    distance_mm: Positive
    """Certified distance."""
    u_distance_mm: Uncertain
    """Its standard uncertainty: U of the certificate divided by k."""
    u_angle_rad: Uncertain
    """Standard uncertainty of the angle between them, from the certificate."""


class Perpendicular(Keys):
    """Two faces or axes are perpendicular."""

    kind: Literal["perpendicular"]
    faces: Pair
    """Names of two targets: planes or cylinders."""
    u_angle_rad: Uncertain
    """Standard uncertainty of the angle between them, from the certificate."""


class Between(Keys):
    """Certified distance of a point from another, from a plane or an axis, or of two parallel axes."""

    kind: Literal["distance"]
    between: Pair
    """Names of two targets."""
    distance_mm: Positive
    """Certified distance."""
    u_distance_mm: Uncertain
    """Its standard uncertainty: U of the certificate divided by k."""


class Diameter(Keys):
    """The diameter of a sphere or cylinder is certified: it is that of its entry."""

    kind: Literal["diameter"]
    target: str
    """Name of a sphere or cylinder."""
    u_diameter_mm: Uncertain
    """Standard uncertainty of its `diameter_mm`."""


class Flat(Keys):
    """The form error of a face is certified."""

    kind: Literal["flat"]
    target: str
    """Name of a plane."""
    u_form_mm: Uncertain
    """Standard deviation of the face from a plane."""


class VolumeEntry(Keys):
    """A box with edges along the axes of F0."""

    centre_mm: Vector
    """Centre of the box in F0."""
    size_mm: tuple[Positive, Positive, Positive]
    """Lengths of its edges along x, y, z."""


class RegionEntry(Keys):
    """Where contacts may be: a rectangle of a face, or a length of a cylinder."""

    centre_mm: Vector
    """Centre of the region, on the surface or the axis, in F0."""
    size_mm: Annotated[list[Positive], Field(min_length=1, max_length=2)]
    """[width, height] of a face, [length] of a cylinder."""
    along: Vector | None = None
    """Direction of the width of a face, a unit vector in F0."""


class PlanEntry(Keys):
    """What `bayescal plan` needs beyond the targets; no other command reads it."""

    volume_of_interest: VolumeEntry | None = None
    """Volume in which distances must be accurate."""
    regions: dict[str, RegionEntry] = Field(default={})
    """Where contacts may be, by the name of the target."""
    table_mm: Number | None = None
    """Height of the table in F0, against gravity."""
    payload_kg: tuple[Positive, ...] = ()
    """Masses that can be attached in addition to the tool."""
    cone_deg: Annotated[float, Field(gt=0, le=180)] | None = None
    """Greatest angle between the tool's z axis and the inward normal; default 60, below six joints 100."""
    clearance_mm: Positive | None = None
    """Smallest clearance of motions between contacts; default 5."""
    poses_deg: tuple[tuple[Number, ...], ...] = ()
    """Joint readings of poses between which distances must be accurate."""


Label = Annotated[Name, Field(json_schema_extra={"type": ["string", "number"]})]
"""A text of the file that an editor may take for a number, as a serial number."""


class SerialsEntry(Keys):
    """Serial numbers."""

    arm: Label | None = None
    """Serial number of the robot arm."""
    probe: Label | None = None
    """Serial number of the probe."""
    artefact: Label | None = None
    """Serial number of the artefact."""
    instrument: Label | None = None
    """Serial number of the tracker or camera."""


def _date(text: str) -> str:
    with suppress(ValueError):
        if text == datetime.date.fromisoformat(text).isoformat():  # which also reads 20260131
            return text
    raise PydanticCustomError("not_a_date", "not a date")


Date = Annotated[str, AfterValidator(_date), Field(json_schema_extra={"pattern": r"^\d{4}-\d\d-\d\d$"})]


class RecordEntry(Keys):
    """What a report that is filed states of the session; no computation depends on it."""

    date: Date | None = None
    """Date of the measurement, as YYYY-MM-DD."""
    operator: Name | None = None
    """Who measured."""
    serials: SerialsEntry = SerialsEntry()
    """Serial numbers of what was used."""
    certificates: tuple[Label, ...] = ()
    """Numbers of the calibration certificates of artefacts and instruments."""
    temperature_degC: Number | None = None
    """Temperature of the room."""


AnyCertificate = Annotated[Parallel | Perpendicular | Between | Diameter | Flat, Field(discriminator="kind")]
TARGETS = "What is touched or read, by name, at its nominal place in F0; the fit estimates the true place."


class DatasetFile(Keys):
    """The set-up of a measuring session: robot, tools, noise, targets and certificates."""

    schema_: Literal["bayescal-dataset/1"] = Field(alias="schema")
    """Version of the format."""
    name: Name
    """Name of the session, in reports."""
    robot: Name
    """Built-in robot, or a path beside this file: robot.yaml, arm.urdf."""
    readings: Literal["encoder", "command"]
    """What the joint columns contain: readings of the encoders, or commanded angles."""
    gravity_mps2: Vector = (0.0, 0.0, -9.81)
    """Gravity in F0, the base frame (of two arms in the frame of the ground); [0, 0, 0]: not modelled."""
    tools: Annotated[dict[str, ToolEntry], Field(min_length=1)]
    """Points carried by the flange, by name; each row of measurements.csv uses one."""
    held: HeldEntry | None = None
    """What the flange of the first of two arms carries: mass and its centre."""
    noise: NoiseEntry = NoiseEntry()
    """Standard uncertainties (k = 1) of contacts, points and readings."""
    targets: Annotated[dict[str, Any], Field(min_length=1)] = Field(description=TARGETS)  # see `file_model`
    certificates: tuple[AnyCertificate, ...] = ()
    """Certified values of the artefacts; u_ is a standard uncertainty (k = 1)."""
    artefact: Name | None = None
    """File in this folder with certified coordinates of an artefact's points."""
    temperature_of: Literal["arm", "air", "artefact"] | None = None
    """What the column `temperature_c` is the temperature of."""
    torques: Literal["computed", "measured"] = "computed"
    """Joint torques: computed from the masses, or the columns `j1_nm` ..."""
    solids: dict[str, SolidEntry] = Field(default={})
    """Own solids around the arm, by name: fixtures, tables, fences; for motions."""
    plan: PlanEntry | None = None
    """What `bayescal plan` needs; no other command reads it."""
    record: RecordEntry = RecordEntry()
    """What a filed report states: date, operator, serial numbers."""
    source: str | None = None
    """Free text: origin, licence, notes."""


_CERTIFICATES: tuple[type[Keys], ...] = (Parallel, Perpendicular, Between, Diameter, Flat)
CERTIFICATES = {get_args(model.model_fields["kind"].annotation)[0]: model for model in _CERTIFICATES}
"""Model of each kind of certificate."""


def entry_of(kind: TargetKind) -> type[Keys]:
    """The model of a target's entry: the keys of its kind, and those of every target."""
    fields: dict[str, Any] = {"kind": (Literal[kind.name], ...)}
    for key, value in kind.keys.items():
        optional = key in kind.optional
        described = Field(None if optional else ..., description=MEANINGS["targets"].get(key))
        fields[key] = (value | None if optional else value, described)
    return create_model(kind.name, __base__=Loose, __doc__=kind.summary, **fields)


def file_model() -> type[DatasetFile]:
    """The model of dataset.yaml with an entry for every declared kind of target."""
    return _file_model(tuple(KINDS.values()))


@lru_cache(maxsize=4)
def _file_model(kinds: tuple[TargetKind, ...]) -> type[DatasetFile]:
    entries: Any = Union[tuple(entry_of(kind) for kind in kinds)]  # noqa: UP007
    entry: Any = Annotated[entries, Field(discriminator="kind")]
    targets: Any = Annotated[dict[str, entry], Field(min_length=1)]
    field: Any = (targets, Field(description=TARGETS))
    return create_model("DatasetFile", __base__=DatasetFile, __doc__=DatasetFile.__doc__, targets=field)
