"""The chain of frames, and its readable NumPy reference: out to a point, and the wrench back.

Frames are numbered 0 (base), 1 to n (each moved by its joint), n + 1 (tool). Every frame carries a
displacement D = Rz Tz Rx Tx Ry Ty of six small components (`transforms.AXES`), and a point of the
tool is at

    base  D0  link0 [Rz(q1) Tz(d1)] D1 link1 ... [Rz(qn) Tz(dn)] Dn linkn  T(tool)  D(n+1)  0

in F0. ``link`` holds what stands between one joint and the next: Rx(alpha) Tx(a) of the next row in
modified DH (and the flange behind the last), Tx(a) Rx(alpha) of the same row in standard DH. Rz and Tz
of D commute with those of the joint, so the components are exact DH errors: of theta, d, alpha, a, and
Hayati's beta.

A robot as its drawing says it is: nominal kinematics, masses and coupling of its axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Literal

import numpy as np

from bayescal.arm.transforms import rigid, rotation

Convention = Literal["mdh", "dh"]
Coupling = Literal["display", "mechanical"]


SHOWN = {False: ("deg", 180.0 / np.pi, np.pi / 180.0), True: ("mm", 1e3, 1e-3)}
"""Unit of a reading in files, factor to it from SI, and back, of revolute and prismatic joints."""


@dataclass(frozen=True)
class Prior:
    """The prior of a parameter of the arm, as a robot file states it; SI."""

    name: str
    unit: str  # m, rad or rad/(N m)
    deviation: float  # mean, from nominal
    sd: float


@dataclass(frozen=True)
class Ground:
    """The link that stands still of a chain through two arms, and what its first link weighs.

    Such a chain begins at the flange of one arm, which is F0, and ends at that of the other: F0 moves, and
    what it carries is measured. Gravity is stated in a frame of the ground, at `place` (4, 4) in the frame of
    the link.
    """

    link: int  # behind the joint of this number, from 1
    place: np.ndarray  # m
    mass: float = 0.0  # kg, of the link before the first joint
    centre: np.ndarray = field(default_factory=lambda: np.zeros(3))  # of this mass, in F0, m
    held: float = 0.0  # kg, of what this link carries in a session
    held_centre: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def load(self) -> tuple[float, np.ndarray]:
        """Mass before the first joint, kg, and its centre (3,) in F0, m."""
        total = self.mass + self.held
        moment = self.mass * self.centre + self.held * self.held_centre
        return total, moment / total if total > 0 else moment


@dataclass(frozen=True)
class Robot:
    """Nominal serial arm of n joints, in SI units: rad at a revolute joint, m at a prismatic one.

    Rows follow `convention`: in modified DH (``mdh``, Craig) ``alpha`` and ``a`` of row i stand
    before joint i, ``Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d)``; in standard DH (``dh``) after it,
    ``Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)``. ``theta = link_from_reading @ reading + offset``.
    Behind modified rows the flange may stand anywhere (`flange`); standard ones end at it.

    A prismatic joint slides along its z axis: ``d = link_from_reading @ reading + d``, and its theta is its
    offset. Limits, speeds and compliances are then in m, m/s and m/N, its torque is a force, N.

    `coupling` says what couples the axes of `link_from_reading`. ``display``: the controller computes what
    it shows; every motor, gear and encoder sits at its own joint, between two links. ``mechanical``: linkages
    or gear trains do; motors and encoders turn by the readings, each moving all links of its column.
    """

    name: str
    convention: Convention
    joint_names: tuple[str, ...]
    alpha: np.ndarray  # (n,) rad
    a: np.ndarray  # (n,) m
    d: np.ndarray  # (n,) m
    offset: np.ndarray  # (n,) rad
    beta: np.ndarray  # (n,) rad, Hayati's angle of near-parallel axes; zero on a drawing
    limits: np.ndarray  # (n, 2) rad, of the link side (row of link_from_reading times its sign)
    link_from_reading: np.ndarray  # (n, n)
    base: np.ndarray = field(default_factory=lambda: np.eye(4))  # first row's frame in F0
    masses: np.ndarray | None = None  # (n,) kg, of the link that each joint moves
    centres_of_mass: np.ndarray | None = None  # (n, 3) m, each in its link frame
    compliance: np.ndarray | None = None  # (n,) rad/(N m), where already known
    reductions: np.ndarray | None = None  # (n,) motor turns a joint turn
    flange: np.ndarray = field(default_factory=lambda: np.eye(4))  # in the last row's frame; mdh only
    coupling: Coupling = "display"
    radii: np.ndarray | None = None  # (n,) m, of capsules around the links; nan where assumed
    velocities: np.ndarray | None = None  # (n,) rad/s, largest of the joints; nan where not stated
    torques: np.ndarray | None = None  # (n,) N m, largest of the joints; nan where not stated
    inertias: np.ndarray | None = None  # (n, 3, 3) kg m2, of the links about their centres, link frames' axes
    coulomb: np.ndarray | None = None  # (n,) N m, friction of the joints; nan where not stated
    viscous: np.ndarray | None = None  # (n,) N m s/rad; nan where not stated
    armatures: np.ndarray | None = None  # (n,) kg m2, rotors as seen at the joints; nan where not stated
    priors: tuple[Prior, ...] = ()  # of parameters whose usual priors do not hold for this arm
    ground: Ground | None = None  # of a chain through two arms; None: F0 stands still
    prismatic: np.ndarray | None = None  # (n,) bool, joints that slide; None: all are revolute
    endless: np.ndarray | None = None  # (n,) bool, joints that turn without end; `limits` bound plans
    mass_covariance: np.ndarray | None = None
    # (4n, 4n) of relative errors of masses and errors of centres, m, link by link, where masses were
    # estimated together with other measurements; None: see `effects.gravity`

    def __post_init__(self) -> None:
        assert self.convention == "mdh" or np.array_equal(self.flange, np.eye(4)), "standard rows end at it"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def two_arms(self) -> str:
        """Which joints are of which of two arms, in words; "" of one arm."""
        if self.ground is None:
            return ""
        last, names = self.ground.link, self.joint_names
        carry = f"two arms: joints 1 to {last} ({names[0]} to {names[last - 1]}) carry what is measured"
        tool = f"{last + 1} to {self.n} ({names[last]} to {names[-1]}) the tool"
        return f"{carry}, {tool}; the base of the chain is the flange of the first arm"

    @cached_property
    def slides(self) -> np.ndarray:
        """Which joints are prismatic, (n,) bool."""
        return np.zeros(self.n, bool) if self.prismatic is None else self.prismatic

    @property
    def unlimited(self) -> np.ndarray:
        """Whether each joint turns without end, (n,)."""
        return np.zeros(self.n, bool) if self.endless is None else self.endless

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each joint's reading in files: deg, or mm of a prismatic joint."""
        return tuple(SHOWN[slides][0] for slides in self.slides.tolist())

    @property
    def unit_words(self) -> str:
        """Units of the readings in words: ``deg``, or ``mm, deg`` in the order in which they first appear."""
        return ", ".join(dict.fromkeys(self.units))

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Axis of each joint's motion in its frame, of `transforms.AXES`: rz, or tz of a prismatic joint."""
        return tuple("tz" if slides else "rz" for slides in self.slides.tolist())

    def limits_within(self, most: float) -> np.ndarray:
        """Limits (n, 2) of which those of revolute joints are at most +-`most`, rad."""
        return np.where(self.slides[:, None], self.limits, np.clip(self.limits, -most, most))

    def shown(self, readings: np.ndarray | Sequence[float]) -> np.ndarray:
        """Readings or their rates (..., n) in the units of files: deg, or mm of a prismatic joint."""
        return np.asarray(readings) * np.array([SHOWN[slides][1] for slides in self.slides.tolist()])

    def read(self, shown: np.ndarray) -> np.ndarray:
        """Readings or their rates (..., n), SI, from those in the units of files."""
        return shown * np.array([SHOWN[slides][2] for slides in self.slides.tolist()])


