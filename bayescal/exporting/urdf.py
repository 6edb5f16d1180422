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
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET
from xml.sax.saxutils import quoteattr

import numpy as np

from bayescal.arm.chain import Robot, chain_of
from bayescal.arm.transforms import rpy_of
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import (
    at_zero_poses,
    centre_in_frame,
    constant,
    constant_displacements,
    coupled,
    geometry_of,
    items,
    joint_angles,
    steps,
)
from bayescal.exporting.same_arm import FileArm, match
from bayescal.exporting.written import Format, Options, Written, path_of
from bayescal.exporting.xml_text import XmlText, numbers
from bayescal.fitted.arm import FittedArm
from bayescal.robots.markup import LARGEST, parse_markup
from bayescal.robots.tree import TURNING, UNLIMITED, Tree, read_tree, tip_of
from bayescal.storage.reading import decoded

CLOSE = 1e-9
"""m: difference of the written file's kinematics from the model's geometry at which it is not handed out."""
BALL = 0.05
"""m: radius of the homogeneous ball whose inertia a link of a new file has; gravity does not depend on it."""


def write(arm: FittedArm, options: Options) -> Written:
    """The URDF of an arm in one state."""
    calibrated = geometry_of(arm, options.state)
    text, names, details, notes = (
        _patched(arm, calibrated, options.into) if options.into else _new(arm, calibrated, options)
    )
    return Written(
        text,
        items(arm, [(f"joint[@name='{name}']/origin", "xyz, rpy") for name in names]),
        details=details,
        notes=(*notes, *coupled(np.array(details["joint_from_reading"]))),
        placed=partial(_moved, text, path_of(options.into)[0].parent) if options.into else None,
    )


def file_arm(tree: Tree, tip: str) -> FileArm:
    """The moving joints of a URDF from its root to a tip, at zero."""
    names, frames, axes, fixed = [], [], [], []
    pose, since = np.eye(4), np.eye(4)
    for joint in tree.above(tip):
        if joint.mimic or joint.kind not in (*TURNING, "fixed"):
            what = f"joint {joint.name} {'follows another joint' if joint.mimic else f'is {joint.kind}'}"
            remedy = f"choose a tip before it, as in --into {tree.file}#{joint.parent}"
            raise BayescalError(what, tree.file, remedy)
        pose = pose @ joint.place
        if joint.kind == "fixed":
            since = since @ joint.place
            continue
        names.append(joint.name)
        frames.append(pose)
        axes.append(joint.axis)
        fixed.append(since)
        since = np.eye(4)
    return FileArm(
        tuple(names),
        np.array(frames).reshape(-1, 4, 4),
        np.array(axes).reshape(-1, 3),
        np.array(fixed).reshape(-1, 4, 4),
        since,
    )


def _patched(
    arm: FittedArm, calibrated: np.ndarray, into: str
) -> tuple[str, tuple[str, ...], dict[str, Any], tuple[str, ...]]:
    path, asked = path_of(into)
    if path.suffix.lower() == ".xacro":
        raise BayescalError(
            "a xacro file cannot be patched", str(path), "expand it: xacro arm.xacro > arm.urdf"
        )
    xml = XmlText(decoded(path, LARGEST)[0], path.name)
    tree = read_tree(xml.root, path.name)
    tip = tip_of(tree, asked)
    file, robot = file_arm(tree, tip), arm.dataset.robot
    matched = match(robot, file, path.name)
    links = calibrated[:-1] @ matched.links
    before = np.concatenate([np.linalg.inv(matched.root)[None] @ np.eye(4), np.linalg.inv(links[:-1])])
    origins = np.linalg.inv(file.fixed) @ before @ links
    joints = {joint.get("name"): joint for joint in xml.root.findall("joint")}
    for name, t in zip(file.names, origins, strict=True):
        _place(joints[name], t)
    text = xml.text
    again = read_tree(parse_markup(text.encode(), path.name), path.name)
    flange_in_tip = np.linalg.inv(links[-1] @ file.tip) @ calibrated[-1]
    _check(arm, calibrated, file_arm(again, tip), matched.root, matched.signs, flange_in_tip, path.name)
    by_reading = matched.signs[:, None] * robot.link_from_reading
    details = {
        "into": path.name,
        "tip": tip,
        "joints": dict(zip(robot.joint_names, file.names, strict=True)),
        "signs": matched.signs.tolist(),
        "joint_from_reading": by_reading.tolist(),
        "root_in_f0": matched.root.tolist(),
        "flange_in_tip": flange_in_tip.tolist(),
    }
    return text, file.names, details, matched.notes


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


