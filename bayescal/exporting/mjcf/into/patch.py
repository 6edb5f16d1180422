"""A user's MJCF file with the fitted arm in it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.arm.transforms import rigid
from bayescal.errors import BayescalError
from bayescal.exporting.digits import number, numbers
from bayescal.exporting.fitted import FittedArm
from bayescal.exporting.mjcf.content import Content
from bayescal.exporting.mjcf.into.found_arm import FoundArm, find_arm
from bayescal.exporting.mjcf.into.keyframes import with_keyframes
from bayescal.exporting.mjcf.into.scene_file import compiled, read_scene
from bayescal.exporting.mjcf.law import bare, law_of
from bayescal.exporting.mjcf.links import MOST, bands, defaults, hinge, tips, tool
from bayescal.exporting.mjcf.mechanism import Body, Hinge, Mechanism, mechanism
from bayescal.exporting.mjcf.readings import Joints, Sections, parts
from bayescal.exporting.mjcf.text import DEFAULT, add, place
from bayescal.exporting.same_arm import ANGLE, Match, match, smallest_turn
from bayescal.exporting.written import Options, path_of

LIGHT = 1e-3
"""Mass, kg, of a body that only carries hinges; gravity does not act on it."""
TURNED = ("axisangle", "xyaxes", "zaxis", "euler")
"""Other attributes for an orientation; a quaternion takes their place."""


def patched(arm: FittedArm, options: Options) -> tuple[str, dict[str, Any], list[str]]:
    """The user's file with the fitted arm: its text, details for the sidecar, and notes.

    The bodies of the arm get calibrated poses, masses and centres of mass; hinges with springs and errors are
    added behind their joints. Actuators are not changed.

    Raises
    ------
    BayescalError
        If the file cannot be patched, or is of another arm.
    """
    path, tip = path_of(options.into)
    scene, robot = read_scene(path), arm.dataset.robot
    check_compiler(scene.root, path.name)
    before = compiled(scene.root, path.parent, path.name)
    found = find_arm(scene, before, robot, tip)
    where = _upright(match(robot, found.file, path.name), before.opt.gravity, arm.dataset.gravity)
    content = Content(arm, options.state)
    law = bare(law_of(content)) if options.readings == "script" else law_of(content)
    machine = mechanism(content, law)
    names = dict(zip(robot.joint_names, found.file.names, strict=True))
    root = scene.root
    _poses(found, where, machine)
    _links(found, where, machine, names, before)
    _stand(root, found, where, machine)
    flange = _flange(found, where, machine)
    loads = machine.loads
    tool(flange, loads[int(arm.dataset.measurements.tool[options.state])])
    tips(flange, loads)
    defaults(root, shown=False)
    world = root.find("worldbody")
    assert world is not None
    to = Sections(world, _section(root, "tendon"), _section(root, "equality"))
    renamed = {h.name: _named(h.name, names) for b in machine.bodies for h in b.hinges}
    bands(to.tendon, machine, renamed)
    torques = np.zeros(1) if arm.model.scene.moments is None else np.abs(arm.model.scene.moments[:, 1:, 2])
    joints = Joints(tuple(names.values()), where.signs)
    parts(to, law, joints, torques)
    for section in (to.tendon, to.equality):
        if not len(section):
            root.remove(section)
    notes = _integrator(root)
    with_keyframes(root, before, path, law, joints)
    ET.indent(root)
    compiled(root, path.parent, path.name)
    details = {
        "into": path.name,
        "tip": before.body(found.ids[-1]).name,
        "joints": names,
        "joint_from_reading": (where.signs[:, None] * robot.link_from_reading).tolist(),
        "signs": where.signs.tolist(),
        "root_in_f0": where.root.tolist(),
    }
    return scene.text, details, [*notes, *_carried(before, found)]


def _upright(where: Match, theirs: np.ndarray, ours: np.ndarray) -> Match:
    """The match with gravity exactly as in the session, where the file has it so within rounding."""
    down = where.root[:3, :3] @ theirs
    size = np.linalg.norm(down) * np.linalg.norm(ours)
    if not size > 0 or np.linalg.norm(np.cross(down, ours)) > ANGLE * size or down @ ours < 0:
        return where
    turn = rigid(smallest_turn(down / np.linalg.norm(down), ours / np.linalg.norm(ours)))
    return replace(where, root=turn @ where.root)


def _poses(found: FoundArm, where: Match, machine: Mechanism) -> None:
    """Calibrated poses of the bodies, as the file writes them: at the references of their joints."""
    links: list[np.ndarray] = []
    pose = np.linalg.inv(where.root)
    for body in machine.bodies:
        pose = pose @ body.pose
        if body.hinges and body.name.startswith("link") and body.hinges[0].spring is None:
            links.append(pose)  # of the body that the joint turns
    before = np.eye(4)
    for k, element in enumerate(found.bodies):
        anchor = rigid(None, found.anchors[k])
        here = links[k] @ where.own[k] @ np.linalg.inv(anchor)
        turn = _about(found.file.axes[k], found.references[k])
        local = np.linalg.inv(before @ found.steps[k]) @ here @ anchor @ turn @ np.linalg.inv(anchor)
        _place(element, local)
        before = here


def _about(axis: np.ndarray, angle: float) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return rigid(Rotation.from_rotvec(angle * axis).as_matrix())


def _place(element: ET.Element, pose: np.ndarray) -> None:
    for name in TURNED:
        element.attrib.pop(name, None)
    for name, value in place(pose).items():
        element.set(name, value)


def _links(found: FoundArm, where: Match, machine: Mechanism, names: dict[str, str], model: Any) -> None:
    """Masses, and hinges behind the joints."""
    for k, element in enumerate(found.bodies):
        own = [b for b in machine.bodies if b.name.partition("_")[0] == f"link{k + 1}"]
        to_file = np.linalg.inv(where.own[k] @ np.linalg.inv(rigid(None, found.anchors[k])))
        _inertial(element, own[-1], to_file, model, found.ids[k])
        made = ET.Element("holder")
        for h in [h for body in own for h in body.hinges][1:]:
            moved = to_file[:3, :3] @ h.axis
            centre = to_file[:3, :3] @ h.pos + to_file[:3, 3]
            hinge(made, Hinge(_named(h.name, names), moved, centre, h.spring, h.rest))
        _insert(found, k, list(made))


def _insert(found: FoundArm, k: int, hinges: list[ET.Element]) -> None:
    """Hinges behind a joint; if they are too many for a body, the joint and the first ones are in another.

    The user's body keeps its name and its parts; the further body stands before it.
    """
    element, joint = found.bodies[k], found.joints[k]
    at = list(element).index(joint) + 1
    more = max(0, 1 + len(hinges) - MOST)
    for h in reversed(hinges[more:]):
        element.insert(at, h)
    if not more:
        return
    carrier = ET.Element("body", name=f"{element.get('name')}_carrier", gravcomp="1")
    for name in ("pos", "quat"):
        carrier.set(name, element.attrib.pop(name))
    if "childclass" in element.attrib:
        carrier.set("childclass", element.get("childclass", ""))
    add(carrier, "inertial", pos=np.zeros(3), mass=LIGHT, diaginertia=[1e-2 * LIGHT] * 3)
    element.remove(joint)
    carrier.extend([joint, *hinges[:more]])
    parent = found.parents[element]
    parent.insert(list(parent).index(element), carrier)
    parent.remove(element)
    carrier.append(element)


def _named(name: str, names: dict[str, str]) -> str:
    """Name of a hinge in the file: that of the file's joint with the same ending."""
    for own, theirs in names.items():
        if name == own or name.startswith(f"{own}_"):
            return theirs + name.removeprefix(own)
    return name


