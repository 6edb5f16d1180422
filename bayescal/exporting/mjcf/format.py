"""MJCF as a format of an export.

A new MJCF file of a fitted arm.

The table of a replay script: the law of the readings, which the light model does not have.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.effects import Parameter
from bayescal.effects.tool import TOOL
from bayescal.exporting.geometry import carries
from bayescal.exporting.mjcf import replay
from bayescal.exporting.mjcf.content import STATE, UNHELD, Content, add, bare, document, law_of
from bayescal.exporting.mjcf.elastic import springless, sprung
from bayescal.exporting.mjcf.links import bands, bodies, defaults, loads, mechanism, names, tips, tool
from bayescal.exporting.mjcf.readings import Joints, Sections, parts, servos
from bayescal.exporting.written import Format, Item, Options, Written, item
from bayescal.fitted.arm import FittedArm

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


PROBE = {
    "lobing sin": "lobing_sin_m",
    "lobing cos": "lobing_cos_m",
    "latency": "latency_s",
}
"""Keys of a table by the names of parameters."""
SCRIPT, TABLE = "-replay.py", "-replay.json"


def beside(
    content: Content, joints: Joints, servos: bool, renamed: Mapping[str, Mapping[str, str]]
) -> dict[str, str]:
    """Further files of an export: the script and its table.

    Parameters
    ----------
    content : Content
    joints : Joints
        Of the file.
    servos : bool
        Whether its actuators command the readings, by the names of the joints.
    renamed : mapping
        Names in the file of added parts that are called otherwise there, by kind.
    """
    table = json.dumps(replay_table(content, joints, servos, renamed), indent=1, allow_nan=False) + "\n"
    return {SCRIPT: Path(replay.__file__).read_text(encoding="utf-8"), TABLE: table}


def replay_table(
    content: Content, joints: Joints, servos: bool, renamed: Mapping[str, Mapping[str, str]]
) -> dict[str, Any]:
    """The table of a script; arguments as of `beside`."""
    law, dataset = law_of(content), content.arm.dataset
    tool = dataset.tools[int(dataset.measurements.tool[content.row])].name
    probe = dict.fromkeys((*PROBE.values(), "ball_radius_m"), 0.0)
    for p, value in content.valued:
        if p.name in PROBE:
            probe[PROBE[p.name]] = value
        elif p.name == f"ball-radius {tool}":
            probe["ball_radius_m"] = value
    return {
        "joints": list(joints.names),
        "signs": joints.signs.tolist(),
        "servos": list(joints.names) if servos else [],
        "tip": renamed.get("site", {}).get(tool, tool),
        "payload_body": renamed.get("body", {}).get("payload", "payload"),
        "payload_factor": next(load.factor for load in loads(content) if load.name == tool),
        "nominal": law.nominal.tolist(),
        "exact": law.exact.tolist(),
        "offset_rad": law.offset.tolist(),
        "waves": [
            {"joint": w.joint, "order": w.order, "sine_rad": w.sine, "cosine_rad": w.cosine}
            for w in law.waves
        ],
        "lost_motion_rad": law.lost.tolist(),
        "geared": law.geared.tolist(),
        "probe": probe,
    }


PLACES = {
    "torque": ("joint {name}_flex, tendons {name}_flex_...", "stiffness"),
    "bending moment": ("joints {name}_tilt_... and {name}_bend_...", "stiffness"),
    "base moment": ("joints stand_...", "stiffness, pos"),
    "mass": ("bodies tool and payload", "mass, pos"),
    "direction": ("tendon {name}_gear", "springlength"),
    "angle": ("tendon {name}_gear", "coef"),
}
"""Element and attribute of a parameter, by the kind of its driver."""
WEIGHED = ("torque", "bending moment", "base moment", "mass")
"""Drivers that need the masses of the links."""


def write(arm: FittedArm, options: Options) -> Written:
    """The MJCF file of an arm."""
    script, whole, arm = options.readings == "script", arm, sprung(arm)
    if options.into:
        from bayescal.exporting.mjcf.scene_patch import patched

        own = patched(arm, options)
        text, details, notes, placed, bodies = own.text, own.details, own.notes, own.placed, own.bodies
        joints = Joints(tuple(details["joints"].values()), np.array(details["signs"]))
    else:
        text, details, notes, placed = mjcf(arm, options.state, script), {}, [], None
        bodies = names(arm.dataset.robot.n)
        joints = Joints.of(arm.dataset.robot.joint_names)
    renamed = details.get("renamed", {})
    more = beside(Content(arm, options.state), joints, not options.into, renamed) if script else {}
    for load in loads(Content(arm, options.state)):
        if load.factor != 1.0:
            told = f"a further mass acts {load.factor:.6g} times: set the body payload so (tool {load.name})"
            notes = [*notes, told]
    details = {**details, "readings": options.readings}
    items = tuple(_items(whole, joints.names, bodies))
    return Written(text, items, more, notes, details, placed)


def holds(arm: FittedArm, k: int) -> bool:
    """Whether an MJCF file can hold a parameter."""
    p = arm.model.parameters[k]
    if p.driver.kind in STATE:
        return all(term.frame >= 0 for term in p.terms)
    weighed = p.driver.kind not in WEIGHED or arm.model.scene.moments is not None
    return p.driver.kind in PLACES and p.driver.form not in UNHELD and weighed and not springless(arm)[k]


def _items(arm: FittedArm, joints: Sequence[str], bodies: Sequence[str]) -> Iterator[Item]:
    """Parameters in a file with these names of its joints, and of the bodies of base, links and flange."""
    for k, p in enumerate(arm.model.parameters):
        if holds(arm, k):
            yield item(arm, k, *_place(p, joints, bodies))


def _place(p: Parameter, joints: Sequence[str], bodies: Sequence[str]) -> tuple[str, str]:
    if p.effect == TOOL.name:
        return f"site {p.name.rpartition(' ')[0]}", "pos"
    if p.driver.kind in PLACES:
        element, attribute = PLACES[p.driver.kind]
        return element.format(name=joints[p.site.number - 1] if p.site.number else "..."), attribute
    term = p.terms[0]
    return f"body {bodies[0 if term.frame == 0 else carries(term) + 1]}", "pos, quat"


MJCF = Format(
    "mjcf",
    ".xml",
    "MuJoCo: geometry, springs of joints, bearings and stand, errors of the readings, lost motion",
    write,
    holds,
    "MuJoCo has no such element",
    readings=("plain", "script"),
    into=True,
)
"""The whole arm, for MuJoCo 4."""