def _check(
    arm: FittedArm, calibrated: np.ndarray, file: FileArm, root: np.ndarray, signs: np.ndarray,
    flange_in_tip: np.ndarray, name: str,
) -> None:  # fmt: skip
    """Compare the kinematics of the written text, read again, with the model's at poses of the session."""
    turns = joint_angles(arm.dataset.robot, arm.dataset.measurements.readings)
    ours = at_zero_poses(calibrated, turns)
    out = np.tile(root, (len(turns), 1, 1))
    before = np.linalg.inv(np.concatenate([np.eye(4)[None], file.frames[:-1]]))
    for k, step in enumerate(before @ file.frames):
        out = out @ step @ _spins(file.axes[k], signs[k] * turns[:, k])
    theirs = out @ file.tip @ flange_in_tip
    off = float(np.abs(theirs - ours).max(initial=0.0))
    if not off < CLOSE:
        what = f"the written file moves by {off:.1e} m (or rad) from the calibrated geometry"
        raise BayescalError(what, name, "this is a defect of bayescal; nothing is written")


def _spins(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations (C, 4, 4) about a unit vector."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.tile(np.eye(4), (len(angle), 1, 1))
    out[:, :3, :3] += np.sin(angle)[:, None, None] * skew + (1 - np.cos(angle))[:, None, None] * (skew @ skew)
    return out


def _new(
    arm: FittedArm, calibrated: np.ndarray, options: Options
) -> tuple[str, tuple[str, ...], dict[str, Any], tuple[str, ...]]:
    robot, name = arm.dataset.robot, options.name
    delta = constant_displacements(arm.model, arm.values, options.state)
    sense = np.where(np.diag(robot.link_from_reading) < 0, -1.0, 1.0)
    most = [np.full(robot.n, np.nan) if x is None else x for x in (robot.torques, robot.velocities)]
    free = " and ".join(
        what for what, each in zip(("effort", "velocity"), most, strict=True) if np.any(np.isnan(each))
    )
    remark = (
        [f"  <!-- {free} of {UNLIMITED:g}: not stated by the robot; a URDF must have a number -->"]
        if free
        else []
    )
    effort, velocity = (np.where(np.isnan(x), UNLIMITED, x).tolist() for x in most)
    lines = [
        '<?xml version="1.0"?>',
        f"<robot name={quoteattr(name)}>",
        *remark,
        '  <link name="base_link"/>',
    ]
    before = "base_link"
    for k, (step, joint) in enumerate(zip(steps(calibrated)[:-1], robot.joint_names, strict=True)):
        link = f"{joint}_link"
        low, high = map(float, robot.limits[k])
        lines += [
            f'  <joint name={quoteattr(joint)} type="revolute">',
            f"    {_origin(step)}",
            f"    <parent link={quoteattr(before)}/>",
            f"    <child link={quoteattr(link)}/>",
            f'    <axis xyz="0 0 {sense[k]:g}"/>',
            f'    <limit lower="{low!r}" upper="{high!r}" '
            f'effort="{effort[k]!r}" velocity="{velocity[k]!r}"/>',
            "  </joint>",
            *_link(robot, delta, k, link),
        ]
        before = link
    lines += [
        '  <joint name="flange_joint" type="fixed">',
        f"    {_origin(steps(calibrated)[-1])}",
        f"    <parent link={quoteattr(before)}/>",
        '    <child link="flange"/>',
        "  </joint>",
        '  <link name="flange"/>',
        "</robot>",
    ]
    text = "\n".join(lines) + "\n"
    tree = read_tree(parse_markup(text.encode(), name), name)
    _check(arm, calibrated, file_arm(tree, "flange"), np.eye(4), sense, np.eye(4), name)
    details = {
        "tip": "flange",
        "joints": {joint: joint for joint in robot.joint_names},
        "signs": sense.tolist(),
        "joint_from_reading": (sense[:, None] * robot.link_from_reading).tolist(),
        "root_in_f0": np.eye(4).tolist(),
        "flange_in_tip": np.eye(4).tolist(),
    }
    return text, robot.joint_names, details, (remark[0].strip(" <!->"),) if remark else ()


def _origin(step: np.ndarray) -> str:
    return f'<origin xyz="{numbers(step[:3, 3])}" rpy="{numbers(rpy_of(step[:3, :3]))}"/>'


def _link(robot: Robot, delta: np.ndarray, k: int, name: str) -> list[str]:
    """A link with its mass."""
    if robot.masses is None:
        return [f"  <link name={quoteattr(name)}/>"]
    centre, mass = centre_in_frame(robot, chain_of(robot), delta, k), float(robot.masses[k])
    inertia = 0.4 * mass * BALL**2
    return [
        f"  <link name={quoteattr(name)}>",
        "    <inertial>",
        f'      <origin xyz="{numbers(centre)}" rpy="0 0 0"/>',
        f'      <mass value="{mass!r}"/>',
        f"      <!-- assumed: a homogeneous ball of {1e3 * BALL:g} mm radius -->",
        f'      <inertia ixx="{inertia!r}" iyy="{inertia!r}" izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/>',
        "    </inertial>",
        "  </link>",
    ]


URDF = Format(
    "urdf",
    ".urdf",
    "URDF, new or patched in place: origins of the joints",
    write,
    lambda arm, k: constant(arm.model.parameters[k]),
    "a URDF holds constant geometry only",
    into=True,
)
"""Geometry and joint zeros, for anything that reads a URDF."""
