"""The arm of a log in simulators: the same torques, and what a file cannot hold."""

import json
import shutil
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import yaml
from cases import refused
from motion.made import RATE, inverse, verified, write

import bayescal as bc
from bayescal.exporting.log_arm import FORMATS, LogExport, bam_of, drives_of, export_log, text_of
from bayescal.exporting.written import mujoco
from bayescal.logs.read import written_out
from bayescal.logs.schema import Arm, arm_text
from bayescal.robots.urdf import robot_from_urdf
from bayescal.verifying.log import COPY

JOINT = {"name": "J", "origin_mm": [0, 0, 0], "mass_kg": 1, "centre_of_mass_mm": [0, 0, 0]}
JOINT |= {"inertia_kgm2": [1, 1, 1, 0, 0, 0]}


@pytest.fixture(scope="module")
def run(tmp_path_factory, null_log):
    folder = tmp_path_factory.mktemp("export") / "run"
    bc.fit(null_log, samples=0).save(folder)
    return folder


def changed(run, folder, **fields):
    """A copy of a run folder whose record has other values of some fields."""
    shutil.copytree(run, folder)
    record = json.loads((folder / "fit.json").read_text()) | fields
    (folder / "fit.json").write_text(json.dumps(record))
    return folder


@pytest.mark.parametrize("to", [name for name in FORMATS if name != "bam"])
def test_every_format_has_the_bodies_and_says_what_it_lacks(run, tmp_path, to):
    exported = bc.export(run, to)
    root = ElementTree.fromstring(exported.content)
    bodies = [e for e in root.iter() if e.tag == "mass" or (e.tag == "inertial" and e.get("mass"))]
    masses = [float(e.get("value") or e.get("mass") or e.text) for e in bodies]
    fitted = bc.load(run).parameters.estimate
    assert masses == pytest.approx([fitted[f"mass of link {k}"] for k in (1, 2, 3)], rel=1e-6)
    path, beside = exported.save(tmp_path / "arm.xml")
    missing = [part["part"] for part in json.loads(beside.read_text())["not_expressed"]]
    assert ("rotors" in missing) == (to != "mjcf")
    assert "offsets of the torque" in missing
    assert "not in the file" in str(exported)
    assert path.read_text() == exported.content


def arm_of(*joints):
    return written_out(Arm.model_validate({"joints": joints}), "made")


LIMITED = {"name": "K", "limits_deg": [-100, 120], "max_velocity_degps": 90, "rated_torque_Nm": 40}


def test_joints_keep_their_limits_and_those_without_turn_without_end(tmp_path):
    """As URDF, SDF and MJCF, and in arm.yaml."""
    m = arm_of(JOINT, JOINT | LIMITED | {"origin_mm": [0, 0, 300], "rpy_deg": [90, 0, 0]})
    m = replace(m, **dict.fromkeys(("armature", "coulomb", "viscous"), np.zeros(2)))
    again = arm_of(*yaml.safe_load(arm_text(m))["joints"])
    assert again.limits == pytest.approx(m.limits, nan_ok=True)
    assert again.fastest == pytest.approx(m.fastest, nan_ok=True)
    low, high = np.radians(LIMITED["limits_deg"])
    texts = {to: text_of(m, to, np.zeros(3)) for to in ("urdf", "sdf", "mjcf")}
    robot = robot_from_urdf(texts["urdf"].encode(), "two.urdf")
    assert list(robot.endless) == [True, False]
    assert robot.limits[1] == pytest.approx([low, high])
    assert robot.velocities == pytest.approx([np.nan, np.pi / 2], nan_ok=True)
    assert robot.torques == pytest.approx([np.nan, 40.0], nan_ok=True)
    assert "not stated by the robot" in texts["urdf"]
    first, second = ElementTree.fromstring(texts["sdf"]).iterfind("model/joint[axis]")
    assert [first.get("type"), second.get("type")] == ["continuous", "revolute"]
    assert first.find("axis/limit") is None
    limit = {e.tag: float(e.text) for e in second.find("axis/limit")}
    assert limit == pytest.approx({"lower": low, "upper": high, "effort": 40.0, "velocity": np.pi / 2})
    model = mujoco().MjModel.from_xml_string(texts["mjcf"])
    assert list(model.jnt_limited) == [False, True]
    assert model.jnt_range[1] == pytest.approx([low, high])


def test_a_machine_may_stand_at_the_limits_of_its_file(run, tmp_path):
    """Torques of a verification are those of bodies and drives alone."""
    text = bc.export(run, "mjcf").content
    for name in "ABC":
        text = text.replace(f'joint name="{name}"', f'joint name="{name}" limited="true" range="-0.1 0.1"')
    (tmp_path / "arm.xml").write_text(text)
    assert bc.verify(run, tmp_path / "arm.xml").passed


