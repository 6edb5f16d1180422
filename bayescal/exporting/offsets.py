"""Corrections of the joint zeros: as a table, and in the files of controllers with one offset for each joint.

The true reading of a joint is what the controller shows plus its correction. Of coupled axes, corrections of
the links are converted to those of the readings.

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

from bayescal.arm.transforms import AXES
from bayescal.dataset.table import csv_text
from bayescal.errors import BayescalError, listed
from bayescal.exporting.geometry import at_state, constant
from bayescal.exporting.written import Format, Item, Options, Written, item
from bayescal.exporting.xml_text import indented, rendered
from bayescal.fitted.arm import FittedArm
from bayescal.robots.servos import STEPS, of_joints, read_calibration
from bayescal.storage.reading import read_json

TURN = 2.0 * np.pi  # rad
LIMITS = "a controller's offsets hold the zeros of the joints only"


def zeros(arm: FittedArm, state: int) -> tuple[np.ndarray, np.ndarray]:
    """Corrections (n,) of the readings, rad, and their covariance (n, n)."""
    robot = arm.dataset.robot
    by = np.zeros((robot.n, len(arm.values)))
    for k, p in enumerate(arm.model.parameters):
        for t in at_state(p, state).terms if holds(arm, k) else ():
            by[t.frame - 1, k] += float(t.driver)
    by = np.linalg.solve(robot.link_from_reading, by)
    return by @ arm.values, by @ arm.covariance @ by.T


def holds(arm: FittedArm, k: int) -> bool:
    """Whether a parameter turns joints about their axes, and does nothing else."""
    p, n = arm.model.parameters[k], arm.model.scene.chain.n
    return constant(p) and all(t.axis == AXES[0] and 1 <= t.frame <= n for t in p.terms)


def items(arm: FittedArm, element: str, attribute: str) -> list[Item]:
    """The parameters in a file of offsets; `element` has the name of the joint in place of ``{}``."""
    names, parameters = arm.dataset.robot.joint_names, arm.model.parameters
    return [
        item(arm, k, element.format(names[p.terms[0].frame - 1]), attribute)
        for k, p in enumerate(parameters)
        if holds(arm, k)
    ]


def undetermined(arm: FittedArm, covariance: np.ndarray) -> list[str]:
    """A note on the joints whose zeros, of covariance (n, n), are not identifiable."""
    variances = zip(arm.dataset.robot.joint_names, np.diag(covariance), strict=True)
    named = [name for name, variance in variances if variance <= 0.0]
    return [f"the zero of {', '.join(named)} is not identifiable and has no correction"] if named else []


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
    return Written(csv_text(header, rows), items(arm, "row of the joint", "correction"), notes=notes)


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
    left = np.degrees((steps - whole) * TURN / STEPS)
    remainder = {name: float(f"{x:.6g}") for name, x in zip(joints, left.tolist(), strict=True)}
    notes = [
        *undetermined(arm, covariance),
        f"corrections are rounded to a step of {360 / STEPS:.3f} deg; the remainder is at most "
        f"{np.abs(left).max():.3f} deg ({joints[int(np.argmax(np.abs(left)))]})",
        "the ranges are as they were: the arm stops that much earlier or later",
        "LeRobot divides a turn by 4095: its degrees stay too large by 0.024 %",
    ]
    inverted = [servo.name for servo in servos if servo.drive_mode and sign < 0]
    if inverted:
        what = (
            f"{listed(inverted)}: drive_mode 1 does not invert LeRobot's degrees, of which the file is; where"
        )
        notes.append(f"{what} values are normalised, change these offsets by as much to the other side")
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


FEETECH, DYNAMIXEL = (Format(".json", partial(_lerobot, sign), holds, LIMITS, into=True) for sign in (-1, 1))
"""The present calibration of LeRobot with new offsets: Feetech servos (SO-100, SO-101), Dynamixel (Koch)."""
ROS2_CONTROL = Format(".xml", _ros2_control, holds, LIMITS)
"""Transmissions with the corrections of the joint zeros."""
