"""Motions to log next: what is lacking, within all limits; the loop from plan to a log that tells."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from cases import refused
from motion.made import read_commands

pytest.importorskip("pinocchio")

import bayescal as bc
from analysis import together as hidden
from analysis.world import arm
from analysis.world.motion.plan import waves
from bayescal.logs import read_log
from bayescal.motion.signals import derivative
from bayescal.preparing.joint_facts import joints_of
from bayescal.preparing.joint_log import check_log
from bayescal.preparing.next_motions import FAST, MARGIN, RATED, SLOW, STATED, STRONGER, Bounds, next_motions
from bayescal.reporting.motion.fit import COMMANDS, PURPOSES, files_of


def quick(rng):
    """A motion in which each joint moves at about 1 rad/s and is slow for moments only."""
    hertz = rng.uniform(0.55, 0.7, (6, 1))
    return waves(hidden.HOME, 1.2 / (2 * np.pi * hertz), 2 * np.pi * hertz, np.zeros((6, 1)), hidden.LENGTH)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("next") / "log"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hidden, "_excitation", quick)
        patch.setattr(hidden, "KINDS", hidden.KINDS[:5])
        hidden.log(folder, np.random.default_rng(3), arm.draw(np.random.default_rng(3)))
    return folder


@pytest.fixture(scope="module")
def result(log):
    return bc.plan(log)


def executed(folder, commands, seed=3):
    """The log of these commands, by the simulator: its columns and motions are those of `hidden.log`."""

    def path(q, step):
        dq = derivative(q, step)
        return lambda t: tuple(x[: len(t)] for x in (q, dq, derivative(dq, step)))

    paths = iter([path(q, time[1] - time[0]) for _, time, q in commands])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hidden, "KINDS", ("excitation",) * 2 + ("other",) * len(commands))
        patch.setattr(hidden, "_excitation", lambda rng: next(paths))
        patch.setattr(hidden, "LENGTH", 20.0)
        hidden.log(folder, np.random.default_rng(seed), arm.draw(np.random.default_rng(seed)))
    return folder


def test_a_log_without_slow_crossings_tells_of_stribeck_after_the_planned_motions(log, result, tmp_path):
    assert "stribeck" in check_log(log).not_assessed
    result.save(tmp_path / "plan")
    commands = {name: (name, t, q) for name, t, q in read_commands(tmp_path / "plan" / COMMANDS)}
    assert "slow" in commands
    run = executed(tmp_path / "log", [commands["slow"], commands["poses"]])
    # by another simulator, with the masses of the hidden arm: the torques that the plan allows
    needed = np.max([np.abs(m.torque).max(axis=0) for m in read_log(run).motions[2:]], axis=0)
    assert np.all(needed < 1.2 * result.data.bounds.torque)
    assert np.any(needed > 0.3 * result.data.bounds.torque)
    after = check_log(run)
    assert "stribeck" not in after.not_assessed
    assert "no_slow" not in {f.code for f in after.findings}
    assert min(j.slow for j in after.joints) > 5.0


def test_commands_are_read_back_and_begin_where_the_log_begins(log, result, tmp_path):
    assert result.save(tmp_path / "plan") == ("plan.json", COMMANDS, PURPOSES)
    commands = read_commands(tmp_path / "plan" / COMMANDS)
    listed = yaml.safe_load((tmp_path / "plan" / PURPOSES).read_text())
    assert [name for name, _, _ in commands] == [m["id"] for m in listed["motions"]]
    first = read_log(log).motions[0].position[0]
    step = np.median(np.diff(read_log(log).motions[0].time))
    for _, time, q in commands:
        assert np.allclose(q[[0, -1]], first, atol=1e-6)
        assert np.allclose(np.diff(time), step)
        assert np.abs(derivative(q, step)[[0, -1]]).max() < 0.01
    assert list(bc.load(tmp_path / "plan").motions.index) == list(result.motions.index)
    assert "slow" in str(result)


def test_planned_motions_keep_limits_speeds_and_clearance(log, result):
    plan, robot = result.data, read_log(log).mechanism.robot
    assert {m.name for m in plan.motions} >= {"slow", "load-1", "load-2"}
    for m in plan.motions:
        angles = plan.bounds.arm.angles_of(m.position)
        assert np.all(angles >= robot.limits[:, 0] + MARGIN - 1e-9)
        assert np.all(angles <= robot.limits[:, 1] - MARGIN + 1e-9)
        dq = derivative(m.position, plan.bounds.step)
        assert np.all(np.abs(dq) <= plan.bounds.speed)
        assert np.all(np.abs(derivative(dq, plan.bounds.step)) <= plan.bounds.acceleration)
        assert not plan.bounds.clearance.collides(m.position[::20]).any()
        if m.name == "slow":
            assert np.abs(dq).max() < 1.5 * SLOW[1]


def test_bounds_name_what_a_motion_does_not_keep(log):
    read = read_log(log)
    bounds, m = Bounds.of(read), read.mechanism
    logged = np.max([np.abs(x.torque).max(axis=0) for x in read.motions], axis=0)
    for rated, most in ((np.nan, STRONGER), (0.1, STRONGER), (10.0, 10.0 * RATED)):  # over what was logged
        of = Bounds.of(replace(read, mechanism=replace(m, rated=rated * logged)))
        assert of.torque == pytest.approx(most * logged)
    stated = replace(read, mechanism=replace(m, fastest=np.full(6, 2.0)))
    assert Bounds.of(stated).speed == pytest.approx(2 * STATED)
    t = np.arange(0.0, 4.0, bounds.step)[:, None]
    still = np.tile(bounds.home, (len(t), 1))
    one = np.eye(6)[1]
    assert bounds.broken(still, 0.0)[0] == ""
    assert bounds.broken(still + 3.0 * one, 0.0)[0] == "range"
    assert bounds.broken(still + 0.4 * np.sin(8.0 * t) * one, 0.0)[0] == "largest speed"
    why, joints = bounds.broken(still + 0.01 * np.sin(60.0 * t) * one, 0.0)
    assert why == "largest acceleration"
    assert joints.tolist() == [False, True, False, False, False, False]
    assert bounds.broken(still, 60.0)[0] == "largest torque"  # of a payload
    folded = replace(bounds, low=bounds.low - 9.0, high=bounds.high + 9.0, torque=bounds.torque + np.inf)
    limits = np.tile([-9.0, 9.0], (6, 1))
    folded = replace(folded, arm=replace(bounds.arm, robot=replace(bounds.arm.robot, limits=limits)))
    some = np.random.default_rng(0).uniform(-2.5, 2.5, (300, 6))
    inside = some[bounds.clearance.collides(some) > 0][0]
    assert folded.broken(np.tile(inside, (len(t), 1)), 0.0)[0] == "clearance of the arm"


def test_a_log_that_lacks_a_quick_motion_gets_one(log):
    read = read_log(log)
    slower = replace(read, motions=tuple(replace(m, time=2.0 * m.time) for m in read.motions))
    assert max(j.fastest for j in joints_of(slower)) < FAST
    plan = next_motions(slower)
    fast = next(m for m in plan.motions if m.name == "fast")
    assert np.all(np.abs(derivative(fast.position, plan.bounds.step)).max(axis=0) > FAST)
    assert not any("is faster than" in text for text in plan.left_out)


def test_a_cause_that_is_left_open_moves_its_joint_alone(log):
    motions = next_motions(read_log(log), (), ("joint 5", "tool")).motions
    moved = np.ptp(next(m for m in motions if m.purpose.kind == "alone").position, axis=0)
    assert moved[4] > 0.3
    assert np.all(np.delete(moved, 4) == 0.0)


def test_a_joint_that_rests_does_not_keep_the_others_from_moving(log):
    read = read_log(log)

    def resting(m):
        position = m.position.copy()
        position[:, 5] = 0.3
        return replace(m, position=position)

    mechanism = replace(read.mechanism, robot=None)
    plan = next_motions(replace(read, mechanism=mechanism, motions=tuple(map(resting, read.motions))))
    moved = np.ptp(next(m for m in plan.motions if m.name == "excitation-1").position, axis=0)
    assert moved[5] == 0.0
    assert moved[:5].min() > 0.2
    assert any("limits" in text for text in plan.left_out)


def test_an_effect_that_was_not_seen_gets_its_motion(log):
    assert "warm-up" in {m.name for m in next_motions(read_log(log), ("torque-drift",)).motions}
    assert "warm-up" not in {m.name for m in next_motions(read_log(log)).motions}


def test_without_torques_no_motion_is_planned(log):
    read = read_log(log)
    bare = replace(read, torque_kind="", motions=tuple(replace(m, torque=None) for m in read.motions))
    plan = next_motions(bare)
    assert plan.motions == ()
    assert "torques with a sign" in plan.left_out[0]
    assert files_of(plan) == {}


def test_options_of_contacts_are_refused(log, result, tmp_path):
    refused("--contacts", lambda: bc.plan(log, contacts=60))
    refused("--for", lambda: bc.plan(log, purpose="gap"))
    refused("--to", lambda: result.save(tmp_path / "plan", ("urscript",)))
    refused("--probe-input", lambda: result.save(tmp_path / "plan", probe_input="tool:0"))
