"""URDF exports against Pinocchio on the written text; the user's file keeps all that is not an origin."""

import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from cases import cases, refused
from export_arms import calibrated_frames, fake, robot_of, session_of, with_robot
from scipy.spatial.transform import Rotation
from urdf_texts import arm as random_arm
from urdf_texts import joint, link, robot

from bayescal.arm.transforms import rpy_matrix, rpy_of
from bayescal.errors import BayescalError
from bayescal.exporting.export import export
from bayescal.exporting.xml_text import XmlText

LRMATE = robot(
    link("base_link"), link("link_1", 7.0), link("link_2"), link("link_3"), link("link_4"), link("link_5"),
    link("link_6"), link("tool0"), link("finger"),
    joint("joint_1", "base_link", "link_1", xyz=(0, 0, 0.33)),
    "<!-- the shoulder -->",
    joint("joint_2", "link_1", "link_2", xyz=(0.075, 0, 0), axis=(0, 1, 0)),
    joint("joint_3", "link_2", "link_3", xyz=(0, 0, 0.3), axis=(0, -1, 0)),
    joint("joint_4", "link_3", "link_4", xyz=(0, 0, 0.075), axis=(-1, 0, 0)),
    joint("joint_5", "link_4", "link_5", xyz=(0.32, 0, 0), axis=(0, -1, 0)),
    joint("joint_6", "link_5", "link_6", xyz=(0.08, 0, 0), axis=(-1, 0, 0)),
    joint("to_tool", "link_6", "tool0", "fixed", rpy=(3.14159265358979, -1.570796326794897, 0)),
    joint("grip", "link_6", "finger", "prismatic", xyz=(0, 0.01, 0),
          more='<mimic joint="joint_6" multiplier="0.1"/>'),
)  # fmt: skip
"""The LR Mate as ROS-Industrial has it: other frames, other senses, and J3 relative to the upper arm."""


def tip_points(text: str, tip: str, record: dict, readings: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Points of the flange (C, 3) in F0, by Pinocchio on a URDF with the mapping of its sidecar."""
    model = pin.buildModelFromXML(text)
    data, frame = model.createData(), model.getFrameId(tip)
    angles = readings @ np.array(record["joint_from_reading"]).T
    own = np.array(record["flange_in_tip"]) @ np.append(point, 1.0)
    out = []
    for turn in angles:
        q = pin.neutral(model)
        for name, value in zip(record["joints"].values(), turn, strict=True):
            q[model.joints[model.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(model, data, q)
        out.append(np.array(record["root_in_f0"]) @ data.oMf[frame].homogeneous @ own)
    return np.array(out)[:, :3]


def expected(arm, point, state=None) -> np.ndarray:
    """The same points by the model's geometry."""
    return (calibrated_frames(arm, state)[:, -1] @ np.append(point, 1.0))[:, :3]


POINT = np.array([0.06, -0.03, 0.12])


@pytest.fixture(scope="module")
def arm():
    return fake(session_of(), ("geometry",))


def saved(tmp_path, text=LRMATE, into="arm.urdf#tool0") -> str:
    """A file and its tip, as --into names them."""
    (tmp_path / into.partition("#")[0]).write_text(text)
    return str(tmp_path / into)


def check_moves(arm, out, tip="tool0", state=None) -> np.ndarray:
    """Points of the written arm, which are those of the calibrated geometry."""
    found = tip_points(out.written.content, tip, out.record("a"), arm.dataset.measurements.readings, POINT)
    np.testing.assert_allclose(found, expected(arm, POINT, state), rtol=0, atol=1e-9)
    return found


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "universal-robots-ur5e", "franka-panda"])
def test_a_new_urdf_moves_as_the_geometry(name):
    arm = fake(session_of(name), ("geometry",))
    out = export(arm, "urdf", name="arm")
    found = check_moves(arm, out, "flange")
    at_tool = (arm.at(arm.dataset.measurements.readings).flange @ np.append(POINT, 1.0))[:, :3]
    np.testing.assert_allclose(found, at_tool, rtol=0, atol=1e-9)
    assert not out.missing


