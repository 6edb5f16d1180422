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
from bayescal.effects import MODELS, Parameter
from bayescal.effects.tool import TOOL
from bayescal.exporting.geometry import constant, coupled, items
from bayescal.exporting.mjcf.elastic import Content, Hinge
from bayescal.exporting.mjcf.mechanism import DAMPING, GYRATION, WEIGHTLESS, Mechanism, mechanism
from bayescal.exporting.mjcf.readings import Law
from bayescal.exporting.written import Format, Item, Options, Written, item
from bayescal.exporting.xml_text import element, number, numbers
from bayescal.fitted.arm import FittedArm

VERSION = "1.8"
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


def _is_spring(p: Parameter) -> bool:
    return p.effect in MODELS and MODELS[p.effect].linear_spring


def _holds(arm: FittedArm, k: int) -> bool:
    """Whether SDF can hold a parameter: constants, linear springs with a positive compliance, the payload."""
    p = arm.model.parameters[k]
    if not _is_spring(p):
        return constant(p) or (p.driver.kind == "mass" and "added" not in p.name)
    springs = not p.positive or p.nominal + arm.values[k] > 0.0
    return springs and arm.model.scene.moments is not None


def _write(arm: FittedArm, options: Options) -> Written:
    robot, scene = arm.dataset.robot, arm.model.scene
    held = [_holds(arm, k) or p.effect == TOOL.name for k, p in enumerate(arm.model.parameters)]
    machine = mechanism_of(arm, options.state, held)
    load = machine.loads[int(scene.dataset.measurements.tool[options.state])]
    parts = [_link(MOUNT, "", np.eye(4)), _joint("fixed_to_world", "fixed", "world", MOUNT)]
    before = MOUNT
    for body in machine.bodies:
        chain = [f"{h.name}_rotor" for h in body.hinges[:-1]] + [body.name]
        pose = body.pose
        for link, hinge in zip(chain, body.hinges or (None,), strict=True):
            weight = (body.mass, body.centre) if link == body.name else ()
            parts.append(_link(link, before, pose, *weight))
            if hinge is None:
                parts.append(_joint(f"{body.name}_joint", "fixed", before, link))
            else:
                parts.append(_hinge(hinge, before, link, robot))
            before, pose = link, np.eye(4)
    parts.append(_link("flange", before, machine.flange, load.mass, load.centre))
    parts.append(_joint("flange_joint", "fixed", before, "flange"))
    root = element("sdf", element("model", *parts, name=options.name), version=VERSION)
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
        if _holds(arm, k) and _is_spring(p):
            named = f"{names[p.site.number - 1]}_..." if p.site.number else "..._flex"
            where = "stand_..." if p.driver.kind == "base moment" else named
            yield item(arm, k, f"joint[@name='{where}']/axis/dynamics", "spring_stiffness")
        elif _holds(arm, k) and p.driver.kind == "mass":
            yield item(arm, k, "link[@name='flange']/inertial", "mass")


def _link(
    name: str, before: str, pose: np.ndarray, mass: float = 0.0, centre: np.ndarray = ORIGIN
) -> ET.Element:
    """A link; one without a mass has inertia, but no weight."""
    heavy = mass if mass > 0 else WEIGHTLESS
    moments = dict.fromkeys(("ixx", "iyy", "izz"), number(heavy * GYRATION**2))
    products = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    inertia = element("inertia", *(element(key, value) for key, value in (moments | products).items()))
    relative = {"relative_to": before} if before else {}
    return element(
        "link",
        element("pose", numbers((*pose[:3, 3], *rpy_of(pose[:3, :3]))), **relative),
        None if mass > 0 else element("gravity", "false"),
        element(
            "inertial",
            element("pose", numbers((*centre, 0.0, 0.0, 0.0))),
            element("mass", number(heavy)),
            inertia,
        ),
        name=name,
    )


def _joint(name: str, kind: str, parent: str, child: str, *more: ET.Element) -> ET.Element:
    return element("joint", element("parent", parent), element("child", child), *more, name=name, type=kind)


def _hinge(hinge: Hinge, parent: str, child: str, robot: Robot) -> ET.Element:
    limit, dynamics = {"lower": -1.0, "upper": 1.0}, {"damping": "0"}
    if hinge.spring is None:
        j = robot.joint_names.index(hinge.name)
        limit["lower"], limit["upper"] = hinge.limits or (-np.pi, np.pi)
        for key, values in (("effort", robot.torques), ("velocity", robot.velocities)):
            if values is not None and not np.isnan(values[j]):  # without them SDF has no limit
                limit[key] = values[j]
    else:
        dynamics = {
            "damping": number(DAMPING * hinge.spring.slope),
            "spring_reference": number(hinge.rest),
            "spring_stiffness": number(hinge.spring.stiffness),
        }
    axis = element(
        "axis",
        element("xyz", numbers(hinge.axis)),
        element("limit", *(element(key, number(value)) for key, value in limit.items())),
        element("dynamics", *(element(key, value) for key, value in dynamics.items())),
    )
    pose = element("pose", numbers((*hinge.pos, 0.0, 0.0, 0.0)))
    return _joint(hinge.name, "revolute", parent, child, pose, axis)


SDF = Format(
    "sdf",
    ".sdf",
    "SDF model: geometry, springs of joints, bearings and stand",
    _write,
    _holds,
    "SDF has constant geometry and linear springs",
)
"""For Gazebo and Drake."""
