"""A new MJCF file of a fitted arm."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from bayescal.exporting.fitted import FittedArm
from bayescal.exporting.mjcf.content import Content
from bayescal.exporting.mjcf.law import bare, law_of
from bayescal.exporting.mjcf.links import bands, bodies, defaults, tips, tool
from bayescal.exporting.mjcf.mechanism import mechanism
from bayescal.exporting.mjcf.readings import Joints, Sections, parts, servos
from bayescal.exporting.mjcf.text import add, document

TIMESTEP = 0.002


def mjcf(arm: FittedArm, row: int, script: bool = False) -> str:
    """The text of an MJCF file.

    Parameters
    ----------
    arm : FittedArm
    row : int
        Row of the session whose state the file has.
    script : bool
        Whether a script corrects the commands: then the file has no errors of the readings.

    Raises
    ------
    BayescalError
        If no spring holds a fitted deflection, or a fitted lost motion leads without a script.
    """
    content = Content(arm, row)
    law = law_of(content)
    if script:
        law = bare(law)
    arm_ = mechanism(content, law)
    scene = arm.model.scene
    root = ET.Element("mujoco", model=scene.dataset.robot.name)
    add(root, "compiler", angle="radian", autolimits="true")
    add(root, "option", integrator="discrete", timestep=TIMESTEP, gravity=arm_.gravity)
    defaults(root)
    world = add(root, "worldbody")
    *_, flange = bodies(world, arm_)
    tool(flange, arm_.loads[int(scene.dataset.measurements.tool[row])])
    tips(flange, arm_.loads)
    tendon, equality, actuator, sensor = (
        add(root, tag) for tag in ("tendon", "equality", "actuator", "sensor")
    )
    bands(tendon, arm_)
    torques = np.zeros(1) if scene.moments is None else np.abs(scene.moments[:, 1:, 2])
    joints = scene.dataset.robot.joint_names
    parts(Sections(world, tendon, equality), law, Joints.of(joints), torques)
    servos(actuator, sensor, tendon, law, joints)
    for part in (tendon, equality):
        if not len(part):
            root.remove(part)
    return document(root)