@pytest.mark.parametrize("style", ["skew", "square"])
def test_a_patched_file_moves_as_the_geometry(tmp_path, style):
    """Fixed joints between the moving ones, branches, axes and frames of any direction."""
    into = saved(tmp_path, random_arm(5, 6, style), "arm.urdf#tip")
    arm = fake(with_robot(session_of(), robot_of("arm.urdf#tip", tmp_path)), ("geometry",))
    out = export(arm, "urdf", into=into)
    check_moves(arm, out, "tip")
    np.testing.assert_allclose(out.record("a")["root_in_f0"], np.eye(4), atol=1e-12)


def test_other_frames_senses_and_coupling(arm, tmp_path):
    out = export(arm, "urdf", into=saved(tmp_path))
    check_moves(arm, out)
    record = out.record("a")
    assert record["joints"]["J3"] == "joint_3"
    np.testing.assert_array_equal(record["joint_from_reading"][2], [0, 1, 1, 0, 0, 0])
    np.testing.assert_allclose(np.array(record["root_in_f0"])[:3, 3], [0, 0, -0.33], atol=1e-12)


@pytest.mark.parametrize("turn", [0, 90, 180, 30])
def test_a_symmetric_arm_keeps_the_senses_of_its_readings(tmp_path, turn):
    """At zero readings an iiwa is the same when turned by 180 deg, with opposite senses of three axes."""
    arm = fake(session_of(robot="kuka-iiwa7"), ("geometry",))
    text = export(arm, "urdf").written.content
    links = [e.get("name") for e in ET.fromstring(text).iter("link")]
    stand = joint("stand", "cell", links[0], "fixed", xyz=(0.2, 0, 0.7), rpy=(0, 0, np.radians(turn)))
    scene = text.replace("</robot>", f"{link('cell')}{stand}</robot>")
    into = saved(tmp_path, scene, f"cell.urdf#{links[-1]}")
    out = export(arm, "urdf", into=into)
    np.testing.assert_array_equal(out.record("a")["joint_from_reading"], np.eye(7))
    check_moves(arm, out, links[-1])


def calibrated_file(tmp_path, degrees, seed=5):
    """The file of the LR Mate with an earlier calibration, of which a zero is off by some degrees."""
    into = saved(tmp_path)
    earlier = fake(session_of(), ("geometry",), seed=seed)
    k = earlier.model.names.index("theta3")
    values = earlier.values.copy()
    values[k] = np.radians(degrees)
    out = export(replace(earlier, values=values), "urdf", into=into, force=True)
    return saved(tmp_path, out.written.content, "calibrated.urdf#tool0")


@pytest.mark.parametrize("degrees", [0.66, -1.8])
def test_a_calibrated_file_is_patched_again(arm, tmp_path, degrees):
    """The new calibration replaces the earlier one, also in the tip and in the frames of the links."""
    into = calibrated_file(tmp_path, degrees)
    fresh, again = (export(arm, "urdf", into=file) for file in (str(tmp_path / "arm.urdf#tool0"), into))
    check_moves(arm, again)
    np.testing.assert_allclose(again.record("a")["flange_in_tip"], np.eye(4), atol=1e-6)
    told = re.search(r"calibrated already, with zeros within ([\d.]+) deg", " ".join(again.notes))
    assert abs(float(told[1]) - abs(degrees)) < 0.25
    assert not any("calibrated already" in note for note in fresh.notes)
    models = [pin.buildModelFromXML(out.written.content) for out in (fresh, again)]
    for one, other in zip(*(model.jointPlacements for model in models), strict=True):
        assert np.linalg.norm(one.translation - other.translation) < 2e-3
        assert np.linalg.norm(pin.log3(one.rotation.T @ other.rotation)) < np.radians(0.4)


