"""A URDF in MuJoCo and in Pinocchio: the kinematics of its constant geometry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.effects.tool import TOOL
from bayescal.errors import BayescalError
from bayescal.exporting.displaced import constant
from bayescal.exporting.engine import mujoco, pinocchio
from bayescal.exporting.fitted import FittedArm
from bayescal.exporting.verify.levels import Level, chosen
from bayescal.exporting.verify.limits import LIMITS

SHOWN = ("visual", "collision")
"""Elements that need files of meshes."""
Poses = Callable[[np.ndarray], np.ndarray]
"""Poses (C, 4, 4) of the tip in the root of a file, at angles (C, n) of its joints, rad."""


def held(arm: FittedArm) -> FittedArm:
    """The arm with the parameters that a URDF holds; others are nominal."""
    own = [constant(p) or p.effect == TOOL.name for p in arm.model.parameters]
    return arm.valued(np.where(own, arm.values, 0.0))


def tool_points(arm: FittedArm, poses: Poses, sidecar: Mapping[str, Any], rows: np.ndarray) -> np.ndarray:
    """Tool points (C, 3), m, in F0, in rows of the session."""
    m = arm.dataset.measurements
    angles = m.readings[rows] @ np.array(sidecar["joint_from_reading"]).T
    flange = np.array(sidecar["root_in_f0"]) @ poses(angles) @ np.array(sidecar["flange_in_tip"])
    tips = 1e-3 * np.array([tool["centre_mm"] for tool in sidecar["tools"]])[m.tool[rows]]
    return (flange[:, :3, :3] @ tips[..., None])[..., 0] + flange[:, :3, 3]


def simulators(text: str, sidecar: Mapping[str, Any], where: str) -> dict[str, Poses]:
    """Kinematics of a file by each simulator that is installed, by its name.

    Raises
    ------
    BayescalError
        If none is installed, or one refuses the file.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise BayescalError(f"not XML: {error}", where, "export it again") from None
    for link in root.iter("link"):
        for tag in SHOWN:
            for element in link.findall(tag):
                link.remove(element)
    joints = list(sidecar["joints"].values())
    try:
        mj = mujoco()
    except BayescalError:
        return _in_pinocchio(root, joints, sidecar["tip"], where)
    out = {f"MuJoCo {mj.__version__}": _in_mujoco(root, joints, sidecar["tip"], where)}
    try:
        return out | _in_pinocchio(root, joints, sidecar["tip"], where)
    except BayescalError:
        return out


def _in_mujoco(root: ET.Element, joints: list[str], tip: str, where: str) -> Poses:
    mj: Any = mujoco()
    own = ET.fromstring(ET.tostring(root))
    ET.SubElement(ET.SubElement(own, "mujoco"), "compiler", fusestatic="false", balanceinertia="true",
                  boundmass="1e-6", boundinertia="1e-9")  # fmt: skip
    try:
        model = mj.MjModel.from_xml_string(ET.tostring(own, encoding="unicode"))
        addresses = [model.joint(name).qposadr[0] for name in joints]
        body = model.body(tip).id
    except (ValueError, KeyError) as error:
        raise BayescalError(f"MuJoCo refuses the file: {error}", where, "export it again") from None
    data = mj.MjData(model)

    def poses(angles: np.ndarray) -> np.ndarray:
        out = np.tile(np.eye(4), (len(angles), 1, 1))
        for k, own in enumerate(angles):
            data.qpos[addresses] = own
            mj.mj_kinematics(model, data)
            out[k, :3, :3], out[k, :3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        return out

    return poses


def _in_pinocchio(root: ET.Element, joints: list[str], tip: str, where: str) -> dict[str, Poses]:
    pin: Any = pinocchio()
    try:
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise BayescalError(f"Pinocchio refuses the file: {error}", where, "export it again") from None
    data, frame = model.createData(), model.getFrameId(tip)
    addresses = [model.joints[model.getJointId(name)].idx_q for name in joints]

    def poses(angles: np.ndarray) -> np.ndarray:
        out = []
        for own in angles:
            q = pin.neutral(model)
            q[addresses] = own
            pin.framesForwardKinematics(model, data, q)
            out.append(data.oMf[frame].homogeneous.copy())
        return np.array(out)

    return {f"Pinocchio {pin.__version__}": poses}


def urdf_levels(
    arm: FittedArm, found: Mapping[str, Poses], sidecar: Mapping[str, Any], state: int
) -> tuple[Level, ...]:
    """Differences from the model of what a URDF holds, by simulator."""
    rows, own = chosen(arm), held(arm)
    m, names = arm.dataset.measurements, [t.name for t in arm.dataset.tools]
    model = np.empty((len(rows), 3))
    for tool in np.unique(m.tool[rows]):
        mine = m.tool[rows] == tool
        model[mine] = own.at(m.readings[rows[mine]], tool=names[int(tool)], row=state).points
    return tuple(
        Level(
            f"geometry, {name}",
            np.linalg.norm(tool_points(arm, poses, sidecar, rows) - model, axis=1),
            LIMITS["geometry"],
        )
        for name, poses in found.items()
    )
