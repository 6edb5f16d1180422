"""A joint log as frozen arrays, in SI, and the nominal mechanism of its arm.

The mechanism has joints, bodies with their inertia, friction, and the rotors of the drives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot, chain_of
from bayescal.arm.transforms import rigid, rotation
from bayescal.errors import listed
from bayescal.robots import only_revolute

TRANSITION = 0.03
"""rad/s: speed scale of the reversal of friction where none is stated (assumed)."""
THINNEST = 1e-4
"""Second moment of a link along one of its axes over the largest one: a link is no thinner (assumed)."""
SHORTEST_LINK = 0.02
"""m, of a link whose inertia is not stated (assumed)."""
TURNING_PART = "of a URDF name the part that turns, `arm.urdf#FIRST..TIP`; what slides must rest"
"""What to do where a joint of an arm slides."""
RADIUS_OF_GYRATION = 0.3
"""Of a link about its centre, over the distance to the next joint, where no inertia is stated (assumed)."""


@dataclass(frozen=True)
class Uncertain:
    """Prior standard uncertainties of the nominal mechanism; relative; of `centre` in m."""

    mass: float = 0.15
    centre: float = 0.012
    inertia: float = 0.15
    armature: float = 0.15
    transition: float = 0.3


@dataclass(frozen=True)
class Mechanism:
    """A serial arm of n turning joints, SI units.

    Body k is carried by joint k. Its frame is `place[k]` in the frame of body k - 1, turned by the joint's
    angle about `axis[k]`. Joint angles are `coupling` times the readings, and torques of readings the
    transpose of it times those of the joints.
    """

    name: str
    joint_names: tuple[str, ...]
    place: np.ndarray  # (n, 4, 4)
    axis: np.ndarray  # (n, 3) unit vectors, in the body's frame
    mass: np.ndarray  # (n,) kg
    centre: np.ndarray  # (n, 3) m, in the body's frame
    inertia: np.ndarray  # (n, 3, 3) kg m2 about the centre, axes of the body's frame
    armature: np.ndarray  # (n,) kg m2, of the rotor as seen at the joint; nan where not known
    coulomb: np.ndarray  # (n,) N m; nan where not known
    viscous: np.ndarray  # (n,) N m s/rad; nan where not known
    rated: np.ndarray  # (n,) N m; nan where not known
    gear_ratio: np.ndarray  # (n,); nan where not known
    limits: np.ndarray  # (n, 2) rad; nan where not known, or none
    fastest: np.ndarray  # (n,) rad/s, largest speeds; nan where not known
    coupling: np.ndarray  # (n, n)
    transition: float = 0.0  # rad/s, 0 where none is stated
    payload_centre: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m, in the last body's frame
    payload_gyration: float = 0.0  # m
    u: Uncertain = Uncertain()
    robot: Robot | None = None  # of which it is, with its shape; None where dataset.yaml has the arm

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def coupled(self) -> bool:
        """Whether joint angles are not the readings."""
        return not np.array_equal(self.coupling, np.eye(self.n))

    @property
    def inertials(self) -> np.ndarray:
        """Parameters (n, 10) in which torques are linear, of each body: see `inertial`."""
        return np.array([inertial(*body) for body in zip(self.mass, self.centre, self.inertia, strict=True)])


PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Elements of a symmetric matrix in the order of parameters: xx, yy, zz, xy, xz, yz."""


