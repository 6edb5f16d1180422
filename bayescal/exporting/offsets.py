"""Corrections of the joint zeros: as a table, and in the files of controllers with one offset for each joint.

The true reading of a joint is what the controller shows plus its correction. Of coupled axes, corrections of
the links are converted to those of the readings.

LeRobot: a calibration of servos (JSON) states `homing_offset` in steps, 4096 a turn. Feetech servos show
``actual - homing_offset``, Dynamixel X ``actual + homing_offset``: the correction is subtracted from the
present offset, or added to it (``_get_half_turn_homings`` of lerobot 0.4.4). The range of the joint stays.

ros2_control: of a ``transmission_interface/SimpleTransmission`` the position of the joint is that of the
actuator over `mechanical_reduction`, plus `offset`.

The calibration file of a Universal Robots arm, as ur_description and ur_robot_driver read it.

`kinematics:` has a transform for each link: its frame in that of the link before, at zero readings, as x, y,
z (m) and roll, pitch, yaw (rad). ur_description passes them to the ``<origin rpy>`` of its URDF, where they
are about fixed axes: R = Rz(yaw) Ry(pitch) Rx(roll). F0 is the controller's base, that of base_link_inertia.
The driver compares `hash` with that of the connected arm and warns of a difference; a given file keeps its
own.
"""

import json
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import AXES, rigid, rotation, rpy_matrix, rpy_of
from bayescal.dataset.table import csv_text
from bayescal.errors import BayescalError, listed
from bayescal.exporting import geometry
from bayescal.exporting.same_arm import FileArm, match
from bayescal.exporting.written import Format, Item, Options, Written, item, path_of
from bayescal.exporting.xml_text import indented, rendered
from bayescal.fitted.arm import FittedArm
from bayescal.robots.servos import STEPS, of_joints, read_calibration
from bayescal.storage.files import read_document
from bayescal.storage.reading import read_json

TURN = 2.0 * np.pi  # rad
LIMITS = "a controller's offsets hold the zeros of the joints only"


def zeros(arm: FittedArm, state: int) -> tuple[np.ndarray, np.ndarray]:
    """Corrections (n,) of the readings, rad, and their covariance (n, n)."""
    robot = arm.dataset.robot
    by = np.zeros((robot.n, len(arm.values)))
    for k, p in enumerate(arm.model.parameters):
        for t in geometry.at_state(p, state).terms if holds(arm, k) else ():
            by[t.frame - 1, k] += float(t.driver)
    by = np.linalg.solve(robot.link_from_reading, by)
    return by @ arm.values, by @ arm.covariance @ by.T


def holds(arm: FittedArm, k: int) -> bool:
    """Whether a parameter turns joints about their axes, and does nothing else."""
    p, n = arm.model.parameters[k], arm.model.scene.chain.n
    return geometry.constant(p) and all(t.axis == AXES[0] and 1 <= t.frame <= n for t in p.terms)


def corrections(arm: FittedArm, element: str, attribute: str) -> list[Item]:
    """The parameters in a file of offsets; `element` has the name of the joint in place of ``{}``."""
    names = arm.dataset.robot.joint_names
    joints = ((k, p.terms[0].frame - 1) for k, p in enumerate(arm.model.parameters) if holds(arm, k))
    return [item(arm, k, element.format(names[j]), attribute) for k, j in joints]


def undetermined(arm: FittedArm, covariance: np.ndarray) -> list[str]:
    """A note on the joints whose zeros, of covariance (n, n), are not identifiable."""
    variances = zip(arm.dataset.robot.joint_names, np.diag(covariance), strict=True)
    named = [name for name, variance in variances if variance <= 0.0]
    return [f"not identifiable, without correction: the zero of {', '.join(named)}"] if named else []


def _table(arm: FittedArm, options: Options) -> Written:
    robot = arm.dataset.robot
    correction, covariance = zeros(arm, options.state)
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    rows = (
        [name, *(repr(float(x)) for x in (np.degrees(c), np.degrees(sd), c, sd)), round(c / TURN * STEPS)]
        for name, c, sd in zip(robot.joint_names, correction.tolist(), u.tolist(), strict=True)
    )
    header = ["joint", "correction_deg", "u_deg", "correction_rad", "u_rad", f"correction_ticks_{STEPS}"]
    sign = "true reading = reading shown + correction; see docs/export.md for the sign of an offset"
    notes = [*undetermined(arm, covariance), sign]
    return Written(csv_text(header, rows), corrections(arm, "row of the joint", "correction"), notes=notes)


JOINT_ZEROS = Format(".csv", _table, holds, LIMITS)
"""Offsets of the joints for a controller, as in the files of LeRobot or TALOS."""


LARGEST_OFFSET = 2047
"""Steps: what a Feetech servo stores of `homing_offset`, beside its sign."""