def test_an_earlier_calibration_of_the_zeros_is_undone_exactly(arm, tmp_path):
    """Zeros of all joints, also of the first and the last one, which move no other axis."""
    xml = XmlText(LRMATE, "arm.urdf")
    for k, zero in enumerate(np.radians([1.2, -0.5, 0.66, 0.3, -0.4, 0.9]), start=1):
        joint = next(e for e in xml.root.iter("joint") if e.get("name") == f"joint_{k}")
        axis = np.array(joint.find("axis").get("xyz").split(), float)
        origin = joint.find("origin")
        turn = rpy_matrix(np.array(origin.get("rpy").split(), float))
        turn = turn @ Rotation.from_rotvec(-zero * axis).as_matrix()
        origin.set("rpy", " ".join(map(repr, rpy_of(turn).tolist())))
    found = []
    for text in (LRMATE, xml.text):
        out = export(arm, "urdf", into=saved(tmp_path, text))
        found.append(pin.buildModelFromXML(out.written.content).jointPlacements)
    assert any("zeros within 1.2 deg" in note for note in out.notes)
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one.homogeneous, other.homogeneous, rtol=0, atol=2e-6)


def test_zeros_that_differ_too_much_are_of_another_arm(arm, tmp_path):
    into = calibrated_file(tmp_path, 2.4)
    with pytest.raises(BayescalError, match=r"the zero of joint_\d is 2\.\d+ deg off .* 2 deg at most"):
        export(arm, "urdf", into=into)


def test_meshes_are_found_from_another_folder(arm, tmp_path):
    shown = '<link name="base_link"><visual><geometry><mesh filename="{}"/></geometry></visual></link>'
    (tmp_path / "out").mkdir()
    cases = {"meshes/a.stl": "../meshes/a.stl", "package://x/a.stl": None, "/abs/a.stl": None}
    for name, wanted in cases.items():
        text = LRMATE.replace('<link name="base_link"></link>', shown.format(name), 1)
        assert text != LRMATE
        out = export(arm, "urdf", into=saved(tmp_path, text))
        assert f'filename="{name}"' in out.written.content
        out.save(tmp_path / "near.urdf")
        out.save(tmp_path / "out" / "far.urdf")
        assert f'filename="{name}"' in (tmp_path / "near.urdf").read_text()
        assert f'filename="{wanted or name}"' in (tmp_path / "out" / "far.urdf").read_text()


def test_everything_else_of_the_file_stays(arm, tmp_path):
    new, old = export(arm, "urdf", into=saved(tmp_path)).written.content, LRMATE
    turning = r'(<joint name="joint_\d" type="revolute"><origin )[^>]*(/>)'
    assert re.sub(turning, r"\1\2", new) == re.sub(turning, r"\1\2", old)
    assert new != old
    assert "<!-- the shoulder -->" in new


def test_a_joint_without_origin_gets_one_and_quotes_may_be_single(arm, tmp_path):
    text = LRMATE.replace('<origin xyz="0.0 0.0 0.33" rpy="0.0 0.0 0.0"/>', "", 1)
    text = text.replace('<origin xyz="0.0 0.0 0.3" rpy="0.0 0.0 0.0"/>', "<origin xyz='0 0 0.3'/>", 1)
    text = text.replace('<joint name="joint_1"', "<joint\n  name = 'joint_1' ", 1)
    assert text.count("<origin") == LRMATE.count("<origin") - 1
    out = export(arm, "urdf", into=saved(tmp_path, text))
    assert out.written.content.count("<origin") == LRMATE.count("<origin")
    check_moves(arm, out)


