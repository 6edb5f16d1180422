"""dataset.yaml of a joint log as pydantic models, in the file's units.

A mechanism as the `robot` of dataset.yaml, as `bayescal.logs.schema.Arm` reads it; commands as a table.
"""

from collections.abc import Iterable
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BaseModel, Field

from bayescal.arm.transforms import rpy_of
from bayescal.logs.types import PAIRS, Mechanism
from bayescal.storage.files import Keys, Name, NotNegative, Number, Positive, Vector, stem_of
from bayescal.storage.writing import Block, block_lines, flow, in_file, row_keys, scalar

SCHEMA = "bayescal-motion/1"
Six = tuple[Number, Number, Number, Number, Number, Number]


class Joint(Keys):
    """A joint and the body that it carries."""

    name: Name
    """Name of the joint, in reports."""
    origin_mm: Vector
    """Origin of the joint's frame in the frame of the body before it."""
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of that frame: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    axis: Vector = (0.0, 0.0, 1.0)
    """Direction about which the joint turns, in its own frame."""
    mass_kg: NotNegative
    """Mass of the body."""
    centre_of_mass_mm: Vector
    """Its centre of mass in the joint's frame."""
    inertia_kgm2: Six
    """Inertia about the centre of mass, axes of the joint's frame: xx, yy, zz, xy, xz, yz."""
    gear_ratio: Positive | None = None
    """Motor revolutions per revolution of the joint."""
    armature_kgm2: NotNegative | None = None
    """Inertia of the rotor as seen at the joint."""
    rated_torque_Nm: Positive | None = None
    """Rated torque."""
    coulomb_Nm: NotNegative | None = None
    """Coulomb friction."""
    viscous_Nms_per_rad: NotNegative | None = None
    """Viscous friction."""
    limits_deg: tuple[Number, Number] | None = None
    """[lower, upper] position; left out of a joint that turns without end."""
    max_velocity_degps: Positive | None = None
    """Largest speed."""


_FIELDS = {"centre_of_mass_mm": "centre", "rated_torque_Nm": "rated", "max_velocity_degps": "fastest"}
_OF_FRAMES = ("name", "origin_mm", "rpy_deg", "axis")
OF_JOINTS = {k: _FIELDS.get(k, stem_of(k)[0]) for k in Joint.model_fields if k not in _OF_FRAMES}
"""Keys of a joint, and the fields of `Mechanism` that they fill."""


class Uncertainty(Keys):
    """Prior standard uncertainties of the nominal arm; relative, of the centre of mass in mm."""

    mass: Positive = 0.15
    """Of a mass."""
    centre_of_mass_mm: Positive = 12.0
    """Of each coordinate of a centre of mass."""
    inertia: Positive = 0.15
    """Of an inertia."""
    armature: Positive = 0.15
    """Of an armature."""
    friction_transition: Positive = 0.3
    """Of the speed scale of the reversal of friction."""


class Payload(Keys):
    """What the arm carries where `payload_kg` is not zero."""

    centre_of_mass_mm: Vector = (0.0, 0.0, 0.0)
    """In the last body's frame."""
    radius_of_gyration_mm: NotNegative = 0.0
    """About the centre of mass."""


class Arm(Keys):
    """The nominal arm, written out."""

    joints: Annotated[list[Joint], Field(min_length=1, max_length=20)]
    """From base to flange."""
    friction_transition_degps: Positive | None = None
    """Speed scale of the reversal of friction: tanh(speed / scale)."""
    gravity_mps2: Vector | None = None
    """Gravity in the base frame."""
    payload: Payload = Payload()
    """What the arm carries."""
    u: Uncertainty = Uncertainty()
    """Prior standard uncertainties."""


class Torque(Keys):
    """How torques were measured."""

    kind: Literal["motor", "current", "sensor"] = "motor"
    """Motor torque, motor current, or a sensor behind the gear."""
    referred_to: Literal["joint", "motor"] = "joint"
    """Side of the gear of the values."""
    sign: Literal["joint", "none"] = "joint"
    """`none`: magnitudes."""
    constant_Nm_per_A: list[Positive] | None = None
    """Torque per current, one per joint; at the side that `referred_to` names."""
    u_constant: Positive = 0.1
    """Relative standard uncertainty of the constants."""


class Position(Keys):
    """Where joint positions are measured."""

    side: Literal["motor", "joint"] = "motor"
    """Side of the gear of the encoder."""


class Control(Keys):
    """The controller, where known."""

    kind: Literal["torque", "position"] = "torque"
    """Whether the drives are given torques or positions."""
    P_coefficient: Positive | None = None
    """Of a servo: its setting of proportional gain."""
    kp_Nm_per_rad: list[Positive] | None = None
    """Torque per error of position, one per joint."""
    kd_Nms_per_rad: list[NotNegative] | None = None
    """Torque per speed, or per error of speed (measured torques tell which), one per joint."""


