"""robot.yaml as pydantic models, in the file's units, and its way to and from a `Robot`.

Beyond the contract a joint may carry ``beta_deg`` (default 0: Hayati's angle of near-parallel axes)
and the file ``joint_compliance_rad_per_nm`` (one a joint): what a calibrated arm needs to be written. Behind
modified rows a ``flange`` (as ``base``) places the flange in the last row's frame: what a URDF's tip needs. A
link may carry ``radius_mm``, the radius of a capsule around it, for the check of collisions; a joint its
largest speed and torque, for files of simulators.

A `Robot` as the text of a robot.yaml, one joint a line.
"""

import math
from collections.abc import Iterable, Iterator
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bayescal.arm.chain import Coupling, Ground, Prior, Robot
from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.errors import BayescalError
from bayescal.storage import files
from bayescal.storage.files import Document, Keys, Name, NotNegative, Number, Positive, Vector
from bayescal.storage.reading import table_beside
from bayescal.storage.writing import Block, block_lines, flow, in_file, number, row_keys, scalar

SCHEMA = "bayescal-robot/1"
KEYS = table_beside(__file__, "keys.toml")
OF_JOINTS, OF_LINKS = KEYS["joints"], KEYS["links"]
"""Fields of a `Robot`, and the keys that fill them: of a revolute and of a prismatic joint; of links."""
SIX = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
"""Place of each element of an inertia in the six that are written."""
SLIDING, ENDLESS = (("type", "prismatic"),), (("continuous", "true"),)
REACH_MM = (20.0, 50_000.0)
"""An arm whose lengths add up to less or more was not written in mm."""


class Joint(Keys):
    """A row of the table of Denavit-Hartenberg parameters; angles and lengths are nominal."""

    name: Name
    """Name of the joint, in reports."""
    type: Literal["revolute", "prismatic"] = "revolute"
    """A prismatic joint slides along its axis: its reading, mm, adds to `d_mm`."""
    alpha_deg: Number
    """Twist; with mdh it stands before the joint, with dh behind it."""
    a_mm: Number
    """Length; with mdh it stands before the joint, with dh behind it."""
    d_mm: Number
    """Offset along the axis of the joint."""
    offset_deg: Number
    """Joint angle at the reading zero; the constant angle of a prismatic joint."""
    limits_deg: tuple[Number, Number] | None = None
    """[lower, upper] reading, of coupled axes by their row of `link_from_reading`; needed if revolute."""
    continuous: bool = False
    """It turns without end, and exports have no limits of it; `limits_deg` bound what is planned."""
    limits_mm: tuple[Number, Number] | None = None
    """[lower, upper] reading of a prismatic joint."""
    beta_deg: Number = 0.0
    """Hayati's angle of near-parallel axes."""
    max_velocity_degps: Positive | None = None
    """Largest speed of the joint, for exports."""
    max_velocity_mmps: Positive | None = None
    """Largest speed of a prismatic joint."""
    max_torque_nm: Positive | None = None
    """Largest torque of the joint, for exports."""
    max_force_n: Positive | None = None
    """Largest force of a prismatic joint."""
    compliance_um_per_n: Positive | None = None
    """Compliance of a prismatic joint along its axis."""
    coulomb_nm: NotNegative | None = None
    """Coulomb friction of the joint, for joint logs."""
    viscous_nms_per_rad: NotNegative | None = None
    """Viscous friction of the joint, for joint logs."""
    armature_kgm2: NotNegative | None = None
    """Inertia of the rotor as seen at the joint, for joint logs."""


class Link(Keys):
    """What a joint moves; required for gravity torques."""

    mass_kg: NotNegative
    """Mass of the link."""
    centre_of_mass_mm: Vector
    """Its centre of mass in the link frame (behind the whole row)."""
    radius_mm: Positive | None = None
    """Radius of a capsule around the link, for the check of collisions."""
    inertia_kgm2: tuple[Number, Number, Number, Number, Number, Number] | None = None
    """Inertia about the centre of mass, axes of the link frame: xx, yy, zz, xy, xz, yz; for joint logs."""