REFUSED = (
    (lambda t: t.replace('0.3"', '0.31"', 1), "the distance of the axes of joint_2 and joint_3 is 310.00 mm"),
    (lambda t: t.replace('axis xyz="-1.0 0.0 0.0"', 'axis xyz="-1.0 0.1 0.0"', 1), "and joint_4 differ by"),
    (lambda t: t.replace('"0.32 0.0 0.0"', '"0.42 0.0 0.0"', 1), "the zero of joint_2 is 9.45 deg off"),
    (lambda t: t.replace('"joint_6" type="revolute"', '"joint_6" type="fixed"'), "5 joints turn before"),
    (lambda t: t.replace("joint_1", "J2"), "joint 1 is called J2"),
    (lambda t: t.replace("joint_5", "lift").replace('"lift" type="revolute"', '"lift" type="prismatic"'),
     "joint lift is prismatic"),
)  # fmt: skip


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_another_arm_is_refused_with_the_first_difference(arm, tmp_path, change, message):
    text = change(LRMATE)
    assert text != LRMATE
    refused(message, lambda: export(arm, "urdf", into=saved(tmp_path, text)))


def test_a_xacro_and_another_format_are_refused(arm, tmp_path):
    refused("a xacro file cannot be patched", lambda: export(arm, "urdf", into=str(tmp_path / "arm.xacro")))
    refused("is always a new file", lambda: export(arm, "robot.yaml", into="arm.yaml"))
    refused("there is no format `step`", lambda: export(arm, "step"))


def test_drift_is_written_at_a_state_and_its_change_is_told():
    arm = fake(session_of(), ("geometry", "thermal-drift", "step@20"))
    m = arm.dataset.measurements
    outs = [export(arm, "urdf", row=row, name="arm") for row in (m.ids[0], None)]
    assert outs[0].written.content != outs[1].written.content
    for out, row in zip(outs, (0, None), strict=True):
        check_moves(arm, out, "flange", row)
        assert {m.effect for m in out.missing} == {"thermal-drift", "step"}
        assert all(m.why.startswith("changes during the session") for m in out.missing)
    assert export(arm, "urdf", time=float(m.time[0]), name="arm").written.content == outs[0].written.content


@pytest.mark.parametrize("outliers", [0, 5])
def test_sizes_of_what_is_missing(outliers):
    """By effect: the distance of the TCP positions from those without it, where the rows are no outliers."""
    arm = fake(session_of(), ("geometry", "compliance", "backlash", "lobing"))
    ids = arm.dataset.measurements.ids
    arm = replace(arm, rejected=ids[::7][:outliers])
    out = export(arm, "urdf", name="arm")
    missing = {m.effect: m for m in out.missing}
    assert missing.keys() == {"compliance", "backlash", "lobing"}
    rows = np.array([k for k, name in enumerate(ids) if name not in arm.rejected])
    rigid = np.where([p.effect == "backlash" for p in arm.model.parameters], 0, arm.values)
    full = arm.model.motion(rows).points(arm.values)
    off = np.linalg.norm(full - arm.model.motion(rows).points(rigid), axis=0)
    assert missing["backlash"].rms == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-12)
    assert missing["backlash"].maximum == pytest.approx(off.max(), rel=1e-12)
    assert missing["lobing"].why.startswith("belongs to the probe")
    assert missing["lobing"].rms > 0
    assert out.total.rms >= 0.5 * missing["compliance"].rms


# --- XML changed in place: what does not change stays to the byte, and the text is the tree.

TAGS, VALUES = ("a", "b-c", "long_name"), ("", "1 2", "x > y", "a &amp; b", "&lt;&#181;", "it's")
GAPS = cases("xml_gaps")


def random_xml(rng: np.random.Generator, depth: int = 0) -> str:
    """An element with attributes of any quotes and blanks, comments, text and children."""
    tag, quote = rng.choice(TAGS), rng.choice(['"', "'"])
    out = f"<{tag}"
    for key in rng.permutation(["x", "name", "y"])[: rng.integers(4)]:
        value = str(rng.choice(VALUES))
        mark = quote if quote not in value else '"'
        out += f"{rng.choice([' ', chr(10) + '  '])}{key}{rng.choice(['=', ' = '])}{mark}{value}{mark}"
    children = int(rng.integers(4)) if depth < 3 else 0
    if not children and rng.random() < 0.7:
        return out + rng.choice(["/>", " />", f"></{tag}>", f"></{tag} >"])
    inner = "".join(str(rng.choice(GAPS)) + random_xml(rng, depth + 1) for _ in range(children))
    return f"{out}>{inner}{rng.choice(GAPS)}</{tag}>"


