"""URDF chains as DH rows, against Pinocchio on the same text; and what is refused."""

import re
from contextlib import suppress

import numpy as np
import pinocchio as pin
import pytest
from cases import refused
from urdf_texts import arm, joint, link, robot, words

from bayescal import robots
from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.statics import gravity_loads
from bayescal.errors import BayescalError
from bayescal.logs.types import mechanism_of
from bayescal.motion.dynamics import regressor
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
    return loads.torques(found.slides)


@pytest.mark.parametrize("style", ["skew", "square", "parallel"])
@pytest.mark.parametrize(("n", "slides"), [(1, ()), (7, ()), (1, (1,)), (5, (1, 2, 5))])
def test_moves_and_hangs_as_pinocchio_says(tmp_path, n, slides, style):
    text = arm(1, n, style, slides)
    found = read(tmp_path, text, "arm.urdf#tip")
    model = pin.buildModelFromXML(text)
    model.gravity.linear = GRAVITY
    data = model.createData()
    readings = np.random.default_rng(1).uniform(-3, 3, (5, n))
    poses, held = ours(found, readings), moments(found, readings)
    for k, q in enumerate(readings):
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(poses[k], data.oMf[model.getFrameId("tip")].homogeneous, atol=1e-12)
        np.testing.assert_allclose(held[k], -pin.computeGeneralizedGravity(model, data, q), atol=1e-11)
    assert found.masses.sum() == pytest.approx(sum(i.mass for i in model.inertias[1:]))
    np.testing.assert_array_equal(found.limits, np.tile([-2.0, 3.0], (n, 1)))
    assert found.joint_names == tuple(f"j{i + 1}" for i in range(n))
    np.testing.assert_array_equal(np.flatnonzero(found.slides) + 1, slides)
    again = read(tmp_path, robot_to_yaml(found), "again.yaml")
    np.testing.assert_allclose(ours(again, readings), poses, atol=1e-11)


