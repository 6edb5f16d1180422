"""Types of a measuring session, in SI units and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset.solids import OwnSolid

ROLES = ("calibrate", "validate", "locate")


@dataclass(frozen=True)
class Tool:
    """A point carried by the flange. `u` is the prior's standard uncertainty; None is loose."""

    name: str
    centre: np.ndarray  # (3,) m, in the flange frame
    ball_radius: float | None = None  # m
    mass: float = 0.0  # kg, total attached to the flange
    centre_of_mass: np.ndarray | None = None  # (3,) m, in the flange frame
    u: float | None = None  # m, 0 = known
    u_angle: float | None = None  # rad, of its orientation
    rpy: np.ndarray | None = None  # (3,) rad, its frame's in that of the flange; None where none is stated


@dataclass(frozen=True)
class Target:
    """What is touched or looked at: its kind and nominal place in F0.

    `values` holds what the kind needs, SI, under the contract's keys without their units: plane
    ``normal`` (3,) unit, ``offset``; sphere ``centre``, ``diameter``; cylinder ``point``, ``axis``
    unit, ``diameter``; fixed-point ``centre``; distance ``centre``, ``length`` (nan where the rows
    read it); instrument ``xyz``, ``rpy``; camera these and its lens and board, nan where left out. Of
    several sessions joined, `session` is the one that it was measured in, and `noise` that whose noise its
    rows share; "" where there is but one.
    """

    name: str
    kind: str
    values: dict[str, np.ndarray | float]
    u: float | None = None  # m, None = loose, 0 = known
    u_angle: float | None = None  # rad
    session: str = ""
    noise: str = ""
    texts: Mapping[str, str] = field(default_factory=dict)  # values that are words, by their keys


@dataclass(frozen=True)
class Points:
    """Certified coordinates of the K points of an artefact, and which of them the targets of a session are.

    Attributes
    ----------
    artefact : str
        Its name.
    names : tuple of str
        Of the points, (K,).
    coordinates : tuple
        (K, 3) m, in the frame of the artefact.
    covariance : tuple
        (3 K, 3 K) m2.
    of : tuple of int
        The point of each target of the certificate.
    placements : tuple of str
        The placement of each target; targets of one placement stand to each other as the points.
    """

    artefact: str
    names: tuple[str, ...]
    coordinates: tuple[tuple[float, ...], ...]
    covariance: tuple[tuple[float, ...], ...]
    of: tuple[int, ...]
    placements: tuple[str, ...]


@dataclass(frozen=True)
class Certificate:
    """What an artefact's certificate says of one or two targets; uncertainties are standard (k = 1).

    kind ``parallel`` (distance m, u_distance m, u_angle rad), ``perpendicular`` (u_angle),
    ``distance`` (distance, u_distance), ``diameter`` (u_distance is that of the diameter),
    ``flat`` (u_form m), ``points`` (coordinates of two or more targets). `derived`: it follows from one of
    kind ``points``, and a fit uses that.
    """

    kind: str
    targets: tuple[str, ...]
    distance: float | None = None
    u_distance: float | None = None
    u_angle: float | None = None
    u_form: float | None = None
    points: Points | None = None
    derived: bool = False

    @property
    def parts(self) -> tuple[str, ...]:
        """Its targets without their placements: ``ball.A`` of ``ball.A@2``."""
        return tuple(name.partition("@")[0] for name in self.targets)


@dataclass(frozen=True)
class Noise:
    """Stated standard uncertainties, None where the file states none.

    One contact (m), one instrument coordinate (m), one joint reading (rad; `slide`, m, of a prismatic joint),
    one turn of the tool about an axis as an instrument reads it (rad), one coordinate of a corner in an image
    (px). `field` is that of each error which the corners of an image share, over the noise of each: powers of
    the place in it up to `power`. A fit tells it; no file states it.
    """

    contact: float | None = None
    point: float | None = None
    joint: float = 0.0
    slide: float | None = None
    orientation: float | None = None
    pixel: float | None = None
    field: float = 0.0
    power: int = 0


@dataclass(frozen=True)
class Box:
    """A box with edges along the axes of F0: its centre (3,) and its edge lengths (3,), m."""

    centre: np.ndarray
    size: np.ndarray


@dataclass(frozen=True)
class Patch:
    """Where contacts may be on a target, as stated: about `centre` (3,), m, in F0.

    Of a face a rectangle of `size` (2,), m, whose first edge is nearest to `along` (3,), a unit vector, or to
    an axis of F0 without it. Of a cylinder a length `size` (1,), m, of its axis.
    """

    centre: np.ndarray
    size: np.ndarray
    along: np.ndarray | None = None


