"""The nominal mechanism of an arm: joints, bodies with their inertia, friction and rotors of the drives."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bayescal.arm.chain import Robot, chain_of
from bayescal.arm.transforms import rigid, rotation
from bayescal.errors import listed
from bayescal.robots import only_revolute

TRANSITION = 0.03
"""rad/s: speed scale of the reversal of friction where none is stated (assumed)."""
THINNEST = 1e-4
"""Second moment of a link along one of its axes over the largest one: a link is no thinner (assumed)."""
SHORTEST = 0.02
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
    transition: float = TRANSITION  # rad/s
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
        limits=bounds_of(robot),
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
            length = max(after[k], float(np.linalg.norm(centre)), SHORTEST)
            inertia[k] = mass * (RADIUS_OF_GYRATION * length) ** 2 * np.eye(3)
            assumed.append(m.joint_names[k])
        elif np.min(moments) < THINNEST * np.max(moments):
            second = (axes * np.maximum(moments, THINNEST * np.max(moments))) @ axes.T
            inertia[k] = np.trace(second) * np.eye(3) - second
            changed.append(m.joint_names[k])
    notes = []
    if assumed:
        notes.append(
            f"no inertia is stated of {listed(assumed)}: that of a rod of the link's length is assumed"
        )
    if changed:
        notes.append(
            f"no body has the inertia that is stated of {listed(changed)}: the nearest one is assumed"
        )
    return replace(m, inertia=inertia) if notes else m, tuple(notes)


def bounds_of(robot: Robot) -> np.ndarray:
    """Limits (n, 2), rad; nan of joints that turn without end."""
    return np.where(robot.unlimited[:, None], np.nan, robot.limits)


def or_nan(values: np.ndarray | None, *shape: int) -> np.ndarray:
    """Values of joints; nan where none are known."""
    return np.full(shape, np.nan) if values is None else values
