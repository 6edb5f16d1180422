"""A calibrated arm as a URDF: the user's file patched in place, or a new one.

In the user's file only the origins of the joints that turn are changed; text, comments, order, meshes,
masses, fixed and mimic joints stay. Where a link's frame stands on its joint's axis is the file's own choice
and is kept; the axis itself is the calibrated one. With F_k the calibrated frame of joint k at zero readings,
X_k the constant transform from it to the file's frame of that link, G that of the file's root in F0, and P_k
the fixed joints before joint k, its origin becomes

    P_k^-1 X_(k-1)^-1 F_(k-1)^-1 F_k X_k,    and    P_1^-1 G^-1 F_1 X_1    for the first.

PAL Robotics' ``master_calibration.yaml`` (TIAGo, TALOS and others) is the difference of both files:
`robot_state_publisher` adds its entries to the origins of the URDF at start. ``geometric_calibration`` has
``arm_1_dx``, ``dy``, ``dz`` (m), ``droll``, ``dpitch`` and ``dyaw`` (rad), differences of `xyz` and `rpy` of
the joint ``arm_1_joint`` (source: figaroh-plus, which writes the same file).

A calibrated arm as an SDF model: joints that a controller commands, and joints with springs behind them.

An elastic joint is two joints in SDF: one that is commanded, and one with `spring_stiffness` and
`spring_reference` on a link of its own without weight. Bearings, links and the stand have joints with springs
too. The mechanism is that of the MuJoCo model (`mjcf.mechanism`). A spring of SDF is linear.
"""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml

from bayescal.arm.chain import Robot, chain_of, frames, link_angles
from bayescal.arm.transforms import rpy_of
from bayescal.effects import ALWAYS, MODELS, Parameter
from bayescal.errors import BayescalError
from bayescal.exporting import geometry
from bayescal.exporting.geometry import constant, coupled, holds_constants, items
from bayescal.exporting.mjcf.elastic import Content, Hinge
from bayescal.exporting.mjcf.mechanism import Body, mechanism
from bayescal.exporting.mjcf.readings import bare, law_of
from bayescal.exporting.same_arm import FileArm, Match, match
from bayescal.exporting.written import IN_F0, Format, Item, Options, Written, item, path_of
from bayescal.exporting.xml_text import XmlText, indented, numbers, rendered
from bayescal.fitted.arm import FittedArm
from bayescal.logs.types import or_nan
from bayescal.robots.tree import BETWEEN, MOVING, TURNING, UNLIMITED, Tree, chain_in, read_tree
from bayescal.robots.urdf import LARGEST, parse_markup
from bayescal.storage.reading import decoded

CLOSE = 1e-9
"""m: difference of the written file's kinematics from the model's geometry at which it is not handed out."""
BALL = 0.05
"""m: radius of the homogeneous ball whose inertia a link of a new file has; gravity does not depend on it."""


@dataclass(frozen=True)
class _File:
    """The text of a URDF, its tip, where its frames are, and the flange (4, 4) in its tip."""

    text: str
    tip: str
    match: Match
    flange_in_tip: np.ndarray


def write(arm: FittedArm, options: Options) -> Written:
    """The URDF of an arm in one state."""
    robot, into = arm.dataset.robot, path_of(options.into)[0]
    name = into.name or options.name
    delta = geometry.constant_displacements(arm.model, arm.values, options.state)
    calibrated = geometry.zero_frames(robot, delta)
    made = _patched(robot, calibrated, options.into) if options.into else _new(robot, delta, options.name)
    file = file_arm(*chain_in(read_tree(parse_markup(made.text.encode(), name), name), made.tip))
    _check(arm, delta, file, made, name)
    root, signs = made.match.root, made.match.signs
    details = {
        **({"into": name} if options.into else {}),
        "tip": made.tip,
        "joints": dict(zip(robot.joint_names, file.names, strict=True)),
        "signs": signs.tolist(),
        "joint_from_reading": (signs[:, None] * robot.link_from_reading).tolist(),
        "root_in_f0": root.tolist(),
        "flange_in_tip": made.flange_in_tip.tolist(),
    }
    origins = [(f"joint[@name='{name}']/origin", "xyz, rpy") for name in file.names]
    notes = (*made.match.notes, *coupled(signs[:, None] * robot.link_from_reading))
    placed = partial(_moved, made.text, into.parent) if options.into else None
    return Written(made.text, items(arm, origins), details=details, notes=notes, placed=placed)


