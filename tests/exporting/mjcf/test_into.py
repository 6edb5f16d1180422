"""A user's scene with the fitted arm in it: everything else stays, and what cannot be patched is refused."""

import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))

from analysis.simulators import BASE, differences, drawn, patched
from bayescal.errors import BayescalError
from bayescal.exporting.export import export
from bayescal.verifying.levels import limit

SCENE = Path(__file__).with_name("ur5e_scene.xml")
EVERY = (*BASE, "base-compliance", "hysteresis", "coupling", "eccentricity", "backlash")


def written(effects, into: Path = SCENE):
    arm = drawn("universal-robots-ur5e", effects)
    return arm, export(arm, "mjcf", into=str(into), force=True)


@pytest.mark.parametrize(
    "effects", [("geometry",), BASE, (*BASE, "base-compliance"), (*BASE, "bending"), (*EVERY, "bending")]
)
def test_simulator_has_the_fitted_arm(effects):
    arm = drawn("universal-robots-ur5e", effects)
    off, _ = differences(arm, 8, patched(arm, SCENE))
    assert np.max(off) < limit(effects)


def test_everything_else_stays():
    text = written(EVERY)[1].written.content
    before, after = SCENE.read_text(), text
    for kept in ("<!-- an arm on a table", "<!-- the upper arm hangs to the side -->", "<?xml version"):
        assert kept in after
    old, new = ElementTree.fromstring(before), ElementTree.fromstring(after)
    for tag in ("geom", "light", "material", "general", "freejoint"):
        assert [e.attrib for e in old.iter(tag)] == [e.attrib for e in new.iter(tag)][
            : len(list(old.iter(tag)))
        ]
    joints = {e.get("name"): e.attrib for e in new.iter("joint") if e.get("name")}
    for e in old.iter("joint"):
        if e.get("name"):
            assert joints[e.get("name")] == e.attrib
    inserted = [e for e in new.iter("joint") if e.get("name", "").endswith("_flex")]
    model = mujoco.MjModel.from_xml_string(after)
    for e in inserted:  # defaults of the user's file do not act on added joints
        joint = model.joint(e.get("name"))
        assert joint.armature[0] == 1e-3
        assert joint.damping[0] == pytest.approx(float(e.get("damping")))


def test_keyframes_hold_the_same_pose():
    text = written(EVERY)[1].written.content
    old, new = mujoco.MjModel.from_xml_path(str(SCENE)), mujoco.MjModel.from_xml_string(text)
    assert new.nq > old.nq
    assert new.nu == old.nu
    for j in range(old.njnt):
        name, size = old.joint(j).name, len(old.joint(j).qpos0)
        a, b = old.joint(j).qposadr[0], new.joint(name).qposadr[0]
        assert np.array_equal(old.key_qpos[0][a : a + size], new.key_qpos[0][b : b + size])
    assert np.array_equal(old.key_ctrl, new.key_ctrl)
    data = mujoco.MjData(new)
    mujoco.mj_resetDataKeyframe(new, data, 0)
    mujoco.mj_forward(new, data)
    assert (
        np.max(np.abs(data.efc_pos[: data.ne]), initial=0.0) < 1e-9
    )  # cranks and slides are at their places


def test_script_leaves_errors_of_readings_out():
    arm = drawn("universal-robots-ur5e", EVERY)
    text = export(arm, "mjcf", into=str(SCENE), readings="script", force=True).written.content
    assert "_flex" in text
    assert "_error" not in text


REFUSALS = {
    "no include": ("<asset>", '<include file="other.xml"/><asset>', "other.xml.>: there is no such file"),
    "included elsewhere": ("<asset>", '<include file="/etc/x.xml"/><asset>', "no relative path"),
    "included itself": ("<asset>", '<include file="scene.xml"/><asset>', "included twice"),
    "another arm": (
        'pos="0 -0.131 0.425"',
        'pos="0 -0.131 0.45"',
        "shoulder_lift_joint and elbow_joint is 450",
    ),
    "zeros": (
        '<body name="wrist_2_link"',
        '<body name="wrist_2_link" quat="0.9 0 0.4 0"',
        "the zero of wrist_1_joint is 47.91 deg off",
    ),
    "a second joint": ('<geom name="cube"', '<joint/><geom name="cube"', "MuJoCo refuses the file"),
    "scaled masses": (
        'autolimits="true"',
        'autolimits="true" settotalmass="30"',
        "settotalmass: MuJoCo changes",
    ),
    "a joint in a frame": (
        '<joint name="elbow_joint" class="size3_limited"/>',
        '<frame><joint name="elbow_joint" class="size3_limited"/></frame>',
        "the joint of body forearm_link is in a <frame>",
    ),
    "doctype": ("<mujoco ", '<!DOCTYPE x [<!ENTITY a "b">]><mujoco ', "DOCTYPE"),
    "name": ('name="table"', 'name="cube"', "MuJoCo refuses the file"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refusals(name, tmp_path):
    what, by, message = REFUSALS[name]
    text = SCENE.read_text()
    assert what in text
    (tmp_path / "scene.xml").write_text(text.replace(what, by, 1))
    with pytest.raises(BayescalError, match=message) as refusal:
        written(BASE, tmp_path / "scene.xml")
    assert "scene.xml" in str(refusal.value)
    assert not re.search("\n", str(refusal.value))


def test_a_tip_that_fewer_joints_turn_is_refused():
    arm = drawn("universal-robots-ur5e", BASE)
    with pytest.raises(BayescalError, match="5 joints turn before the tip"):
        export(arm, "mjcf", into=f"{SCENE}#wrist_2_link", force=True)
