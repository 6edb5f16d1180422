"""A user's MJCF file with the fitted arm in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.arm.transforms import rigid
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import number, numbers
from bayescal.exporting.mjcf.content import DEFAULT, Content, add, bare, law_of, place
from bayescal.exporting.mjcf.links import (
    MOST,
    Body,
    Hinge,
    Mechanism,
    bands,
    defaults,
    hinge,
    mechanism,
    tips,
    tool,
)
from bayescal.exporting.mjcf.readings import Joints, Sections, parts
from bayescal.exporting.mjcf.scene_arm import (
    FoundArm,
    compiled,
    find_arm,
    model_of,
    moved,
    read_scene,
    skeleton,
    spec_of,
)
from bayescal.exporting.mjcf.scene_parts import check, with_keyframes, with_unique_names, without_earlier
from bayescal.exporting.same_arm import ANGLE, Match, smallest_turn
from bayescal.exporting.sidecar import mujoco
from bayescal.exporting.written import Options, Placed, path_of
from bayescal.fitted.arm import FittedArm

LIGHT = 1e-3
"""Mass, kg, of a body that only carries hinges; gravity does not act on it."""
TURNED = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
"""Attributes for an orientation; a quaternion takes the place of any."""
SAME = 1e-12
"""m and rad: a pose that differs by less is left as it is written."""


@dataclass(frozen=True)
class Patched:
    """A patched file: its text, details for the sidecar, notes, and its text in another folder.

    `bodies` are names of the bodies that base, links and flange of the arm displace.
    """

    text: str
    details: dict[str, Any]
    notes: list[str]
    placed: Placed
    bodies: tuple[str, ...]


def patched(arm: FittedArm, options: Options) -> Patched:
    """The user's file with the fitted arm.

    The bodies of the arm get calibrated poses. If the arm has springs or errors of its readings, hinges for
    them are added behind its joints, and its bodies get masses and centres of mass of its model, and the file
    an integrator for stiff springs. Actuators are not changed. Parts of an earlier export are replaced.

    Raises
    ------
    BayescalError
        If the file cannot be patched, or is of another arm.
    """
    path, tip = path_of(options.into)
    scene, robot = read_scene(path), arm.dataset.robot
    root = scene.root
    before = compiled(scene.xml.text, path.parent, path.name)
    gone = without_earlier(root)
    spec = spec_of(skeleton(root), path.parent, path.name)
    model = model_of(spec, path.name)
    found = find_arm(root, spec, model, robot, tip, path.name)
    where = _upright(found.where, before.opt.gravity, arm.dataset.gravity)
    content = Content(arm, options.state)
    law = bare(law_of(content)) if options.readings == "script" else law_of(content)
    machine = mechanism(content, law)
    names = dict(zip(robot.joint_names, found.file.names, strict=True))
    yields = any(len(b.hinges) > (b.name != "base") for b in machine.bodies)
    load = machine.loads[int(arm.dataset.measurements.tool[options.state])]
    joints = Joints(tuple(names.values()), where.signs)
    notes = [f"{name} stands in place of its <include>" for name in scene.included]
    _poses(found, where, machine)
    flange = _flange(found, where, machine)
    tips(flange, machine.loads)
    if yields:
        flange.set("childclass", DEFAULT)
        tool(flange, load)
        notes += [*_explicit_masses(root, spec, path.name), *_integrator(root, model)]
        notes += _links(found, where, machine, names, model)
        _stand(root, found, where, machine)
        defaults(root, shown=False)
        world = root.find("worldbody")
        assert world is not None
        to = Sections(world, _section(root, "tendon"), _section(root, "equality"))
        renamed = {h.name: _named(h.name, names) for b in machine.bodies for h in b.hinges}
        bands(to.tendon, machine, renamed)
        moments = arm.model.scene.moments
        torques = np.zeros(1) if moments is None else np.abs(moments[:, 1:, 2])
        parts(to, law, joints, torques)
        for section in (to.tendon, to.equality):
            if not len(section):
                root.remove(section)
    others = with_unique_names(scene.xml, model, found.file.names, path.name)
    with_keyframes(scene, before, gone, law, joints, others.get("joint", {}))
    text = scene.xml.text
    after = compiled(text, path.parent, path.name)
    check(found, where, machine, model, after, others.get("body", {}), path.name)
    details = {
        "into": path.name,
        "tip": model.body(found.ids[-1]).name,
        "joints": names,
        "joint_from_reading": (where.signs[:, None] * robot.link_from_reading).tolist(),
        "signs": where.signs.tolist(),
        "root_in_f0": where.root.tolist(),
        "renamed": others,
    }
    for kind, each in others.items():
        for name, new in each.items():
            notes.append(f"the file has a {kind} {name}: that of the arm is called {new}")
    links = [model.body(b).name for b in found.ids]
    return Patched(
        text,
        details,
        [*notes, *where.notes, *_carried(model, found)],
        partial(moved, text, path.parent),
        (links[0], *links, others.get("body", {}).get("flange", "flange")),
    )


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
        _place(element, local, found.written[k])
        before = here


def _about(axis: np.ndarray, angle: float) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return rigid(Rotation.from_rotvec(angle * axis).as_matrix())


def _place(element: ET.Element, pose: np.ndarray, before: np.ndarray) -> None:
    """Give a body another pose; a position or an orientation that is the same stays as it is written."""
    new = place(pose)
    if np.max(np.abs(pose[:3, 3] - before[:3, 3])) > SAME:
        element.set("pos", new["pos"])
    if np.max(np.abs(pose[:3, :3] - before[:3, :3])) > SAME:
        for name in TURNED[1:]:
            element.attrib.pop(name, None)
        element.set("quat", new["quat"])


def _links(found: FoundArm, where: Match, machine: Mechanism, names: dict[str, str], model: Any) -> list[str]:
    """Masses, and hinges behind the joints; notes."""
    known, lifted = any(b.mass > 0 for b in machine.bodies), []
    for k, element in enumerate(found.bodies):
        own = [b for b in machine.bodies if b.name.partition("_")[0] == f"link{k + 1}"]
        to_file = np.linalg.inv(where.own[k] @ np.linalg.inv(rigid(None, found.anchors[k])))
        if known and model.body_gravcomp[found.ids[k]] != (own[-1].mass <= 0):
            element.set("gravcomp", "0" if own[-1].mass > 0 else "1")
            lifted += [element.get("name", "")] if own[-1].mass > 0 else []
        _inertial(element, own[-1], to_file, model, found.ids[k])
        made = ET.Element("holder")
        for h in [h for body in own for h in body.hinges][1:]:
            axis, pos = to_file[:3, :3] @ h.axis, to_file[:3, :3] @ h.pos + to_file[:3, 3]
            hinge(made, Hinge(_named(h.name, names), axis, pos, h.spring, h.rest))
        _insert(found, k, list(made))
    return [f"gravity acts on {', '.join(lifted)}: springs of the arm carry them"] if lifted else []


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
    for name in ("pos", *TURNED):
        if name in element.attrib:
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
    """A body for the hinges of the stand, around the first link: what carries the arm does not load them."""
    base = machine.bodies[0]
    if not base.hinges:
        return
    parent = {child: e for e in root.iter() for child in e}
    top = found.bodies[0]
    if parent[found.joints[0]] is not top:  # in a body before it
        top = parent[top]
    around = parent[top]
    at = list(around).index(top)
    around.remove(top)
    stand = ET.Element("body", name="stand", gravcomp="1")
    add(stand, "inertial", pos=np.zeros(3), mass=1.0, diaginertia=[0.01] * 3)
    to_parent = np.linalg.inv(where.root @ found.steps[0]) @ base.pose
    for h in base.hinges:
        axis, pos = to_parent[:3, :3] @ h.axis, to_parent[:3, :3] @ h.pos + to_parent[:3, 3]
        hinge(stand, replace(h, axis=axis, pos=pos))
    stand.append(top)
    around.insert(at, stand)


def _flange(found: FoundArm, where: Match, machine: Mechanism) -> ET.Element:
    """A body for the flange on the last body of the arm."""
    own = where.own[-1] @ np.linalg.inv(rigid(None, found.anchors[-1]))
    return add(found.bodies[-1], "body", name="flange", **place(np.linalg.inv(own) @ machine.flange))


def _section(root: ET.Element, tag: str) -> ET.Element:
    found = root.find(tag)
    return ET.SubElement(root, tag) if found is None else found


def _integrator(root: ET.Element, model: Any) -> list[str]:
    """The integrator that is implicit in positions."""
    kinds = mujoco().mjtIntegrator
    if model.opt.integrator == kinds.mjINT_DISCRETE:
        return []
    options = root.findall("option") or [ET.Element("option")]
    if root.find("option") is None:
        root.insert(0, options[0])
    options[-1].set("integrator", "discrete")  # of several, the last one counts
    was = kinds(model.opt.integrator).name.removeprefix("mjINT_").lower()
    return [f"the integrator is discrete (it was {was}): springs of joints are stiff"]


def _explicit_masses(root: ET.Element, spec: Any, where: str) -> list[str]:
    """Masses as bodies state them, where MuJoCo took all from the geoms: those of other bodies stay the same.

    Raises
    ------
    BayescalError
        If MuJoCo scales all masses to a total, or removes the bodies that are to carry the tool.
    """
    for name in ("settotalmass", "fusestatic"):
        if getattr(spec.compiler, name) > 0:
            what = f"compiler {name}: MuJoCo changes masses and bodies of the file when it reads it"
            raise BayescalError(what, where, f"remove {name}, or export a fit of the geometry alone")
    if spec.compiler.inertiafromgeom != mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        return []
    for compiler in root.iter("compiler"):
        if "inertiafromgeom" in compiler.attrib:
            compiler.set("inertiafromgeom", "auto")
    for body in list(root.iter("body")):
        own = body.find("inertial")
        if own is not None and any(e.tag == "geom" for e in _parts_of(body)):
            body.remove(own)  # it had no effect
    return ["inertiafromgeom is auto (it was true): bodies of the arm have the masses of its model"]


def _parts_of(body: ET.Element) -> Iterator[ET.Element]:
    """Elements of a body, also those in frames."""
    for e in body:
        yield e
        if e.tag == "frame":
            yield from _parts_of(e)


def _carried(model: Any, found: FoundArm) -> list[str]:
    """Masses on the last body of the file, besides the tool."""
    last = found.ids[-1]
    more = float(model.body_subtreemass[last] - model.body_mass[last])
    if more <= 1e-6:
        return []
    return [f"the file has {more:.3g} kg on the last body, in addition to the tool of the session"]
