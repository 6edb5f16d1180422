"""Logs of position servos without torques: friction with memory, stiffness by sag, verdicts in degrees."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from cases import refused
from motion.made import verified
from motion.servo_logs import without_stiffness

import bayescal as bc
from analysis.world.motion.servos import make, write
from bayescal.logs import read_log
from bayescal.logs.types import SERVO, TORQUE
from bayescal.motion.controller import is_servo, with_torques
from bayescal.motion.dynamics import Followed, carried, followed, regressor
from bayescal.motion.effects import EFFECTS
from bayescal.motion.estimate import estimate_of, spread_of_servos
from bayescal.motion.fit_settings import SERVOS
from bayescal.motion.signals import all_signals
from bayescal.preparing.next_motions import next_motions


def held(u, load=0.0, stiffness=10.0, friction=1.0, slow=1e-4):
    """Motion of one joint with hardly any inertia or viscous friction."""
    drive = np.array([[stiffness], [friction], [1e-3], [1e-6], [slow]])
    out = followed(u[:, None], np.full((len(u), 1), load), drive, np.array([u[0] - load / stiffness]), 0.02)
    return Followed(*out[:, :, 0])


def test_friction_holds_a_joint_until_the_error_exceeds_it():
    """Up by 1 rad and back, at 10 N m/rad and 1 N m: it moves after .1 rad, and back after .2 rad."""
    u = np.r_[np.linspace(0.0, 1.0, 101), np.linspace(0.99, 0.0, 100)]
    for load in (0.0, 3.0):  # a constant load displaces the joint and changes nothing else
        motion = held(u, load)
        friction = motion.friction
        assert friction[:11] == pytest.approx(np.linspace(0.0, 1.0, 11), abs=0.02)
        assert friction[15:100] == pytest.approx(1.0, abs=1e-9)
        assert friction[100:121] == pytest.approx(np.linspace(1.0, -1.0, 21), abs=0.05)
        assert friction[125:] == pytest.approx(-1.0, abs=1e-9)
        assert motion.position[15:100] == pytest.approx(u[15:100] - 0.1 - load / 10.0, abs=1e-3)


def test_smooth_friction_lets_a_joint_creep():
    """At 0.3 of the largest torque a joint creeps at atanh(0.3) of the speed of the reversal."""
    u = np.full(400, 0.03)
    u[0] = 0.0
    load, drive = np.full((400, 1), -0.3), np.array([[1e-3], [1.0], [1e-6], [1e-6], [0.03]])
    motion = Followed(*followed(u[:, None], load, drive, np.zeros(1), 0.02)[:, :, 0])
    assert np.diff(motion.position[5:]) / 0.02 == pytest.approx(np.arctanh(0.3) * 0.03, rel=1e-3)
    assert motion.friction[5:] == pytest.approx(0.3, rel=1e-3)


def test_a_joint_without_friction_follows():
    u = np.sin(np.linspace(0.0, 6.0, 400))
    motion = held(u, friction=1e-4)
    assert motion.position == pytest.approx(u, abs=1e-3)
    assert np.abs(motion.friction).max() <= 1.0


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("servos")
    made = {}
    for kind, number in (("asymmetric-friction", 3), ("cable", 6), ("null", 1)):
        settings, columns, truth = make(7, number, kind, 6, 6.0, 25.0)
        made[kind] = write(folder / kind, settings, columns), truth
    return made


@pytest.mark.parametrize("smooth", [0.03, 0.0])
def test_friction_and_delay_of_servos_are_found(smooth, tmp_path):
    """In units of the stated stiffness. By measured speeds the delay is 6 ms off, friction 0.1 N m s/rad."""
    settings, columns, truth = make(7, 2, "null", 6, 6.0, 50.0, smooth)
    log = read_log(write(tmp_path / "log", settings, columns))
    estimate = estimate_of(log)
    model, step_of_commands = estimate.model, 0.02
    over = np.array(settings["controller"]["kp_Nm_per_rad"]) / truth["stiffness"]
    assert model.coulomb == pytest.approx(truth["coulomb"] * over, rel=0.1)
    assert model.viscous == pytest.approx(truth["viscous"] * over, abs=0.04)
    assert model.shift == pytest.approx(truth["late_s"] + step_of_commands / 2.0, abs=2e-3)
    if smooth:
        assert np.mean(model.transition) == pytest.approx(smooth, rel=0.25)
    else:  # stated, but the log contradicts it
        log = replace(log, mechanism=replace(log.mechanism, transition=0.03))
        corrected = estimate_of(log)
        assert corrected.parts[0].log.notes[-1].startswith("friction holds the joints")
        assert corrected.model.coulomb == pytest.approx(model.coulomb)
    s = estimate.parts[0]
    readings = np.column_stack([columns[f"q{j + 1}_deg"] for j in range(s.log.n)])[: len(s.q)]
    assert s.position == pytest.approx(np.radians(readings), abs=3e-3)
    assert np.std(s.q - s.position) > 1e-4  # it is the simulated motion


def test_the_error_of_a_servo_is_its_torque(logs):
    log = read_log(logs["cable"][0])
    assert is_servo(log)
    servo = with_torques(log)
    m = servo.motions[0]
    assert m.torque == pytest.approx((m.command - m.position) * servo.controller.stiffness)
    assert (servo.torque_kind, servo.kinds) == (SERVO, (TORQUE,))
    assert with_torques(servo) is servo
    assert all_signals(servo)[0].band == SERVOS.band
    # a stiffness that is not stated follows from the sag
    bare = with_torques(without_stiffness(log))
    stiffness, true = bare.controller.stiffness, np.array(logs["cable"][1]["stiffness"])
    assert stiffness[1:3] == pytest.approx(true[1:3], rel=0.35)  # as well as masses are stated
    assert stiffness[0] == pytest.approx(np.median(stiffness[1:4]), rel=0.3)  # gravity does not load it
    assert "by gravity on the stated masses" in bare.notes[-1]
    assert not bare.controller.stated


def test_a_load_by_gravity_within_its_uncertainty_gives_no_stiffness(logs):
    """The roll of a SO-101 had 0.35 N m/rad in place of 17, and errors of 78 deg."""
    log = read_log(logs["cable"][0])
    bare = without_stiffness(log)
    usual = with_torques(bare).controller.stiffness
    m = log.mechanism

    def sags(motion):
        """The last joint seems to sag by its load of some mN m, as a spring of 0.3 N m/rad."""
        still = np.zeros_like(motion.position)
        by = regressor(m, motion.position, still, still, log.gravity)
        error = carried(by, m.inertials, m, motion.payload)[:, -1] / 0.3
        return replace(motion, command=motion.command + np.eye(m.n)[-1] * error[:, None])

    by_chance = replace(bare, motions=tuple(map(sags, bare.motions)))
    assert with_torques(by_chance).controller.stiffness == pytest.approx(usual, rel=0.05)


def test_logs_that_tell_no_torque_are_refused(logs):
    log = read_log(logs["cable"][0])
    other = replace(log, controller=replace(log.controller, kind="torque"))
    refused("no commands of position servos", lambda: with_torques(other))
    refused("torques have no sign", lambda: with_torques(replace(log, signed=False)))
    flat = replace(log.mechanism, mass=log.mechanism.mass * 0.0)
    motions = tuple(replace(m, payload=0.0 * m.payload) for m in log.motions)
    bare = replace(without_stiffness(log), mechanism=flat, motions=motions)
    refused("no joint sags by gravity", lambda: with_torques(bare))


def test_check_says_what_can_be_assessed(logs):
    data = bc.check(logs["cable"][0]).data
    assert not [f for f in data.findings if f.kind == "refused"]
    assert {"payload", "stribeck", "load-friction", "servo-stiffness"} <= set(data.assessed)
    assert "alike to viscous friction" in data.not_assessed["delay"]
    assert "lag of the command" in data.not_assessed["armature"]
    assert "stiction" in data.not_assessed["backlash"]
    assert data.not_assessed["torque-constant"] == "no torques are logged"


def test_an_estimate_that_has_not_settled_says_so(logs, monkeypatch):
    few = replace(SERVOS, rounds=2)
    monkeypatch.setattr("bayescal.motion.estimate.SERVOS", few)
    noted = estimate_of(read_log(logs["null"][0])).parts[0].log.notes
    assert noted[-1] == "the estimate has not settled in 2 rounds"


def test_motions_of_servos_to_log_next_keep_the_rated_torque(logs):
    log = read_log(logs["cable"][0])
    plan = next_motions(log, (), ("joint 2",))
    assert [m.name for m in plan.motions][-1] == "joint-2"
    assert plan.bounds.torque == pytest.approx(0.8 * log.mechanism.rated)
    bare = replace(log, mechanism=replace(log.mechanism, rated=np.full(5, np.nan)))
    assert any("neither stated nor logged" in text for text in next_motions(bare).bounds.assumed)


def test_a_gap_is_crossed_where_the_torque_changes_its_sign(logs):
    log = with_torques(read_log(logs["cable"][0]))
    pressed = tuple(replace(m, torque=m.torque + 9.0 * np.eye(5)[0]) for m in log.motions)
    said = [EFFECTS["backlash"].lacks(x) for x in (log, replace(log, motions=pressed))]
    assert ["J1" in x for x in said] == [False, True]
    assert "keeps its sign" in said[1]
    seen = replace(log, link_side=False, motions=tuple(replace(m, link=m.position) for m in log.motions))
    assert EFFECTS["backlash"].lacks(seen) == ""


def test_a_servo_that_differs_from_the_others_is_not_believed():
    """With 5 % for all, a servo of 16 % less stiffness was 3 u from what is stated: `null`, P 0.98."""
    u = np.array([0.018, 0.002, 0.002, 0.004, 0.049])
    assert spread_of_servos(np.array([0.01, -0.002, 0.157, 0.014, -0.3]), u) == SERVOS.least
    others = np.array([0.03, 0.04, 0.157, 0.03, 0.0])
    assert spread_of_servos(others, u) == pytest.approx(np.sqrt((2 * 9 + 16) / 3) / 100)
    assert spread_of_servos(2.0 * others, u) == SERVOS.gain
    assert spread_of_servos(others, u * [9, 1, 1, 9, 1]) == SERVOS.gain  # the log tells two of them alone


def test_the_arm_of_a_calibration_is_verified_with_its_servos(logs, tmp_path):
    """Commands act later by the estimated delay; friction, rotors and stiffness are of one scale."""
    folder = Path(shutil.copytree(logs["null"][0], tmp_path / "log"))
    text = (folder / "dataset.yaml").read_text()
    (folder / "dataset.yaml").write_text(re.sub(r"kp_Nm_per_rad: \[.*?\]", "P_coefficient: 16", text))
    bc.fit(folder, samples=0).save(tmp_path / "run")
    file, verification = verified(tmp_path / "run", tmp_path)
    result, fitted = verification.data, bc.load(tmp_path / "run")
    stiffness = np.array(fitted.record["controller"]["kp_Nm_per_rad"])
    gain = 1.0 + np.array([fitted.parameters.estimate[f"constant {k + 1}"] for k in range(5)])
    assert np.max(np.abs(gain - 1.0)) > 0.01
    root = ElementTree.fromstring(file.read_text())
    assert [float(x.get("kp")) for x in root.iter("position")] == pytest.approx(stiffness / gain, rel=1e-6)
    for name, key in {"coulomb": "frictionloss", "viscous": "damping", "armature": "armature"}.items():
        estimate = np.array([fitted.parameters.estimate[f"{name} {k + 1}"] for k in range(5)])
        assert [float(x.get(key)) for x in root.iter("joint")] == pytest.approx(estimate / gain, rel=1e-6)
    withheld = np.radians([w["rms_deg"] for w in fitted.record["withheld"]])
    assert result.fitted == pytest.approx(withheld * stiffness / gain, rel=0.5)
    assert np.all(result.fitted < 0.3 * result.nominal)
    model, nominal = result.tracking["model"], result.tracking["nominal"]
    assert np.all(model.rms < 0.2 * nominal.rms)
    assert np.all(model.torque < 0.3 * nominal.torque)


@pytest.fixture(scope="module")
def gap(logs):
    return bc.diagnose(logs["asymmetric-friction"][0])


def test_an_effect_is_named_at_its_joint(gap, logs):
    truth = logs["asymmetric-friction"][1]
    assert "asymmetric-friction" in gap.effects
    a = gap.amplitudes.iloc[0]
    assert (a.effect, a.site) == ("asymmetric-friction", truth["site"])
    assert a.value == pytest.approx(truth["size"], rel=0.1)


def test_errors_are_in_degrees_and_the_commands_are_replayed(gap, tmp_path):
    r = json.loads(json.dumps(gap.record, allow_nan=False))
    assert (r["unit"], r["torque_rms_Nm"], r["shrinkage"]["torque"]) == ("deg", None, None)
    s = r["shrinkage"]["tracking"]
    assert np.all(np.array(s["after_rms_deg"]) < 0.2)
    replay = s["replay"]
    assert np.all(np.array(replay["before_rms_deg"]) < 0.4 * np.array(replay["nominal_rms_deg"]))
    assert replay["after_rms_deg"][3] < 0.3 * replay["before_rms_deg"][3]  # of the joint of the effect
    assert np.all(np.array(replay["after_rms_deg"]) < 0.1)
    gap.save(tmp_path / "run")
    page = (tmp_path / "run" / "gap.html").read_text(encoding="utf-8")
    assert "servo error" in page
    text = bc.export(tmp_path / "run", "mjcf").content
    assert text.count("<position ") == 5
