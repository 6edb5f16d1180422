"""The calibration file of a Universal Robots arm, as ur_description and ur_robot_driver read it.

`kinematics:` has a transform for each link: its frame in that of the link before, at zero readings, as x, y,
z (m) and roll, pitch, yaw (rad). ur_description passes them to the ``<origin rpy>`` of its URDF, where they
are about fixed axes: R = Rz(yaw) Ry(pitch) Rx(roll). F0 is the controller's base, that of base_link_inertia.
The driver compares `hash` with that of the connected arm and warns of a difference; a given file keeps its
own.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rigid, rotation, rpy_matrix, rpy_of
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import constant, constant_displacements, items, steps, zero_frames
from bayescal.exporting.same_arm import FileArm, match
from bayescal.exporting.written import Format, Options, Written, path_of
from bayescal.fitted.arm import FittedArm
from bayescal.storage.files import read_document

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
TWISTS = np.radians([0.0, 90.0, 0.0, 0.0, 90.0, -90.0])
"""Rotation about x from each frame to the next of every arm of the manufacturer, rad."""
ALIKE = np.radians(1.0)


def _write(arm: FittedArm, options: Options) -> Written:
    robot = arm.dataset.robot
    _check_is_ur(robot)
    calibrated = zero_frames(robot, constant_displacements(arm.model, arm.values, options.state))
    label, root, in_links = "", np.eye(4), np.tile(np.eye(4), (6, 1, 1))
    notes = ["without --into the hash is not that of the arm: ur_robot_driver warns that it differs"]
    if options.into:
        file, label, name = _read(options.into)
        matched = match(robot, file, name)
        root, in_links, notes = matched.root, matched.links, list(matched.notes)
    links = calibrated[:-1] @ in_links
    transforms = steps(links, root)
    lines = [f"# {robot.name} calibrated on {arm.dataset.name}: {', '.join(arm.effects)}", "kinematics:"]
    for link, t in zip(LINKS, transforms, strict=True):
        values = [*t[:3, 3].tolist(), *rpy_of(t[:3, :3]).tolist()]
        lines += [f"  {link}:", *(f"    {key}: {v + 0.0!r}" for key, v in zip(KEYS, values, strict=True))]
    lines.append(f"  hash: {label or f'calib_bayescal_{arm.dataset.sha256[:12]}'}")
    return Written(
        "\n".join(lines) + "\n",
        items(arm, [(f"kinematics/{link}", "x y z roll pitch yaw") for link in LINKS]),
        notes=notes,
        details={
            "joint_from_reading": robot.link_from_reading.tolist(),
            "root_in_f0": root.tolist(),
            "tip": "tool0",
            "flange_in_tip": (np.linalg.inv(links[-1]) @ calibrated[-1]).tolist(),
        },
    )


def _check_is_ur(robot: Robot) -> None:
    """Refuse an arm whose joints are not arranged as those of a UR."""
    ok = robot.n == 6 and np.array_equal(robot.link_from_reading, np.eye(6))
    if ok:
        first, *turns = rotation(0, -TWISTS) @ steps(zero_frames(robot))[:-1, :3, :3]
        alike = Rotation.from_matrix(np.array(turns)).magnitude() < ALIKE
        ok = abs(first[2, 2] - 1.0) < ALIKE and bool(np.all(alike))
    if not ok:
        what = f"{robot.name} is no arm of Universal Robots: its joints are arranged differently"
        raise BayescalError(what, "--to ur-yaml", "choose urdf")


def _read(into: str) -> tuple[FileArm, str, str]:
    """A given calibration file: its arm, its hash, its name."""
    path, _ = path_of(into)
    data = read_document(path).data
    try:
        each = data["kinematics"]
        values = np.array([[float(each[link][key]) for key in KEYS] for link in LINKS])
        label = str(each["hash"])
        if not np.all(np.isfinite(values)):
            raise ValueError("a number is not finite")
    except (KeyError, TypeError, ValueError) as error:
        what = f"no calibration of ur_robot_driver: {error!r}"
        raise BayescalError(what, path.name, "give the file that ur_calibration wrote") from None
    pose, frames = np.eye(4), []
    for x in values:
        pose = pose @ rigid(rpy_matrix(x[3:]), x[:3])
        frames.append(pose)
    none = np.tile(np.eye(4), (6, 1, 1))
    axes = np.tile([0.0, 0.0, 1.0], (6, 1))
    return FileArm(LINKS, np.array(frames), axes, none, np.eye(4), np.zeros(6, bool)), label, path.name


UR_YAML = Format(
    ".yaml",
    _write,
    lambda arm, k: constant(arm.model.parameters[k]),
    "the calibration of ur_description holds constant geometry only",
    into=True,
)
"""kinematics_params of ur_description, new or with the hash and frames of a given file."""
