"""A URDF in MuJoCo and in Pinocchio: the kinematics of its constant geometry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.effects.tool import TOOL
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import constant
from bayescal.exporting.sidecar import AGAIN, mujoco, pinocchio
from bayescal.fitted.arm import FittedArm
from bayescal.robots.markup import parse_markup
from bayescal.verifying.levels import LIMITS, Level, chosen, modelled

SHOWN = ("visual", "collision")
"""Elements that need files of meshes."""
Poses = Callable[[np.ndarray], np.ndarray]
"""Poses (C, 4, 4) of the tip in the root of a file, at angles (C, n) of its joints, rad."""


def held(arm: FittedArm) -> FittedArm:
    """The arm with the parameters that a URDF holds; others are nominal."""
    own = [constant(p) or p.effect == TOOL.name for p in arm.model.parameters]
    return arm.valued(np.where(own, arm.values, 0.0))


def tool_points(arm: FittedArm, poses: Poses, sidecar: Mapping[str, Any], rows: np.ndarray) -> np.ndarray:
    """TCP positions (C, 3), m, in F0, in rows of the session."""
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
    root = parse_markup(text.encode(), where)
    for link in root.iter("link"):
        for tag in SHOWN:
            for element in link.findall(tag):
                link.remove(element)
    joints, out, missing = list(sidecar["joints"].values()), {}, None
    for name, (module, kinematics) in SIMULATORS.items():
        try:
            own = module()
        except BayescalError as error:
            missing = error
            continue
        out[f"{name} {own.__version__}"] = kinematics(own, root, joints, sidecar["tip"], where)
    if missing is not None and not out:
        raise missing
    return out


def _in_mujoco(mj: Any, root: ET.Element, joints: list[str], tip: str, where: str) -> Poses:
    own = ET.fromstring(ET.tostring(root))
    ET.SubElement(ET.SubElement(own, "mujoco"), "compiler", fusestatic="false", balanceinertia="true",
                  boundmass="1e-6", boundinertia="1e-9")  # fmt: skip
    try:
        model = mj.MjModel.from_xml_string(ET.tostring(own, encoding="unicode"))
        addresses = [model.joint(name).qposadr[0] for name in joints]
        body = model.body(tip).id
    except (ValueError, KeyError) as error:
        raise BayescalError(f"MuJoCo refuses the file: {error}", where, AGAIN) from None
    data = mj.MjData(model)

    def poses(angles: np.ndarray) -> np.ndarray:
        out = np.tile(np.eye(4), (len(angles), 1, 1))
        for k, own in enumerate(angles):
            data.qpos[addresses] = own
            mj.mj_kinematics(model, data)
            out[k, :3, :3], out[k, :3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        return out

    return poses


def _in_pinocchio(pin: Any, root: ET.Element, joints: list[str], tip: str, where: str) -> Poses:
    try:
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise BayescalError(f"Pinocchio refuses the file: {error}", where, AGAIN) from None
    for known, kind, names in ((model.existJointName, "joint", joints), (model.existFrame, "link", [tip])):
        for name in names:
            if not known(name):
                raise BayescalError(f"Pinocchio finds no {kind} `{name}`", where, AGAIN)
    data, frame = model.createData(), model.getFrameId(tip)
    moving = [model.joints[model.getJointId(name)] for name in joints]

    def poses(angles: np.ndarray) -> np.ndarray:
        out = []
        for own in angles.tolist():
            q = pin.neutral(model)
            for joint, angle in zip(moving, own, strict=True):
                # a continuous joint has the cosine and the sine of its angle
                q[joint.idx_q : joint.idx_q + joint.nq] = (
                    angle if joint.nq == 1 else (np.cos(angle), np.sin(angle))
                )
            pin.framesForwardKinematics(model, data, q)
            out.append(data.oMf[frame].homogeneous.copy())
        return np.array(out)

    return poses


SIMULATORS = {"MuJoCo": (mujoco, _in_mujoco), "Pinocchio": (pinocchio, _in_pinocchio)}
"""Module and kinematics of each simulator of a URDF."""


def urdf_levels(
    arm: FittedArm, found: Mapping[str, Poses], sidecar: Mapping[str, Any], state: int
) -> tuple[Level, ...]:
    """Differences from the model of what a URDF holds, by simulator."""
    rows, own = chosen(arm), held(arm)
    model = modelled(own, rows, arm.dataset.measurements.readings[rows], state)
    return tuple(
        Level(
            f"geometry, {name}",
            np.linalg.norm(tool_points(arm, poses, sidecar, rows) - model, axis=1),
            LIMITS["geometry"],
        )
        for name, poses in found.items()
    )
