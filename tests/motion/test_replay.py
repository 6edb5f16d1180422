"""Open-loop replays: a log that MuJoCo made with an arm is followed by that arm, and by no other."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from motion.servo_logs import KD, KP, another, servo_log, without_stiffness

from bayescal.exporting.log_arm import text_of
from bayescal.logs import read_log
from bayescal.logs.types import TRACKING
from bayescal.motion.controller import Law, law_of, with_controller
from bayescal.motion.diagnose import Tracking
from bayescal.motion.dynamics import payload_of, regressor
from bayescal.motion.signals import all_signals, derivative
from bayescal.motion.terms import nominal
from bayescal.reporting.motion.record import _replay
from bayescal.verifying.log import Arm, _driven, replayed


@pytest.fixture(scope="module")
def arms(null_log):
    m = read_log(null_log).mechanism
    return m, another(m)


@pytest.fixture(scope="module")
def log(arms):
    return servo_log(*arms, motions=4, seconds=6.0)


def of(log, **arms):
    files = {name: Arm(text_of(m, "mjcf", log.gravity)) for name, m in arms.items()}
    return replayed(mujoco, log, all_signals(log), files)


def test_the_arm_that_made_a_log_follows_it_to_rounding(log, arms):
    made = of(log, nominal=arms[0], true=arms[1])
    assert np.all(made["true"].rms < 1e-4)  # rad; positions of the start are low-passed
    assert np.all(made["nominal"].rms > 5.0 * made["true"].rms)
    assert np.all(made["true"].torque < 0.1)
    share, (low, high) = made["true"].removed(made["nominal"])
    assert 0.97 < low < share < high < 1.0


def test_gains_that_are_not_stated_follow_from_the_torques(log, arms):
    bare = replace(log, controller=replace(log.controller, stiffness=None, damping=None))
    law = law_of(bare, all_signals(bare))
    assert law.stiffness == pytest.approx(KP, rel=0.01)
    assert law.damping == pytest.approx(KD, rel=0.03)
    assert not law.stated
    assert np.all(of(bare, true=arms[1])["true"].rms < 3e-4)


def test_what_cannot_be_replayed_is_said(log, arms):
    parts, silent = all_signals(log), tuple(replace(m, command=None) for m in log.motions)
    assert "no commands" in law_of(replace(log, motions=silent), parts)
    turned = replace(log.mechanism, coupling=np.array([[1.0, 0, 0], [0, 1, 0], [0, 1, 1]]))
    assert "are coupled" in replayed(mujoco, replace(log, mechanism=turned), parts, {})
    forward = tuple(replace(s, torque=s.torque + 20.0 * s.ddq) for s in parts)  # feed-forward
    bare = without_stiffness(log)
    assert "is no function of command and position" in law_of(bare, forward)
    # of a part that follows neither, its share of the variance is said
    wave = [np.sin(37.0 * s.time)[:, None] * np.std(s.torque, axis=0) for s in parts]
    noisy = tuple(replace(s, torque=s.torque + 1.2 * w) for s, w in zip(parts, wave, strict=True))
    share = 100.0 * 0.72 / 1.72
    assert float(law_of(bare, noisy).split(": ")[1].split()[0]) == pytest.approx(share, abs=8.0)
    weak = replace(log, controller=replace(log.controller, stiffness=KP / 100.0, damping=0.01 * KD))
    assert "the replay is not a measure" in of(weak, true=arms[1])


def of_errors(s):
    """The commands of a controller of the same torques that brakes by the error of speed."""
    decay, late = np.exp(-s.step * KP / KD), s.torque / KP
    left = np.zeros_like(late)
    for k in range(1, len(late)):
        left[k] = decay * left[k - 1] + (1.0 - decay) * 0.5 * (late[k] + late[k - 1])
    return replace(s, command=s.q + left)


def stiffer(s):
    return replace(s, command=s.q + (0.3 * (s.torque - s.torque.mean(axis=0)) + KD * s.dq) / KP)


def fed_forward(s):
    """With nominal torques of links and rotors."""
    model = nominal(s.log, KP)
    rigid = model.load(s) + model.armature * s.ddq
    return replace(s, command=s.q + (s.torque - rigid + KD * s.dq) / KP)


def same(s):
    return s


@pytest.mark.parametrize(
    ("change", "ahead", "complete"),
    [(same, 0.0, True), (of_errors, 1.0, True), (stiffer, 0.0, True), (fed_forward, 0.0, False)],
)
def test_torques_tell_how_a_stated_controller_acts(log, change, ahead, complete):
    stated = replace(log, controller=replace(log.controller, kind="position"))
    parts = with_controller(tuple(change(s) for s in all_signals(stated)))
    control = parts[0].log.controller
    assert control.complete == complete
    assert (TRACKING in parts[0].log.kinds) == complete
    assert any("tracking errors are not assessed" in note for note in parts[0].log.notes) != complete
    assert control.ahead == pytest.approx(ahead * KD, abs=1e-9)
    if change in (of_errors, same):
        law = law_of(parts[0].log, parts)
        for s in parts:
            off = law.torque(s.command, derivative(s.command, s.step), s.q, s.dq) - s.torque
            assert np.std(off[50:-50]) < 0.03 * np.std(s.torque)


def test_a_joint_that_rests_tells_nothing_of_the_controller(log):
    """Its torque is noise, and no function of command and position."""
    rng = np.random.default_rng(5)

    def held(s):
        q, u, torque = s.q.copy(), s.command.copy(), s.torque.copy()
        q[:, 1:], u[:, 1:], torque[:, 1:] = 0.3, 0.3, rng.standard_normal((len(q), 2))
        return replace(s, q=q, command=u, torque=torque)

    motions = []
    for m in log.motions:
        position, command = m.position.copy(), m.command.copy()
        position[:, 1:] = command[:, 1:] = 0.3
        motions.append(replace(m, position=position, command=command))
    resting = replace(log, motions=tuple(motions))
    parts = tuple(replace(held(s), log=resting) for s in all_signals(log))
    control = with_controller(parts)[0].log.controller
    assert control.complete
    assert control.ahead == pytest.approx(0.0 * KD)
    rests = tuple(replace(m, position=0.0 * m.position) for m in log.motions)
    parts = tuple(replace(s, log=replace(log, motions=rests)) for s in parts)
    assert with_controller(parts) is parts


def test_torque_beside_the_file_is_that_of_a_heavier_arm(log, arms):
    """The viscous friction of one joint in the file, or beside it along the motion of the simulation."""
    less = replace(arms[1], viscous=arms[1].viscous - [0.0, 2.0, 0.0])
    beside = Arm(text_of(less, "mjcf", log.gravity), lambda s: (-s.dq * [0.0, 2.0, 0.0], 0.0 * s.q))
    both = replayed(mujoco, log, all_signals(log), {"beside": beside, "less": replace(beside, further=None)})
    assert np.all(both["beside"].rms < 2e-4)
    assert both["less"].rms[1] > 5.0 * both["beside"].rms[1]


def test_payloads_are_carried(log, arms):
    """Gravity of the arm with a payload, by the regressor, which is checked against MuJoCo elsewhere."""
    s = replace(all_signals(log)[-1], payload=np.full(len(log.motions[-1].time), 1.5))
    text = text_of(arms[1], "mjcf", log.gravity)
    model = _driven(mujoco, text, law_of(log, (s,)), s)
    data = mujoco.MjData(model)
    data.qpos[:] = s.q[50]
    mujoco.mj_forward(model, data)
    still = np.zeros((1, 3))
    by = regressor(arms[1], s.q[50:51], still, still, log.gravity)[0]
    wanted = np.einsum("jkp,kp->j", by, arms[1].inertials) + 1.5 * by[:, -1] @ payload_of(arms[1])
    assert data.qfrc_bias == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("named", [True, False])
def test_the_record_of_a_replay_has_each_arm_under_its_name(log, named):
    """Before is the model without the effects, and what they remove is of its errors."""
    rng = np.random.default_rng(0)
    names = ("nominal", "model", "effects") if named else ("nominal", "model")
    errors = {name: 0.1**k * rng.uniform(1.0, 2.0, (40, 3)) for k, name in enumerate(names)}
    arms = {
        name: Tracking(np.sqrt(np.mean(e, axis=0)), np.mean(e, axis=0), e, 4) for name, e in errors.items()
    }
    estimate = SimpleNamespace(parts=[SimpleNamespace(log=log)])
    record = _replay(SimpleNamespace(tracking=arms, estimate=estimate))
    for key, name in (("nominal", "nominal"), ("before", "model"), ("after", names[-1])):
        assert record[f"{key}_rms_deg"] == pytest.approx(np.degrees(arms[name].rms))
        assert record[f"{key}_torque_rms_Nm"] == pytest.approx(arms[name].torque)
    if named:
        assert record["removed"] == pytest.approx(1.0 - errors["effects"].sum() / errors["model"].sum())
    else:
        assert record["removed"] is None


def test_a_law_of_true_torques_gives_the_measured_ones_over_their_gain():
    """One in stated N m is of true torques already."""
    rng = np.random.default_rng(0)
    terms, motion, gain = rng.uniform(1.0, 2.0, (4, 3)), rng.normal(size=(4, 7, 3)), np.array([1.1, 0.9, 1.3])
    measured = Law(*terms, stated=False)
    assert measured.over(gain).torque(*motion) == pytest.approx(measured.torque(*motion) / gain)
    stated = replace(measured, stated=True)
    assert stated.over(gain).torque(*motion) == pytest.approx(stated.torque(*motion))
