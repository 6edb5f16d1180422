"""dataset.yaml as pydantic models, in the file's units; one model a kind of target and certificate."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

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


class Plane(Loose):
    """``n.x = offset`` on the surface, n outward."""

    kind: Literal["plane"]
    normal: Vector
    offset_mm: Number


class Sphere(Loose):
    """A ball to be probed."""

    kind: Literal["sphere"]
    centre_mm: Vector
    diameter_mm: Positive


class Cylinder(Loose):
    """A pin to be probed on its side."""

    kind: Literal["cylinder"]
    point_mm: Vector
    axis: Vector
    diameter_mm: Positive


class FixedPoint(Loose):
    """A seat to which the ball's centre comes back."""

    kind: Literal["fixed-point"]
    centre_mm: Vector


class Distance(Loose):
    """A ball bar or a wire: the ball's centre at a length from a fixed pivot."""

    kind: Literal["distance"]
    centre_mm: Vector
    length_mm: Positive | None = None


class Instrument(Loose):
    """A tracker's or a camera's frame in F0."""

    kind: Literal["instrument"]
    xyz_mm: Vector
    rpy_deg: Vector


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


AnyTarget = Annotated[
    Plane | Sphere | Cylinder | FixedPoint | Distance | Instrument, Field(discriminator="kind")
]
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
    targets: Annotated[dict[str, AnyTarget], Field(min_length=1)]
    certificates: tuple[AnyCertificate, ...] = ()
    temperature_of: Literal["arm", "air", "artefact"] | None = None
    source: str | None = None


TARGETS: dict[str, type[Keys]] = {
    "plane": Plane,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "fixed-point": FixedPoint,
    "distance": Distance,
    "instrument": Instrument,
}
"""Model of each kind of target."""

CERTIFICATES: dict[str, type[Keys]] = {
    "parallel": Parallel,
    "perpendicular": Perpendicular,
    "distance": Between,
    "diameter": Diameter,
    "flat": Flat,
}
"""Model of each kind of certificate."""
