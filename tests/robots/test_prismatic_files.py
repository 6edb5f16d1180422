"""Prismatic joints in robot files: units, refusals, columns of a URDF against Pinocchio and MuJoCo."""

import numpy as np
import pinocchio as pin
import pytest
from cases import cases, file_text, refused
from urdf_texts import joint, link, robot

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.errors import BayescalError
from bayescal.logs.types import mechanism_of
from bayescal.robots import load_robot, only_revolute, robot_to_yaml

SCARA = file_text("scara.yaml")


def read(tmp_path, text, name="arm.yaml"):
    (tmp_path / name).write_text(text)
    return load_robot(name, tmp_path)[0]


def flange(found, readings):
    return frames(chain_of(found), link_angles(found, np.atleast_2d(readings)))[:, -1]


def test_units_of_a_robot_file(tmp_path):
    found = read(tmp_path, SCARA)
    assert found.units == ("deg", "deg", "mm", "deg")
    np.testing.assert_allclose(found.limits[2], [0, 0.15])
    np.testing.assert_allclose([found.velocities[2], found.torques[2], found.torques[3]], [1, 200, 5])
    np.testing.assert_allclose(found.compliance, [0, 0, 2e-7, 0])
    readings = found.read(np.array([30.0, 0.0, 100.0, 20.0]))
    np.testing.assert_allclose(readings[2], 0.1)
    np.testing.assert_allclose(found.shown(readings), [30, 0, 100, 20])
    # 20 deg of J4 lower the quill by 1 mm: 0.05 mm per deg
    at = flange(found, readings)[0]
    np.testing.assert_allclose(at[:3, 3], [0.5 * np.cos(np.pi / 6), 0.25, 0.2 - 0.03 - 0.101], atol=1e-12)
    again = read(tmp_path, robot_to_yaml(found))
    np.testing.assert_allclose(flange(again, readings)[0], at, atol=1e-12)
    np.testing.assert_allclose(again.compliance, found.compliance)
    np.testing.assert_allclose(again.link_from_reading, found.link_from_reading, atol=1e-15)


@pytest.mark.parametrize(("old", "new", "words"), cases("prismatic_refusals"))
def test_refusals(tmp_path, old, new, words):
    assert old in SCARA
    refused(words, lambda: read(tmp_path, SCARA.replace(old, new, 1)))


def test_what_knows_revolute_joints_only(tmp_path):
    with pytest.raises(BayescalError, match="Z is prismatic: joint logs know revolute joints only"):
        only_revolute(read(tmp_path, SCARA), "joint logs")
    refused("name the part that turns", lambda: mechanism_of(read(tmp_path, SCARA)))


def column(second="mast", multiplier=0.5, axis=(0, 0, 1)):
    """A base, a column of two stages, the second of which follows the first, an arm and a tip."""
    follows = f'<mimic joint="mast" multiplier="{multiplier}" offset="0.1"/>'
    return robot(
        link("root"), link("outer", 3.0, (0.01, 0, 0.2)), link("inner", 2.0, (0, 0.02, 0.1)),
        link("upper", 1.0, (0.1, 0, 0)), link("tip"),
        joint("mast", "root", "outer", "prismatic", (0.1, 0, 0.3), (0, 0, 0.4)),
        joint("stage", "outer", "inner", "prismatic", (0, 0, 0.2), (0, 0, -0.7), axis, follows),
        joint("turn", "inner", "upper", "revolute", (0, 0, 0.1), (0, 1.2, 0)),
        joint("end", "upper", "tip", "fixed", (0.3, 0, 0)),
    )  # fmt: skip


def test_a_telescopic_column_is_one_joint(tmp_path):
    text = column()
    found = read(tmp_path, text, "arm.urdf")
    assert found.joint_names == ("mast", "turn")
    np.testing.assert_allclose(np.diag(found.link_from_reading), [1.5, 1.0])
    np.testing.assert_allclose(found.limits[0], [-3.0, 4.5])  # of the link: 1.5 times the reading
    model = pin.buildModelFromXML(text)
    data = model.createData()
    for q in np.random.default_rng(0).uniform(-2, 2, (5, 2)):
        pin.framesForwardKinematics(model, data, np.array([q[0], 0.5 * q[0] + 0.1, q[1]]))
        wanted = data.oMf[model.getFrameId("tip")].homogeneous
        np.testing.assert_allclose(flange(found, q)[0], wanted, atol=1e-12)


@pytest.mark.parametrize(
    "text", [column(axis=(0, 1, 0)), column().replace('"stage" type="prismatic"', '"stage" type="revolute"')]
)
def test_followers_that_are_no_stages(tmp_path, text):
    refused("joint `stage` follows another joint", lambda: read(tmp_path, text, "arm.urdf"))
