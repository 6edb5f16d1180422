"""The arm in a user's file: its joints from the world to the tip, and the elements of its bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.arm.robot import Robot
from bayescal.arm.transforms import rigid
from bayescal.errors import BayescalError
from bayescal.exporting.engine import mujoco
from bayescal.exporting.mjcf.into.scene_file import SceneFile
from bayescal.exporting.same_arm import FileArm

FORBIDDEN = ("freejoint", "frame", "composite", "flexcomp")
"""Elements that may not be among the bodies of the arm."""


@dataclass(frozen=True)
class FoundArm:
    """The joints of an arm and the bodies that they move, as elements and as compiled.

    `file` is the arm at zero: frames with their origins on the axes of the joints. `anchors` (n, 3) are these
    origins in the frames of the bodies, `references` (n,) the joints' values as the file is written, rad.
    `steps` (n, 4, 4) stand in the file between the body of the joint before and the parent of each body.
    `parents` are those of all elements.
    """

    file: FileArm
    bodies: tuple[ET.Element, ...]
    joints: tuple[ET.Element, ...]
    ids: tuple[int, ...]  # of the bodies
    anchors: np.ndarray
    references: np.ndarray
    steps: np.ndarray
    parents: Mapping[ET.Element, ET.Element]


def find_arm(scene: SceneFile, model: Any, robot: Robot, tip: str) -> FoundArm:
    """Find the arm of a robot in a file.

    Parameters
    ----------
    scene : SceneFile
    model : MjModel
        Of the same file.
    robot : Robot
    tip : str
        Name of its last body, or of one that this carries; "" for the longest chain of hinges.

    Raises
    ------
    BayescalError
        If there is no such chain, or it is made of parts that cannot be patched.
    """
    mj = mujoco()
    where = scene.path.name
    named = {e.get("name"): e for e in scene.root.iter("body") if e.get("name")}
    end = _end(model, robot, tip, where)
    chain = [b for b in _above(model, end) if model.body_jntnum[b]]
    for b in chain:
        first, count = int(model.body_jntadr[b]), int(model.body_jntnum[b])
        if count > 1 or model.jnt_type[first] != mj.mjtJoint.mjJNT_HINGE:
            has = "several joints" if count > 1 else "a joint that is no hinge"
            what = f"body {model.body(b).name} has {has}"
            raise BayescalError(what, where, f"give the file of the arm {robot.name} on a fixed base")
    ids = tuple(chain[: robot.n])
    missing = [b for b in ids if model.body(b).name not in named]
    if missing:
        raise BayescalError("a body of the arm has no name", where, "name the bodies of the arm")
    elements = tuple(named[model.body(b).name] for b in ids)
    parents = {child: e for e in scene.root.iter() for child in e}
    _check_parents(parents, elements, where)
    data = mj.MjData(model)
    addresses = [int(model.body_jntadr[b]) for b in ids]
    data.qpos[[model.jnt_qposadr[j] for j in addresses]] = 0.0
    mj.mj_kinematics(model, data)
    pose = np.array([rigid(data.xmat[b].reshape(3, 3), data.xpos[b]) for b in range(model.nbody)])
    anchors, axes = model.jnt_pos[addresses].copy(), model.jnt_axis[addresses].copy()
    frames = np.array([pose[b] @ rigid(None, a) for b, a in zip(ids, anchors, strict=True)])
    steps = [
        np.linalg.inv(pose[before]) @ pose[int(model.body_parentid[b])]
        for before, b in zip((0, *ids[:-1]), ids, strict=True)
    ]
    names = tuple(model.joint(j).name for j in addresses)
    file = FileArm(names, frames, axes, np.array(steps), np.linalg.inv(frames[-1]) @ pose[end])
    joints = tuple(next(e for e in body if e.tag == "joint") for body in elements)
    references = np.array([model.qpos0[model.jnt_qposadr[j]] for j in addresses])
    return FoundArm(file, elements, joints, ids, anchors, references, np.array(steps), parents)


def _above(model: Any, body: int) -> list[int]:
    """Bodies from the world to a body."""
    out = [body]
    while body:
        body = int(model.body_parentid[body])
        out.insert(0, body)
    return out


def _end(model: Any, robot: Robot, tip: str, where: str) -> int:
    """The body that ends the arm."""
    mj = mujoco()
    if tip:
        body = mj.mj_name2id(model, mj.mjtObj.mjOBJ_BODY, tip)
        if body < 0:
            raise BayescalError(f"there is no body `{tip}`", where, "name the last body of the arm")
        return int(body)
    count = [sum(int(model.body_jntnum[a]) for a in _above(model, b)) for b in range(model.nbody)]
    ends = [b for b in range(model.nbody) if count[b] == robot.n and model.body_jntnum[b]]
    if len(ends) != 1:
        what = f"{len(ends)} chains of {robot.n} joints" if ends else f"no chain of {robot.n} joints"
        remedy = f"name the last body of the arm, as in --into {where}#wrist_3_link"
        raise BayescalError(f"the file has {what}", where, remedy)
    return ends[0]


def _check_parents(
    parent: Mapping[ET.Element, ET.Element], elements: tuple[ET.Element, ...], where: str
) -> None:
    """Refuse a frame element or a composite among the bodies of the arm."""
    for element in elements:
        if any(child.tag in FORBIDDEN for child in element) or parent[element].tag == "frame":
            what = f"body {element.get('name')} is in or has a <frame>, or a part made by MuJoCo"
            raise BayescalError(what, where, "write the poses of the bodies themselves")
