"""robot.yaml as pydantic models, in the file's units, and its way to and from a `Robot`.

Beyond the contract a joint may carry ``beta_deg`` (default 0: Hayati's angle of near-parallel axes)
and the file ``joint_compliance_rad_per_nm`` (one a joint): what a calibrated arm needs to be written. Behind
modified rows a ``flange`` (as ``base``) places the flange in the last row's frame: what a URDF's tip needs. A
link may carry ``radius_mm``, the radius of a capsule around it, for the check of collisions; a joint its
largest speed and torque, for files of simulators.

A `Robot` as the text of a robot.yaml, one joint a line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Annotated, Literal

import numpy as np
import yaml
from pydantic import Field

from bayescal.arm.chain import Coupling, Robot
from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.errors import BayescalError
from bayescal.storage.files import Document, Keys, Name, NotNegative, Number, Positive, Vector, si

SCHEMA = "bayescal-robot/1"
REACH_MM = (20.0, 50_000.0)
"""An arm whose lengths add up to less or more was not written in mm."""


class Joint(Keys):
    """A row of the table of Denavit-Hartenberg parameters; angles and lengths are nominal."""

    name: Name
    """Name of the joint, in reports."""
    alpha_deg: Number
    """Twist; with mdh it stands before the joint, with dh behind it."""
    a_mm: Number
    """Length; with mdh it stands before the joint, with dh behind it."""
    d_mm: Number
    """Offset along the axis of the joint."""
    offset_deg: Number
    """Joint angle at the reading zero."""
    limits_deg: tuple[Number, Number]
    """[lower, upper] reading of the joint."""
    beta_deg: Number = 0.0
    """Hayati's angle of near-parallel axes."""
    max_velocity_degps: Positive | None = None
    """Largest speed of the joint, for exports."""
    max_torque_nm: Positive | None = None
    """Largest torque of the joint, for exports."""


class Link(Keys):
    """What a joint moves; required for gravity torques."""

    mass_kg: NotNegative
    """Mass of the link."""
    centre_of_mass_mm: Vector
    """Its centre of mass in the link frame (behind the whole row)."""
    radius_mm: Positive | None = None
    """Radius of a capsule around the link, for the check of collisions."""


class Place(Keys):
    """A frame in another."""

    xyz_mm: Vector = (0.0, 0.0, 0.0)
    """Origin."""
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll)."""


class RobotFile(Keys):
    """A robot arm: its nominal geometry, limits and masses."""

    schema_: Literal["bayescal-robot/1"] = Field(alias="schema")
    """Version of the format."""
    name: Name
    """Name of the robot, in reports."""
    convention: Literal["mdh", "dh"]
    """mdh: modified (Craig), or dh: standard Denavit-Hartenberg rows."""
    joints: Annotated[list[Joint], Field(min_length=1)]
    """Rows from base to flange."""
    link_from_reading: list[list[Number]] | None = None
    """Joint angle = this matrix x readings + offset: signs, coupled axes; default: identity."""
    base: Place = Place()
    """Frame of the first row in F0."""
    flange: Place = Place()
    """Flange in the frame of the last row; only with mdh."""
    links: list[Link] | None = None
    """One entry per joint; required for compliance."""
    reductions: list[Positive] | None = None
    """Motor revolutions per revolution of the joint, one per joint."""
    joint_compliance_rad_per_nm: list[NotNegative] | None = None
    """Compliance, one per joint; written for a calibrated arm."""
    coupling: Coupling = "display"
    """display: link_from_reading is done by the controller's display; mechanical: by gears."""


def robot_from(document: Document) -> Robot:
    """Check a parsed robot.yaml as a whole and turn it to SI units."""
    file = document.parse(RobotFile)
    n = len(file.joints)
    _check(document, file, n)
    table = {
        key.rpartition("_")[0]: np.array([getattr(j, key) for j in file.joints]) * si(key)
        for key in ("alpha_deg", "a_mm", "d_mm", "offset_deg", "beta_deg", "limits_deg")
    }
    return Robot(
        name=file.name,
        convention=file.convention,
        joint_names=tuple(j.name for j in file.joints),
        link_from_reading=np.eye(n) if file.link_from_reading is None else np.array(file.link_from_reading),
        base=_frame(file.base),
        flange=_frame(file.flange),
        masses=None if file.links is None else np.array([link.mass_kg for link in file.links]),
        centres_of_mass=(
            None if file.links is None else np.array([link.centre_of_mass_mm for link in file.links]) * 1e-3
        ),
        compliance=_array(file.joint_compliance_rad_per_nm),
        reductions=_array(file.reductions),
        coupling=file.coupling,
        radii=_stated([link.radius_mm for link in file.links or ()], 1e-3),
        velocities=_stated([j.max_velocity_degps for j in file.joints], si("max_velocity_degps")),
        torques=_stated([j.max_torque_nm for j in file.joints], 1.0),
        **table,
    )


def _frame(place: Place) -> np.ndarray:
    return rigid(rpy_matrix(np.deg2rad(place.rpy_deg)), np.array(place.xyz_mm) * 1e-3)


def _array(values: list[float] | None) -> np.ndarray | None:
    return None if values is None else np.array(values)


def _stated(values: Sequence[float | None], factor: float) -> np.ndarray | None:
    """Values (n,), SI, nan where none is stated; None if none is."""
    if not any(values):
        return None
    return np.array([np.nan if value is None else value * factor for value in values])


