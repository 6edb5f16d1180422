"""SDF exports: read by the rules of the format and put into MuJoCo: where the tool comes to rest."""

from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from export_arms import fake, session_of

from bayescal.arm.transforms import rigid, rotation, rpy_matrix
from bayescal.exporting.export import export

STEPS = 12


def pose(text: str) -> np.ndarray:
    x = np.array(text.split(), float)
    return rigid(rpy_matrix(x[3:]), x[:3])


def quat(matrix: np.ndarray) -> str:
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, matrix[:3, :3].ravel())
    return " ".join(map(repr, out.tolist()))


def words(values) -> str:
    return " ".join(repr(float(v)) for v in values)


def resting(text: str, angles: dict[str, float], gravity: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the flange in the model's frame, with commanded joints at some angles, rad."""
    model = ET.fromstring(text).find("model")
    links = {link.get("name"): link for link in model.findall("link")}
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(root, "option", integrator="discrete", timestep="1", gravity=words(gravity))
    bodies = {"world": ET.SubElement(root, "worldbody")}
    for joint in model.findall("joint"):
        parent, child = joint.findtext("parent"), joint.findtext("child")
        own = links[child].find("pose")
        assert own.get("relative_to", "world") == parent
        at, axis = pose(own.text), joint.find("axis")
        spring = None if axis is None else axis.findtext("dynamics/spring_stiffness")
        if axis is not None and spring is None:
            assert pose(joint.findtext("pose"))[:3, 3].tolist() == [0, 0, 0]
            assert axis.findtext("xyz").split() == ["0.0", "0.0", "1.0"]
            at = at @ rigid(rotation(2, angles[joint.get("name")]))
        body = ET.SubElement(bodies[parent], "body", name=child, pos=words(at[:3, 3]), quat=quat(at))
        inertial = links[child].find("inertial")
        if links[child].findtext("gravity") == "false":
            body.set("gravcomp", "1")
        ET.SubElement(
            body, "inertial", mass=inertial.findtext("mass"),
            pos=words(pose(inertial.findtext("pose"))[:3, 3]),
            diaginertia=" ".join(inertial.findtext(f"inertia/{k}") for k in ("ixx", "iyy", "izz")),
        )  # fmt: skip
        if spring is not None:
            ET.SubElement(
                body, "joint", type="hinge", axis=axis.findtext("xyz"), stiffness=spring,
                pos=words(pose(joint.findtext("pose"))[:3, 3]), damping=axis.findtext("dynamics/damping"),
                springref=axis.findtext("dynamics/spring_reference"),
            )  # fmt: skip
        bodies[child] = body
    built = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(built)
    for _ in range(STEPS if built.nv else 0):
        mujoco.mj_step(built, data)
    mujoco.mj_forward(built, data)
    k = mujoco.mj_name2id(built, mujoco.mjtObj.mjOBJ_BODY, "flange")
    return rigid(data.xmat[k].reshape(3, 3), data.xpos[k])


ELASTIC = ("compliance",), ("compliance", "bending"), ("compliance", "base-compliance")


@pytest.mark.parametrize("effects", ELASTIC, ids=lambda e: e[-1])
@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", "universal-robots-ur5e"])
def test_the_tool_rests_where_the_model_has_it(name, effects):
    arm = fake(session_of(name), ("geometry", *effects), scale=0.4)
    out = export(arm, "sdf", name="arm", force=True)
    record = out.record("arm.sdf")
    readings, names = arm.dataset.measurements.readings[:4], arm.dataset.robot.joint_names
    poses = arm.at(readings)
    point = np.linalg.solve(poses.flange[0], np.append(poses.points[0], 1.0))
    for k, reading in enumerate(readings):
        turns = dict(zip(names, np.array(record["joint_from_reading"]) @ reading, strict=True))
        found = resting(out.written.content, turns, arm.dataset.gravity) @ point
        # the second order of bending: the same limit as of tests/statics
        assert np.linalg.norm(found[:3] - poses.points[k]) < (0.6e-6 if "bending" in effects else 0.15e-6)
    assert not out.missing


def test_names_are_unique_and_other_effects_are_told():
    arm = fake(session_of(), ("geometry", "compliance", "backlash", "hardening"))
    out = export(arm, "sdf", name="arm")
    model = ET.fromstring(out.written.content).find("model")
    for tag in ("link", "joint"):
        each = [element.get("name") for element in model.findall(tag)]
        assert len(set(each)) == len(each)
    assert {m.effect for m in out.missing} == {"backlash", "hardening"}
    springs = {j.get("name"): j.findtext("axis/dynamics/spring_stiffness") for j in model.findall("joint")}
    values = dict(zip(arm.model.names, arm.model.shift * 0 + arm.values, strict=False))
    assert float(springs["J3_flex"]) == pytest.approx(1.0 / values["compliance J3"], rel=1e-9)
    assert springs["J3"] is None
