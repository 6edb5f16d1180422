"""Calibrations of servos in steps of 4096 a turn, as LeRobot's JSON files state them.

A servo shows ``actual - homing_offset`` (Feetech STS) or ``actual + homing_offset`` (Dynamixel X). LeRobot
chooses the offset so that the middle pose shows half a turn. A reading in degrees is zero in the middle of
`range_min` and `range_max`, and 360 deg are 4095 steps. A normalised one is -100 and 100 at the ends. Source:
lerobot 0.4.4, ``_normalize`` of ``motors_bus.py``, ``_get_half_turn_homings`` of Feetech and Dynamixel.
A turn has 4096 steps: LeRobot's degrees are too large by 1 part in 4095.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError, listed
from bayescal.storage.reading import read_json

STEPS = 4096
"""Steps per revolution of the encoders of common servos (Feetech STS, Dynamixel X)."""
STEP = 2.0 * np.pi / STEPS  # rad
OF_LEROBOT = (STEPS - 1) / STEPS
"""A true angle over what LeRobot states in degrees."""
KEYS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
GRIPPER = re.compile("gripper|finger|jaw|knuckle", re.IGNORECASE)
"""Names of joints that are not of the arm."""
LARGEST = 2**31
REMEDY = f"give the calibration that LeRobot wrote: {{joint: {{{', '.join(KEYS)}}}}}"


@dataclass(frozen=True)
class Servo:
    """A servo in a calibration: its name, and LeRobot's entries, in steps."""

    name: str
    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

    @property
    def middle(self) -> float:
        """Position at which the reading is zero, in steps."""
        return (self.range_min + self.range_max) / 2


def read_calibration(path: Path) -> tuple[Servo, ...]:
    """The servos of a calibration of LeRobot, in the order of the file.

    Raises
    ------
    BayescalError
        If it is no such file, or a range is empty.
    """
    content = read_json(path, REMEDY)
    if not isinstance(content, dict) or not content:
        raise BayescalError("not a calibration of servos", path.name, REMEDY)
    return tuple(_servo(name, entry, path.name) for name, entry in content.items())


def _servo(name: str, entry: Any, file: str) -> Servo:
    where = f"{file}: {name}"
    values = [entry.get(key) for key in KEYS] if isinstance(entry, dict) else [None]
    if not all(type(value) is int and abs(value) < LARGEST for value in values):
        raise BayescalError("not whole numbers for " + ", ".join(KEYS), where, REMEDY)
    servo = Servo(name, *values)
    if servo.range_min >= servo.range_max:
        raise BayescalError("`range_min` is not below `range_max`", where, "calibrate this joint again")
    return servo


def of_joints(servos: Iterable[Servo], joints: Sequence[str], file: str) -> tuple[Servo, ...]:
    """The servos of the joints of an arm: by name, else by id without the gripper.

    Raises
    ------
    BayescalError
        If names differ, and there are not as many servos as joints.
    """
    servos = tuple(servos)
    by_name = {servo.name: servo for servo in servos}
    if set(joints) <= set(by_name):
        return tuple(by_name[name] for name in joints)
    arm = sorted((s for s in servos if not GRIPPER.search(s.name)), key=lambda servo: servo.id)
    if len(arm) != len(joints):
        what = f"its joints are {listed([s.name for s in servos])}, those of the robot {listed(joints)}"
        raise BayescalError(what, file, "give the calibration of this arm")
    return tuple(arm)


def angles(values: np.ndarray, unit: str, servos: Sequence[Servo]) -> np.ndarray:
    """True angles (N, n), rad, of readings of LeRobot.

    Parameters
    ----------
    values : np.ndarray, shape (N, n)
        Positions of the servos in steps, or LeRobot's deg or normalised values.
    unit : str
        steps, deg, rad or normalised.
    servos : sequence of Servo
        One of each joint.

    Raises
    ------
    BayescalError
        Of normalised values of an inverted servo: LeRobot inverts those of some buses only.
    """
    if unit == "steps":
        return np.asarray((values - [servo.middle for servo in servos]) * STEP)
    if unit in ("deg", "rad"):
        return np.asarray((np.radians(values) if unit == "deg" else values) * OF_LEROBOT)
    if inverted := [servo.name for servo in servos if servo.drive_mode]:
        what = f"normalised values of {listed(inverted)} (drive_mode 1) have the other sign with some servos"
        raise BayescalError(what, "--calibration", "log `--map deg` or `--map steps`")
    span = np.array([servo.range_max - servo.range_min for servo in servos])
    return np.asarray(values / 200.0 * span * STEP)


def zero_shift(one: Servo, other: Servo) -> float:
    """How many steps a reading of the other calibration is above that of the first, at the same pose.

    Of Feetech servos; with Dynamixel servos the homing offsets have the opposite sign.
    """
    return (one.homing_offset + one.middle) - (other.homing_offset + other.middle)