def shape(e: ET.Element):
    return e.tag, dict(e.attrib), [shape(child) for child in e]


@pytest.mark.parametrize("seed", range(40))
def test_the_text_is_the_tree(seed):
    rng = np.random.default_rng(seed)
    text = f"<!-- before -->\n{random_xml(rng)}\n<!-- behind -->"
    xml = XmlText(text, "x")
    assert xml.text == text
    for _ in range(6):
        elements = list(xml.root.iter())
        e = elements[rng.integers(len(elements))]
        parents = {child: own for own in elements for child in own}
        kind = rng.integers(6)
        if kind == 0:
            e.set("x", str(rng.choice(['"', "<&>", "7"])))
        elif kind == 1 and e.attrib:
            del e.attrib[next(iter(e.attrib))]
        elif kind == 2:
            e.insert(int(rng.integers(len(e) + 1)), ET.Element("new", n="1"))
        elif kind == 3 and e in parents:
            parents[e].remove(e)
        elif kind == 4 and e in parents:  # a new element around an old one
            own, around = parents[e], ET.Element("around")
            at = list(own).index(e)
            own.remove(e)
            around.append(e)
            own.insert(at, around)
        elif kind == 5 and len(e) > 1:
            last = e[-1]
            e.remove(last)
            e.insert(0, last)
        assert shape(ET.fromstring(xml.text)) == shape(xml.root)
    assert xml.text.startswith("<!-- before -->\n<")
    assert xml.text.endswith(">\n<!-- behind -->")


def test_only_the_changed_attribute_changes():
    text = "<a>\n\t<b\n  k = 'x=\"1\"'  x='1'\ty=\"&lt;\" /> <!-- x='1' -->\n\t<b x='1'/>\n</a>"
    xml = XmlText(text, "x")
    xml.root[0].set("x", "2")
    assert xml.text == text.replace("  x='1'\ty", '  x="2"\ty')
    del xml.root[0].attrib["x"]
    assert xml.text == text.replace("  x='1'\ty", "\ty")


def test_added_elements_have_the_indentation_of_their_place():
    xml = XmlText("<a>\r\n   <b>\r\n      <c/>\r\n   </b>\r\n   <d/>\r\n</a>\r\n", "x")
    ET.SubElement(ET.SubElement(xml.root[0], "n"), "m")
    ET.SubElement(xml.root[1], "n")
    ET.SubElement(xml.root, "n")
    assert xml.text == (
        "<a>\r\n   <b>\r\n      <c/>\r\n      <n>\r\n        <m/>\r\n      </n>\r\n   </b>\r\n"
        "   <d>\r\n     <n/>\r\n   </d>\r\n   <n/>\r\n</a>\r\n"
    )
    assert XmlText("<a><b/></a>", "x").text == "<a><b/></a>"
    line = XmlText("<a><b/></a>", "x")
    ET.SubElement(line.root, "n")
    assert line.text == "<a><b/><n/></a>"


def test_comments_of_removed_elements_stay_and_names_of_spaces_too():
    text = '<a xmlns:i="http://i/" i:k="v" x="1">\n <!-- of b -->\n <b/>\n <c/>\n</a>'
    xml = XmlText(text, "x")
    xml.root.remove(xml.root[0])
    assert xml.text == text.replace("\n <b/>", "")
    xml.root.set("x", "2")
    assert xml.text == text.replace("\n <b/>", "").replace('x="1"', 'x="2"')