@dataclass(frozen=True)
class PlanSettings:
    """What a session states for the choice of its contacts (`plan:` in dataset.yaml).

    Attributes
    ----------
    volume : Box or None
        Volume of interest, in which distances must be accurate.
    regions : mapping of str to Patch
        By the name of their target.
    table : float or None
        Height of the table in F0, m, against gravity.
    payloads : tuple of float
        Masses, kg, that can be attached in addition to the tool.
    cone : float or None
        Greatest angle, rad, between the axis of the tool and the inward normal.
    clearance : float or None
        Smallest clearance, m, of motions between contacts.
    poses : tuple of tuple of float
        Readings (n), rad, of poses between which distances must be accurate.
    """

    volume: Box | None = None
    regions: Mapping[str, Patch] = field(default_factory=dict)
    table: float | None = None
    payloads: tuple[float, ...] = ()
    cone: float | None = None
    clearance: float | None = None
    poses: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class Record:
    """What a report that is filed states of a session beyond its data; no computation depends on it.

    Attributes
    ----------
    date : str
        YYYY-MM-DD, or "".
    operator : str
    serials : mapping of str to str
        Serial numbers of ``arm``, ``probe``, ``artefact`` and ``instrument``, those that are stated.
    certificates : tuple of str
        Numbers of the calibration certificates of the artefacts and instruments.
    temperature : float or None
        Of the room, deg C.
    """

    date: str = ""
    operator: str = ""
    serials: Mapping[str, str] = field(default_factory=dict)
    certificates: tuple[str, ...] = ()
    temperature: float | None = None


@dataclass(frozen=True)
class Measurements:
    """N rows in order of time. Optional columns are None where the file has no such column."""

    ids: tuple[str, ...]
    role: np.ndarray  # (N,) str, of ROLES
    target: np.ndarray  # (N,) int, index into Dataset.targets
    tool: np.ndarray  # (N,) int, index into Dataset.tools
    readings: np.ndarray  # (N, n) rad; m of prismatic joints, as all that follows
    line: np.ndarray  # (N,) int, line in measurements.csv (the header is line 1)
    velocity: np.ndarray | None = None  # (N, n) rad/s
    xyz: np.ndarray | None = None  # (N, 3) m, nan in rows that read none
    rpy: np.ndarray | None = None  # (N, 3) rad, nan in rows that read none
    length: np.ndarray | None = None  # (N,) m, nan in rows that read none
    pixel: np.ndarray | None = None  # (N, 3) px and the number of the board's point, nan in rows of no image
    u: np.ndarray | None = None  # (N,) m, nan where the stated noise holds
    stop: np.ndarray | None = None  # (N,) str, "" where none
    command: np.ndarray | None = None  # (N, n) rad
    torque: np.ndarray | None = None  # (N, n) N m
    time: np.ndarray | None = None  # (N,) s
    temperature: np.ndarray | None = None  # (N,) deg C
    payload: np.ndarray | None = None  # (N,) additional payload, kg
    repeat: np.ndarray | None = None  # (N,) str, "" where none


@dataclass(frozen=True)
class Dataset:
    """One session, or several of one arm joined: robot, tools, targets, certificates and measurements."""

    name: str
    folder: Path
    robot: Robot
    robot_reference: str  # as dataset.yaml names it: built-in or a path beside it
    readings: str  # "encoder" or "command"
    gravity: np.ndarray  # (3,) m/s2, in F0
    tools: tuple[Tool, ...]
    noise: Noise
    targets: tuple[Target, ...]
    certificates: tuple[Certificate, ...]
    measurements: Measurements
    temperature_of: str | None = None
    torques: str = "computed"  # of the joints: "computed" from the masses, or "measured"
    source: str | None = None
    plan: PlanSettings | None = None  # for `bayescal plan`; no other computation depends on it
    record: Record = Record()  # for the header of reports; empty where several sessions are joined
    solids: tuple[OwnSolid, ...] = ()  # around the arm, for motions
    unfilled: tuple[tuple[str | int, ...], ...] = ()  # keys in dataset.yaml of values that are only assumed
    sha256: str = ""  # of dataset.yaml, measurements.csv and the robot file
    sessions: tuple[Dataset, ...] = ()  # those joined in this one, each as it was read

    @property
    def reading_noise(self) -> tuple[float, np.ndarray]:
        """Standard uncertainty u of a reading, rad, and that of each joint over u, (n,).

        If only prismatic joints have one, u is theirs, m.
        """
        slide = self.noise.slide or 0.0
        u = self.noise.joint or slide
        every = np.where(self.robot.slides, slide, self.noise.joint)
        return u, every / u if u else np.ones(self.robot.n)