def test_what_a_file_lacks_has_its_size_whatever_its_sign(run):
    record = bc.load(run).record
    offsets = [p for p in record["parameters"] if p["name"].startswith("offset")]
    negative = [p | {"estimate": -abs(p["estimate"])} for p in offsets]
    sizes = [-p["estimate"] for p in negative]
    assert export_log(run, {**record, "parameters": negative}, "mjcf").missing["offset"] == tuple(sizes)
    assert min(sizes) > 0.0


def test_simulators_load_the_same_arm(run):
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 4, 3))
    models = [mujoco().MjModel.from_xml_string(bc.export(run, to).content) for to in ("mjcf", "urdf")]
    for model in models:
        model.dof_frictionloss[:], model.dof_damping[:], model.dof_armature[:] = 0.0, 0.0, 0.0
    a, b = (inverse(model, q, dq, ddq) for model in models)
    assert a == pytest.approx(b, abs=1e-6)


def test_the_exported_arm_needs_the_torques_that_were_measured(run, tmp_path):
    file, result = verified(run, tmp_path)
    assert result.passed
    data = result.data
    assert np.all(data.difference < 1e-9)
    withheld = bc.load(run).withheld
    assert data.fitted == pytest.approx(withheld.rms_Nm, rel=0.15)
    assert np.all(data.nominal[1:] > 2.0 * data.fitted[1:])
    assert result.save(tmp_path / "verify") == ("verify.json",)
    assert "the file is the arm that was fitted" in str(result)
    # Torques that are logged two rows late, and a fit that states it: the same errors
    shift = bc.load(run).record["torque_shift_ms"] + 2e3 / RATE
    late = changed(run, tmp_path / "late", torque_shift_ms=shift)
    (path,) = (late / COPY).glob("*.csv.gz")
    table = pd.read_csv(path)
    torques = [name for name in table.columns if name.startswith("torque")]
    table[torques] = table.groupby("motion")[torques].shift(2).bfill()
    table.to_csv(path, index=False)
    assert bc.verify(late, file).data.fitted == pytest.approx(data.fitted, rel=0.03)


def test_errors_of_a_coarse_log_are_those_of_its_fit(tmp_path):
    """Positions are differentiated in the band of the fit: a wider one has ten times the noise."""
    path = next(write(tmp_path / "log").glob("*.csv.gz"))
    table, step = pd.read_csv(path), 360.0 / 4096
    angles = [name for name in table.columns if name.startswith("q")]
    table[angles] = step * np.round(table[angles] / step)
    table.to_csv(path, index=False)
    fit = bc.fit(tmp_path / "log", samples=0)
    fit.save(tmp_path / "run")
    _, result = verified(tmp_path / "run", tmp_path)
    assert result.data.fitted == pytest.approx(fit.withheld.rms_Nm, rel=0.3)


def test_another_arm_is_not_the_one_that_was_fitted(run, tmp_path):
    text = bc.export(run, "mjcf").content
    wrong = tmp_path / "wrong.xml"
    mass = text.split('mass="')[2].split('"')[0]
    wrong.write_text(text.replace(f'mass="{mass}"', f'mass="{1.01 * float(mass)}"', 1))
    result = bc.verify(run, wrong)
    assert not result.passed
    assert "the file is not the arm that was fitted" in str(result)
    for what, factor in (("damping", 1.2), ("frictionloss", 0.8)):
        size = text.split(f'{what}="')[1].split('"')[0]
        wrong.write_text(text.replace(f'{what}="{size}"', f'{what}="{factor * float(size)}"', 1))
        assert not bc.verify(run, wrong).passed
    wrong.write_text(bc.export(run, "urdf").content)
    refused("is no MJCF", lambda: bc.verify(run, wrong))
    wrong.write_text("<mujoco><worldbody/></mujoco>")
    refused("has 0 joints, the log 3", lambda: bc.verify(run, wrong))
    wrong.write_text("<mujoco><no/></mujoco>")
    refused("MuJoCo does not load it", lambda: bc.verify(run, wrong))


def test_drives_are_read_back_as_bam_reads_them(run):
    """The names of BAM's parameters, and its budget of friction, against the fitted model."""
    drives = json.loads(bc.export(run, "bam").content)
    fitted = bc.load(run).parameters.estimate
    assert list(drives) == ["A", "B", "C"]
    names = {"friction_base": "coulomb", "friction_viscous": "viscous", "armature": "armature"}
    for k, drive in enumerate(drives.values(), 1):
        assert drive["model"] == "m1"
        for key, name in names.items():
            assert drive[key] == pytest.approx(fitted[f"{name} {k}"], rel=1e-6)


