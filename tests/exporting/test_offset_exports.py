"""Files of offsets and of differences, read back by the rules of the programs that use them."""

import json
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yaml
from cases import refused
from export_arms import fake, session_of
from test_urdf_export import LRMATE, POINT, expected, tip_points
from urdf_texts import words

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.transforms import rotation, rpy_matrix, rpy_of
from bayescal.errors import BayescalError
from bayescal.exporting.export import export

RANGES = [(735, 3480), (810, 3260), (905, 3108), (840, 3231), (1000, 3000), (0, 4095)]


@pytest.fixture(scope="module")
def arm():
    return fake(session_of(), ("joint",))


def flange_of_zeros(arm):
    """Poses of the flange with the fitted zeros alone, and readings."""
    readings = arm.dataset.measurements.readings
    zeros = np.array([p.unit == "rad" for p in arm.model.parameters])
    return arm.valued(np.where(zeros, arm.values, 0.0)).at(readings).flange, readings


def nominal_flange(arm, readings):
    robot = arm.dataset.robot
    return frames(chain_of(robot), link_angles(robot, readings))[:, -1]


def calibration(arm):
    names = (*arm.dataset.robot.joint_names, "gripper")
    return {
        name: {"id": k, "drive_mode": 0, "homing_offset": 50 * k - 900, "range_min": low, "range_max": high}
        for k, name, (low, high) in zip(range(1, 8), names, [*RANGES, (2000, 3400)], strict=True)
    }


@pytest.mark.parametrize(("to", "sign"), [("lerobot", -1), ("lerobot-dynamixel", 1)])
def test_lerobot(arm, tmp_path, to, sign):
    """The same actual positions, shown by the old and the new calibration."""
    old = calibration(arm)
    (tmp_path / "c.json").write_text(json.dumps(old))
    out = export(arm, to, into=str(tmp_path / "c.json"))
    new = json.loads(out.written.content)
    assert new["gripper"] == old["gripper"]
    shifts = []
    for name in arm.dataset.robot.joint_names:
        assert new[name] | {"homing_offset": old[name]["homing_offset"]} == old[name]
        shown = [2000 + sign * c[name]["homing_offset"] for c in (old, new)]
        shifts.append((shown[1] - shown[0]) * 2 * np.pi / 4096)
    truth, readings = flange_of_zeros(arm)
    left = np.radians(list(out.written.details["remainder_deg"].values()))
    assert 0 < np.abs(left).max() <= np.pi / 4096
    np.testing.assert_allclose(nominal_flange(arm, readings + shifts + left), truth, atol=1e-8)
    assert any("rounded to a step of 0.088 deg" in note for note in out.notes)
    _, sidecar = out.save(tmp_path / "new.json")
    assert json.loads(sidecar.read_text())["not_expressed"][0]["effect"] == "joint"


def test_an_inverted_servo_is_that_of_degrees(arm, tmp_path):
    """LeRobot inverts normalised values of Feetech servos, not degrees; Dynamixel ones invert themselves."""
    values = calibration(arm)
    name = arm.dataset.robot.joint_names[2]
    plain = {}
    for mode in (0, 1):
        values[name]["drive_mode"] = mode
        (tmp_path / "c.json").write_text(json.dumps(values))
        for to in ("lerobot", "lerobot-dynamixel"):
            out = export(arm, to, into=str(tmp_path / "c.json"))
            said = any("drive_mode 1" in note and name in note for note in out.notes)
            assert said == (mode == 1 and to == "lerobot")
            offset = json.loads(out.written.content)[name]["homing_offset"]
            assert plain.setdefault(to, offset) == offset


@pytest.mark.parametrize(("sign", "end"), [(1, -2047), (-1, 2047)])
def test_an_offset_stays_within_half_a_turn(arm, tmp_path, sign, end):
    """Beyond what a servo stores it goes on from the other end; exactly half a turn it does not store."""
    values = calibration(arm)
    for entry in values.values():
        entry["homing_offset"] = end
    (tmp_path / "c.json").write_text(json.dumps(values))
    of_j2 = np.array([p.terms[0].frame == 2 for p in arm.model.parameters])
    moved = replace(arm, values=np.where(of_j2, sign * 20 * 2 * np.pi / 4096, 0.0))
    new = json.loads(export(moved, "lerobot", into=str(tmp_path / "c.json")).written.content)
    offset = new[arm.dataset.robot.joint_names[1]]["homing_offset"]
    assert abs(offset) <= 2047
    assert (offset - (end - sign * 20)) % 4096 == 0
    with pytest.raises(BayescalError, match="half a turn"):
        export(replace(moved, values=moved.values / 20), "lerobot", into=str(tmp_path / "c.json"))