def file_arm(tree: Tree, tip: str) -> FileArm:
    """The moving joints of a URDF from its root to a tip, at zero."""
    moving, frames, fixed = [], [], []
    pose, since = np.eye(4), np.eye(4)
    for joint in tree.above(tip):
        if joint.mimic or joint.kind not in (*MOVING, "fixed"):
            what = f"joint {joint.name} {'follows another joint' if joint.mimic else f'is {joint.kind}'}"
            remedy = f"choose a tip before it, as in --into {tree.file}#{joint.parent}"
            raise BayescalError(what, tree.file, remedy)
        pose = pose @ joint.place
        if joint.kind == "fixed":
            since = since @ joint.place
            continue
        moving.append(joint)
        frames.append(pose)
        fixed.append(since)
        since = np.eye(4)
    return FileArm(
        tuple(joint.name for joint in moving),
        np.array(frames).reshape(-1, 4, 4),
        np.array([joint.axis for joint in moving]).reshape(-1, 3),
        np.array(fixed).reshape(-1, 4, 4),
        since,
        np.array([joint.kind not in TURNING for joint in moving], bool),
    )


def _patched(robot: Robot, calibrated: np.ndarray, into: str) -> _File:
    """The file of a user with frames (n + 1, 4, 4) of the arm and its flange in place of its own."""
    path, asked = path_of(into)
    if path.suffix.lower() == ".xacro":
        remedy = "expand it: xacro arm.xacro > arm.urdf"
        raise BayescalError("a xacro file cannot be patched", str(path), remedy)
    xml = XmlText(decoded(path, LARGEST)[0], path.name)
    tree, tip = chain_in(stood := read_tree(xml.root, path.name), asked)
    file = file_arm(tree, tip)
    matched = match(robot, file, path.name)
    links = calibrated[:-1] @ matched.links
    passed = len({joint.name for joint in tree.above(stood.root)} & {*file.names})
    if passed:  # the file has no origin between its first link and the first joint
        matched = replace(matched, root=links[0] @ np.linalg.inv(file.fixed[0]))
    between = geometry.steps(links, matched.root)
    origins = np.linalg.inv(file.fixed) @ between
    places = {joint.name: joint.place for joint in stood.joints.values()}
    for k in range(passed):  # of these the origin stands behind the joint, before the next one
        back = file.fixed[k + 1] @ np.linalg.inv(between[k + 1]) if k + 1 < passed else np.eye(4)
        origins[k] = places[file.names[k]] @ back
    joints = {joint.get("name"): joint for joint in xml.root.findall("joint")}
    for name, t in zip(file.names, origins, strict=True):
        _place(joints[name], t)
    whole = asked if passed else tip
    return _File(xml.text, whole, matched, np.linalg.inv(links[-1] @ file.tip) @ calibrated[-1])


def _moved(text: str, before: Path, after: Path) -> str:
    """A text whose meshes with relative paths are found from another folder."""
    xml, back = XmlText(text, "arm"), os.path.relpath(before.resolve(), after.resolve())
    for e in xml.root.iter() if back != "." else ():
        file = e.get("filename", "")
        if e.tag in ("mesh", "texture") and file and "://" not in file and not Path(file).is_absolute():
            e.set("filename", Path(os.path.normpath(Path(back) / file)).as_posix())
    return xml.text


def _place(joint: ET.Element, pose: np.ndarray) -> None:
    """Give a joint its origin."""
    origin = joint.find("origin")
    if origin is None:
        origin = ET.Element("origin")
        joint.insert(0, origin)
    origin.attrib.update(xyz=numbers(pose[:3, 3]), rpy=numbers(rpy_of(pose[:3, :3])))


