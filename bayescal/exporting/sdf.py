"""A calibrated arm as an SDF model: joints that a controller commands, and joints with springs behind them.

An elastic joint is two joints in SDF: one that is commanded, and one with `spring_stiffness` and
`spring_reference` on a link of its own without weight. Bearings, links and the stand have joints with springs
too. The mechanism is that of the MuJoCo model (`mjcf.mechanism`). A spring of SDF is linear.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.effects import ALWAYS, MODELS, Parameter
from bayescal.exporting.geometry import constant, coupled, items
from bayescal.exporting.mjcf.elastic import Content, Hinge
from bayescal.exporting.mjcf.mechanism import Body, mechanism
from bayescal.exporting.mjcf.readings import bare, law_of
from bayescal.exporting.written import Format, Item, Options, Written, item
from bayescal.exporting.xml_text import indented, rendered
from bayescal.fitted.arm import FittedArm

EARTH = np.array([0.0, 0.0, -9.81])
"""Gravity, m/s2, of a world that states another one only in its digits."""


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
    held = [_holds(arm, k) or p.effect in ALWAYS for k, p in enumerate(arm.model.parameters)]
    content = Content(replace(arm, values=np.where(held, arm.values, 0.0)), options.state)
    machine = mechanism(content, bare(law_of(content)))
    load = machine.loads[int(scene.dataset.measurements.tool[options.state])]
    text = rendered(
        "arm.sdf.j2", name=options.name, machine=machine, limits=partial(_limits, robot),
        mount=Body("mount", np.eye(4)),
        flange=Body("flange", machine.flange, mass=load.mass, centre=load.centre),
    )  # fmt: skip
    notes = coupled(robot.link_from_reading)
    if np.linalg.norm(arm.dataset.gravity - EARTH) > 0.02:
        gravity = " ".join(map(str, arm.dataset.gravity.tolist()))
        notes.append(f"gravity of the world must be {gravity} m/s2")
    notes.append(f"the link flange carries the tool {load.name}, {load.mass:g} kg")
    places = [(f"link[@name='link{k}']", "pose") for k in range(1, robot.n + 1)]
    return Written(
        '<?xml version="1.0"?>\n' + indented(text),
        [*items(arm, places), *_elastic(arm)],
        notes=notes,
        details={"joint_from_reading": robot.link_from_reading.tolist()},
    )


def _elastic(arm: FittedArm) -> Iterator[Item]:
    names = arm.dataset.robot.joint_names
    for k, p in enumerate(arm.model.parameters):
        if _holds(arm, k) and _is_spring(p):
            named = f"{names[p.site.number - 1]}_..." if p.site.number else "..._flex"
            where = "stand_..." if p.driver.kind == "base moment" else named
            yield item(arm, k, f"joint[@name='{where}']/axis/dynamics", "spring_stiffness")
        elif _holds(arm, k) and p.driver.kind == "mass":
            yield item(arm, k, "link[@name='flange']/inertial", "mass")


def _limits(robot: Robot, hinge: Hinge) -> dict[str, float]:
    """Limits of a joint; of one without a stated effort or velocity SDF has none."""
    if hinge.spring is not None:
        return {"lower": -1.0, "upper": 1.0}
    j = robot.joint_names.index(hinge.name)
    most = {"effort": robot.torques, "velocity": robot.velocities}
    stated = {key: float(x[j]) for key, x in most.items() if x is not None and not np.isnan(x[j])}
    return dict(zip(("lower", "upper"), hinge.limits or (), strict=False)) | stated


SDF = Format(".sdf", _write, _holds, "SDF has constant geometry and linear springs", prismatic=True)
"""Geometry, springs of joints, bearings and stand, for Gazebo and Drake."""
