"""The fitted arm as a mechanism, bodies in series with their hinges, springs and masses, and its elements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.arm.chain import Ground, displaced
from bayescal.arm.transforms import rigid, rotation
from bayescal.dataset import Tool
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import centre_in_frame, transform_of
from bayescal.exporting.mjcf import elastic
from bayescal.exporting.mjcf.elastic import Content, Hinge, Spring
from bayescal.exporting.mjcf.readings import Joints, Law, erring, error, parts
from bayescal.exporting.written import IN_F0
from bayescal.exporting.xml_text import TEMPLATES

Z = np.array([0.0, 0.0, 1.0])
GYRATION = 0.08
"""Radius of gyration of a link, m (assumed: a calibration at standstill does not identify inertias)."""
WEIGHTLESS = 1.0
"""Mass, kg, of a body without a stated mass; gravity does not act on it."""
THIN = 0.02
"""m: no capsule shows a link that is shorter."""
MOST = 6
"""Largest number of hinges of a body in MuJoCo."""


@dataclass(frozen=True)
class Body:
    """A rigid body: pose (4, 4) in its parent at zero, its hinges in order, mass and its centre (3,).

    `end` (3,) is where the next body begins, None if that is nearby.
    """

    name: str
    pose: np.ndarray
    hinges: tuple[Hinge, ...] = ()
    mass: float = 0.0
    centre: np.ndarray = field(default_factory=lambda: np.zeros(3))
    end: np.ndarray | None = None

    @property
    def inertial_mass(self) -> float:
        """kg; one without a mass has inertia, but no weight."""
        return self.mass if self.mass > 0 else WEIGHTLESS

    @property
    def inertia(self) -> float:
        """Moment of inertia about any axis, kg m2."""
        return self.inertial_mass * GYRATION**2


@dataclass(frozen=True)
class Load:
    """A tool: its tip and centre of mass in the flange frame, (3,), m, and its mass, kg.

    A further mass acts at a point `hangs_at`, (3,), m, and counts `factor` times.
    """

    name: str
    tip: np.ndarray
    mass: float
    centre: np.ndarray
    hangs_at: np.ndarray
    factor: float = 1.0

    @property
    def inertia(self) -> float:
        """Moment of inertia about any axis, kg m2."""
        return self.mass * GYRATION**2


@dataclass(frozen=True)
class Mechanism:
    """Bodies in series from the base, the flange (4, 4) in the frame of the last one, and the tools.

    Of two arms, `passed` are the bodies from the base, which is the link that stands still, to the one in F0.
    """

    bodies: tuple[Body, ...]
    flange: np.ndarray
    loads: tuple[Load, ...]
    gravity: np.ndarray  # (3,) m/s2
    passed: tuple[Body, ...] = ()


def within(bodies: Sequence[Body], flange: np.ndarray | None = None) -> list[Body]:
    """Bodies in series; of one with too many hinges, one without a mass for the first of them, and itself."""
    out = []
    ends = [b.pose[:3, 3] for b in bodies[1:]] + [np.zeros(3) if flange is None else flange[:3, 3]]
    for body, end in zip(bodies, ends, strict=bool(bodies)):
        last = replace(body, end=end if np.linalg.norm(end) > THIN else None)
        if len(body.hinges) > MOST:
            out.append(replace(body, hinges=body.hinges[:-MOST], mass=0.0, centre=np.zeros(3)))
            name, hinges = f"{body.name}_yielding", body.hinges[-MOST:]
            last = replace(last, name=name, pose=np.eye(4), hinges=hinges)
        out.append(last)
    return out


def mechanism(content: Content, law: Law) -> Mechanism:
    """The mechanism of an arm.

    A link's frame is that of its row, behind Rz and Tz; what stands between it and the next joint, with its
    constant displacements, is part of the pose of the next body.

    Raises
    ------
    BayescalError
        If no spring holds a fitted elastic deflection.
    """
    scene = content.arm.model.scene
    robot, chain, delta = scene.dataset.robot, scene.chain, content.constants()
    springs, tilts = elastic.joint_springs(content), elastic.bearings(content)
    bends, wrong = elastic.link_hinges(content), erring(law)
    foot, *places, flange = poses(content, law)
    shift = chain.base[:3, 3] - foot[:3, 3]  # hinges of the stand are relative to the nominal base, in F0
    stand = (replace(h, pos=shift + h.pos) for h in elastic.stand_hinges(content))
    bodies = [Body("base", foot, tuple(h.seen(rigid(foot[:3, :3].T)) for h in stand))]
    for j, (name, frame) in enumerate(zip(robot.joint_names, places, strict=True)):
        low, high = sorted((np.sign(robot.link_from_reading[j, j]) * robot.limits[j]).tolist())
        slides = bool(robot.slides[j])
        limits = None if robot.unlimited[j] else (low, high)
        hinges = [Hinge(name, Z, 0.0 * Z, limits=limits, slides=slides)]
        if wrong[j]:
            hinges.append(Hinge(error(name), Z, 0.0 * Z, slides=slides))
        if j in springs:
            hinges.append(Hinge(f"{name}_flex", Z, 0.0 * Z, springs[j], slides=slides))
        hinges += _yielding(name, tilts.get(j), bends.get(j, ()), transform_of(delta[j + 1], (1,)))
        mass = 0.0 if robot.masses is None else float(robot.masses[j])
        bodies.append(Body(f"link{j + 1}", frame, tuple(hinges), mass, centre_in_frame(robot, delta, j)))
    made = Mechanism(tuple(bodies), flange, loads(content), scene.dataset.gravity)
    return made if robot.ground is None else _on_ground(made, robot.ground)


def _on_ground(machine: Mechanism, ground: Ground) -> Mechanism:
    """A mechanism in series from F0, as one from the link that stands still, with a branch to each side.

    The hinges of a joint on the way to F0 are passed from behind, in reversed order and about reversed axes,
    in the frame that they had: what they move is placed in it by the inverse of the body's pose. The last
    body is that in F0, with what it carries.
    """
    first, *links = machine.bodies
    stands, passed, back = ground.link, [], np.eye(4)
    to_f0 = first.pose @ links[0].pose
    for j in range(stands, 0, -1):
        body, inner = links[j - 1], links[j - 2] if j > 1 else Body("link0", np.eye(4))
        hinges = tuple(h.passed for h in reversed(body.hinges))
        into = np.linalg.inv(body.pose if j > 1 else to_f0)
        centre = into[:3, :3] @ inner.centre + into[:3, 3]
        passed.append(Body(inner.name, back, hinges, inner.mass, centre))
        back = into
    passed.append(Body(IN_F0, back, (), *ground.load))
    base = Body("base", np.linalg.inv(ground.place))
    return replace(machine, bodies=(base, *links[stands:]), passed=tuple(passed))


def _yielding(name: str, tilt: Spring | None, bends: tuple[Hinge, ...], behind: np.ndarray) -> list[Hinge]:
    """Hinges of the bearing of a joint and of its link, in the order in which a frame yields: z, x, y.

    Those about y are behind the constant displacement about x, `behind` (4, 4).
    """
    out = []
    for k in "zxy":
        frame = behind if k == "y" else np.eye(4)
        if tilt is not None and k != "z":
            out.append(Hinge(f"{name}_tilt_{k}", frame[:3, "xyz".index(k)], frame[:3, 3], tilt))
        out += [b.seen(frame, f"{name}_bend_{k}") for b in bends if b.name == k]
    return out


def loads(content: Content) -> tuple[Load, ...]:
    """The tools with their fitted offsets and the fitted payload."""
    return tuple(_load(content, k, tool) for k, tool in enumerate(content.arm.dataset.tools))


def names(n: int, ground: Ground | None = None) -> tuple[str, ...]:
    """Names of the bodies of an arm with n joints that have the `poses` of base, links and flange."""
    links = [f"link{j}" for j in range(n + 1)]
    if ground is None:
        return ("base", *links[1:], "flange")
    return (IN_F0, IN_F0, *links[: ground.link - 1], *links[ground.link + 1 :], "flange")


def places(content: Content, law: Law) -> dict[str, np.ndarray]:
    """Poses (4, 4) of the bodies of a file in their parents, by name."""
    machine = mechanism(content, law)
    return {b.name: b.pose for b in (*machine.bodies, *machine.passed)} | {"flange": machine.flange}


def poses(content: Content, law: Law) -> list[np.ndarray]:
    """Poses (4, 4) of base, links and flange, each in the frame of the one before, at readings of zero."""
    scene = content.arm.model.scene
    chain, delta = scene.chain, content.constants()
    at_zero = law.turned(np.zeros((1, chain.n)))[0]  # shifts of prismatic joints, whose angle is the offset
    angle = scene.dataset.robot.offset + np.where(chain.slides, 0.0, at_zero)
    shift = chain.d + np.where(chain.slides, at_zero, 0.0)
    out, before = [chain.base @ transform_of(delta[0])], chain.link[0]
    for j in range(1, chain.n + 1):
        turn, along = angle[j - 1] + delta[j, 0], shift[j - 1] + delta[j, 1]
        out.append(before @ rigid(rotation(2, turn), along * Z))
        before = transform_of(delta[j], (1, 2)) @ chain.link[j]
    return [*out, before]


def _load(content: Content, number: int, tool: Tool) -> Load:
    """A tool with its fitted offset and the fitted payload."""
    rows = np.flatnonzero(content.arm.model.scene.dataset.measurements.tool == number)
    row = content.row if content.row in rows or not len(rows) else int(rows[-1])
    shift = content.constants(row)[-1]
    fitted = {p.name.rpartition(":")[2].removeprefix("payload "): v for p, v in content.driven("mass")}
    mass = tool.mass + fitted.get("mass", 0.0)
    centre = displaced(tool.centre if tool.centre_of_mass is None else tool.centre_of_mass, shift)
    parts = ("moment", "added centre")
    moment, moved = (np.array([fitted.get(f"{part} {axis}", 0.0) for axis in "xyz"]) for part in parts)
    if np.any(moment) and mass <= 0:
        what = "the payload has a first moment, but no mass"
        raise BayescalError(what, "export", "leave the effect out with --without")
    tip = tool.centre + displaced(np.zeros(3), shift)
    balanced = centre + moment / mass if np.any(moment) else centre
    factor = 1.0 + fitted.get("added share", 0.0)
    # the shift is of the stated mass
    return Load(tool.name, tip, mass, balanced, centre + moved / factor, factor)


PARTS: Any = TEMPLATES.get_template("parts.mjcf.j2").module
"""Macros of the elements that are added to a file."""


def elements(text: str) -> list[ET.Element]:
    """Elements of an XML text."""
    return list(ET.fromstring(f"<parts>{text}</parts>"))


def merge(root: ET.Element, text: str) -> None:
    """Append the parts of the sections of a file to those of another one."""
    for part in ET.fromstring(text):
        old = root.find(part.tag)
        if len(part):
            (ET.SubElement(root, part.tag) if old is None else old).extend(part)


def merge_held(
    root: ET.Element, content: Content, mechanism: Mechanism, law: Law, joints: Joints,
    names: Mapping[str, str] | None = None,
) -> None:  # fmt: skip
    """Append what holds the hinges: dead bands of springs, and the parts of errors of the readings.

    `names` are those of the hinges in the file, if they differ.
    """
    hinges = [h for b in (*mechanism.bodies, *mechanism.passed) for h in b.hinges if h.spring is not None]
    springs = {h.name if names is None else names[h.name]: h.spring for h in hinges}
    loads, slides = content.arm.model.scene.loads, content.arm.dataset.robot.slides
    torques = np.zeros(1) if loads is None else np.abs(loads.torques(slides))
    merge(root, PARTS.held(springs=springs, **parts(law, joints, torques)))
