"""The fitted arm as a mechanism, and its elements in an MJCF file.

A mechanism is bodies in series with their hinges, springs and masses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import displaced
from bayescal.arm.transforms import rigid, rotation
from bayescal.dataset import Tool
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import centre_in_frame
from bayescal.exporting.mjcf.elastic import (
    Content,
    Hinge,
    Spring,
    bearings,
    joint_springs,
    link_hinges,
    stand_hinges,
)
from bayescal.exporting.mjcf.readings import DEFAULT, Joints, Law, erring, error, parts, section
from bayescal.exporting.xml_text import add, number, numbers

X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class Body:
    """A rigid body: pose (4, 4) in its parent at zero, its hinges in order, mass and its centre (3,)."""

    name: str
    pose: np.ndarray
    hinges: tuple[Hinge, ...] = ()
    mass: float = 0.0
    centre: np.ndarray = field(default_factory=lambda: np.zeros(3))


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


@dataclass(frozen=True)
class Mechanism:
    """Bodies in series from the base, the flange (4, 4) in the frame of the last one, and the tools."""

    bodies: tuple[Body, ...]
    flange: np.ndarray
    loads: tuple[Load, ...]
    gravity: np.ndarray  # (3,) m/s2


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
    springs, tilts, bends, wrong = (
        joint_springs(content),
        bearings(content),
        link_hinges(content),
        erring(law),
    )
    foot, *places, flange = poses(content, law)
    shift = chain.base[:3, 3] - foot[:3, 3]  # hinges of the stand are relative to the nominal base, in F0
    stand = (replace(h, pos=shift + h.pos) for h in stand_hinges(content))
    bodies = [Body("base", foot, tuple(h.seen(rigid(foot[:3, :3].T)) for h in stand))]
    for j, (name, frame) in enumerate(zip(robot.joint_names, places, strict=True)):
        low, high = sorted((np.sign(robot.link_from_reading[j, j]) * robot.limits[j]).tolist())
        hinges = [Hinge(name, Z, 0.0 * Z, limits=(low, high))]
        if wrong[j]:
            hinges.append(Hinge(error(name), Z, 0.0 * Z))
        if j in springs:
            hinges.append(Hinge(f"{name}_flex", Z, 0.0 * Z, springs[j]))
        hinges += _yielding(name, tilts.get(j), bends.get(j, ()), _moved(delta[j + 1], (1,)))
        mass = 0.0 if robot.masses is None else float(robot.masses[j])
        bodies.append(Body(f"link{j + 1}", frame, tuple(hinges), mass, centre_in_frame(robot, delta, j)))
    return Mechanism(tuple(bodies), flange, loads(content), scene.dataset.gravity)


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


def names(n: int) -> tuple[str, ...]:
    """Names of the bodies of an arm with n joints, with the flange."""
    return ("base", *(f"link{j}" for j in range(1, n + 1)), "flange")


def poses(content: Content, law: Law) -> list[np.ndarray]:
    """Poses (4, 4) of base, links and flange, each in the frame of the one before, at readings of zero."""
    scene = content.arm.model.scene
    chain, delta = scene.chain, content.constants()
    at_zero = scene.dataset.robot.offset + law.turned(np.zeros((1, chain.n)))[0]
    out, before = [chain.base @ _moved(delta[0])], chain.link[0]
    for j in range(1, chain.n + 1):
        turn, along = at_zero[j - 1] + delta[j, 0], chain.d[j - 1] + delta[j, 1]
        out.append(before @ rigid(rotation(2, turn), along * Z))
        before = _moved(delta[j], (1, 2)) @ chain.link[j]
    return [*out, before]


def _moved(delta: np.ndarray, parts: tuple[int, ...] = (0, 1, 2)) -> np.ndarray:
    """Transform (4, 4) of some parts of a displacement (6,): 0 is Rz Tz, 1 Rx Tx, 2 Ry Ty."""
    selected = np.where(np.isin(np.arange(6) // 2, parts), delta, 0.0)
    corners = displaced(np.vstack([np.zeros(3), np.eye(3)]), selected)
    return rigid((corners[1:] - corners[0]).T, corners[0])


def _load(content: Content, number: int, tool: Tool) -> Load:
    """A tool with its fitted offset and the fitted payload."""
    m = content.arm.model.scene.dataset.measurements
    rows = np.flatnonzero(m.tool == number)
    row = content.row if content.row in rows or not len(rows) else int(rows[-1])
    shift = content.constants(row)[-1]
    fitted = {p.name.rpartition(":")[2].removeprefix("payload "): v for p, v in content.driven("mass")}
    mass = tool.mass + fitted.get("mass", 0.0)
    centre = displaced(tool.centre if tool.centre_of_mass is None else tool.centre_of_mass, shift)
    moment, moved = (
        np.array([fitted.get(f"{what} {axis}", 0.0) for axis in "xyz"]) for what in ("moment", "added centre")
    )
    if np.any(moment) and mass <= 0:
        what = "the payload has a first moment, but no mass"
        raise BayescalError(what, "export", "leave the effect out with --without")
    tip = tool.centre + displaced(np.zeros(3), shift)
    balanced = centre + moment / mass if np.any(moment) else centre
    factor = 1.0 + fitted.get("added share", 0.0)
    # the shift is of the stated mass
    return Load(tool.name, tip, mass, balanced, centre + moved / factor, factor)


DAMPING = 0.02
"""Damping of a spring, s times its stiffness."""
GYRATION = 0.08
"""Radius of gyration of a link, m (assumed: a calibration at standstill does not identify inertias)."""
WEIGHTLESS = 1.0
"""Mass, kg, of a body without a stated mass; gravity does not act on it."""
NEUTRAL = {
    "joint": {
        "frictionloss": "0", "springref": "0", "ref": "0", "stiffness": "0", "damping": "0", "springyield":
        "0", "actuatorfrclimited": "false", "margin": "0", "group": "3",
    },
    "tendon": {
        "frictionloss": "0", "stiffness": "0", "damping": "0", "springlength": "-1", "springyield": "0",
        "armature": "0", "margin": "0",
    },
    "equality": {"active": "true", "solref": "0.02 1", "solimp": "0.9 0.95 0.001 0.5 2"},
}  # fmt: skip
"""Attributes of added elements that have no effect."""
MOST = 6
"""Largest number of hinges of a body in MuJoCo."""
TIP = {"type": "sphere", "size": "0.004", "rgba": ".9 .2 .1 1", "group": "0"}
"""Attributes of a site at the tip of a tool."""
THIN = 0.02
"""Radius of the capsules that show the links, m."""
SHOWN = {
    "contype": "0", "conaffinity": "0", "group": "2", "type": "capsule", "size": number(THIN), "rgba":
    ".7 .7 .75 1",
}  # fmt: skip
"""Attributes of these capsules."""


def place(pose: np.ndarray) -> dict[str, str]:
    """Attributes `pos` and `quat` of a pose (4, 4)."""
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return {"pos": numbers(pose[:3, 3]), "quat": numbers((w, x, y, z))}


def defaults(root: ET.Element, shown: bool = True) -> None:
    """The default class of all added elements: it resets what the defaults of a file may set."""
    top = root.find("default")
    of_class = add(add(root, "default") if top is None else top, "default", **{"class": DEFAULT})
    add(of_class, "joint", type="hinge", limited="false", range="0 0", armature=1e-3, **NEUTRAL["joint"])
    add(of_class, "tendon", limited="false", range="0 0", **NEUTRAL["tendon"])
    add(of_class, "equality", **NEUTRAL["equality"])
    if shown:
        add(of_class, "geom", **SHOWN)


def bodies(parent: ET.Element, mechanism: Mechanism) -> list[ET.Element]:
    """Append the bodies in series; returns their elements, the last that of the flange."""
    out = []
    ends = [b.pose[:3, 3] for b in mechanism.bodies[1:]] + [mechanism.flange[:3, 3]]
    for body, end in zip(mechanism.bodies, ends, strict=True):
        for part in _parts(body):
            parent = add(parent, "body", name=part.name, childclass=DEFAULT, **place(part.pose))
            inertial(parent, part)
            for h in part.hinges:
                hinge(parent, h)
        if np.linalg.norm(end) > THIN:
            add(parent, "geom", fromto=[0.0, 0.0, 0.0, *end])
        out.append(parent)
    out.append(add(parent, "body", name="flange", childclass=DEFAULT, **place(mechanism.flange)))
    return out


def _parts(body: Body) -> list[Body]:
    """The body; of one with too many hinges, a body without a mass for its first ones and itself."""
    if len(body.hinges) <= MOST:
        return [body]
    first = replace(body, hinges=body.hinges[:-MOST], mass=0.0, centre=np.zeros(3))
    return [first, replace(body, name=f"{body.name}_yielding", pose=np.eye(4), hinges=body.hinges[-MOST:])]


def inertial(element: ET.Element, body: Body) -> None:
    """Append the mass of a body; one without a mass has inertia, but no weight."""
    if body.mass <= 0:
        element.set("gravcomp", "1")
    mass = body.mass if body.mass > 0 else WEIGHTLESS
    add(element, "inertial", pos=body.centre, mass=mass, diaginertia=[mass * GYRATION**2] * 3)


def hinge(element: ET.Element, h: Hinge) -> None:
    """Append a hinge with its spring."""
    joint = add(element, "joint", **{"class": DEFAULT}, name=h.name, axis=h.axis, pos=h.pos)
    if h.limits is not None:
        joint.attrib.update(limited="true", range=numbers(h.limits))
    if h.spring is not None:
        joint.set("stiffness", number(h.spring.stiffness))
        joint.set("damping", number(DAMPING * h.spring.slope))
        if h.rest:
            joint.set("springref", number(h.rest))


def held(
    root: ET.Element, content: Content, mechanism: Mechanism, law: Law, joints: Joints,
    names: Mapping[str, str] | None = None,
) -> None:  # fmt: skip
    """Append what holds the hinges: dead bands of springs, and the parts of errors of the readings.

    `names` are those of the hinges in the file, if they differ.
    """
    tendons = section(root, "tendon")
    section(root, "equality")
    for h in (h for b in mechanism.bodies for h in b.hinges if h.spring is not None):
        assert h.spring is not None
        name = h.name if names is None else names[h.name]
        for k, b in enumerate(h.spring.bands, start=1):
            fixed = add(
                tendons, "fixed", **{"class": DEFAULT}, name=f"{name}_{k}",
                springlength=[b.lower, b.upper], stiffness=b.stiffness,
            )  # fmt: skip
            add(fixed, "joint", joint=name, coef=1.0)
    moments = content.arm.model.scene.moments
    parts(root, law, joints, np.zeros(1) if moments is None else np.abs(moments[:, 1:, 2]))


def without_empty(root: ET.Element) -> None:
    """Take sections of the parts that hold nothing out of a file."""
    for part in (section(root, "tendon"), section(root, "equality")):
        if not len(part):
            root.remove(part)


def tool(flange: ET.Element, load: Load) -> None:
    """Append a tool: its mass, a further mass that a user may set, and its tip."""
    body = add(flange, "body", name="tool", childclass=DEFAULT)
    if load.mass > 0:
        add(body, "inertial", pos=load.centre, mass=load.mass, diaginertia=[load.mass * GYRATION**2] * 3)
    added = add(body, "body", name="payload", **place(rigid(None, load.hangs_at)))
    add(added, "inertial", pos=np.zeros(3), mass=1e-9, diaginertia=[1e-9] * 3)


def tips(flange: ET.Element, loads: tuple[Load, ...]) -> None:
    """Append the tips of all tools as sites."""
    for load in loads:
        add(flange, "site", name=load.name, pos=load.tip, **TIP)