class Clock(Keys):
    """The clock of torques against that of positions."""

    kind: Literal["stamps", "index"] = "stamps"
    """`index`: no stamps were logged; `t_s` was made from the rate."""
    alignment_ms: Number = 0.0
    """By how much the torque in a row is later than the position: positive if it lags."""
    u_alignment_ms: Positive = 0.3
    """Its standard uncertainty."""


class LogNoise(Keys):
    """Standard deviations of the noise, where known."""

    torque_Nm: list[Positive] | None = None
    """One per joint."""
    autocorrelated: bool = True
    """Whether neighbouring rows share noise."""
    position_deg: NotNegative | None = None
    """Of positions."""
    velocity_degps: NotNegative | None = None
    """Of velocities."""
    temperature_degC: NotNegative | None = None
    """Of the temperature."""


class MotionEntry(Keys):
    """One motion of the log."""

    id: Name
    """As in the column `motion`."""
    role: Literal["calibrate", "validate"] = "calibrate"
    """`validate`: never fitted, only predicted."""
    kind: str = ""
    """Such as excitation, slow, pick-place."""
    same_as: str = ""
    """The motion whose commands it repeats; its own id where it is the first."""
    payload_kg: NotNegative = 0.0
    """Where there is no column `payload_kg`."""


class LogFile(Keys):
    """A joint log."""

    schema_: Literal["bayescal-motion/1"] = Field(alias="schema")
    """Version of the format."""
    name: Name
    """Name of the log, in reports."""
    robot: Name | Arm
    """File of the nominal arm (URDF or robot.yaml), a built-in name, or the arm itself."""
    gravity_mps2: Vector | None = None
    """Gravity in the base frame; default [0, 0, -9.80665]."""
    payload: Payload | None = None
    """What the arm carries; as in `robot`."""
    u: Uncertainty | None = None
    """Prior standard uncertainties; as in `robot`."""
    rate_hz: Positive | None = None
    """Informative: `t_s` counts."""
    torque: Torque = Torque()
    """How torques were measured."""
    position: Position = Position()
    """Where positions were measured."""
    controller: Control = Control()
    """The controller."""
    clock: Clock = Clock()
    """Clocks."""
    noise: LogNoise = LogNoise()
    """Noise."""
    motions: list[MotionEntry] | None = None
    """The motions; where left out, all of the table, the last fifth of them `validate`."""


def known_keys(data: Any, model: type[BaseModel]) -> tuple[Any, list[str]]:
    """Data without keys that a model does not have, and these: the format may have further ones."""
    fields = {f.alias or name: f for name, f in model.model_fields.items()}
    kept, ignored = {}, [key for key in data if key not in fields]
    for key in data.keys() & fields.keys():
        kinds = get_args(fields[key].annotation) or (fields[key].annotation,)
        inner = [m for m in kinds if isinstance(m, type) and issubclass(m, BaseModel)]
        kept[key] = data[key]
        if inner and isinstance(data[key], dict):
            kept[key], more = known_keys(data[key], inner[0])
            ignored += [f"{key}: {name}" for name in more]
    return kept, ignored


DIGITS = 9
"""Significant digits of a value."""


def arm_text(m: Mechanism) -> str:
    """YAML of an arm: mm, deg, kg, kg m2, N m.

    Raises
    ------
    ValueError
        If its joints are coupled, which the format cannot hold.
    """
    if m.coupled:
        raise ValueError("coupled joints")
    columns = {
        "origin_mm": m.place[:, :3, 3],
        "rpy_deg": np.array([rpy_of(place[:3, :3]) for place in m.place]),
        "axis": m.axis,
        **{key: getattr(m, field) for key, field in OF_JOINTS.items()},
        "inertia_kgm2": m.inertia[:, *np.transpose(PAIRS)],
    }
    centre = in_file("centre_of_mass_mm", m.payload_centre, DIGITS)
    gyration = in_file("radius_of_gyration_mm", m.payload_gyration, DIGITS)
    speed = in_file("friction_transition_degps", m.transition, DIGITS) if m.transition else None
    block: Block = {
        "joints": [
            flow([("name", scalar(name)), *row_keys(columns, k, DIGITS)])
            for k, name in enumerate(m.joint_names)
        ],
        "friction_transition_degps": speed,
        "payload": flow([("centre_of_mass_mm", centre), ("radius_of_gyration_mm", gyration)]),
    }
    return "\n".join(block_lines(block)) + "\n"


Commands = tuple[str, np.ndarray, np.ndarray]
"""Name of a motion, times (N,), s, and readings (N, n), rad."""


def commands_text(motions: Iterable[Commands]) -> str:
    """Commands as a table: `t_s`, `motion`, `q1_deg` ..., one row a step; at rest between motions."""
    lines: list[str] = []
    for name, time, q in motions:
        if not lines:
            lines.append(",".join(["t_s", "motion", *(f"q{j + 1}_deg" for j in range(q.shape[1]))]))
        rows = zip(time.tolist(), np.degrees(q).tolist(), strict=True)
        lines += [f"{t:.6g},{name}," + ",".join(f"{x:.5f}" for x in row) for t, row in rows]
    return "\n".join([*lines, ""])
