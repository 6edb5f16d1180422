"""Readings of servos by LeRobot's calibration: as LeRobot's own rules give them, in each unit."""

import json

import numpy as np
import pytest
from cases import refused

from bayescal.errors import BayescalError
from bayescal.importing import Request, convert
from bayescal.robots.servos import angles, of_joints, read_calibration, zero_shift

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
RANGES = [(735, 3480), (810, 3260), (905, 3108), (840, 3231), (0, 4095), (2035, 3500)]
NAMES = (*JOINTS, "gripper")
CALIBRATION = {
    name: {"id": k, "drive_mode": 0, "homing_offset": 9 * k - 35, "range_min": low, "range_max": high}
    for k, name, (low, high) in zip(range(1, 7), NAMES, RANGES, strict=True)
}
# lerobot 0.4.4, `_normalize` of an sts3215 (resolution 4096): position in steps, deg, normalised
LEROBOT = {
    "shoulder_pan": (1200, -79.7802197802198, -66.120218579235),
    "elbow_flex": (2400, 34.5934065934066, 35.7240127099410),
    "wrist_roll": (3000, 83.7362637362637, 46.5201465201465),
}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "follower.json"
    path.write_text(json.dumps(CALIBRATION))
    return path


def test_units_of_lerobot_are_one_angle(file):
    servos = of_joints(read_calibration(file), JOINTS, file.name)
    for name, (steps, degrees, normalised) in LEROBOT.items():
        servo = [s for s in servos if s.name == name]
        true = np.radians((steps - sum(RANGES[JOINTS.index(name)]) / 2) * 360 / 4096)
        for unit, value in (("steps", steps), ("deg", degrees), ("normalised", normalised)):
            assert angles(np.array([[value]]), unit, servo)[0, 0] == pytest.approx(true, abs=1e-12)


def test_zeros_of_two_calibrations(file):
    """One pose, two homings: what LeRobot shows differs by the shift."""
    one = read_calibration(file)[1]
    other = type(one)(one.name, one.id, 0, one.homing_offset + 2048, one.range_min - 30, one.range_max + 10)
    actual = 1500
    shown = [actual - s.homing_offset - (s.range_min + s.range_max) / 2 for s in (one, other)]
    assert zero_shift(one, other) == shown[1] - shown[0] == -2038


def test_names_of_another_robot_follow_the_ids(file):
    servos = of_joints(reversed(read_calibration(file)), ("1", "2", "3", "4", "5"), file.name)
    assert [s.name for s in servos] == list(JOINTS)
    refused("those of the robot", lambda: of_joints(servos, ("J1", "J2"), file.name))


ENTRY = {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 9}


@pytest.mark.parametrize(("content", "words"), [
    ([], "not a calibration of servos"),
    ({"a": {"id": 1}}, "not whole numbers"),
    ({"a": ENTRY | {"homing_offset": 0.5}}, "not whole"),
    ({"a": ENTRY | {"range_min": 9}}, "not below"),
])  # fmt: skip
def test_other_files_are_refused(tmp_path, content, words):
    (tmp_path / "c.json").write_text(json.dumps(content))
    refused(words, lambda: read_calibration(tmp_path / "c.json"))


def test_inverted_servos_are_not_guessed(file):
    servo = type(s := read_calibration(file)[0])(s.name, 1, 1, 0, 100, 3000)
    refused("drive_mode 1", lambda: angles(np.zeros((1, 1)), "normalised", [servo]))


def table(path, steps):
    """A log of steps at 50 Hz in two motions."""
    rows = [f"{0.02 * i:.2f},{i // 60},{','.join(map(str, row))}" for i, row in enumerate(steps)]
    path.write_text("\n".join(["t,m," + ",".join(JOINTS), *rows]))
    return path


@pytest.mark.parametrize("calibrated", [False, True])
def test_a_log_in_steps(tmp_path, file, calibrated):
    wave = np.sin(0.05 * np.arange(120))[:, None]
    middles = np.array([sum(r) / 2 for r in RANGES[:5]]) if calibrated else np.full(5, 2048)
    steps = np.round(middles + wave * [300, 200, 250, 150, 400]).astype(int)
    named = ", ".join(f"j{k + 1}={name} steps" for k, name in enumerate(JOINTS))
    log = table(tmp_path / "log.csv", steps)
    usual = {"robot": "robotstudio-so101", "motions": "column", "map": f"time=t s, motion=m, {named}"}
    draft = convert(Request(log, calibration=file if calibrated else None, **usual))
    found = np.column_stack([draft.columns[f"q{k + 1}_deg"] for k in range(5)])
    np.testing.assert_allclose(found, (steps - middles) * 360 / 4096, atol=1e-9)
    if calibrated:
        with pytest.raises(BayescalError, match="no readings are in steps"):
            convert(Request(log, calibration=file, **(usual | {"map": usual["map"].replace("steps", "rad")})))