def _inertial(element: ET.Element, body: Body, to_file: np.ndarray, model: Any, number_: int) -> None:
    """Mass and centre of mass of the arm's model; the inertia of the file."""
    if body.mass <= 0:
        return
    own = element.find("inertial")
    if own is None:
        own = ET.Element("inertial", quat=numbers(model.body_iquat[number_]))
        own.set("diaginertia", numbers(np.maximum(model.body_inertia[number_], 1e-9)))
        element.insert(0, own)
    own.set("mass", number(body.mass))
    own.set("pos", numbers(to_file[:3, :3] @ body.centre + to_file[:3, 3]))


def _stand(root: ET.Element, found: FoundArm, where: Match, machine: Mechanism) -> None:
    """A body for the hinges of the stand, around the arm."""
    base = machine.bodies[0]
    if not base.hinges:
        return
    parent = {child: e for e in root.iter() for child in e}
    top = found.bodies[0]
    while parent[top].tag == "body":
        top = parent[top]
    world = parent[top]
    at = list(world).index(top)
    world.remove(top)
    stand = ET.Element("body", name="stand", gravcomp="1")
    add(stand, "inertial", pos=np.zeros(3), mass=1.0, diaginertia=[0.01] * 3)
    to_world = np.linalg.inv(where.root) @ base.pose
    for h in base.hinges:
        moved = to_world[:3, :3] @ h.axis
        hinge(stand, Hinge(h.name, moved, to_world[:3, :3] @ h.pos + to_world[:3, 3], h.spring, h.rest))
    stand.append(top)
    world.insert(at, stand)


def _flange(found: FoundArm, where: Match, machine: Mechanism) -> ET.Element:
    """A body for the flange on the last body of the arm."""
    own = where.own[-1] @ np.linalg.inv(rigid(None, found.anchors[-1]))
    pose = np.linalg.inv(own) @ machine.flange
    return add(found.bodies[-1], "body", name="flange", childclass=DEFAULT, **place(pose))


def _section(root: ET.Element, tag: str) -> ET.Element:
    found = root.find(tag)
    return ET.SubElement(root, tag) if found is None else found


def _integrator(root: ET.Element) -> list[str]:
    """The integrator that is implicit in positions."""
    option = root.find("option")
    if option is None:
        option = ET.Element("option")
        root.insert(0, option)
    was = option.get("integrator", "Euler")
    option.set("integrator", "discrete")
    return (
        []
        if was == "discrete"
        else [f"the integrator is discrete (it was {was}): springs of joints are stiff"]
    )


def _carried(model: Any, found: FoundArm) -> list[str]:
    """Masses on the last body of the file, besides the tool."""
    last = found.ids[-1]
    more = float(model.body_subtreemass[last] - model.body_mass[last])
    if more <= 1e-6:
        return []
    return [f"the file has {more:.3g} kg on the last body, in addition to the tool of the session"]


def check_compiler(root: ET.Element, where: str) -> None:
    """Refuse masses that MuJoCo takes from the geoms."""
    compiler = root.find("compiler")
    if compiler is not None and compiler.get("inertiafromgeom") == "true":
        what = "inertiafromgeom is true: MuJoCo takes all masses from the geoms"
        raise BayescalError(what, where, "set it to auto")