@pytest.fixture(scope="module")
def gap(tmp_path_factory, rubbing):
    """The run folder of a diagnosis with friction that grows with load."""
    folder = tmp_path_factory.mktemp("named") / "run"
    rubbing.save(folder)
    return folder


def test_named_effects_are_in_the_file_or_stated(gap):
    record = bc.load(gap).record
    assert "load-friction" in record["effects"]
    value = record["arm"]["load-friction joint 2 torque times direction"]
    drives = json.loads(bc.export(gap, "bam").content)
    assert drives["B"]["model"] == "m5"
    assert drives["B"]["load_friction_external"] == pytest.approx(value)
    assert drives["A"]["model"] == "m1"
    beside = {e["effect"]: e for e in record["beside"]}["load-friction"]
    assert beside["of_joints"][1] > 10.0 * max(beside["of_joints"][0], beside["of_joints"][2], 1e-9)
    for to, stated in (("mjcf", True), ("urdf", True), ("sdf", True), ("bam", False)):
        parts = {p["part"]: p for p in bc.export(gap, to).record["not_expressed"]}
        assert ("load-friction" in parts) == stated
        if stated:
            assert parts["load-friction"]["of_joints"] == pytest.approx(beside["of_joints"])


def test_the_budget_of_bam_is_the_torque_of_the_effects():
    """Duclusaud et al., ICRA 2025: base + Stribeck + load, of which the model has the same columns."""
    record = {
        "unit": "deg",
        "controller": {"kind": "position", "kp_Nm_per_rad": [100.0], "kd_Nms_per_rad": None},
        "arm": {
            "stribeck joint 1 low speed 0.12 rad/s, power 2": 0.3,
            "load-friction joint 1 torque times direction": 0.07,
            "servo-stiffness joint 1 torque": 0.25,
            "tracking lag 1": 0.02,
        },
    }
    d = drives_of(record, 1)
    assert d.stiffness == pytest.approx([80.0])
    assert d.damping == pytest.approx([2.0])
    m = replace(arm_of(JOINT), armature=np.array([0.1]), coulomb=np.array([0.5]), viscous=np.array([0.2]))
    p = json.loads(bam_of(m, d))["J"]
    speed, motor, external = 0.05, 1.4, -2.0
    rise = np.exp(-((abs(speed) / p["dtheta_stribeck"]) ** p["alpha"]))
    load = abs(external * p["load_friction_external"] - motor * p["load_friction_motor"])
    held = p["friction_base"] + p["friction_stribeck"] * rise + load
    assert held == pytest.approx(0.5 + 0.3 * np.exp(-((0.05 / 0.12) ** 2)) + 0.07 * 2.0)


def test_a_diagnosis_is_verified_with_its_arm(gap, tmp_path):
    _, result = verified(gap, tmp_path)
    assert result.passed
    assert "no commands are logged" in result.data.tracking
    assert "not replayed: no commands are logged" in str(result)


def test_other_formats_and_options_are_refused(run):
    refused("cannot be written as kuka", lambda: bc.export(run, "kuka"))
    refused("is the run of a joint log", lambda: bc.budget(run))
    refused("leave other options out", lambda: bc.export(run, "mjcf", with_="backlash"))


def test_an_arm_whose_base_is_tilted_is_verified_with_its_gravity(run, tmp_path):
    tilted = changed(run, tmp_path / "tilted", gravity_mps2=[0.3, -0.2, -9.8])
    file, result = verified(tilted, tmp_path)
    assert result.passed
    file.write_text(bc.export(run, "mjcf").content)
    assert not bc.verify(tilted, file).passed


def test_errors_of_position_are_the_torques_over_the_stiffness():
    """In mrad, of what is left out and has a torque; the stored entries have them too."""
    missing, effect = {"offset": (1.0, 0.5)}, {"effect": "ripple", "unit": "N m", "of_joints": [0.2, 0.1]}
    angle = {"effect": "delay", "unit": "s", "of_joints": [1.0, 1.0]}
    stiffness = np.array([500.0, 250.0])
    out = LogExport("mjcf", "arm", "", missing, (effect, angle), {}, stiffness)
    parts = out.record("")["not_expressed"]
    assert len(parts) == 3
    for part in parts[:2]:
        radians = np.array(part["of_joints"]) / stiffness
        assert part["mrad"] == pytest.approx(1e3 * radians)
    assert parts[2]["mrad"] is None
    assert replace(out, stiffness=None).record("")["not_expressed"][0]["mrad"] is None
