"""A user's MJCF file with the fitted arm in it: a list of edits, each of which changes the tree.

An edit takes the `Scene`, and returns what a user should know of it, if anything.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rigid, rotation
from bayescal.errors import BayescalError
from bayescal.exporting.mjcf import scene_arm
from bayescal.exporting.mjcf.elastic import Content
from bayescal.exporting.mjcf.mechanism import MOST, PARTS, Body, Mechanism, elements, mechanism, merge_held
from bayescal.exporting.mjcf.readings import Joints, Law, bare, law_of
from bayescal.exporting.mjcf.scene_arm import FoundArm
from bayescal.exporting.mjcf.scene_parts import with_keyframes, with_unique_names, without_earlier
from bayescal.exporting.same_arm import ANGLE, Match
from bayescal.exporting.written import Options, Written, mujoco, path_of
from bayescal.exporting.xml_text import number, numbers
from bayescal.fitted.arm import FittedArm
from bayescal.robots.urdf import smallest_turn

LIGHT = 1e-3
"""Mass, kg, of a body that only carries hinges; gravity does not act on it."""
TURNED = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
"""Attributes for an orientation; a quaternion takes the place of any."""
SAME = 1e-12
"""m and rad: a pose that differs by less is left as it is written."""
CLOSE = 1e-9
"""m: difference of the written file's kinematics from the arm's at which it is not handed out."""


@dataclass(frozen=True)
class Scene:
    """A user's file that is edited: its tree, its arm, and the fitted arm that takes its place.

    `spec` and `model` are of the file as it was, without the parts of an earlier export. `names` are those of
    the file's joints by those of the robot.
    """

    name: str
    root: ET.Element
    spec: Any
    model: Any
    arm: FoundArm
    content: Content
    law: Law
    names: Mapping[str, str]

    @cached_property
    def machine(self) -> Mechanism:
        """The fitted arm."""
        return mechanism(self.content, self.law)

    @property
    def joints(self) -> Joints:
        """Joints of the arm in the file."""
        signs, references = self.arm.where.signs, self.arm.references
        return Joints(tuple(self.names.values()), signs, references, bool(self.spec.compiler.degree))

    @property
    def yields(self) -> bool:
        """Whether the fitted arm has springs or errors of its readings."""
        return any(len(b.hinges) > (b.name != "base") for b in self.machine.bodies)

    def named(self, name: str) -> str:
        """Name of a hinge in the file: that of the file's joint with the same ending."""
        for ours, theirs in self.names.items():
            if name == ours or name.startswith(f"{ours}_"):
                return theirs + name.removeprefix(ours)
        return name


def patched(arm: FittedArm, options: Options) -> tuple[Written, tuple[str, ...]]:
    """The user's file with the fitted arm, and the names of its bodies that are base, links and flange.

    The bodies of the arm get calibrated poses. If the arm has springs or errors of its readings, hinges for
    them are added behind its joints, and its bodies get masses and centres of mass of its model, and the file
    an integrator for stiff springs. Actuators are not changed. Parts of an earlier export are replaced.

    Raises
    ------
    BayescalError
        If the file cannot be patched, or is of another arm.
    """
    path, tip = path_of(options.into)
    file = scene_arm.read_scene(path)
    before = scene_arm.compiled(file.xml.text, path.parent, path.name)
    gone = without_earlier(file.root)
    scene = _scene(arm, options, file.root, tip, before)
    notes = [f"{name} stands in place of its <include>" for name in file.included]
    for edit in (*GEOMETRY, *(ELASTIC if scene.yields else ())):
        notes += edit(scene) or []
    model, names = scene.model, scene.arm.file.names
    others = with_unique_names(file.xml, model, names, path.name)
    with_keyframes(file, before, gone, scene.law, scene.joints, others.get("joint", {}))
    text = file.xml.text
    after = scene_arm.compiled(text, path.parent, path.name)
    flange = others.get("body", {}).get("flange", "flange")
    _check(scene, after, flange)
    for kind, renamed in others.items():
        for old, new in renamed.items():
            notes.append(f"the file has a {kind} {old}: that of the arm is called {new}")
    links = [model.body(b).name for b in scene.arm.ids]
    carried = _carried(model, scene.arm)
    details = {
        "into": path.name, "tip": links[-1], "joints": scene.names,
        "joint_from_reading": (scene.arm.where.signs[:, None] * arm.dataset.robot.link_from_reading).tolist(),
        "signs": scene.arm.where.signs.tolist(), "root_in_f0": scene.arm.where.root.tolist(),
        "renamed": others, "carried_kg": carried,
    }  # fmt: skip
    notes += scene.arm.where.notes
    if carried > 1e-6:
        notes += [f"the file has {carried:.3g} kg on the last body, in addition to the tool of the session"]
    written = Written(text, notes=notes, details=details, placed=partial(scene_arm.moved, text, path.parent))
    return written, (links[0], *links, flange)


