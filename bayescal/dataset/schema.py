"""dataset.yaml as pydantic models, in the file's units; one model a kind of target and certificate."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any, Literal, Union

from pydantic import Field, create_model

from bayescal.dataset.target_kinds import KINDS, TargetKind
from bayescal.files import Keys, NotNegative, Number, Positive, Vector

SCHEMA = "bayescal-dataset/1"


class ToolEntry(Keys):
    """A point carried by the flange."""

    centre_mm: Vector
    ball_radius_mm: NotNegative | None = None
    mass_kg: NotNegative = 0.0
    centre_of_mass_mm: Vector | None = None
    rpy_deg: Vector | None = None
    u_mm: NotNegative | None = None
    u_rad: NotNegative | None = None


class NoiseEntry(Keys):
    """Stated standard uncertainties."""

    contact_mm: Positive | None = None
    point_mm: Positive | None = None
    joint_deg: NotNegative = 0.0
    orientation_deg: Positive | None = None


class Loose(Keys):
    """What every target may carry: how well its nominal place is known."""

    u_mm: NotNegative | None = None
    u_rad: NotNegative | None = None


Pair = Annotated[list[str], Field(min_length=2, max_length=2)]


class Parallel(Keys):
    """Two faces or axes, at a distance."""

    kind: Literal["parallel"]
    faces: Pair
    distance_mm: Positive
    u_distance_mm: Positive
    u_angle_rad: Positive


class Perpendicular(Keys):
    """Two faces or axes, square to each other."""

    kind: Literal["perpendicular"]
    faces: Pair
    u_angle_rad: Positive


class Between(Keys):
    """A point and another, a plane or an axis, or two parallel axes, at a distance."""

    kind: Literal["distance"]
    between: Pair
    distance_mm: Positive
    u_distance_mm: Positive


class Diameter(Keys):
    """A ball's or pin's own diameter is that of its entry, to this."""

    kind: Literal["diameter"]
    target: str
    u_diameter_mm: Positive


class Flat(Keys):
    """A face's form error."""

    kind: Literal["flat"]
    target: str
    u_form_mm: Positive


class VolumeEntry(Keys):
    """A box with edges along the axes of F0."""

    centre_mm: Vector
    size_mm: tuple[Positive, Positive, Positive]


class RegionEntry(Keys):
    """Where contacts may be: a rectangle of a face, or a length of a cylinder."""

    centre_mm: Vector
    size_mm: Annotated[list[Positive], Field(min_length=1, max_length=2)]
    along: Vector | None = None


class PlanEntry(Keys):
    """What `bayescal plan` needs beyond the targets."""

    volume_of_interest: VolumeEntry | None = None
    regions: dict[str, RegionEntry] = Field(default={})
    table_mm: Number | None = None
    payload_kg: tuple[Positive, ...] = ()
    cone_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    poses_deg: tuple[tuple[Number, ...], ...] = ()


AnyCertificate = Annotated[Parallel | Perpendicular | Between | Diameter | Flat, Field(discriminator="kind")]


class DatasetFile(Keys):
    """dataset.yaml. Left out, gravity is that of an arm standing upright."""

    schema_: Literal["bayescal-dataset/1"] = Field(alias="schema")
    name: str
    robot: str
    readings: Literal["encoder", "command"]
    gravity_mps2: Vector = (0.0, 0.0, -9.81)
    tools: Annotated[dict[str, ToolEntry], Field(min_length=1)]
    noise: NoiseEntry = NoiseEntry()
    targets: Annotated[dict[str, Any], Field(min_length=1)]  # see `file_model`
    certificates: tuple[AnyCertificate, ...] = ()
    temperature_of: Literal["arm", "air", "artefact"] | None = None
    torques: Literal["computed", "measured"] = "computed"
    plan: PlanEntry | None = None
    source: str | None = None


CERTIFICATES: dict[str, type[Keys]] = {
    "parallel": Parallel,
    "perpendicular": Perpendicular,
    "distance": Between,
    "diameter": Diameter,
    "flat": Flat,
}
"""Model of each kind of certificate."""


def entry_of(kind: TargetKind) -> type[Keys]:
    """The model of a target's entry: the keys of its kind, and those of every target."""
    fields: dict[str, Any] = {"kind": (Literal[kind.name], ...)}
    for key, value in kind.keys.items():
        fields[key] = (value | None, None) if key in kind.optional else (value, ...)
    return create_model(kind.name, __base__=Loose, **fields)


def file_model() -> type[DatasetFile]:
    """The model of dataset.yaml with an entry for every declared kind of target."""
    return _file_model(tuple(KINDS.values()))


@lru_cache(maxsize=4)
def _file_model(kinds: tuple[TargetKind, ...]) -> type[DatasetFile]:
    entries: Any = Union[tuple(entry_of(kind) for kind in kinds)]  # noqa: UP007
    entry: Any = Annotated[entries, Field(discriminator="kind")]
    targets: Any = Annotated[dict[str, entry], Field(min_length=1)]
    return create_model("DatasetFile", __base__=DatasetFile, targets=(targets, ...))