def _check(arm: FittedArm, delta: np.ndarray, file: FileArm, made: _File, name: str) -> None:
    """Compare the kinematics of the written text, read again, with the model's at poses of the session."""
    robot, readings = arm.dataset.robot, arm.dataset.measurements.readings
    moved = np.broadcast_to(delta, (len(readings), *delta.shape))
    ours = frames(chain_of(robot), link_angles(robot, readings), moved)[:, -1]
    turned = file.turned(made.match.signs * (readings @ robot.link_from_reading.T))[:, -1]
    theirs = made.match.root @ turned @ file.tip @ made.flange_in_tip
    off = float(np.abs(theirs - ours).max(initial=0.0))
    if not off < CLOSE:
        what = f"the written file moves by {off:.1e} m (or rad) from the calibrated geometry"
        raise BayescalError(what, name, "this is a defect of bayescal; nothing is written")


def _new(robot: Robot, delta: np.ndarray, name: str) -> _File:
    """A file of a robot whose frames have displacements (n + 2, 6)."""
    *poses, flange = geometry.steps(geometry.zero_frames(robot, delta))
    links = _links(robot, delta, poses)
    signs = np.where(np.diag(robot.link_from_reading) < 0, -1.0, 1.0)
    most, remark = most_of(*(or_nan(x, robot.n) for x in (robot.torques, robot.velocities)))
    joints = [
        {
            "name": joint,
            "type": "prismatic" if robot.slides[k] else "continuous" if robot.unlimited[k] else "revolute",
            **links[joint],
            "sense": f"{signs[k] * links[joint]['sense']:g}",
            **dict(zip(("lower", "upper"), robot.limits[k].tolist(), strict=True)),
            **{key: float(x[k]) for key, x in most.items()},
        }
        for k, joint in enumerate(robot.joint_names)
    ]
    ends, tip = [{"name": "flange", "parent": robot.joint_names[-1], "pose": flange}], "flange"
    if robot.ground is not None:
        ends += [{"name": IN_F0, "parent": robot.joint_names[0], "pose": np.linalg.inv(poses[0])}]
        tip = f"{IN_F0}{BETWEEN}{tip}"
    text = rendered("arm.urdf.j2", name=name, remark=remark, joints=joints, ends=ends, ball=BALL)
    here = Match(np.eye(4), np.tile(np.eye(4), (robot.n, 1, 1)), signs, (remark,) if remark else ())
    return _File(text, tip, here, np.eye(4))


def most_of(effort: np.ndarray, velocity: np.ndarray) -> tuple[dict[str, np.ndarray], str]:
    """Largest torques and speeds (n,) of joints as a URDF must have them, and a remark where it is not true.

    Those that are not known (nan) become `UNLIMITED`.
    """
    most = {"effort": effort, "velocity": velocity}
    free = " and ".join(what for what, each in most.items() if np.any(np.isnan(each)))
    remark = f"{free} of {UNLIMITED:g}: not stated by the robot; a URDF must have a number" if free else ""
    return {key: np.where(np.isnan(each), UNLIMITED, each) for key, each in most.items()}, remark