def _scene(arm: FittedArm, options: Options, root: ET.Element, tip: str, before: Any) -> Scene:
    """The arm in a tree; `before` is the compiled file."""
    (path, _), robot = path_of(options.into), arm.dataset.robot
    spec = scene_arm.spec_of(scene_arm.skeleton(root), path.parent, path.name)
    model = scene_arm.model_of(spec, path.name)
    located = scene_arm.find_arm(root, spec, model, robot, tip, path.name)
    in_file = replace(located, where=_upright(located.where, before.opt.gravity, arm.dataset.gravity))
    content = Content(arm, options.state)
    law = law_of(content)
    return Scene(
        path.name, root, spec, model, in_file, content, bare(law) if options.readings == "script" else law,
        dict(zip(robot.joint_names, in_file.file.names, strict=True)),
    )  # fmt: skip


def _upright(where: Match, theirs: np.ndarray, ours: np.ndarray) -> Match:
    """The match with gravity exactly as in the session, where the file has it so within rounding."""
    down = where.root[:3, :3] @ theirs
    size = np.linalg.norm(down) * np.linalg.norm(ours)
    if not size > 0 or np.linalg.norm(np.cross(down, ours)) > ANGLE * size or down @ ours < 0:
        return where
    turn = rigid(smallest_turn(down / np.linalg.norm(down), ours / np.linalg.norm(ours)))
    return replace(where, root=turn @ where.root)


def _poses(scene: Scene) -> None:
    """Calibrated poses of the bodies, as the file writes them: at the references of their joints."""
    arm, links = scene.arm, list[np.ndarray]()
    pose = np.linalg.inv(scene.arm.where.root)
    for body in scene.machine.bodies:
        pose = pose @ body.pose
        if body.hinges and body.name.startswith("link") and body.hinges[0].spring is None:
            links.append(pose)  # of the body that the joint turns
    before = np.eye(4)
    for k, body_element in enumerate(arm.bodies):
        anchor = rigid(None, arm.anchors[k])
        here = links[k] @ scene.arm.where.links[k] @ np.linalg.inv(anchor)
        turn = rigid(Rotation.from_rotvec(arm.references[k] * arm.file.axes[k]).as_matrix())
        local = np.linalg.inv(before @ arm.steps[k]) @ here @ anchor @ turn @ np.linalg.inv(anchor)
        _place(body_element, local, arm.written[k])
        before = here


def _place(element: ET.Element, pose: np.ndarray, before: np.ndarray) -> None:
    """Give a body another pose; a position or an orientation that is the same stays as it is written."""
    new = _place_of(pose)
    if np.max(np.abs(pose[:3, 3] - before[:3, 3])) > SAME:
        element.set("pos", new["pos"])
    if np.max(np.abs(pose[:3, :3] - before[:3, :3])) > SAME:
        for name in TURNED[1:]:
            element.attrib.pop(name, None)
        element.set("quat", new["quat"])


def _place_of(pose: np.ndarray) -> dict[str, str]:
    """Attributes `pos` and `quat` of a pose (4, 4)."""
    return ET.fromstring(f"<body {PARTS.place(pose)}/>").attrib


def _links(scene: Scene) -> list[str]:
    """Masses, and hinges behind the joints."""
    arm, bodies, lifted = scene.arm, scene.machine.bodies, []
    weighed = any(b.mass > 0 for b in bodies)
    for k, body_element in enumerate(arm.bodies):
        parts = [b for b in bodies if b.name.partition("_")[0] == f"link{k + 1}"]
        heavy = parts[-1].mass > 0
        to_file = np.linalg.inv(scene.arm.where.links[k] @ np.linalg.inv(rigid(None, arm.anchors[k])))
        if weighed and scene.model.body_gravcomp[arm.ids[k]] != (not heavy):
            body_element.set("gravcomp", "0" if heavy else "1")
            lifted += [body_element.get("name", "")] if heavy else []
        _inertial(body_element, parts[-1], to_file, scene.model, arm.ids[k])
        _, *added = (h.seen(to_file, scene.named(h.name)) for body in parts for h in body.hinges)
        _insert(arm, k, [e for h in added for e in elements(PARTS.hinge(replace(h, limits=None)))])
    return [f"gravity acts on {', '.join(lifted)}: springs of the arm carry them"] if lifted else []


