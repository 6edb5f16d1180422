"""A calibrated arm as a URDF: the user's file patched in place, or a new one.

In the user's file only the origins of the joints that turn are changed; text, comments, order, meshes,
masses, fixed and mimic joints stay. Where a link's frame stands on its joint's axis is the file's own choice
and is kept; the axis itself is the calibrated one. With F_k the calibrated frame of joint k at zero readings,
X_k the constant transform from it to the file's frame of that link, G that of the file's root in F0, and P_k
the fixed joints before joint k, its origin becomes

    P_k^-1 X_(k-1)^-1 F_(k-1)^-1 F_k X_k,    and    P_1^-1 G^-1 F_1 X_1    for the first.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.arm.chain import Robot, chain_of, frames, link_angles
from bayescal.arm.transforms import rpy_of
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import (
    centre_in_frame,
    constant,
    constant_displacements,
    coupled,
    items,
    steps,
    zero_frames,
)
from bayescal.exporting.same_arm import FileArm, Match, match
from bayescal.exporting.written import Format, Options, Written, path_of
from bayescal.exporting.xml_text import XmlText, numbers, rendered
from bayescal.fitted.arm import FittedArm
from bayescal.robots.markup import LARGEST, parse_markup
from bayescal.robots.tree import MOVING, TURNING, UNLIMITED, Tree, read_tree, tip_of
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
    delta = constant_displacements(arm.model, arm.values, options.state)
    calibrated = zero_frames(robot, delta)
    made = _patched(robot, calibrated, options.into) if options.into else _new(robot, delta, options.name)
    file = file_arm(read_tree(parse_markup(made.text.encode(), name), name), made.tip)
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
    return Written(
        made.text,
        items(arm, [(f"joint[@name='{name}']/origin", "xyz, rpy") for name in file.names]),
        details=details,
        notes=(*made.match.notes, *coupled(np.array(details["joint_from_reading"]))),
        placed=partial(_moved, made.text, into.parent) if options.into else None,
    )


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
    tree = read_tree(xml.root, path.name)
    tip = tip_of(tree, asked)
    file = file_arm(tree, tip)
    matched = match(robot, file, path.name)
    links = calibrated[:-1] @ matched.links
    origins = np.linalg.inv(file.fixed) @ steps(links, matched.root)
    joints = {joint.get("name"): joint for joint in xml.root.findall("joint")}
    for name, t in zip(file.names, origins, strict=True):
        _place(joints[name], t)
    return _File(xml.text, tip, matched, np.linalg.inv(links[-1] @ file.tip) @ calibrated[-1])


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
    *poses, flange = steps(zero_frames(robot, delta))
    signs = np.where(np.diag(robot.link_from_reading) < 0, -1.0, 1.0)
    most = {"effort": robot.torques, "velocity": robot.velocities}
    free = " and ".join(what for what, each in most.items() if each is None or np.any(np.isnan(each)))
    remark = f"{free} of {UNLIMITED:g}: not stated by the robot; a URDF must have a number" if free else ""
    joints = [
        {
            "name": joint,
            "type": "prismatic" if robot.slides[k] else "revolute",
            "pose": poses[k],
            "sense": f"{signs[k]:g}",
            **dict(zip(("lower", "upper"), robot.limits[k].tolist(), strict=True)),
            **{key: UNLIMITED if x is None or np.isnan(x[k]) else float(x[k]) for key, x in most.items()},
            "mass": None if robot.masses is None else float(robot.masses[k]),
            "centre": centre_in_frame(robot, delta, k),
        }
        for k, joint in enumerate(robot.joint_names)
    ]
    text = rendered("arm.urdf.j2", name=name, remark=remark, joints=joints, flange=flange, ball=BALL)
    here = Match(np.eye(4), np.tile(np.eye(4), (robot.n, 1, 1)), signs, (remark,) if remark else ())
    return _File(text, "flange", here, np.eye(4))


URDF = Format(
    "urdf",
    ".urdf",
    "URDF, new or patched in place: origins of the joints",
    write,
    lambda arm, k: constant(arm.model.parameters[k]),
    "a URDF holds constant geometry only",
    into=True,
    prismatic=True,
)
"""Geometry and joint zeros, for anything that reads a URDF."""