class Place(Keys):
    """A frame in another."""

    xyz_mm: Vector = (0.0, 0.0, 0.0)
    """Origin."""
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll)."""


class GroundEntry(Place):
    """The link that stands still of a chain through two arms, whose F0 is the flange of the first."""

    behind: Name
    """Joint whose link stands still; the place is that of the frame of gravity in the frame of this link."""
    mass_kg: NotNegative = 0.0
    """Mass of the link before the first joint."""
    centre_of_mass_mm: Vector = (0.0, 0.0, 0.0)
    """Its centre in F0."""


class PriorEntry(Keys):
    """Prior of a parameter: mean deviation from nominal, and standard deviation, in one unit."""

    name: Name
    """Name of the parameter, as in fit.json: theta2, a2, compliance J3."""
    deviation_mm: Number = 0.0
    """Mean deviation of a length from its nominal value."""
    sd_mm: Positive | None = None
    """Standard deviation of a length."""
    deviation_deg: Number = 0.0
    """Mean deviation of an angle from its nominal value."""
    sd_deg: Positive | None = None
    """Standard deviation of an angle."""
    deviation_rad_per_nm: Number = 0.0
    """Mean deviation of a compliance from its nominal value."""
    sd_rad_per_nm: Positive | None = None
    """Standard deviation of a compliance."""


PRIOR_UNITS = {"mm": "m", "deg": "rad", "rad_per_nm": "rad/(N m)"}
"""Suffixes of the keys of a prior, and the units of the parameters, SI."""
PRIOR_DIGITS = 6
"""Significant digits of a prior that is written."""


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
    """Joint angle = this matrix x readings + offset, in deg or mm: signs, coupled axes; default: identity."""
    base: Place = Place()
    """Frame of the first row in F0."""
    ground: GroundEntry | None = None
    """Of a chain through two arms: the link that stands still; default: F0 does."""
    flange: Place = Place()
    """Flange in the frame of the last row; only with mdh."""
    links: list[Link] | None = None
    """One entry per joint; required for compliance."""
    reductions: list[Positive] | None = None
    """Motor revolutions per revolution of the joint (per metre of a prismatic one), one per joint."""
    joint_compliance_rad_per_nm: list[NotNegative] | None = None
    """Compliance, one per joint, 0 of prismatic ones; written for a calibrated arm."""
    coupling: Coupling = "display"
    """display: link_from_reading is done by the controller's display; mechanical: by gears."""
    priors: tuple[PriorEntry, ...] = ()
    """Priors of parameters in place of the usual ones, as bayescal fleet learns them."""


def robot_from(document: Document) -> Robot:
    """Check a parsed robot.yaml as a whole and turn it to SI units."""
    file = document.parse(RobotFile)
    n, joints, links = len(file.joints), file.joints, file.links or []
    for path, what, remedy in _faults(file, n):
        raise BayescalError(what, document.where(path), remedy)
    prismatic = np.array([joint.type == "prismatic" for joint in joints])
    of_each = ((field, np.where(prismatic, *keys[::-1])) for field, keys in OF_JOINTS.items())
    columns = {field: files.column_of(joints, keys) for field, keys in of_each}
    columns |= {field: files.column_of(links, [key] * len(links)) for field, key in OF_LINKS.items()}
    if (six := columns["inertias"]) is not None:
        columns["inertias"] = None if np.isnan(six).any() else six[:, SIX]
    coupling = np.eye(n) if file.link_from_reading is None else np.array(file.link_from_reading)
    if prismatic.any():
        unit = np.where(prismatic, files.si("_mm"), files.si("_deg"))
        coupling = coupling * unit[:, None] / unit
    endless = np.array([joint.continuous for joint in joints])
    turning = files.in_si("joint_compliance_rad_per_nm", file.joint_compliance_rad_per_nm)
    if (along := columns["compliance"]) is not None:
        turning = np.where(np.isnan(along), 0.0 if turning is None else turning, along)
    return Robot(
        name=file.name,
        convention=file.convention,
        joint_names=tuple(j.name for j in joints),
        link_from_reading=coupling,
        prismatic=prismatic if prismatic.any() else None,
        endless=endless if endless.any() else None,
        base=_frame(file.base),
        flange=_frame(file.flange),
        ground=None if file.ground is None else _ground(file.ground, joints),
        reductions=files.in_si("reductions", file.reductions),
        coupling=file.coupling,
        priors=tuple(map(_prior, file.priors)),
        **columns | {"compliance": turning},
    )