def _insert(arm: FoundArm, k: int, hinges: list[ET.Element]) -> None:
    """Hinges behind a joint; if they are too many for a body, the joint and the first ones are in another.

    The user's body keeps its name and its parts; the further body stands before it.
    """
    element, joint = arm.bodies[k], arm.joints[k]
    index = list(element).index(joint) + 1
    more = max(0, 1 + len(hinges) - MOST)
    for h in reversed(hinges[more:]):
        element.insert(index, h)
    if not more:
        return
    carrier = ET.Element("body", name=f"{element.get('name')}_carrier", gravcomp="1")
    for name in ("pos", *TURNED):
        if name in element.attrib:
            carrier.set(name, element.attrib.pop(name))
    if "childclass" in element.attrib:
        carrier.set("childclass", element.get("childclass", ""))
    carrier.extend(elements(PARTS.inertial((0, 0, 0), LIGHT, 1e-2 * LIGHT)))
    element.remove(joint)
    carrier.extend([joint, *hinges[:more]])
    parent = arm.parents[element]
    parent.insert(list(parent).index(element), carrier)
    parent.remove(element)
    carrier.append(element)


def _inertial(element: ET.Element, body: Body, to_file: np.ndarray, model: Any, number_: int) -> None:
    """Mass and centre of mass of the arm's model; the inertia of the file."""
    if body.mass <= 0:
        return
    inertial = element.find("inertial")
    if inertial is None:
        inertial = ET.Element("inertial", quat=numbers(model.body_iquat[number_]))
        inertial.set("diaginertia", numbers(np.maximum(model.body_inertia[number_], 1e-9)))
        element.insert(0, inertial)
    inertial.set("mass", number(body.mass))
    inertial.set("pos", numbers(to_file[:3, :3] @ body.centre + to_file[:3, 3]))


def _stand(scene: Scene) -> None:
    """A body for the hinges of the stand, around the first link: what carries the arm does not load them."""
    arm, base = scene.arm, scene.machine.bodies[0]
    if not base.hinges:
        return
    parent = {child: e for e in scene.root.iter() for child in e}
    top = arm.bodies[0]
    if parent[arm.joints[0]] is not top:  # in a body before it
        top = parent[top]
    around = parent[top]
    place_of_top = list(around).index(top)
    around.remove(top)
    stand = ET.Element("body", name="stand", gravcomp="1")
    stand.extend(elements(PARTS.inertial((0, 0, 0), 1, 0.01)))
    to_parent = np.linalg.inv(scene.arm.where.root @ arm.steps[0]) @ base.pose
    for h in base.hinges:
        stand.extend(elements(PARTS.hinge(h.seen(to_parent))))
    stand.append(top)
    around.insert(place_of_top, stand)


def _flange(scene: Scene) -> None:
    """A body for the flange on the last body of the arm, with the tips of the tools; if it yields, a tool."""
    arm, machine = scene.arm, scene.machine
    last = scene.arm.where.links[-1] @ np.linalg.inv(rigid(None, arm.anchors[-1]))
    place = _place_of(np.linalg.inv(last) @ machine.flange)
    flange = ET.SubElement(arm.bodies[-1], "body", {"name": "flange", **place})
    flange.extend(elements(PARTS.tips(machine.loads)))
    if scene.yields:
        flange.set("childclass", PARTS.CLASS)
        number_ = int(scene.content.arm.dataset.measurements.tool[scene.content.row])
        flange.extend(elements(PARTS.tool(machine.loads[number_])))


def _integrator(scene: Scene) -> list[str]:
    """The integrator that is implicit in positions."""
    root, kinds = scene.root, mujoco().mjtIntegrator
    if scene.model.opt.integrator == kinds.mjINT_DISCRETE:
        return []
    options = root.findall("option") or [ET.Element("option")]
    if root.find("option") is None:
        root.insert(0, options[0])
    options[-1].set("integrator", "discrete")  # of several, the last one counts
    was = kinds(scene.model.opt.integrator).name.removeprefix("mjINT_").lower()
    return [f"the integrator is discrete (it was {was}): springs of joints are stiff"]


