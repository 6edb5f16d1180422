"""Corrections of the joint zeros in the files of controllers that have one offset for each joint.

LeRobot: a calibration of servos (JSON) states `homing_offset` in steps, 4096 a turn. Feetech servos show
``actual - homing_offset``, Dynamixel X ``actual + homing_offset``: the correction is subtracted from the
present offset, or added to it (``_get_half_turn_homings`` of lerobot 0.4.4). The range of the joint stays.

ros2_control: of a ``transmission_interface/SimpleTransmission`` the position of the joint is that of the
actuator over `mechanical_reduction`, plus `offset`.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.joint_zeros import LIMITS, TURN, holds, items, undetermined, zeros
from bayescal.exporting.written import Format, Options, Written
from bayescal.exporting.xml_text import indented, rendered
from bayescal.fitted.arm import FittedArm
from bayescal.robots.servos import STEPS, of_joints, read_calibration
from bayescal.storage.reading import read_json

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
    left = np.degrees((steps - whole) * TURN / STEPS)
    remainder = {name: float(f"{x:.6g}") for name, x in zip(joints, left.tolist(), strict=True)}
    notes = [
        *undetermined(arm, covariance),
        f"corrections are rounded to a step of {360 / STEPS:.3f} deg; the remainder is at most "
        f"{np.abs(left).max():.3f} deg ({joints[int(np.argmax(np.abs(left)))]})",
        "the ranges are as they were: the arm stops that much earlier or later",
        "LeRobot divides a turn by 4095: its degrees stay too large by 0.024 %",
    ]
    text = json.dumps(content, indent=4) + "\n"
    details = {"remainder_deg": remainder}
    return Written(text, items(arm, "{}", "homing_offset"), notes=notes, details=details)


def _ros2_control(arm: FittedArm, options: Options) -> Written:
    correction, covariance = zeros(arm, options.state)
    offsets = zip(arm.dataset.robot.joint_names, correction.tolist(), strict=True)
    text = rendered("ros2_control.xml.j2", name=options.name, offsets=dict(offsets))
    notes = [
        *undetermined(arm, covariance),
        "copy the transmissions into the <ros2_control> of the arm; add the offset it has already",
        "mechanical_reduction is 1: of an actuator with a gear write its reduction; the offset stays",
    ]
    found = items(arm, "transmission/joint[@name='{}']", "offset")
    return Written('<?xml version="1.0"?>\n' + indented(text), found, notes=notes)


FEETECH, DYNAMIXEL = (
    Format(
        name, ".json", f"LeRobot calibration of {servos}", partial(_lerobot, sign), holds, LIMITS, into=True
    )
    for name, servos, sign in (
        ("lerobot", "Feetech servos (SO-100, SO-101)", -1),
        ("lerobot-dynamixel", "Dynamixel servos (Koch)", 1),
    )
)
"""The present calibration, with new offsets."""
ROS2_CONTROL = Format(
    "ros2-control", ".xml", "offsets of the joints in ros2_control", _ros2_control, holds, LIMITS
)
"""Transmissions with the corrections of the joint zeros."""