def inertial(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Mass, first moment (3) and inertia (6) about the origin of the body's frame, as `PAIRS`.

    The torques of a rigid body are linear in these ten (Atkeson, An and Hollerbach, IJRR 5(3), 1986).
    """
    about = inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([[mass], mass * centre, [about[i, j] for i, j in PAIRS]])


def mechanism_of(robot: Robot) -> tuple[Mechanism, tuple[str, ...]]:
    """The mechanism of a robot of Denavit-Hartenberg rows, and what had to be assumed of it.

    A joint whose reading has the opposite sense of its row turns about the reversed axis.
    """
    only_revolute(robot, "joint logs", TURNING_PART)
    chain, n = chain_of(robot), robot.n
    sense = np.where(np.diag(robot.link_from_reading) < 0.0, -1.0, 1.0)
    turned = zip(robot.offset, robot.d, strict=True)
    place = chain.link[:-1] @ np.array([rigid(rotation(2, a), np.array([0.0, 0.0, d])) for a, d in turned])
    place[0] = chain.base @ place[0]
    behind = chain.link[1:] if robot.convention == "dh" else np.tile(np.eye(4), (n, 1, 1))
    notes = []
    masses, centres = robot.masses, robot.centres_of_mass
    if masses is None or centres is None:
        masses, centres = np.full(n, np.nan), np.zeros((n, 3))
        notes.append("the robot states no masses: torques are not assessed")
    inertia = robot.inertias
    if inertia is None:
        length = np.hypot(robot.a, robot.d)
        gyration = RADIUS_OF_GYRATION * np.maximum(length, np.max(length) / 4)
        inertia = (np.nan_to_num(masses) * gyration**2)[:, None, None] * np.eye(3)
        notes.append("the robot states no inertias: those of rods of the links' lengths are assumed")
    turn = behind[:, :3, :3]
    return Mechanism(
        name=robot.name,
        joint_names=robot.joint_names,
        place=place,
        axis=np.outer(sense, [0.0, 0.0, 1.0]),
        mass=masses,
        centre=np.einsum("kij,kj->ki", turn, centres) + behind[:, :3, 3],
        inertia=turn @ inertia @ np.swapaxes(turn, 1, 2),
        armature=or_nan(robot.armatures, n),
        coulomb=or_nan(robot.coulomb, n),
        viscous=or_nan(robot.viscous, n),
        rated=or_nan(robot.torques, n),
        gear_ratio=or_nan(robot.reductions, n),
        limits=np.where(robot.unlimited[:, None], np.nan, robot.limits),
        fastest=or_nan(robot.velocities, n),
        coupling=sense[:, None] * robot.link_from_reading,
        u=Uncertain() if robot.inertias is not None else Uncertain(inertia=1.0),
        robot=robot,
    ), tuple(notes)


def with_bodies(m: Mechanism) -> tuple[Mechanism, tuple[str, ...]]:
    """A mechanism of which every link with a mass is a body that there can be, and what was assumed of it.

    The second moments of a body are not negative: no moment of inertia is larger than the sum of the others.
    """
    inertia, assumed, changed = m.inertia.copy(), [], []
    after = np.linalg.norm(np.roll(m.place[:, :3, 3], -1, axis=0), axis=1)
    after[-1] = 0.0
    for k, (mass, centre) in enumerate(zip(m.mass, m.centre, strict=True)):
        if not mass > 0.0:
            continue
        moments, axes = np.linalg.eigh(0.5 * np.trace(inertia[k]) * np.eye(3) - inertia[k])
        if np.max(moments) <= 0.0:
            length = max(after[k], float(np.linalg.norm(centre)), SHORTEST_LINK)
            inertia[k] = mass * (RADIUS_OF_GYRATION * length) ** 2 * np.eye(3)
            assumed.append(m.joint_names[k])
        elif np.min(moments) < THINNEST * np.max(moments):
            second = (axes * np.maximum(moments, THINNEST * np.max(moments))) @ axes.T
            inertia[k] = np.trace(second) * np.eye(3) - second
            changed.append(m.joint_names[k])
    said = {
        "no inertia is stated of {}: that of a rod of the link's length is assumed": assumed,
        "no body has the inertia that is stated of {}: the nearest one is assumed": changed,
    }
    notes = tuple(text.format(listed(names)) for text, names in said.items() if names)
    return replace(m, inertia=inertia) if notes else m, notes


def or_nan(values: np.ndarray | None, *shape: int) -> np.ndarray:
    """Values of joints; nan where none are known."""
    return np.full(shape, np.nan) if values is None else values


CALIBRATE, VALIDATE = "calibrate", "validate"
SERVO = "servo"
"""Kind of torques that are errors of position servos, times their stiffness."""
TORQUE, TRACKING, LINK = "torque", "tracking", "link"
"""Kinds of residuals: torque, N m; command less position beyond what the torque explains, rad; position
behind the gear less position of the motor, rad. A joint has a channel of each kind that a log has."""


ONE_VALUE, MOVING = 0.5, 0.1
"""Fraction of the rows of a moving joint with one and the same torque: its signal has too few digits, or is
dead; and a joint moves where it is faster than this fraction of its 95th percentile (conventions)."""
LOST_STEPS, LOST = 3.0, 0.05
"""Steps, and s, without rows, over which nothing is interpolated: half a period of 10 Hz (assumed)."""
FEWEST_ROWS = 20
"""Rows of a motion: fewer have no derivatives."""
SHORTEST = 1.0
"""s of a part of a motion that is of use: its ends are lost to filters (assumed)."""


@dataclass(frozen=True)
class Motion:
    """One motion of a log: N rows of n joints. A column that was not measured is None."""

    name: str
    role: str  # calibrate or validate
    kind: str  # of motion, as the file says
    same_as: str  # the motion that it repeats; its own name if none
    time: np.ndarray  # (N,) s
    position: np.ndarray  # (N, n) rad
    velocity: np.ndarray | None  # (N, n) rad/s
    command: np.ndarray | None  # (N, n) rad
    torque: np.ndarray | None  # (N, n) N m, at the joint
    link: np.ndarray | None  # (N, n) rad, of second encoders behind the gears
    temperature: np.ndarray | None  # (N,) degC
    payload: np.ndarray  # (N,) kg
    line: int  # of its first row

    @property
    def loaded(self) -> bool:
        """Whether it carries a payload."""
        return bool(np.any(self.payload > 0.0))

    @property
    def divided(self) -> tuple[Motion, ...]:
        """Its parts between rows that are missing, without those that are too short; itself if none are."""
        steps = np.diff(self.time)
        lost = np.flatnonzero(steps > max(LOST_STEPS * float(np.median(steps)), LOST)) + 1
        if not len(lost):
            return (self,)
        parts = [slice(a, b) for a, b in pairwise((0, *lost.tolist(), len(self.time)))]
        parts = [p for p in parts if self.time[p.stop - 1] - self.time[p.start] >= SHORTEST]
        parts = [p for p in parts if p.stop - p.start >= FEWEST_ROWS]
        columns = {f.name for f in fields(self)} - {"name", "role", "kind", "same_as", "line"}
        measured = {c: x for c in columns if (x := getattr(self, c)) is not None}
        out = []
        for k, rows in enumerate(parts, 1):
            values: dict[str, Any] = {c: x[rows] for c, x in measured.items()}
            name = f"{self.name} ({k})"
            out.append(replace(self, name=name, same_as=name, line=self.line + rows.start, **values))
        return tuple(out)


@dataclass(frozen=True)
class Controller:
    """What is known of the controller: gains (n,) in SI, None where not stated."""

    kind: str  # torque or position
    stiffness: np.ndarray | None  # (n,) N m/rad
    damping: np.ndarray | None  # (n,) N m s/rad
    stated: bool = True  # False where the stiffness follows from the log
    ahead: np.ndarray | None = None  # (n,) N m s/rad, of the commanded speed; None where torques do not tell
    complete: bool = True  # False where measured torques have a further part, such as feed-forward


@dataclass(frozen=True)
class Log:
    """Motions of one arm, with its nominal mechanism and what is known of the measurement."""

    name: str
    mechanism: Mechanism
    motions: tuple[Motion, ...]
    gravity: np.ndarray  # (3,) m/s2
    controller: Controller
    torque_kind: str  # motor, current, sensor or servo; "" without torques
    signed: bool  # whether the torque has a sign
    u_constant: float  # relative standard uncertainty of the torque constants
    alignment: float  # s, of torque against position, and its standard uncertainty
    u_alignment: float
    link_side: bool  # whether positions are of the link side of the gears
    notes: tuple[str, ...]  # what was assumed
    digest: str  # SHA-256 of the files
    files: tuple[Path, ...] = ()  # that were read
    noise: np.ndarray | None = None  # (n,) N m, stated standard deviations of the torques
    mistaken: tuple[str, ...] = ()  # what is probably wrong with its columns, with the remedy

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.mechanism.n

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of residuals of this log."""
        control = self.controller
        servo = control.kind == "position" and control.stiffness is not None and control.complete
        servo = servo and self.torque_kind != SERVO
        tracked = servo and all(m.command is not None for m in self.motions)
        linked = not self.link_side and all(m.link is not None for m in self.motions)
        return (TORQUE, *([TRACKING] if tracked else []), *([LINK] if linked else []))

    def of_role(self, role: str) -> tuple[Motion, ...]:
        """The motions of a role."""
        return tuple(m for m in self.motions if m.role == role)

    @property
    def divided(self) -> Log:
        """The log with motions divided where rows are missing."""
        parts = {m.name: m.divided for m in self.motions}
        if all(len(p) == 1 and p[0].name == name for name, p in parts.items()):
            return self
        kept = tuple(p for m in self.motions for p in parts[m.name])
        missing = [name for name, p in parts.items() if [m.name for m in p] != [name]]
        said = f"rows are missing in motion {', '.join(missing)}: it is divided there, not interpolated"
        return replace(self, motions=kept, notes=(*self.notes, said))

    @property
    def coarse(self) -> Mapping[str, float]:
        """Joints with one and the same torque in most rows in which they move, and the fraction of these.

        What such a torque tells of masses, centres of mass and friction would be wrong: it is left out.
        """
        parts = [m for m in self.motions if m.torque is not None and len(m.time) > 1]
        if not parts or self.torque_kind == SERVO:
            return {}
        torque = np.concatenate([m.torque for m in parts if m.torque is not None])
        speed = np.abs(np.concatenate([np.gradient(m.position, m.time, axis=0) for m in parts]))
        out = {}
        for name, t, v in zip(self.mechanism.joint_names, torque.T, speed.T, strict=True):
            moves = v > max(MOVING * float(np.quantile(v, 0.95)), np.finfo(float).tiny)
            share = np.unique(t[moves], return_counts=True)[1].max() / moves.sum() if moves.any() else 0.0
            if share > ONE_VALUE:
                out[name] = float(share)
        return out

    @property
    def limits(self) -> tuple[str, ...]:
        """What limits all results of this log, as text: assumptions, and torques that tell nothing."""
        coarse = self.coarse
        if not coarse:
            return self.notes
        each = ", ".join(f"{name} {100 * share:.0f} %" for name, share in coarse.items())
        what = f"one and the same torque in most rows in which the joint moves: {each}: it would tell wrong "
        return (*self.notes, what + "masses and friction, and is left out; log it with more digits")
