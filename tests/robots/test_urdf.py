"""URDF chains as DH rows, against Pinocchio on the same text; and what is refused."""

import numpy as np
import pinocchio as pin
import pytest
from urdf_texts import arm, joint, link, robot

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.statics import gravity_loads
from bayescal.errors import BayescalError
from bayescal.robots import load_robot, robot_to_yaml

GRAVITY = np.array([1.0, -2.0, -9.0])


def read(tmp_path, text, reference="arm.urdf", **allow):
    (tmp_path / reference.partition("#")[0]).write_text(text, encoding="utf-8")
    return load_robot(reference, tmp_path, **allow)[0]


def ours(found, readings):
    return frames(chain_of(found), link_angles(found, readings))[:, -1]


def moments(found, readings) -> np.ndarray:
    none = np.zeros(len(readings))
    q = link_angles(found, readings)
    loads = gravity_loads(found, chain_of(found), q, GRAVITY, none, np.zeros((len(readings), 3)))
    return loads.moments[:, 1:, 2]


@pytest.mark.parametrize("style", ["skew", "square", "parallel"])
@pytest.mark.parametrize("n", [1, 2, 6, 7])
@pytest.mark.parametrize("seed", [1, 2])
def test_moves_and_hangs_as_pinocchio_says(tmp_path, seed, n, style):
    text = arm(seed, n, style)
    found = read(tmp_path, text, "arm.urdf#tip")
    model = pin.buildModelFromXML(text)
    model.gravity.linear = GRAVITY
    data = model.createData()
    readings = np.random.default_rng(seed).uniform(-3, 3, (20, n))
    poses, held = ours(found, readings), moments(found, readings)
    for k, q in enumerate(readings):
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(poses[k], data.oMf[model.getFrameId("tip")].homogeneous, atol=1e-12)
        np.testing.assert_allclose(held[k], -pin.computeGeneralizedGravity(model, data, q), atol=1e-11)
    assert found.masses.sum() == pytest.approx(sum(i.mass for i in model.inertias[1:]))
    np.testing.assert_array_equal(found.limits, np.tile([-2.0, 3.0], (n, 1)))
    assert found.joint_names == tuple(f"j{i + 1}" for i in range(n))
    again = read(tmp_path, robot_to_yaml(found), "again.yaml")
    np.testing.assert_allclose(ours(again, readings), poses, atol=1e-11)


PLAIN = robot(
    link("base"),
    link("arm", 2.0, (0.1, 0, 0)),
    link("hand", 1.0),
    link("tool0"),
    joint("turn", "base", "arm", xyz=(0, 0, 0.4)),
    joint("lift", "arm", "hand", "continuous", (0.1, 0, 0.2), axis=(0, 1, 0)),
    joint("mount", "hand", "tool0", "fixed", (0.05, 0, 0)),
)


def test_simple_ends_are_no_frames(tmp_path):
    """A base that only lifts goes into d; an arm without masses has none; a wheel turns all round."""
    found = read(tmp_path, PLAIN)
    np.testing.assert_array_equal(found.base, np.eye(4))
    assert found.d[0] == pytest.approx(0.6)
    np.testing.assert_allclose(found.limits[1], [-2 * np.pi, 2 * np.pi])
    bare = PLAIN.replace("<mass", "<!--").replace("</inertial>", "--></inertial>")
    assert read(tmp_path, bare.replace("--></inertial>", '--><mass value="0"/></inertial>')).masses is None


def test_a_fixed_joint_needs_no_axis(tmp_path):
    """Exporters write 0 0 0 there (SO-101, TIAGo)."""
    text = PLAIN.replace(
        '<axis xyz="0.0 0.0 1.0"/><limit lower="-2" upper="3" effort="1" velocity="1"/></joint></robot>',
        '<axis xyz="0 0 0"/></joint></robot>',
    )
    assert text != PLAIN
    readings = np.array([[0.3, -0.2]])
    np.testing.assert_array_equal(ours(read(tmp_path, text), readings), ours(read(tmp_path, PLAIN), readings))