@dataclass(frozen=True)
class Chain:
    """Constants of a robot's chain: `base` (4, 4), `link` (n + 1, 4, 4), `d` (n,), m and rad.

    Joints that `slides` (n,) move along their axes; `theta` (n,) is the constant angle of these. `ground` is
    the link that stands still; None: F0 does.
    """

    base: np.ndarray
    link: np.ndarray
    d: np.ndarray
    slides: np.ndarray = field(default_factory=lambda: np.zeros(1, bool))
    theta: np.ndarray = field(default_factory=lambda: np.zeros(1))
    ground: Ground | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.d)

    def moved(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles about, rad, and shifts along the joints' axes, m, (..., n), at link coordinates (..., n)."""
        return np.where(self.slides, self.theta, q), self.d + np.where(self.slides, q, 0.0)


def chain_of(robot: Robot) -> Chain:
    """Build the chain of a robot, whichever of the two DH conventions its rows follow."""
    n = robot.n
    link = np.tile(np.eye(4), (n + 1, 1, 1))
    for i in range(n):
        twist, shift = rigid(rotation(0, robot.alpha[i])), rigid(None, np.array([robot.a[i], 0.0, 0.0]))
        hayati = rigid(rotation(1, robot.beta[i]))
        k = i if robot.convention == "mdh" else i + 1
        link[k] = twist @ shift @ hayati if robot.convention == "mdh" else shift @ twist @ hayati
    link[n] = link[n] @ robot.flange
    theta = np.where(robot.slides, robot.offset, 0.0)
    return Chain(robot.base, link, robot.d, robot.slides, theta, robot.ground)


def link_angles(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Joint angles of the chain (N, n), rad, from readings (N, n), rad: signs, coupling, offsets.

    At a prismatic joint both are shifts, m.
    """
    return readings @ robot.link_from_reading.T + np.where(robot.slides, 0.0, robot.offset)


def displaced(x: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """Points x (..., 3) moved by D of delta (..., 6)."""
    for axis, turn, slide in ((1, 4, 5), (0, 2, 3), (2, 0, 1)):  # Ry Ty, then Rx Tx, then Rz Tz
        shift = np.zeros(3)
        shift[axis] = 1.0
        x = x + delta[..., slide, None] * shift
        x = (rotation(axis, delta[..., turn]) @ x[..., None])[..., 0]
    return x


def points(chain: Chain, q: np.ndarray, tool: np.ndarray, delta: np.ndarray | None = None) -> np.ndarray:
    """Ball centres in F0.

    Parameters
    ----------
    chain : Chain
    q : np.ndarray, shape (C, n)
        Nominal link angles, rad (`link_angles`).
    tool : np.ndarray, shape (C, 3) or (3,)
        Ball centre in the flange frame, m.
    delta : np.ndarray, shape (..., C, n + 2, 6), optional
        Displacements of the frames, rad and m, in the order of `transforms.AXES`.

    Returns
    -------
    np.ndarray, shape (..., C, 3), m
    """
    n, (angle, shift) = chain.n, chain.moved(q)
    delta = np.zeros((len(q), n + 2, 6)) if delta is None else delta
    x = np.broadcast_to(tool, (len(q), 3)) + displaced(np.zeros(3), delta[..., n + 1, :])
    for i in range(n, 0, -1):
        x = x @ chain.link[i, :3, :3].T + chain.link[i, :3, 3]
        motion = delta[..., i, :].copy()
        motion[..., 0] += angle[:, i - 1]
        motion[..., 1] += shift[:, i - 1]
        x = displaced(x, motion)
    x = x @ chain.link[0, :3, :3].T + chain.link[0, :3, 3]
    x = displaced(x, delta[..., 0, :])
    return x @ chain.base[:3, :3].T + chain.base[:3, 3]


def wrenches(chain: Chain, q: np.ndarray, tool: np.ndarray, delta: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Derivatives of ``u . p`` by every displacement: the contact wrench in every frame.

    Force u and moment p x u are carried from the base to the tool; a component of the wrench in the
    frame where a displacement acts is the derivative by that displacement.

    Parameters
    ----------
    chain, q, tool, delta
        As for `points`; delta of shape (C, n + 2, 6).
    u : np.ndarray, shape (C, 3)
        Direction in F0 along which the ball's motion counts: the gradient of a residual.

    Returns
    -------
    np.ndarray, shape (C, n + 2, 6)
        Per rad and per m of each displacement, in the order of `transforms.AXES`.
    """
    n, (angle, shift) = chain.n, chain.moved(q)
    x = points(chain, q, tool, delta)
    out = np.zeros((len(q), n + 2, 6))

    def enter(transform: np.ndarray) -> None:
        nonlocal x, u
        x = (x - transform[:3, 3]) @ transform[:3, :3]
        u = u @ transform[:3, :3]

    def cross(frame: int, motion: np.ndarray) -> None:
        nonlocal x, u
        for axis, turn, slide in ((2, 0, 1), (0, 2, 3), (1, 4, 5)):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            out[:, frame, turn] = x[:, i] * u[:, j] - x[:, j] * u[:, i]  # of p x u about the axis
            out[:, frame, slide] = u[:, axis]
            back = np.swapaxes(rotation(axis, motion[:, turn]), -1, -2)
            x = (back @ x[..., None])[..., 0]
            u = (back @ u[..., None])[..., 0]
            x[:, axis] -= motion[:, slide]

    enter(chain.base)
    cross(0, delta[:, 0])
    enter(chain.link[0])
    for i in range(1, n + 1):
        motion = delta[:, i].copy()
        motion[:, 0] += angle[:, i - 1]
        motion[:, 1] += shift[:, i - 1]
        cross(i, motion)
        enter(chain.link[i])
    x = x - tool
    cross(n + 1, delta[:, n + 1])
    return out


def by_joints(chain: Chain, wrench: np.ndarray) -> np.ndarray:
    """Components (..., n) of wrenches (..., n + 2, 6) along the joints: moments; forces where they slide."""
    return np.where(chain.slides, wrench[..., 1:-1, 1], wrench[..., 1:-1, 0])


def frames(chain: Chain, q: np.ndarray, delta: np.ndarray | None = None) -> np.ndarray:
    """Poses in F0 of frames 0 to n, each behind its joint's Rz and Tz, and of the flange.

    Parameters
    ----------
    chain : Chain
    q : np.ndarray, shape (C, n), rad
    delta : np.ndarray, shape (C, n + 2, 6), optional
        Displacements of the frames; the tilts and slides across a frame's axis move what stands behind it.

    Returns
    -------
    np.ndarray, shape (C, n + 2, 4, 4)
        The last is the flange.
    """
    count, n = q.shape
    out = np.empty((count, n + 2, 4, 4))
    motion = np.zeros((count, n, 6)) if delta is None else delta[:, 1:-1].copy()
    angle, shift = chain.moved(q)
    motion[..., 0] += angle
    motion[..., 1] += shift
    # all joints at once: the search for poses calls this for few rows, thousands of times
    joint = chain.link[:-1] @ _moved(motion.reshape(-1, 6), (0,)).reshape(count, n, 4, 4)
    out[:, 0] = behind = chain.base if delta is None else chain.base @ _moved(delta[:, 0], (0, 1, 2))
    for i in range(1, n + 1):
        out[:, i] = behind = behind @ joint[:, i - 1]
        if delta is not None and delta[:, i, 2:].any():
            behind = behind @ _moved(delta[:, i], (1, 2))
    out[:, n + 1] = behind @ chain.link[n]
    if delta is not None:
        out[:, n + 1] = out[:, n + 1] @ _moved(delta[:, n + 1], (0, 1, 2))
    return out


def _moved(delta: np.ndarray, parts: tuple[int, ...]) -> np.ndarray:
    """Transforms (C, 4, 4) of some parts of D of delta (C, 6): 0 is Rz Tz, 1 Rx Tx, 2 Ry Ty."""
    steps = []
    for part in parts:
        axis = (2, 0, 1)[part]
        step = np.zeros((len(delta), 4, 4))
        step[:, 3, 3] = 1.0
        step[:, :3, :3] = rotation(axis, delta[:, 2 * part])
        step[:, axis, 3] = delta[:, 2 * part + 1]
        steps.append(step)
    return reduce(np.matmul, steps)
