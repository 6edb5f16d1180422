"""UR calibration, DH table, joint zeros."""

import csv
import json

import numpy as np
import pytest
import yaml
from export_arms import fake, session_of

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.transforms import rigid, rotation, rpy_matrix
from bayescal.errors import BayescalError
from bayescal.exporting.export import export
from bayescal.exporting.geometry import at_zero_poses, geometry_of, joint_angles
from bayescal.exporting.robot import calibrated_robot
from bayescal.fitted.unmodelled import state_row

UR = "universal-robots-ur5e"
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
FACTORY = {
    "shoulder": (0, 0, 0.1625, 0, 0, 0),
    "upper_arm": (0, 0, 0, 1.570796327, 0, 0),
    "forearm": (-0.425, 0, 0, 0, 0, 0),
    "wrist_1": (-0.3922, 0, 0.1333, 0, 0, 0),
    "wrist_2": (0, -0.0997, -2.044881182297852e-11, 1.570796327, 0, 0),
    "wrist_3": (0, 0.0996, -2.042830148012698e-11, 1.570796326589793, 3.141592653589793, 3.141592653589793),
}
"""default_kinematics.yaml of ur_description for the UR5e."""


def kinematics(values, label="calib_12345") -> str:
    lines = ["kinematics:"]
    for link, numbers in values.items():
        lines += [f"  {link}:"]
        lines += [
            f"    {k}: {v!r}" for k, v in zip(("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True)
        ]
    return "\n".join([*lines, f"  hash: {label}"]) + "\n"


def wrist(text: str, readings: np.ndarray) -> np.ndarray:
    """Frames of wrist_3 (C, 4, 4) in base_link_inertia, as the URDF of ur_description builds them."""
    each, out = yaml.safe_load(text)["kinematics"], []
    for q in readings:
        pose = np.eye(4)
        for link, turn in zip(LINKS, q, strict=True):
            x = np.array([each[link][key] for key in KEYS])
            pose = pose @ rigid(rpy_matrix(x[3:]), x[:3]) @ rigid(rotation(2, turn))
        out.append(pose)
    return np.array(out)


def test_ur_calibration():
    arm = fake(session_of(UR), ("geometry",))
    out = export(arm, "ur-yaml")
    readings = arm.dataset.measurements.readings
    calibrated = geometry_of(arm, state_row(arm.dataset))
    calibrated[-1] = calibrated[-2]
    own = at_zero_poses(calibrated, joint_angles(arm.dataset.robot, readings))
    np.testing.assert_allclose(wrist(out.written.content, readings), own, rtol=0, atol=1e-12)
    assert "ur_robot_driver warns" in " ".join(out.notes)
    assert not out.missing


def test_ur_calibration_with_the_hash_of_the_arm(tmp_path):
    (tmp_path / "mine.yaml").write_text(kinematics(FACTORY))
    arm = fake(session_of(UR), ("geometry",))
    out = export(arm, "ur-yaml", into=str(tmp_path / "mine.yaml"))
    assert yaml.safe_load(out.written.content)["kinematics"]["hash"] == "calib_12345"
    readings = arm.dataset.measurements.readings
    alone = wrist(export(arm, "ur-yaml").written.content, readings)
    np.testing.assert_allclose(wrist(out.written.content, readings), alone, rtol=0, atol=1e-9)


def test_ur_calibration_of_an_arm_that_the_manufacturer_calibrated(tmp_path):
    """Zeros of 0.66 deg, and a last link that is 0.33 mm longer: where the tool is in tool0 is stated."""
    factory = {link: np.array(x, float) for link, x in FACTORY.items()}
    factory["forearm"] += (2e-4, -1e-4, 3e-4, 1e-3, -5e-4, np.radians(0.66))
    factory["wrist_1"] += (1e-4, 0, -3e-4, 4e-4, 0, -np.radians(0.4))
    factory["wrist_3"][:3] += (0, 3.3e-4, 0)
    (tmp_path / "mine.yaml").write_text(kinematics({k: tuple(x.tolist()) for k, x in factory.items()}))
    arm = fake(session_of(UR), ("geometry",))
    out = export(arm, "ur-yaml", into=str(tmp_path / "mine.yaml"))
    assert any("calibrated already, with zeros within 0.6" in note for note in out.notes)
    readings, record = arm.dataset.measurements.readings, out.record("mine.yaml")
    flange = wrist(out.written.content, readings) @ np.array(record["flange_in_tip"])
    flange = np.array(record["root_in_f0"]) @ flange
    calibrated = geometry_of(arm, state_row(arm.dataset))
    own = at_zero_poses(calibrated, joint_angles(arm.dataset.robot, readings))
    np.testing.assert_allclose(flange, own, rtol=0, atol=1e-9)
    np.testing.assert_allclose(record["flange_in_tip"], np.eye(4), atol=1e-6)


def test_the_tool_in_a_tip_that_is_not_the_flange(tmp_path):
    """The nominal file of an arm whose last frame is 5 mm before the flange."""
    short = FACTORY | {"wrist_3": (0, 0.0946, 0, *FACTORY["wrist_3"][3:])}
    (tmp_path / "mine.yaml").write_text(kinematics(short))
    arm = fake(session_of(UR), ("geometry",))
    out = export(arm, "ur-yaml", into=str(tmp_path / "mine.yaml"))
    tool = out.record("mine.yaml")["tools"][0]
    np.testing.assert_allclose(
        np.subtract(tool["centre_in_tip_mm"], tool["centre_mm"]), [0, 0, 5.0], atol=1e-4
    )
    at = ", ".join(f"{x:.3f}" for x in tool["centre_in_tip_mm"])
    assert f"tool0 is not the flange: the centre of tool {tool['name']} is at {at} mm in it" in out.notes
    readings = arm.dataset.measurements.readings
    tips = (wrist(out.written.content, readings) @ [*(1e-3 * np.array(tool["centre_in_tip_mm"])), 1.0])[:, :3]
    np.testing.assert_allclose(tips, arm.at(readings).points, rtol=0, atol=1e-7)
    alone = export(arm, "ur-yaml")
    assert not any("is not the flange" in note for note in alone.notes)


def test_ur_calibration_of_another_arm_is_refused(tmp_path):
    with pytest.raises(BayescalError, match="is no arm of Universal Robots"):
        export(fake(session_of(), ("geometry",)), "ur-yaml")
    arm = fake(session_of(UR), ("geometry",))
    (tmp_path / "mine.yaml").write_text(kinematics(FACTORY | {"forearm": (-0.6127, 0, 0, 0, 0, 0)}))
    with pytest.raises(BayescalError, match=r"the axes of upper_arm and forearm is 612\.70 mm"):
        export(arm, "ur-yaml", into=str(tmp_path / "mine.yaml"))
    (tmp_path / "mine.yaml").write_text("kinematics: {}\n")
    with pytest.raises(BayescalError, match="no calibration of ur_robot_driver"):
        export(arm, "ur-yaml", into=str(tmp_path / "mine.yaml"))


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", UR])
def test_dh_table(name):
    arm = fake(session_of(name), ("geometry", "compliance"))
    out = export(arm, "dh-csv")
    robot = calibrated_robot(arm.model, arm.values)
    rows = list(csv.DictReader(out.written.content.splitlines()))
    np.testing.assert_array_equal([float(r["a_mm"]) for r in rows], 1e3 * robot.a)
    record = json.loads(out.written.beside[".json"])
    covariance = np.array(record["covariance"])
    names = [(v["place"], v["quantity"]) for v in record["values"]]
    k, p = names.index(("J3", "a")), arm.model.names.index("a2")
    assert covariance[k, k] == pytest.approx(1e6 * arm.covariance[p, p], rel=1e-5)
    k, p = names.index(("J3", "compliance")), arm.model.names.index("compliance J3")
    assert covariance[k, k] == pytest.approx(1e12 * arm.covariance[p, p], rel=1e-5)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
    assert not out.missing


def test_joint_zeros():
    """Readings with the corrections added move the nominal arm as the arm with these zeros alone."""
    arm = fake(session_of(), ("joint",))
    out = export(arm, "joint-zeros")
    rows = list(csv.DictReader(out.written.content.splitlines()))
    correction = np.array([float(r["correction_rad"]) for r in rows])
    readings, robot = arm.dataset.measurements.readings, arm.dataset.robot
    shown = frames(chain_of(robot), link_angles(robot, readings + correction))[:, -1]
    zeros = np.array([p.unit == "rad" and p.effect == "joint" for p in arm.model.parameters])
    own = arm.valued(np.where(zeros, arm.values, 0.0)).at(readings).flange
    np.testing.assert_allclose(shown, own, rtol=0, atol=1e-12)
    assert [r["u_rad"] == "0.0" for r in rows] == [True, False, False, False, False, True]
    assert out.missing[0].effect == "joint"
    assert all(name.startswith("encoder-scale") for name in out.missing[0].parameters)
    assert float(rows[1]["correction_ticks_4096"]) == pytest.approx(
        correction[1] / (2 * np.pi) * 4096, abs=0.5
    )