def _explicit_masses(scene: Scene) -> list[str]:
    """Masses as bodies state them, where MuJoCo took all from the geoms: those of other bodies stay the same.

    Raises
    ------
    BayescalError
        If MuJoCo scales all masses to a total, or removes the bodies that are to carry the tool.
    """
    for name in ("settotalmass", "fusestatic"):
        if getattr(scene.spec.compiler, name) > 0:
            what = f"compiler {name}: MuJoCo changes masses and bodies of the file when it reads it"
            raise BayescalError(what, scene.name, f"remove {name}, or export a fit of the geometry alone")
    if scene.spec.compiler.inertiafromgeom != mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        return []
    for compiler in scene.root.iter("compiler"):
        if "inertiafromgeom" in compiler.attrib:
            compiler.set("inertiafromgeom", "auto")
    for body in list(scene.root.iter("body")):
        stated = body.find("inertial")
        if stated is not None and any(e.tag == "geom" for e in _parts_of(body)):
            body.remove(stated)  # it had no effect
    return ["inertiafromgeom is auto (it was true): bodies of the arm have the masses of its model"]


def _parts_of(body: ET.Element) -> Iterator[ET.Element]:
    """Elements of a body, also those in frames."""
    for e in body:
        yield e
        if e.tag == "frame":
            yield from _parts_of(e)


def _held(scene: Scene) -> None:
    """Defaults of all added parts, and what holds their hinges."""
    top = scene.root.find("default")
    (ET.SubElement(scene.root, "default") if top is None else top).extend(elements(PARTS.defaults(False)))
    renamed = {h.name: scene.named(h.name) for b in scene.machine.bodies for h in b.hinges}
    merge_held(scene.root, scene.content, scene.machine, scene.law, scene.joints, renamed)
    for part in [e for tag in ("tendon", "equality") for e in scene.root.findall(tag)[:1] if not len(e)]:
        scene.root.remove(part)  # an earlier export had parts there


Edit = Callable[[Scene], list[str] | None]
GEOMETRY: tuple[Edit, ...] = (_poses, _flange)
"""Edits for a rigid arm."""
ELASTIC: tuple[Edit, ...] = (_explicit_masses, _integrator, _links, _stand, _held)
"""Further ones for an arm with springs or errors of its readings."""


def _check(scene: Scene, after: Any, flange: str) -> None:
    """Compare the compiled file with the arm's kinematics, and its other bodies with the file as it was.

    `flange` is the name of its body.

    Raises
    ------
    BayescalError
        If they differ: nothing is written.
    """
    mj, before, ids, where = mujoco(), scene.model, scene.arm.ids, scene.arm.where
    data, rng = mj.MjData(after), np.random.default_rng(0)
    off = 0.0
    for turns in (np.zeros(len(ids)), *rng.uniform(-np.pi, np.pi, (3, len(ids)))):
        data.qpos[:] = after.qpos0
        angles = iter(turns.tolist())
        pose = np.eye(4)
        for body in scene.machine.bodies:
            turn = next(angles) if body.name.startswith("link") else 0.0
            pose = pose @ body.pose @ rigid(rotation(2, turn))
        for name, sign, turn in zip(scene.joints.names, where.signs, turns, strict=True):
            data.joint(name).qpos[0] = sign * turn
        mj.mj_kinematics(after, data)
        tip = data.body(flange)
        theirs = where.root @ rigid(tip.xmat.reshape(3, 3), tip.xpos)
        off = max(off, float(np.max(np.abs(theirs - pose @ scene.machine.flange))))
    arm = {before.body(b).name for b in ids}
    others = [name for b in range(1, before.nbody) if (name := before.body(b).name) not in arm | {""}]
    same = after.ngeom == before.ngeom and all(
        np.allclose(getattr(before.body(name), key), getattr(after.body(name), key), rtol=1e-9, atol=1e-12)
        for name in others
        for key in ("mass", "inertia", "pos", "ipos")
    )
    if not (off < CLOSE and same):
        moves = f"moves by {off:.1e} m (or rad) from the calibrated geometry"
        what = f"the written file {moves if same else 'changes other bodies'}"
        raise BayescalError(what, scene.name, "this is a defect of bayescal; nothing is written")


def _carried(model: Any, arm: FoundArm) -> float:
    """Mass, kg, on the last body of the file, besides the tool."""
    last = arm.ids[-1]
    return float(model.body_subtreemass[last] - model.body_mass[last])
