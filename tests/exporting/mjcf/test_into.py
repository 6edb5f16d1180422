"""A user's scene with the fitted arm in it: everything else stays, and what cannot be patched is refused."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from cases import DATA, cases, refused
from drawn_arms import drawn, off
from scipy.spatial.transform import Rotation
from urdf_texts import words

from analysis.simulators import BASE, CASES, differences, patched
from bayescal.arm.motion import Term
from bayescal.arm.transforms import rigid
from bayescal.effects.location import joint
from bayescal.errors import BayescalError
from bayescal.exporting.export import export
from bayescal.exporting.geometry import zero_frames
from bayescal.exporting.mjcf import mjcf
from bayescal.model import with_parameters
from bayescal.simulation import Options, simulate
from bayescal.verifying.simulator import File, Machine, limit, modelled

SCENE = DATA / "ur5e_scene.xml"
EVERY = (*BASE, "base-compliance", "hysteresis", "coupling", "eccentricity", "backlash")


def written(effects, into: Path = SCENE):
    arm = drawn("universal-robots-ur5e", effects)
    return arm, export(arm, "mjcf", into=str(into), force=True)


@pytest.mark.parametrize("effects", [(*BASE, "bending"), (*EVERY, "bending")])
def test_simulator_has_the_fitted_arm(effects):
    arm = drawn("universal-robots-ur5e", effects)
    assert np.max(off(arm, 8, patched(arm, SCENE))) < limit(effects)


def test_everything_else_stays():
    text = written(EVERY)[1].written.content
    before, after = SCENE.read_text(), text
    for kept in ("<!-- an arm on a table", "<!-- the upper arm hangs to the side -->", "<?xml version"):
        assert kept in after
    old, new = ElementTree.fromstring(before), ElementTree.fromstring(after)
    for tag in ("geom", "light", "material", "general", "freejoint"):
        kept = [e.attrib for e in old.iter(tag)]
        assert kept == [e.attrib for e in new.iter(tag)][: len(kept)]
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
    # keyframes hold the same pose
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
    # cranks and slides are at their places
    assert np.max(np.abs(data.efc_pos[: data.ne]), initial=0.0) < 1e-9


def test_script_leaves_errors_of_readings_out():
    arm = drawn("universal-robots-ur5e", EVERY)
    text = export(arm, "mjcf", into=str(SCENE), readings="script", force=True).written.content
    assert "_flex" in text
    assert "_error" not in text


REFUSALS = cases("mjcf_refusals")


@pytest.mark.parametrize("name", REFUSALS)
def test_refusals(name, tmp_path):
    what, by, message = REFUSALS[name]
    text = SCENE.read_text()
    assert what in text
    (tmp_path / "scene.xml").write_text(text.replace(what, by, 1))
    assert "scene.xml" in str(refused(message, lambda: written(BASE, tmp_path / "scene.xml")))


def test_a_tip_that_fewer_joints_turn_is_refused():
    arm = drawn("universal-robots-ur5e", BASE)
    with pytest.raises(BayescalError, match="5 joints turn before the tip"):
        export(arm, "mjcf", into=f"{SCENE}#wrist_2_link", force=True)


# --- Scenes of arms with arbitrary frames, axes, references and orientations: the patched arm is the model.

EFFECTS = (*BASE, "base-compliance", "coupling", "eccentricity", "backlash")


def turned(rng, rotation: np.ndarray, degrees: bool) -> dict[str, str]:
    """One of the attributes that state an orientation."""
    own, kind = Rotation.from_matrix(rotation), rng.integers(4)
    if kind == 0:
        x, y, z, w = own.as_quat()
        return {"quat": words(3.0 * np.array([w, x, y, z]))}
    if kind == 1:
        return {"euler": words(own.as_euler("zyx", degrees=degrees))}
    if kind == 2:
        angle = own.magnitude()
        axis = own.as_rotvec() / max(angle, 1e-12)
        return {"axisangle": words([*axis, np.degrees(angle) if degrees else angle])}
    return {"xyaxes": words([*rotation[:, 0], *rotation[:, 1]])}


def about(axis: np.ndarray, at: np.ndarray, angle: float) -> np.ndarray:
    """A rotation (4, 4) about an axis through a point."""
    turn = Rotation.from_rotvec(angle * axis).as_matrix()
    return rigid(turn, at - turn @ at)


def random_scene(robot, rng) -> str:
    """An arm in a scene; its joints, at zero, are where those of the robot are."""
    degrees = bool(rng.integers(2))
    unit = np.degrees if degrees else float
    root = ET.Element("mujoco")
    angle = "degree" if degrees else "radian"
    ET.SubElement(root, "compiler", angle=angle, eulerseq="ZYX", autolimits="true")
    turn = Rotation.random(random_state=rng).as_matrix() if rng.integers(2) else np.eye(3)
    place, before = rigid(turn, rng.normal(size=3)), np.eye(4)
    ET.SubElement(root, "option", timestep="0.001", gravity=words(turn @ (0.0, 0.0, -9.81)))
    world = ET.SubElement(root, "worldbody")

    def body(within: ET.Element, name: str, pose: np.ndarray) -> ET.Element:
        orientation = turned(rng, pose[:3, :3], degrees)
        return ET.SubElement(within, "body", name=name, pos=words(pose[:3, 3]), **orientation)

    parent = body(world, "foot", place)
    ET.SubElement(parent, "geom", size=".1")
    for k, frame in enumerate(zero_frames(robot)[:-1]):
        own = frame @ rigid(Rotation.random(random_state=rng).as_matrix(), 0.1 * rng.normal(size=3))
        inverse, sign = np.linalg.inv(own), rng.choice([-1.0, 1.0])
        axis = inverse[:3, :3] @ (sign * frame[:3, 2])
        anchor = (inverse @ (frame @ [0.0, 0.0, 0.1 * rng.normal(), 1.0]))[:3]
        reference = float(rng.normal()) if rng.integers(2) else 0.0
        parent = body(parent, f"part{k}", np.linalg.inv(before) @ own @ about(axis, anchor, reference))
        ET.SubElement(parent, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        stated = {"axis": words(2.0 * axis), "pos": words(anchor), "ref": words([unit(reference)])}
        ET.SubElement(parent, "joint", name=f"turn{k}", **stated)
        before = own
    hand = ET.SubElement(parent, "body", name="hand")
    for k in (1, 2):
        finger = ET.SubElement(hand, "body", name=f"finger{k}")
        ET.SubElement(finger, "joint", name=f"knuckle{k}", axis="0 1 0", stiffness="1")
        ET.SubElement(finger, "geom", size=".01", mass="1e-6")
    ET.indent(root, "\t")
    return ET.tostring(root, encoding="unicode")


@pytest.mark.parametrize("robot", ["fanuc-lrmate200ic", "franka-panda"])
def test_an_arm_in_any_frames(tmp_path, robot):
    arm = drawn(robot, EFFECTS)
    text = random_scene(arm.dataset.robot, np.random.default_rng(2))
    (tmp_path / "scene.xml").write_text(text)
    mujoco.MjModel.from_xml_string(text)
    file = patched(arm, tmp_path / "scene.xml")
    assert np.max(off(arm, 3, file)) < limit(EFFECTS)
    model = mujoco.MjModel.from_xml_string(file.text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)  # as the file has the joints, at their references
    assert np.max(np.abs(data.efc_pos[: data.ne])) < 1e-9


# --- Arms with drawn parameters in MuJoCo, an independent simulator, against our own model.

POSES = 8


@pytest.mark.parametrize("effects", CASES, ids=lambda case: f"{case[-1]} of {len(case)}")
def test_every_effect_of_a_coupled_arm(effects):
    away, size = differences(drawn("fanuc-lrmate200ic", effects), POSES)
    assert np.max(away) < limit(effects)
    assert size > 2e-6  # there is an effect to hold


@pytest.mark.parametrize("robot", ["universal-robots-ur5e", "franka-panda"])
def test_other_arms(robot):
    effects = (*BASE, "base-compliance", "hysteresis", "coupling", "eccentricity", "backlash")
    assert np.max(off(drawn(robot, effects), POSES)) < limit(effects)


def test_a_stand_with_axes_of_its_own():
    """Two hinges along its principal axes, 0.4 m below the base."""
    arm, depth = drawn("universal-robots-ur5e", (*BASE, "base-compliance@turned")), 0.4
    xx, yy, cross = 1.2e-5, 6e-6, 4e-6
    given = {"x": xx, "y": yy, "cross": cross}
    given |= {"slide x": -depth * xx, "slide y": depth * yy, "slide cross": depth * cross}
    at = {p.name: k for k, p in enumerate(arm.model.parameters)}
    values = arm.values.copy()
    for name, value in given.items():
        values[at[f"base-compliance {name}"]] = value
    away, size = differences(arm.valued(values), POSES)
    assert np.max(away) < limit((*BASE, "base-compliance")) + 5e-8  # three times the tilt of other tests
    assert size > 1e-4


def test_an_added_load_elsewhere_is_a_further_mass(monkeypatch):
    """The body of the further mass is moved, and its mass counts by a factor."""
    counts = {"contacts": 60, "repeats": 0, "later": 10, "spheres": 0, "placements": 0}
    loaded = simulate(Options(seed=2, payload=2.0, **counts)).dataset
    monkeypatch.setattr("analysis.simulators.session", lambda robot, seed: loaded)
    away, size = differences(drawn("fanuc-lrmate200ic", (*BASE, "payload@added")), POSES)
    assert np.max(away) < limit((*BASE, "payload"))
    assert size > 2e-6


@pytest.mark.parametrize("side", ["reading", "link"])
def test_lost_motion_of_coupled_axes_is_at_its_gear(side):
    away, size = differences(drawn("fanuc-lrmate200ic", (*BASE, f"backlash@{side}")), POSES)
    assert np.max(away) < limit((*BASE, "backlash"))
    assert size > 2e-6


def test_a_difference_is_seen():
    """Ten micrometres in the file are ten micrometres in the comparison."""
    arm = drawn("universal-robots-ur5e", BASE)
    text = mjcf(arm, len(arm.dataset.measurements.ids) - 1)
    x = re.search(r'<body name="base" .*?pos="(\S+) ', text)
    wrong = text[: x.start(1)] + repr(float(x[1]) + 1e-5) + text[x.end(1) :]
    assert np.allclose(off(arm, POSES, File.of(arm, wrong, Path("wrong"), {})), 1e-5, atol=1e-8)


def test_leading_backlash_and_negative_compliance_are_refused():
    arm = drawn("universal-robots-ur5e", (*BASE, "backlash"))
    backlash = np.array([p.effect == "backlash" for p in arm.model.parameters])
    compliance = np.array([p.effect == "compliance" for p in arm.model.parameters])
    leading = arm.valued(np.where(backlash, -arm.values, arm.values))
    refused("backlash of J1 leads by", lambda: mjcf(leading, 0))
    assert np.max(off(leading, POSES, File.new(leading, 0, script=True))) < 2e-8
    of_two = drawn("universal-robots-ur5e", (*BASE, "hysteresis"))
    hysteresis = np.array([p.effect == "hysteresis" for p in of_two.model.parameters])
    with pytest.raises(BayescalError, match=r"J2 \+ hysteresis J2; .*--without 'hysteresis J2'"):
        mjcf(of_two.valued(np.where(hysteresis, -100.0 * np.abs(of_two.values), of_two.values)), 0)
    with pytest.raises(BayescalError, match="J2 turns against its torque"):
        mjcf(arm.valued(np.where(compliance, -arm.values, arm.values)), 0)


def test_a_joint_without_torque_where_the_arm_stands_has_no_spring():
    """A fit may have a compliance of a first joint that only a leaning base loads; a file then needs none."""
    arm = drawn("universal-robots-ur5e", BASE)
    scene, extra = arm.model.scene, next(p for p in arm.model.parameters if p.name == "compliance J2")
    upright = replace(extra, name="compliance J1", site=joint(1), terms=(Term(1, "rz", 0.0),))
    model = with_parameters(scene, arm.model.effects, (*arm.model.parameters, upright))
    further = replace(arm, model=model, values=np.append(arm.values, 1e-4), covariance=np.zeros((1, 1)))
    assert mjcf(further, 0) == mjcf(arm, 0)


def test_springs_and_friction_hold_the_largest_moments_of_the_session():
    """At the poses of the largest torques, and friction of twice the largest torque of any joint."""
    arm = drawn("universal-robots-ur5e", (*BASE, "hardening", "backlash"))
    torques = np.abs(arm.model.scene.moments[:, 1:, 2])
    rows = np.unique(np.argmax(torques, axis=0))
    state = len(torques) - 1
    text = mjcf(arm, state)
    reached, points = Machine.of(arm, state, File.of(arm, text, Path("arm"), {})).replayed(rows)
    away = np.linalg.norm(points - modelled(arm, rows, reached, state), axis=1)
    assert np.max(away) < limit((*BASE, "hardening", "backlash"))
    model = mujoco.MjModel.from_xml_string(text)
    tendons = [e for e in ElementTree.fromstring(text).iter("fixed") if e.get("name").endswith("_friction")]
    stiffness = [model.tendon_stiffness[model.tendon(e.get("name")).id] for e in tendons]
    held = [k * float(e.get("springyield")) for k, e in zip(stiffness, tendons, strict=True)]
    assert held == pytest.approx([max(30.0, 2.0 * torques.max())] * 6, rel=1e-12)