def _links(robot: Robot, delta: np.ndarray, poses: Sequence[np.ndarray]) -> dict[str, dict[str, Any]]:
    """What a new file has of each joint: parent, pose, sense of its axis, mass and centre of the link behind.

    Of two arms the root is the frame in which gravity is stated. A joint on the way from there to F0 has the
    frame that it has in the chain, with the reversed axis, and carries the link before it.
    """
    masses = np.zeros(robot.n) if robot.masses is None else robot.masses
    weighed = [(float(mass), geometry.centre_in_frame(robot, delta, k)) for k, mass in enumerate(masses)]
    ground, before = robot.ground, "base"
    stands = 0 if ground is None else ground.link
    root = np.eye(4) if ground is None else np.linalg.inv(ground.place)
    out: dict[str, dict[str, Any]] = {}

    def add(k: int, pose: np.ndarray, sense: float, mass: float, centre: np.ndarray) -> None:
        nonlocal before
        of = {"parent": before, "pose": pose, "sense": sense, "centre": centre}
        before = robot.joint_names[k]
        out[before] = of | {"mass": None if robot.masses is None else mass}

    for k in range(stands - 1, -1, -1):
        assert ground is not None
        mass, centre = weighed[k - 1] if k else (ground.mass, ground.centre)
        back = np.linalg.inv(poses[k])
        pose = root if k == stands - 1 else np.linalg.inv(poses[k + 1])
        add(k, pose, -1.0, mass, back[:3, :3] @ centre + back[:3, 3])
    before = "base"
    for k in range(stands, robot.n):
        add(k, root @ poses[k] if k == stands else poses[k], 1.0, *weighed[k])
    return out


URDF = Format(
    ".urdf", write, holds_constants, "a URDF holds constant geometry only", into=True, prismatic=True,
    two_arms=("plain", "into"),
)  # fmt: skip
"""Geometry and joint zeros, new or patched in place, for anything that reads a URDF."""


KEYS = ("dx", "dy", "dz", "droll", "dpitch", "dyaw")
ATTRIBUTE = "geometric_calibration"
LEAST = 1e-12
"""m and rad: smaller differences are rounding."""


def _origins(content: bytes, file: str) -> dict[str, np.ndarray]:
    """`xyz` and `rpy` (6,) of the joints of a URDF, as they are written."""
    out = {}
    for joint in parse_markup(content, file).findall("joint"):
        origin = joint.find("origin")
        stated = {} if origin is None else origin.attrib
        texts = (stated.get("xyz", "0 0 0"), stated.get("rpy", "0 0 0"))
        out[joint.get("name", "")] = np.array([float(x) for text in texts for x in text.split()])
    return out


def _write_pal(arm: FittedArm, options: Options) -> Written:
    if not options.into:
        what = "the entries are differences from the URDF of the robot"
        raise BayescalError(what, "--to pal", "give it: `--into robot.urdf#link`")
    path = path_of(options.into)[0]
    patched = write(arm, options)
    text = patched.content if isinstance(patched.content, bytes) else patched.content.encode()
    before, after = _origins(decoded(path, LARGEST)[1], path.name), _origins(text, path.name)
    entries: dict[str, float] = {}
    for name, origin in after.items():
        change = origin - before[name]
        change[3:] = (change[3:] + np.pi) % (2.0 * np.pi) - np.pi
        bare = name.removesuffix("_joint")
        differences = zip(KEYS, change.tolist(), strict=True)
        new = {f"{bare}_{k}": x for k, x in differences if abs(x) > LEAST}
        if twice := entries.keys() & new.keys():
            what = f"two joints have the entry {min(twice)}"
            raise BayescalError(what, path.name, "names differ by `_joint` alone: rename one of the joints")
        entries |= new
    content = {"robot_state_publisher": {ATTRIBUTE: entries}}
    named = [replace(i, element=_joint_of(i.element), attribute=ATTRIBUTE) for i in patched.items]
    added = f"the entries are added to the origins of {path.name}: an earlier calibration must not be in it"
    notes = [*(n for n in patched.notes if "mesh" not in n), added]
    text_ = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    return Written(text_, named, notes=notes, details=patched.details)


def _joint_of(element: str) -> str:
    """The name of a joint in an XPath."""
    matched = re.search(r"@name=(['\"])(.*)\1", element)
    return matched[2] if matched else element


PAL = Format(
    ".yaml", _write_pal, holds_constants, "master_calibration.yaml has constant geometry only", into=True
)
"""Differences of joint origins from those of the robot's URDF, which is given as the file of the user."""


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
    details = {"joint_from_reading": robot.link_from_reading.tolist()}
    entries = [*items(arm, places), *_elastic(arm)]
    return Written('<?xml version="1.0"?>\n' + indented(text), entries, notes=notes, details=details)


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