def _given(entry: PriorEntry) -> list[str]:
    """Units (suffixes) whose keys a prior has."""
    return [u for u in PRIOR_UNITS if {f"deviation_{u}", f"sd_{u}"} & entry.model_fields_set]


def _prior(entry: PriorEntry) -> Prior:
    (unit,) = _given(entry)
    mean, sd = (files.in_si(f"{key}_{unit}", getattr(entry, f"{key}_{unit}")) for key in ("deviation", "sd"))
    return Prior(entry.name, PRIOR_UNITS[unit], mean, sd)


def _ground(entry: GroundEntry, joints: list[Joint]) -> Ground:
    link = 1 + [joint.name for joint in joints].index(entry.behind)
    centre = files.in_si("centre_of_mass_mm", entry.centre_of_mass_mm)
    return Ground(link, _frame(entry), entry.mass_kg, centre)


def _frame(place: Place) -> np.ndarray:
    return rigid(rpy_matrix(files.in_si("rpy_deg", place.rpy_deg)), files.in_si("xyz_mm", place.xyz_mm))


def _faults(file: RobotFile, n: int) -> Iterator[tuple[tuple[str | int, ...], str, str]]:
    """Place, what is wrong and remedy of entries that contradict each other.

    They are lengths of lists, limits, names, the coupling and the reach.
    """
    matrix = file.link_from_reading or []
    for key in ("link_from_reading", "links", "reductions", "joint_compliance_rad_per_nm"):
        entries = getattr(file, key)
        if entries is not None and len(entries) != n:
            yield (key,), f"`{key}` has {len(entries)} entries, the robot {n} joints", "give one a joint"
    if file.convention == "dh" and file.flange != Place():
        yield ("flange",), "standard rows end at the flange", "leave `flange` out, or use mdh rows"
    if file.convention == "dh" and file.ground is not None:
        yield ("ground",), "a chain through two arms has mdh rows", "give a URDF of both, or mdh rows"
    if file.ground is not None and file.ground.behind not in [joint.name for joint in file.joints[:-1]]:
        remedy = "name a joint before the last"
        yield ("ground", "behind"), f"`{file.ground.behind}` is no joint between two arms", remedy
    for i, joint in enumerate(file.joints):
        slides = joint.type == "prismatic"
        key, limits = ("limits_mm", joint.limits_mm) if slides else ("limits_deg", joint.limits_deg)
        if limits is None:
            yield ("joints", i), f"missing `{key}` of {joint.name}", "add it: [lower, upper]"
        elif not limits[0] < limits[1]:
            yield ("joints", i, key), f"limits of {joint.name} are not in order", "write [lower, upper]"
        if slides and joint.continuous:
            yield ("joints", i, "continuous"), f"{joint.name} slides: it does not turn", "leave it out"
        foreign = [pair[not slides] for pair in OF_JOINTS.values() if pair[0] != pair[1]]
        for wrong in (key for key in foreign if key and getattr(joint, key) is not None):
            yield ("joints", i, wrong), f"`{wrong}` of {joint.name}, which is {joint.type}", "leave it out"
        if joint.name in [j.name for j in file.joints[:i]]:
            yield ("joints", i), f"two joints are called {joint.name}", "rename one"
    for i, row in enumerate(matrix):
        if len(row) != n:
            what = f"row {i + 1} of `link_from_reading` has {len(row)} entries, the robot {n} joints"
            yield ("link_from_reading", i), what, "give one a joint"
    if matrix and abs(np.linalg.det(np.array(matrix))) < 1e-6:
        yield ("link_from_reading",), "`link_from_reading` cannot be inverted", "check its rows"
    for i, entry in enumerate(file.priors):
        if len(units := _given(entry)) != 1 or getattr(entry, f"sd_{units[0]}") is None:
            keys = ", ".join(f"sd_{unit}" for unit in PRIOR_UNITS)
            yield ("priors", i), f"the prior of {entry.name} has no standard deviation in one unit", keys
        if entry.name in [e.name for e in file.priors[:i]]:
            yield ("priors", i), f"two priors of {entry.name}", "keep one"
    reach = sum(math.hypot(j.a_mm, j.d_mm) + np.ptp(j.limits_mm or (0.0, 0.0)) for j in file.joints)
    if not REACH_MM[0] <= reach <= REACH_MM[1]:
        yield ("joints",), f"the arm's lengths add up to {reach:g} mm", "`a_mm` and `d_mm` are in mm"


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
    slides, compliance = robot.slides, robot.compliance
    typed = [
        SLIDING if slide else ENDLESS if endless else ()
        for slide, endless in zip(slides, robot.unlimited, strict=True)
    ]
    columns = {field: getattr(robot, field) for field in (*OF_JOINTS, *OF_LINKS)}
    columns["beta"] = np.where(robot.beta, robot.beta, np.nan)
    if compliance is not None:
        columns["compliance"] = np.where(compliance > 0, compliance, np.nan)
        compliance = np.where(slides, 0.0, compliance)
    if robot.inertias is not None:
        columns["inertias"] = robot.inertias[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    turning, sliding = (
        {pair[k]: columns[field] for field, pair in OF_JOINTS.items() if pair[k]} for k in (0, 1)
    )
    links = {key: columns[field] for field, key in OF_LINKS.items()}
    unit, shown = robot.shown(np.ones(robot.n)), robot.link_from_reading
    if slides.any():
        shown = shown * unit[:, None] / unit
    coupled = not np.array_equal(robot.link_from_reading, np.eye(robot.n))
    lists = {"reductions": robot.reductions, "joint_compliance_rad_per_nm": compliance}
    block: Block = {
        "schema": SCHEMA,
        "name": scalar(robot.name),
        "convention": robot.convention,
        "joints": [
            flow([("name", scalar(name)), *kind, *row_keys(sliding if slides[i] else turning, i)])
            for i, (name, kind) in enumerate(zip(robot.joint_names, typed, strict=True))
        ],
        "link_from_reading": [in_file("", row) for row in shown] if coupled else None,
        "base": _place(robot.base),
        "flange": _place(robot.flange),
        "ground": None if robot.ground is None else flow(_ground_keys(robot.ground, robot.joint_names)),
        "links": None if robot.masses is None else [flow(row_keys(links, i)) for i in range(robot.n)],
        **{key: None if values is None else in_file(key, values) for key, values in lists.items()},
        "priors": [flow(_prior_keys(p)) for p in robot.priors],
        "coupling": robot.coupling if robot.coupling != "display" or coupled else None,
    }
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    return "\n".join([*lines, *block_lines(block)]) + "\n"


def _prior_keys(prior: Prior) -> Iterator[tuple[str, str]]:
    unit = next(u for u, of in PRIOR_UNITS.items() if of == prior.unit)
    yield "name", scalar(prior.name)
    for key, value in (("deviation", prior.deviation), ("sd", prior.sd)):
        yield f"{key}_{unit}", number(value / files.si(f"{key}_{unit}"), PRIOR_DIGITS)


def _ground_keys(ground: Ground, joints: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    yield "behind", scalar(joints[ground.link - 1])
    yield from _place_keys(ground.place)
    yield from row_keys({"mass_kg": np.array([ground.mass]), "centre_of_mass_mm": ground.centre[None]}, 0)


def _place(frame: np.ndarray) -> str:
    """A frame in another, "" where they are the same."""
    return "" if np.array_equal(frame, np.eye(4)) else flow(_place_keys(frame))


def _place_keys(frame: np.ndarray) -> Iterable[tuple[str, str]]:
    return row_keys({"xyz_mm": frame[None, :3, 3], "rpy_deg": rpy_of(frame[:3, :3])[None]}, 0)