def _check(document: Document, file: RobotFile, n: int) -> None:
    """What needs several entries: lengths of lists, limits, names, the coupling, the reach."""
    for key in ("link_from_reading", "links", "reductions", "joint_compliance_rad_per_nm"):
        entries = getattr(file, key)
        if entries is not None and len(entries) != n:
            raise BayescalError(
                f"`{key}` has {len(entries)} entries, the robot {n} joints",
                document.where((key,)),
                "give one a joint",
            )
    if file.convention == "dh" and file.flange != Place():
        where = document.where(("flange",))
        raise BayescalError("standard rows end at the flange", where, "leave `flange` out, or use mdh rows")
    for i, joint in enumerate(file.joints):
        if not joint.limits_deg[0] < joint.limits_deg[1]:
            where = document.where(("joints", i, "limits_deg"))
            raise BayescalError(f"limits of {joint.name} are not in order", where, "write [lower, upper]")
        if joint.name in [j.name for j in file.joints[:i]]:
            where = document.where(("joints", i))
            raise BayescalError(f"two joints are called {joint.name}", where, "rename one")
    for i, row in enumerate(file.link_from_reading or ()):
        if len(row) != n:
            raise BayescalError(
                f"row {i + 1} of `link_from_reading` has {len(row)} entries, the robot {n} joints",
                document.where(("link_from_reading", i)),
                "give one a joint",
            )
    if file.link_from_reading is not None and abs(np.linalg.det(np.array(file.link_from_reading))) < 1e-6:
        where = document.where(("link_from_reading",))
        raise BayescalError("`link_from_reading` cannot be inverted", where, "check its rows")
    reach = sum(math.hypot(j.a_mm, j.d_mm) for j in file.joints)
    if not REACH_MM[0] <= reach <= REACH_MM[1]:
        where = document.where(("joints",))
        raise BayescalError(f"the arm's lengths add up to {reach:g} mm", where, "`a_mm` and `d_mm` are in mm")


def number(value: float, digits: int = 14) -> str:
    """Shortest text of a number to so many significant digits; no minus zero."""
    text = f"{float(value):.{digits}g}"
    return "0" if text == "-0" else text


def scalar(text: str) -> str:
    """A text as a YAML scalar on one line, also inside brackets: quoted where it must be."""
    if re.fullmatch(r"[A-Za-z][\w.@+/-]*( [\w.@+/-]+)*", text, re.ASCII) and yaml.safe_load(text) == text:
        return text
    return yaml.safe_dump(text, default_style='"', allow_unicode=True, width=10**9).removesuffix("\n")


def sequence(values: Iterable[float], digits: int = 14) -> str:
    """Numbers as a YAML list on one line."""
    return "[" + ", ".join(number(v, digits) for v in values) + "]"


def robot_to_yaml(robot: Robot, comment: str = "") -> str:
    """Text of a robot.yaml that reads back as `robot`, to 1e-12.

    Parameters
    ----------
    robot : Robot
        In SI units.
    comment : str
        Put at the head of the file, behind ``#``.

    Returns
    -------
    str
        YAML of schema ``bayescal-robot/1``: mm, deg, kg.
    """
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    lines += ["schema: bayescal-robot/1", f"name: {scalar(robot.name)}"]
    lines += [f"convention: {robot.convention}", "joints:"]
    alpha, beta, offset, limits = (
        np.rad2deg(v) for v in (robot.alpha, robot.beta, robot.offset, robot.limits)
    )
    for i, name in enumerate(robot.joint_names):
        cells = [
            f"name: {scalar(name)}",
            f"alpha_deg: {number(alpha[i])}",
            f"a_mm: {number(robot.a[i] * 1e3)}",
            f"d_mm: {number(robot.d[i] * 1e3)}",
            f"offset_deg: {number(offset[i])}",
            f"limits_deg: {sequence(limits[i])}",
        ]
        cells += [f"beta_deg: {number(beta[i])}"] if robot.beta[i] else []
        for key, values, factor in (
            ("max_velocity_degps", robot.velocities, np.rad2deg(1.0)),
            ("max_torque_nm", robot.torques, 1.0),
        ):
            if values is not None and not np.isnan(values[i]):
                cells.append(f"{key}: {number(values[i] * factor)}")
        lines.append(f"  - {{{', '.join(cells)}}}")
    if not np.array_equal(robot.link_from_reading, np.eye(robot.n)):
        lines += ["link_from_reading:"] + [f"  - {sequence(row)}" for row in robot.link_from_reading]
    for key, frame in (("base", robot.base), ("flange", robot.flange)):
        if not np.array_equal(frame, np.eye(4)):
            rpy = np.rad2deg(rpy_of(frame[:3, :3]))
            lines.append(f"{key}: {{xyz_mm: {sequence(frame[:3, 3] * 1e3)}, rpy_deg: {sequence(rpy)}}}")
    if robot.masses is not None and robot.centres_of_mass is not None:
        radii = np.full(robot.n, np.nan) if robot.radii is None else robot.radii
        around = ["" if np.isnan(radius) else f", radius_mm: {number(radius * 1e3)}" for radius in radii]
        lines += ["links:"] + [
            f"  - {{mass_kg: {number(mass)}, centre_of_mass_mm: {sequence(centre * 1e3)}{last}}}"
            for mass, centre, last in zip(robot.masses, robot.centres_of_mass, around, strict=True)
        ]
    if robot.reductions is not None:
        lines.append(f"reductions: {sequence(robot.reductions)}")
    if robot.compliance is not None:
        lines.append(f"joint_compliance_rad_per_nm: {sequence(robot.compliance)}")
    if robot.coupling != "display" or not np.array_equal(robot.link_from_reading, np.eye(robot.n)):
        lines.append(f"coupling: {robot.coupling}")
    return "\n".join(lines) + "\n"
