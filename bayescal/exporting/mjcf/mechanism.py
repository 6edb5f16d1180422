"""The fitted arm as a mechanism: bodies in series with their hinges, springs and masses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bayescal.arm.chain import Chain, displaced
from bayescal.arm.transforms import rigid, rotation
from bayescal.dataset import Tool
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import centre_in_frame
from bayescal.exporting.mjcf.content import Content
from bayescal.exporting.mjcf.elastic import (
    LinkHinge,
    StandHinge,
    bearings,
    joint_springs,
    link_hinges,
    stand_hinges,
)
from bayescal.exporting.mjcf.law import Law
from bayescal.exporting.mjcf.readings import erring, error
from bayescal.exporting.mjcf.spring import Spring

X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class Hinge:
    """A hinge of a body: unit axis and a point of it (3,), m, in the body's frame at zero.

    Without a spring it is a joint that the readings command, with limits, rad. A spring has its zero at
    `rest`, rad.
    """

    name: str
    axis: np.ndarray
    pos: np.ndarray
    spring: Spring | None = None
    rest: float = 0.0
    limits: tuple[float, float] | None = None


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

    A further mass acts `at` a point, (3,), m, and counts `factor` times.
    """

    name: str
    tip: np.ndarray
    mass: float
    centre: np.ndarray
    at: np.ndarray
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
    bodies = [Body("base", foot, _stand(stand_hinges(content), foot, chain))]
    for j, (name, frame) in enumerate(zip(robot.joint_names, places, strict=True)):
        low, high = sorted((np.sign(robot.link_from_reading[j, j]) * robot.limits[j]).tolist())
        hinges = [Hinge(name, Z, 0.0 * Z, limits=(low, high))]
        if wrong[j]:
            hinges.append(Hinge(error(name), Z, 0.0 * Z))
        if j in springs:
            hinges.append(Hinge(f"{name}_flex", Z, 0.0 * Z, springs[j]))
        hinges += _yielding(name, tilts.get(j), bends.get(j, ()), _moved(delta[j + 1], (1,)))
        mass = 0.0 if robot.masses is None else float(robot.masses[j])
        centre = np.zeros(3) if robot.centres_of_mass is None else centre_in_frame(robot, chain, delta, j)
        bodies.append(Body(f"link{j + 1}", frame, tuple(hinges), mass, centre))
    return Mechanism(tuple(bodies), flange, loads(content), scene.dataset.gravity)


def _yielding(
    name: str, tilt: Spring | None, bends: tuple[LinkHinge, ...], behind: np.ndarray
) -> list[Hinge]:
    """Hinges of the bearing of a joint and of its link, in the order in which a frame yields: z, x, y.

    Those about y are behind the constant displacement about x, `behind` (4, 4).
    """
    out = []
    for k in "zxy":
        at = behind if k == "y" else np.eye(4)
        if tilt is not None and k != "z":
            out.append(Hinge(f"{name}_tilt_{k}", at[:3, "xyz".index(k)], at[:3, 3], tilt))
        for b in (b for b in bends if b.name == k):
            axis, pos = at[:3, :3] @ b.axis, at[:3, :3] @ b.pos + at[:3, 3]
            out.append(Hinge(f"{name}_bend_{k}", axis, pos, b.spring))
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
    own = np.where(np.isin(np.arange(6) // 2, parts), delta, 0.0)
    corners = displaced(np.vstack([np.zeros(3), np.eye(3)]), own)
    return rigid((corners[1:] - corners[0]).T, corners[0])


def _stand(hinges: tuple[StandHinge, ...], foot: np.ndarray, chain: Chain) -> tuple[Hinge, ...]:
    """Hinges of the stand in the frame of the displaced base; given relative to the nominal one, in F0."""
    turn = foot[:3, :3].T
    at = chain.base[:3, 3] - foot[:3, 3]
    return tuple(Hinge(h.name, turn @ h.axis, turn @ (at + h.pos), h.spring, h.rest) for h in hinges)


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
    own = centre + moment / mass if np.any(moment) else centre
    factor = 1.0 + fitted.get("added share", 0.0)
    return Load(tool.name, tip, mass, own, centre + moved / factor, factor)  # the shift is of the stated mass