def test_fingers_beside_the_chain_weigh(tmp_path):
    finger = link("finger", 0.5, (0, 0, 0.1)) + joint("grip", "hand", "finger", "prismatic", (0, 0, 0.1))
    text = PLAIN.replace("</robot>", finger + "</robot>")
    assert read(tmp_path, text, "arm.urdf#tool0").masses.tolist() == [2.0, 1.5]


BOMB = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><robot name="&b;"/>'
OUTSIDE = '<!DOCTYPE robot SYSTEM "http://127.0.0.1/evil.dtd"><robot name="x"/>'
SECOND = (
    link("left") + link("right") + joint("l", "hand", "left", "fixed") + joint("r", "hand", "right", "fixed")
)
SPOILT = [
    (BOMB, "DOCTYPE or entities"),
    (OUTSIDE, "DOCTYPE or entities"),
    ("<robot name='x'>", "arm.urdf:1: not XML"),
    ("<sdf/>", "begins with <sdf>"),
    (
        PLAIN.replace(
            "</robot>", '<link name="m"><visual><mesh filename="https://h/a.stl"/></visual></link></robot>'
        ),
        "is on the network",
    ),
    (PLAIN.replace('"continuous"', '"prismatic"'), r"joint `lift` is prismatic; .* `robot: arm.urdf#arm`"),
    (PLAIN.replace('"continuous"', '"floating"'), "joint `lift` is floating"),
    (
        PLAIN.replace("</joint></robot>", '<mimic joint="turn"/></joint></robot>').replace(
            '"fixed"', '"revolute"'
        ),
        "joint `mount` follows another joint",
    ),
    (PLAIN.replace('"continuous"', '"hinge"'), "joint `lift` has the type `hinge`; known: revolute"),
    (
        PLAIN.replace('<parent link="arm"/>', '<parent link="arm"/><axis xyz="1 0 0"/>'),
        "lift has several <axis>",
    ),
    (PLAIN.replace(' effort="1"', "", 1), "joint.*turn.*effort"),
    (PLAIN.replace('lower="-2"', 'lower="-170"', 1), "limits of joint `turn` are too wide"),
    (PLAIN.replace('lower="-2"', 'lower="5"', 1), "joint `turn` has no limits in order"),
    (PLAIN.replace("0.4", "400", 1), "add up to 40.* a URDF is in metres"),
    (PLAIN.replace("0.4", "nan", 1), "origin of `turn` is not finite"),
    (PLAIN.replace("0.0 0.0 1.0", "0 0 0", 1), "axis of `turn` is zero"),
    (PLAIN.replace('value="2.0"', 'value="-2.0"'), "mass of `arm` is -2 kg"),
    (PLAIN.replace('child link="tool0"', 'child link="elsewhere"'), "names a link `elsewhere`"),
    (PLAIN.replace("</robot>", link("hand") + "</robot>"), "several links are called `hand`"),
    (PLAIN.replace("</robot>", link("loose") + "</robot>"), "links with no joint above: base, loose"),
    (
        PLAIN.replace(
            "</robot>", link("a") + link("b") + joint("x", "a", "b") + joint("y", "b", "a") + "</robot>"
        ),
        "joints around `a` form a ring",
    ),
    (
        PLAIN.replace("</robot>", SECOND + "</robot>"),
        r"they end at left, right, tool0; write `robot: arm.urdf#left`",
    ),
    (robot(link("base")), "no joint turns between `base` and `base`"),
]


@pytest.mark.parametrize(("text", "told"), SPOILT)
def test_refusals(tmp_path, text, told):
    with pytest.raises(BayescalError, match=told) as caught:
        read(tmp_path, text)
    assert caught.value.where.startswith("arm.urdf")
    assert caught.value.remedy


def test_references(tmp_path):
    with pytest.raises(BayescalError, match="on the network"):
        load_robot("https://host/arm.urdf")
    with pytest.raises(BayescalError, match="no such file"):
        load_robot("nowhere.urdf", tmp_path)
    with pytest.raises(BayescalError, match="no link is called `flange`; chains end at: tool0"):
        read(tmp_path, PLAIN, "arm.urdf#flange")