def _lerobot(sign: int, arm: FittedArm, options: Options) -> Written:
    """A calibration whose offsets change by `sign` times the corrections."""
    if not options.into:
        what = "an offset is relative to that of the present calibration"
        raise BayescalError(what, "--to lerobot", "give it: `--into follower.json`")
    path, joints = Path(options.into), arm.dataset.robot.joint_names
    servos = of_joints(read_calibration(path), joints, path.name)
    content = read_json(path, "give the calibration that LeRobot wrote")
    correction, covariance = zeros(arm, options.state)
    steps = correction / TURN * STEPS
    whole = np.round(steps).astype(int)
    for servo, change in zip(servos, whole.tolist(), strict=True):
        offset = servo.homing_offset + sign * change
        offset = (offset + STEPS // 2) % STEPS - STEPS // 2 if abs(offset) > LARGEST_OFFSET else offset
        if abs(offset) > LARGEST_OFFSET:
            what = f"the offset of {servo.name} would be half a turn, {offset} steps"
            raise BayescalError(what, path.name, "mount the horn of the servo turned, and calibrate it again")
        content[servo.name] = content[servo.name] | {"homing_offset": offset}
    rounding = np.degrees((steps - whole) * TURN / STEPS)
    remainder = {name: float(f"{x:.6g}") for name, x in zip(joints, rounding.tolist(), strict=True)}
    notes = [
        *undetermined(arm, covariance),
        f"corrections are rounded to a step of {360 / STEPS:.3f} deg; the remainder is at most "
        f"{np.abs(rounding).max():.3f} deg ({joints[int(np.argmax(np.abs(rounding)))]})",
        "the ranges are as they were: the arm stops that much earlier or later",
        "LeRobot divides a turn by 4095: its degrees stay too large by 0.024 %",
    ]
    inverted = [servo.name for servo in servos if servo.drive_mode and sign < 0]
    if inverted:
        what = f"{listed(inverted)}: drive_mode 1 does not invert LeRobot's degrees, of which the file is; "
        notes.append(f"{what}where values are normalised, change these offsets by as much to the other side")
    text = json.dumps(content, indent=4) + "\n"
    details = {"remainder_deg": remainder}
    return Written(text, corrections(arm, "{}", "homing_offset"), notes=notes, details=details)


def _ros2_control(arm: FittedArm, options: Options) -> Written:
    correction, covariance = zeros(arm, options.state)
    offsets = zip(arm.dataset.robot.joint_names, correction.tolist(), strict=True)
    text = rendered("ros2_control.xml.j2", name=options.name, offsets=dict(offsets))
    notes = [
        *undetermined(arm, covariance),
        "copy the transmissions into the <ros2_control> of the arm; add the offset it has already",
        "mechanical_reduction is 1: of an actuator with a gear write its reduction; the offset stays",
    ]
    entries = corrections(arm, "transmission/joint[@name='{}']", "offset")
    return Written('<?xml version="1.0"?>\n' + indented(text), entries, notes=notes)


FEETECH, DYNAMIXEL = (Format(".json", partial(_lerobot, sign), holds, LIMITS, into=True) for sign in (-1, 1))
"""The present calibration of LeRobot with new offsets: Feetech servos (SO-100, SO-101), Dynamixel (Koch)."""
ROS2_CONTROL = Format(".xml", _ros2_control, holds, LIMITS)
"""Transmissions with the corrections of the joint zeros."""


LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
TWISTS = np.radians([0.0, 90.0, 0.0, 0.0, 90.0, -90.0])
"""Rotation about x from each frame to the next of every arm of the manufacturer, rad."""
ALIKE = np.radians(1.0)


def _write(arm: FittedArm, options: Options) -> Written:
    robot = arm.dataset.robot
    _check_is_ur(robot)
    delta = geometry.constant_displacements(arm.model, arm.values, options.state)
    calibrated = geometry.zero_frames(robot, delta)
    label, root, in_links = "", np.eye(4), np.tile(np.eye(4), (6, 1, 1))
    notes = ["without --into the hash is not that of the arm: ur_robot_driver warns that it differs"]
    if options.into:
        file, label, name = _read(options.into)
        matched = match(robot, file, name)
        root, in_links, notes = matched.root, matched.links, list(matched.notes)
    links = calibrated[:-1] @ in_links
    transforms = geometry.steps(links, root)
    lines = [f"# {robot.name} calibrated on {arm.dataset.name}: {', '.join(arm.effects)}", "kinematics:"]
    for link, t in zip(LINKS, transforms, strict=True):
        values = [*t[:3, 3].tolist(), *rpy_of(t[:3, :3]).tolist()]
        lines += [f"  {link}:", *(f"    {key}: {v + 0.0!r}" for key, v in zip(KEYS, values, strict=True))]
    lines.append(f"  hash: {label or f'calib_bayescal_{arm.dataset.sha256[:12]}'}")
    details = {
        "joint_from_reading": robot.link_from_reading.tolist(),
        "root_in_f0": root.tolist(),
        "tip": "tool0",
        "flange_in_tip": (np.linalg.inv(links[-1]) @ calibrated[-1]).tolist(),
    }
    items = geometry.items(arm, [(f"kinematics/{link}", "x y z roll pitch yaw") for link in LINKS])
    return Written("\n".join(lines) + "\n", items, notes=notes, details=details)


def _check_is_ur(robot: Robot) -> None:
    """Refuse an arm whose joints are not arranged as those of a UR."""
    ok = robot.n == 6 and np.array_equal(robot.link_from_reading, np.eye(6))
    if ok:
        first, *turns = rotation(0, -TWISTS) @ geometry.steps(geometry.zero_frames(robot))[:-1, :3, :3]
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


OF_UR = "the calibration of ur_description holds constant geometry only"
UR_YAML = Format(".yaml", _write, geometry.holds_constants, OF_UR, into=True)
"""kinematics_params of ur_description, new or with the hash and frames of a given file."""
