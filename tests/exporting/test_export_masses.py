"""Masses, limits and units in exported files, for arms of both conventions of rows."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from export_arms import fake, robot_of, session_of, with_robot

from bayescal.arm.chain import chain_of
from bayescal.arm.statics import Stance, gravity_loads
from bayescal.arm.transforms import rigid, rotation, rpy_matrix
from bayescal.exporting.export import FORMATS, export
from bayescal.exporting.geometry import constant_displacements, joint_angles
from bayescal.robots import load_robot
from bayescal.robots.schema import robot_to_yaml

pin = pytest.importorskip("pinocchio")
mujoco = pytest.importorskip("mujoco")
HALF = 0.5 * np.pi


def standard(name="universal-robots-ur5e"):
    """A UR5e with rows in standard DH and skew centres of mass."""
    robot = session_of(name).robot
    own = {"alpha": [HALF, 0, 0, HALF, -HALF, 0], "a": [0, -0.425, -0.3922, 0, 0, 0]}
    rows = {key: np.array(values) for key, values in own.items()}
    return replace(
        robot, convention="dh", d=np.array([0.1625, 0, 0, 0.1333, 0.0997, 0.0996]), **rows,
        centres_of_mass=np.random.default_rng(1).uniform(-0.1, 0.1, (6, 3)),
    )  # fmt: skip


ARMS = {
    "mdh": lambda: fake(session_of("franka-panda"), ("geometry",), scale=3.0),
    "mdh, coupled": lambda: fake(session_of("fanuc-lrmate200ic"), ("geometry",), scale=3.0),
    "dh": lambda: fake(with_robot(session_of("universal-robots-ur5e"), standard()), ("geometry",), scale=3.0),
}


def expected(arm, load: bool) -> np.ndarray:
    """Gravity torques (C, n) about the axes of the joints, N m, with the tool or without."""
    data, robot = arm.dataset, arm.dataset.robot
    turns = joint_angles(robot, data.measurements.readings[:5])
    state = len(data.measurements.ids) - 1
    delta = np.tile(constant_displacements(arm.model, arm.values, state), (5, 1, 1))
    tool = data.tools[int(data.measurements.tool[state])]
    mass = np.full(5, tool.mass if load else 0.0)
    # the mass of a tool is displaced as its tip
    values = dict(zip((p.name for p in arm.model.parameters), arm.values, strict=True))
    centre = np.tile(tool.centre_of_mass + [values[f"{tool.name} {axis}"] for axis in "xyz"], (5, 1))
    loads = gravity_loads(
        robot, chain_of(robot), turns + robot.offset, data.gravity, mass, centre, Stance(delta, 0.0 * delta)
    )
    return loads.moments[:, 1:, 2]


@pytest.mark.parametrize("name", ARMS)
def test_gravity_torques_of_a_urdf(name):
    arm = ARMS[name]()
    out = export(arm, "urdf", force=True)
    model = pin.buildModelFromXML(out.written.content)
    model.gravity.linear = arm.dataset.gravity
    data, record = model.createData(), out.record("a")
    angles = arm.dataset.measurements.readings[:5] @ np.array(record["joint_from_reading"]).T
    joints = [model.joints[model.getJointId(name)] for name in record["joints"].values()]
    found = []
    for turn in angles:
        q = pin.neutral(model)
        q[[joint.idx_q for joint in joints]] = turn
        held = pin.computeGeneralizedGravity(model, data, q)[[joint.idx_v for joint in joints]]
        found.append(-held * np.array(record["signs"]))
    np.testing.assert_allclose(found, expected(arm, False), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_gravity_torques_of_an_sdf(name):
    arm = ARMS[name]()
    out = export(arm, "sdf", force=True)
    model = ET.fromstring(out.written.content).find("model")
    joints = {j.findtext("child"): j for j in model.findall("joint")}
    turns = joint_angles(arm.dataset.robot, arm.dataset.measurements.readings[:5])
    for turn, wanted in zip(turns, expected(arm, True), strict=True):
        angles = dict(zip(arm.dataset.robot.joint_names, turn, strict=True))
        poses, points = {"": np.eye(4)}, []  # of links; weights with their points and the joints before them
        axes = {}
        for link in model.findall("link"):
            x = np.array(link.findtext("pose").split(), float)
            joint = joints[link.get("name")]
            before = link.find("pose").get("relative_to", "")
            pose = poses[before] @ rigid(rpy_matrix(x[3:]), x[:3])
            above = [*axes.get(before, ())]
            if joint.get("type") == "revolute":
                above.append((joint.get("name"), pose[:3, 2], pose[:3, 3]))
                pose = pose @ rigid(rotation(2, angles[joint.get("name")]))
            poses[link.get("name")], axes[link.get("name")] = pose, above
            if link.findtext("gravity") != "false":
                centre = np.array(link.findtext("inertial/pose").split()[:3], float)
                weight = float(link.findtext("inertial/mass")) * arm.dataset.gravity
                points.append(((pose @ np.append(centre, 1.0))[:3], weight, above))
        found = dict.fromkeys(angles, 0.0)
        for point, weight, above in points:
            for own, axis, at in above:
                found[own] += axis @ np.cross(point - at, weight)
        np.testing.assert_allclose(list(found.values()), wanted, rtol=0, atol=1e-9)


FACTORS = {"mm": 1e3, "deg": 180.0 / np.pi, "urad/(N m)": 1e6, "kg": 1.0, "kg mm": 1e3, "1": 1.0}
"""Unit of a sidecar: how many of it are one SI unit."""


def written_values(arm):
    """Values and u of the parameters, in every unit that has a factor, by name."""
    u = np.sqrt(np.diag(arm.covariance))
    return {
        p.name: {unit: ((p.nominal + v) * f, own * f) for unit, f in FACTORS.items()}
        for p, v, own in zip(arm.model.parameters, arm.values, u, strict=True)
    }


UNIT_OF = {"a2": "mm", "alpha2": "deg", "theta2": "deg", "scale J2": "1", "compliance J2": "urad/(N m)"}


@pytest.mark.parametrize("name", FORMATS)
def test_values_of_a_sidecar_are_in_their_units(name):
    session = session_of("universal-robots-ur5e") if name == "ur-yaml" else session_of()
    arm = fake(session, ("geometry", "compliance", "encoder-scale", "payload"), scale=0.4)
    record = json.loads(json.dumps(export(arm, name, force=True).record("arm")))
    known, units = written_values(arm), {}
    assert record["written"]
    for item in record["written"]:
        value, u = known[item["parameter"]][item["unit"]]
        assert item["value"] == pytest.approx(value, rel=1e-12, abs=1e-15)
        assert item["u"] == pytest.approx(u, rel=1e-12)
        units[item["parameter"]] = item["unit"]
    for parameter, unit in UNIT_OF.items():
        assert units.get(parameter, unit) == unit
    tip = np.array([known[f"{arm.dataset.tools[0].name} {axis}"]["mm"] for axis in "xyz"])
    np.testing.assert_allclose(record["tools"][0]["centre_mm"], tip[:, 0], rtol=1e-12)
    np.testing.assert_allclose(record["tools"][0]["u_mm"], tip[:, 1], rtol=1e-12)


def test_limits_that_the_robot_states(tmp_path):
    """In degrees per second in robot.yaml; in files where it is stated, and nowhere a limit of zero."""
    robot = session_of("universal-robots-ur5e").robot
    robot = replace(
        robot, velocities=np.array([2.0, 3.0, np.nan, 3.2, 3.2, 3.2]),
        torques=np.array([150.0, 150, 150, 28, 28, np.nan]),
    )  # fmt: skip
    (tmp_path / "robot.yaml").write_text(robot_to_yaml(robot))
    assert f"max_velocity_degps: {np.rad2deg(2.0):.14g}" in (tmp_path / "robot.yaml").read_text()
    again = load_robot("robot.yaml", tmp_path)[0]
    np.testing.assert_allclose(again.velocities, robot.velocities, rtol=1e-12)
    np.testing.assert_array_equal(again.torques, robot.torques)
    arm = fake(with_robot(session_of("universal-robots-ur5e"), again), ("geometry",))
    out = export(arm, "urdf", name="arm")
    model = pin.buildModelFromXML(out.written.content)
    low, high = robot.limits.T
    np.testing.assert_allclose(model.lowerPositionLimit, low, rtol=1e-12)
    np.testing.assert_allclose(model.upperPositionLimit, high, rtol=1e-12)
    np.testing.assert_allclose(model.velocityLimit, [2, 3, 1e9, 3.2, 3.2, 3.2], rtol=1e-12)
    np.testing.assert_allclose(model.effortLimit, [150, 150, 150, 28, 28, 1e9], rtol=1e-12)
    assert any("effort and velocity of 1e+09: not stated" in note for note in out.notes)
    (tmp_path / "arm.urdf").write_text(out.written.content)
    found = robot_of("arm.urdf", tmp_path)
    np.testing.assert_allclose(found.velocities, robot.velocities, rtol=1e-12)
    np.testing.assert_array_equal(found.torques, robot.torques)
    sdf = ET.fromstring(export(arm, "sdf", name="arm").written.content)
    limits = {j.get("name"): j.find("axis/limit") for j in sdf.iter("joint") if j.find("axis") is not None}
    assert float(limits["J1"].findtext("velocity")) == pytest.approx(2.0, rel=1e-12)
    assert float(limits["J4"].findtext("effort")) == 28.0
    assert limits["J3"].find("velocity") is None
    assert limits["J6"].find("effort") is None
    ranges = mujoco.MjModel.from_xml_string(export(arm, "mjcf", name="arm").written.content)
    np.testing.assert_allclose([ranges.joint(j).range for j in robot.joint_names], robot.limits, rtol=1e-12)
    assert all(ranges.joint(j).limited[0] for j in robot.joint_names)


def test_limits_of_coupled_and_inverted_joints(tmp_path):
    """Limits of the links, with the sense that the axis has in the file."""
    arm = fake(session_of(), ("geometry",))
    robot = arm.dataset.robot
    sense = np.sign(np.diag(robot.link_from_reading))
    model = mujoco.MjModel.from_xml_string(export(arm, "mjcf", name="arm").written.content)
    for name, own, limits in zip(robot.joint_names, sense, robot.limits, strict=True):
        np.testing.assert_allclose(model.joint(name).range, sorted(own * limits), rtol=1e-12)
    urdf = export(arm, "urdf", name="arm").written.content
    assert not re.search(r'(effort|velocity)="0(\.0)?"', urdf)
    (tmp_path / "arm.urdf").write_text(urdf)
    assert robot_of("arm.urdf", tmp_path).velocities is None