@pytest.mark.parametrize("to", ["lerobot", "pal"])
def test_a_difference_needs_what_it_is_relative_to(arm, to):
    refused("--into", lambda: export(arm, to))


def test_ros2_control(arm):
    """As SimpleTransmission: a joint is at actuator / mechanical_reduction + offset."""
    root = ET.fromstring(export(arm, "ros2-control", name='a"<b').written.content)
    assert root.get("name") == 'a"<b'
    parts = [(t.find("joint"), t.findtext("plugin")) for t in root.iter("transmission")]
    assert [j.get("name") for j, _ in parts] == list(arm.dataset.robot.joint_names)
    assert {plugin for _, plugin in parts} == {"transmission_interface/SimpleTransmission"}
    truth, readings = flange_of_zeros(arm)
    tags = ("mechanical_reduction", "offset")
    reduction, offset = (np.array([float(j.findtext(tag)) for j, _ in parts]) for tag in tags)
    np.testing.assert_allclose(nominal_flange(arm, readings / reduction + offset), truth, atol=1e-12)


def test_pal(tmp_path):
    """The entries added to the origins, as robot_state_publisher does; then Pinocchio."""
    arm = fake(session_of(), ("geometry", "compliance"))
    (tmp_path / "arm.urdf").write_text(LRMATE)
    out = export(arm, "pal", into=str(tmp_path / "arm.urdf#tool0"))
    entries = yaml.safe_load(out.written.content)["robot_state_publisher"]["geometric_calibration"]
    root, used = ET.fromstring(LRMATE), 0
    for joint in root.iter("joint"):
        origin = joint.find("origin")
        for attribute, keys in (("xyz", ("dx", "dy", "dz")), ("rpy", ("droll", "dpitch", "dyaw"))):
            stem = joint.get("name").removesuffix("_joint")
            change = [entries.get(f"{stem}_{key}", 0.0) for key in keys]
            used += sum(f"{stem}_{key}" in entries for key in keys)
            before = [float(x) for x in origin.get(attribute, "0 0 0").split()]
            origin.set(attribute, " ".join(repr(a + b) for a, b in zip(before, change, strict=True)))
    assert used == len(entries) > 20
    readings = arm.dataset.measurements.readings
    found = tip_points(ET.tostring(root, "unicode"), "tool0", out.written.details, readings, POINT)
    np.testing.assert_allclose(found, expected(arm, POINT), atol=1e-9)
    assert out.missing[0].effect == "compliance"


@pytest.mark.parametrize("half", [np.pi, -np.pi])
def test_differences_of_pal_are_small_where_an_origin_is_turned_by_half_a_turn(tmp_path, half):
    """As an angle it is at either end of the range: the calibrated one may be at the other end."""
    arm, root = fake(session_of(), ("geometry",)), ET.fromstring(LRMATE)
    origins = {joint.get("name"): joint.find("origin") for joint in root.iter("joint")}
    behind = np.array([float(x) for x in origins["to_tool"].get("rpy").split()])
    origins["joint_6"].set("rpy", words([0.0, 0.0, half]))
    next(j for j in root.iter("joint") if j.get("name") == "joint_6").find("axis").set("xyz", "1 0 0")
    origins["to_tool"].set("rpy", words(rpy_of(rotation(2, -half) @ rpy_matrix(behind))))
    (tmp_path / "arm.urdf").write_text(ET.tostring(root, "unicode"))
    out = export(arm, "pal", into=str(tmp_path / "arm.urdf#tool0"))
    entries = yaml.safe_load(out.written.content)["robot_state_publisher"]["geometric_calibration"]
    assert abs(entries["joint_6_dyaw"]) > 1e-6
    assert max(map(abs, entries.values())) < 0.05
