"""A calibrated arm as an SDF model: joints that a controller commands, and joints with springs behind them.

An elastic joint is two joints in SDF: one that is commanded, and one with `spring_stiffness` and
`spring_reference` on a link of its own without weight. Bearings, links and the stand have joints with springs
too. The mechanism is that of the MuJoCo model (`mjcf.mechanism`). A spring of SDF is linear.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rpy_of
from bayescal.effects.base_compliance import BASE_COMPLIANCE
from bayescal.effects.bending import BENDING
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.tool import TOOL
from bayescal.exporting.geometry import constant, coupled, items, number, numbers
from bayescal.exporting.mjcf.content import Content, Law
from bayescal.exporting.mjcf.links import DAMPING, GYRATION, WEIGHTLESS, Hinge, Mechanism, mechanism
from bayescal.exporting.written import Format, Item, Options, Written, item
from bayescal.fitted.arm import FittedArm

VERSION = "1.8"
ELASTIC = (COMPLIANCE.name, BENDING.name, BASE_COMPLIANCE.name)
"""Effects that are linear springs."""
EARTH = np.array([0.0, 0.0, -9.81])
"""Gravity, m/s2, of a world that states another one only in its digits."""
MOUNT = "mount"
ORIGIN = np.zeros(3)


def mechanism_of(arm: FittedArm, state: int, held: Sequence[bool]) -> Mechanism:
    """The mechanism of the parameters that are held, without errors of the readings."""
    robot = arm.dataset.robot
    law = Law(
        robot.link_from_reading, robot.link_from_reading, robot.offset, (), np.zeros(robot.n), np.eye(robot.n)
    )
    return mechanism(Content(replace(arm, values=np.where(held, arm.values, 0.0)), state), law)


def _holds(arm: FittedArm, k: int) -> bool:
    """Whether SDF can hold a parameter: constants, linear springs with a positive compliance, the payload."""
    p = arm.model.parameters[k]
    if p.effect not in ELASTIC:
        return constant(p) or (p.driver.kind == "mass" and "added" not in p.name)
    springs = not p.positive or p.nominal + arm.values[k] > 0.0
    return springs and arm.model.scene.moments is not None


def _write(arm: FittedArm, options: Options) -> Written:
    robot, scene = arm.dataset.robot, arm.model.scene
    held = [_holds(arm, k) or p.effect == TOOL.name for k, p in enumerate(arm.model.parameters)]
    found = mechanism_of(arm, options.state, held)
    load = found.loads[int(scene.dataset.measurements.tool[options.state])]
    root = ET.Element("sdf", version=VERSION)
    model = ET.SubElement(root, "model", name=options.name)
    _link(model, MOUNT, "", np.eye(4))
    _joint(model, "fixed_to_world", "fixed", "world", MOUNT)
    before = MOUNT
    for body in found.bodies:
        chain = [f"{h.name}_rotor" for h in body.hinges[:-1]] + [body.name]
        pose = body.pose
        for link, hinge in zip(chain, body.hinges or (None,), strict=True):
            weight = (body.mass, body.centre) if link == body.name else (0.0, np.zeros(3))
            _link(model, link, before, pose, *weight)
            if hinge is None:
                _joint(model, f"{body.name}_joint", "fixed", before, link)
            else:
                _hinge(model, hinge, before, link, robot)
            before, pose = link, np.eye(4)
    _link(model, "flange", before, found.flange, load.mass, load.centre)
    _joint(model, "flange_joint", "fixed", before, "flange")
    ET.indent(root)
    text = '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
    return Written(
        text,
        [*items(arm, _places(robot)), *_elastic(arm)],
        notes=[*_notes(arm), f"the link flange carries the tool {load.name}, {load.mass:g} kg"],
        details={"joint_from_reading": robot.link_from_reading.tolist()},
    )


def _notes(arm: FittedArm) -> Iterator[str]:
    yield from coupled(arm.dataset.robot.link_from_reading)
    if np.linalg.norm(arm.dataset.gravity - EARTH) > 0.02:
        yield f"gravity of the world must be {' '.join(map(str, arm.dataset.gravity.tolist()))} m/s2"


def _places(robot: Robot) -> list[tuple[str, str]]:
    return [(f"link[@name='link{k}']", "pose") for k in range(1, robot.n + 1)]


def _elastic(arm: FittedArm) -> Iterator[Item]:
    names = arm.dataset.robot.joint_names
    for k, p in enumerate(arm.model.parameters):
        if _holds(arm, k) and p.effect in ELASTIC:
            named = f"{names[p.site.number - 1]}_..." if p.site.number else "..._flex"
            where = "stand_..." if p.effect == BASE_COMPLIANCE.name else named
            yield item(arm, k, f"joint[@name='{where}']/axis/dynamics", "spring_stiffness")
        elif _holds(arm, k) and p.driver.kind == "mass":
            yield item(arm, k, "link[@name='flange']/inertial", "mass")


def _add(parent: ET.Element, tag: str, text: str = "", **attributes: str) -> ET.Element:
    out = ET.SubElement(parent, tag, attributes)
    out.text = text or None
    return out


def _link(
    model: ET.Element, name: str, before: str, pose: np.ndarray, mass: float = 0.0,
    centre: np.ndarray = ORIGIN,
) -> None:  # fmt: skip
    """A link; one without a mass has inertia, but no weight."""
    link = _add(model, "link", name=name)
    own = _add(link, "pose", numbers((*pose[:3, 3], *rpy_of(pose[:3, :3]))))
    if before:
        own.set("relative_to", before)
    if mass <= 0:
        _add(link, "gravity", "false")
    inertial = _add(link, "inertial")
    _add(inertial, "pose", numbers((*centre, 0.0, 0.0, 0.0)))
    heavy = mass if mass > 0 else WEIGHTLESS
    _add(inertial, "mass", number(heavy))
    inertia = _add(inertial, "inertia")
    for key in ("ixx", "iyy", "izz"):
        _add(inertia, key, number(heavy * GYRATION**2))
    for key in ("ixy", "ixz", "iyz"):
        _add(inertia, key, "0")


def _joint(model: ET.Element, name: str, kind: str, parent: str, child: str) -> ET.Element:
    joint = _add(model, "joint", name=name, type=kind)
    _add(joint, "parent", parent)
    _add(joint, "child", child)
    return joint


def _hinge(model: ET.Element, hinge: Hinge, parent: str, child: str, robot: Robot) -> None:
    joint = _joint(model, hinge.name, "revolute", parent, child)
    _add(joint, "pose", numbers((*hinge.pos, 0.0, 0.0, 0.0)))
    axis = _add(joint, "axis")
    _add(axis, "xyz", numbers(hinge.axis))
    limit, dynamics = _add(axis, "limit"), _add(axis, "dynamics")
    if hinge.spring is None:
        j = robot.joint_names.index(hinge.name)
        low, high = hinge.limits or (-np.pi, np.pi)
        _add(dynamics, "damping", "0")
    else:
        low, high = -1.0, 1.0
        _add(dynamics, "damping", number(DAMPING * hinge.spring.slope))
        _add(dynamics, "spring_reference", number(hinge.rest))
        _add(dynamics, "spring_stiffness", number(hinge.spring.stiffness))
    _add(limit, "lower", number(low))
    _add(limit, "upper", number(high))
    if hinge.spring is None:  # without them SDF has no limit
        for key, values in (("effort", robot.torques), ("velocity", robot.velocities)):
            if values is not None and not np.isnan(values[j]):
                _add(limit, key, number(values[j]))


SDF = Format(
    "sdf",
    ".sdf",
    "SDF model: geometry, springs of joints, bearings and stand",
    _write,
    _holds,
    "SDF has constant geometry and linear springs",
)
"""For Gazebo and Drake."""