def test_bodies_take_torques_as_pinocchio_says(tmp_path):
    """Of uneven bodies whose axes are turned against those of their links, some of them on fixed joints."""
    rng = np.random.default_rng(2)

    def uneven(match):
        (xx, xy, xz), (_, yy, yz), (*_, zz) = (root := rng.standard_normal((3, 3))) @ root.T
        parts = {"ixx": xx, "iyy": yy, "izz": zz, "ixy": xy, "ixz": xz, "iyz": yz}
        six = " ".join(f'{key}="{float(value)!r}"' for key, value in parts.items())
        return f'{match[1]} rpy="{words(rng.uniform(-2, 2, 3))}"/>{match[2]}<inertia {six}/>'

    text = re.sub(r"(<inertial><origin [^>]*)/>(<mass [^>]*>)<inertia [^>]*>", uneven, arm(1, 4, "skew"))
    m, _ = mechanism_of(read(tmp_path, text, "arm.urdf#tip"))
    model = pin.buildModelFromXML(text)
    model.gravity.linear = GRAVITY
    motions = rng.uniform(-2, 2, (3, 5, 4))
    found = np.einsum("cjkp,kp->cj", regressor(m, *motions, GRAVITY), m.inertials)
    expected = [pin.rnea(model, model.createData(), *each) for each in zip(*motions, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


PLAIN = robot(
    link("base"),
    link("arm", 2.0, (0.1, 0, 0)),
    link("hand", 1.0),
    link("tool0"),
    joint("turn", "base", "arm", xyz=(0, 0, 0.4)),
    joint("lift", "arm", "hand", "continuous", (0.1, 0, 0.2), axis=(0, 1, 0)),
    joint("mount", "hand", "tool0", "fixed", (0.05, 0, 0)),
)


def plus(*more: str) -> str:
    """The plain arm with further elements."""
    return PLAIN.replace("</robot>", "".join(more) + "</robot>")


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
    assert read(tmp_path, plus(finger), "arm.urdf#tool0").masses.tolist() == [2.0, 1.5]


BOMB = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><robot name="&b;"/>'
OUTSIDE = '<!DOCTYPE robot SYSTEM "http://127.0.0.1/evil.dtd"><robot name="x"/>'
SECOND = "".join(link(name) + joint(name[0], "hand", name, "fixed") for name in ("left", "right"))
FINGERS = SECOND.replace('"hand"', '"tool0"')
FOLLOWS = PLAIN.replace("</joint></robot>", '<mimic joint="turn"/></joint></robot>')
SPOILT = [
    (BOMB, "DOCTYPE or entities"),
    (OUTSIDE, "DOCTYPE or entities"),
    ("<robot name='x'>", "arm.urdf:1: not XML"),
    ("<sdf/>", "begins with <sdf>"),
    (plus('<link name="m"><visual><mesh filename="https://h/a.stl"/></visual></link>'), "is on the network"),
    (PLAIN.replace('"continuous"', '"planar"'), r"joint `lift` is planar; .* `robot: arm.urdf#arm`"),
    (PLAIN.replace('"continuous"', '"floating"'), "joint `lift` is floating"),
    (FOLLOWS.replace('"fixed"', '"revolute"'), "joint `mount` follows another joint"),
    (PLAIN.replace('"continuous"', '"hinge"'), "joint `lift` has the type `hinge`; known: revolute"),
    (PLAIN.replace('parent link="arm"/>', 'parent link="arm"/><axis xyz="1 0 0"/>'),
     "lift has several <axis>"),
    (PLAIN.replace(' effort="1"', "", 1), "joint.*turn.*effort"),
    (PLAIN.replace('lower="-2"', 'lower="-170"', 1), "limits of joint `turn` are too wide"),
    (PLAIN.replace('lower="-2"', 'lower="5"', 1), "joint `turn` has no limits in order"),
    (PLAIN.replace("0.4", "400", 1), "add up to 40.* a URDF is in metres"),
    (PLAIN.replace("0.4", "nan", 1), "origin of `turn` is not finite"),
    (PLAIN.replace("0.0 0.0 1.0", "0 0 0", 1), "axis of `turn` is zero"),
    (PLAIN.replace('value="2.0"', 'value="-2.0"'), "mass of `arm` is -2 kg"),
    (PLAIN.replace('child link="tool0"', 'child link="elsewhere"'), "names a link `elsewhere`"),
    (plus(link("hand")), "several links are called `hand`"),
    (plus(link("loose")), "links with no joint above: base, loose"),
    (plus(link("a"), link("b"), joint("x", "a", "b"), joint("y", "b", "a")), "joints around `a` form a ring"),
    (plus(FINGERS), "they end at left, right; .* as in arm.urdf#tool0$"),
    (
        plus(SECOND),
        r"they end at left, right, tool0; name the link that carries the tool, as in arm.urdf#hand",
    ),
    (robot(link("base")), "no joint moves between `base` and `base`"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "told"), SPOILT)
def test_refusals(tmp_path, text, told):
    caught = refused(told, lambda: read(tmp_path, text))
    assert caught.where.startswith("arm.urdf")
    assert caught.remedy


def test_references(tmp_path):
    refused("on the network", lambda: load_robot("https://host/arm.urdf"))
    refused("no such file", lambda: load_robot("nowhere.urdf", tmp_path))
    with pytest.raises(BayescalError, match="no link is called `flange`; chains end at: tool0"):
        read(tmp_path, PLAIN, "arm.urdf#flange")


# --- xacro files: programs, executed only where the user says so, and then apart and within limits.

ARM = """<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">
<xacro:arg name="reach" default="0.3"/><xacro:include filename="part.xacro"/>
<xacro:part length="$(arg reach)"/></robot>"""
PART = """<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:macro name="part" params="length">
<link name="base"/><link name="tool0"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="tool0"/>
<origin xyz="0 0 ${2 * length}" rpy="0 0 ${pi / 2}"/><axis xyz="0 0 1"/>
<limit lower="${radians(-90)}" upper="1" effort="0" velocity="0"/></joint></xacro:macro></robot>"""

SYSTEM = "(lambda: xacro.load_yaml.__globals__['os'].system('touch WITNESS'))()"
"""An expression that leaves xacro's own guard, which looks at names outside of lambdas alone."""
PIECES = SYSTEM.replace("__", "_$(arg u)")  # what a filter of the text does not find
ESCAPES = {
    "an attribute": f'<xacro:arg name="u" default="_"/><link name="${{{PIECES}}}"/>',
    "a comment": f"<!-- xacro:eval-comments --><!-- ${{{SYSTEM}}} -->",
    "a YAML file": "<link name=\"${xacro.load_yaml('more.yaml')}\"/>",
}


def xacro_read(folder, text=ARM, **allow):
    (folder / "part.xacro").write_text(PART)
    (folder / "arm.xacro").write_text(text)
    return load_robot("arm.xacro", folder, **allow)


def test_expanded_where_allowed(tmp_path):
    found, content = xacro_read(tmp_path, allow_xacro=True)
    tip = frames(chain_of(found), link_angles(found, np.zeros((1, 1))))[0, -1]
    np.testing.assert_allclose(tip[:3, 3], [0, 0, 0.6], atol=1e-15)
    assert found.limits[0, 0] == pytest.approx(-np.pi / 2)
    (tmp_path / "part.xacro").write_text(PART.replace("2 *", "3 *"))
    assert load_robot("arm.xacro", tmp_path, allow_xacro=True)[1] != content  # the hash covers included files
    (tmp_path / "moved").mkdir()
    assert xacro_read(tmp_path / "moved", allow_xacro=True)[1] == content  # and not where they lie


@pytest.mark.parametrize("place", ESCAPES)
def test_no_expression_runs_unasked(tmp_path, place):
    witness = tmp_path / "witness"
    (tmp_path / "more.yaml").write_text(f'a: !degrees "{SYSTEM}"'.replace("WITNESS", str(witness)))
    text = ARM.replace("</robot>", f"{ESCAPES[place]}</robot>".replace("WITNESS", str(witness)))
    caught = refused("is a program", lambda: xacro_read(tmp_path, text))
    assert not witness.exists()
    assert "`xacro arm.xacro > arm.urdf`" in caught.remedy
    assert "--allow-xacro" in caught.remedy
    with suppress(BayescalError):
        xacro_read(tmp_path, text, allow_xacro=True)
    assert witness.exists()  # the file does what it seems to do: the test would see it


def test_the_child_has_no_environment_and_limits(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET_TOKEN", "hush")
    with pytest.raises(BayescalError, match="SECRET_TOKEN"):
        xacro_read(tmp_path, ARM.replace('default="0.3"', 'default="$(env SECRET_TOKEN)"'), allow_xacro=True)
    monkeypatch.setattr(robots, "BYTES", 2**27)
    with pytest.raises(BayescalError, match="MemoryError"):
        xacro_read(tmp_path, ARM.replace("$(arg reach)", "${len([0] * 2**28)}"), allow_xacro=True)


def test_an_endless_expression_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(robots, "SECONDS", 1)
    with pytest.raises(BayescalError, match="stopped after 1 s"):
        xacro_read(tmp_path, ARM.replace("$(arg reach)", "${10**10**9}"), allow_xacro=True)


@pytest.mark.parametrize(("text", "told"), [
    (ARM.replace("part.xacro", "http://127.0.0.1/part.xacro"), "cannot expand it: .*No such file"),
    (ARM.replace("part.xacro", "$(find somewhere)/part.xacro"), "cannot expand it: .*ROS is installed"),
    (ARM.replace("part.xacro", "nowhere.xacro"), "No such file"),
    (ARM.replace("part.xacro", "bomb.xacro"), "DTDForbidden"),
    (BOMB, "DTDForbidden"),
    (ARM.replace(' default="0.3"', ""), "missing attribute 'default'"),
    (ARM.replace("$(arg reach)", "${1 / 0}"), "division by zero"),
])  # fmt: skip
def test_xacro_refusals(tmp_path, text, told):
    (tmp_path / "bomb.xacro").write_text(BOMB)
    refused(told, lambda: xacro_read(tmp_path, text, allow_xacro=True))


def test_a_missing_file_is_said_to_be_missing(tmp_path):
    refused("no such file", lambda: load_robot("nowhere.xacro", tmp_path, allow_xacro=True))
