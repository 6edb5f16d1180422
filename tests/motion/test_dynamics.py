"""Torques against MuJoCo's inverse dynamics, and columns against differences of the model."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from motion.made import inverse, model_of, of_rows

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.statics import gravity_loads
from bayescal.logs import read_log
from bayescal.logs.types import Controller, inertial, mechanism_of
from bayescal.motion.dynamics import Loads, payload_of, regressor
from bayescal.motion.effects import AS_LINK, BODY_ON_IT, DENSE, EFFECTS, ELSEWHERE, EVERY, Scale, warming
from bayescal.motion.possible import added, with_body
from bayescal.motion.settings import FORMS
from bayescal.motion.signals import all_signals
from bayescal.motion.terms import ALL, FORM, Term, assembled, baseline, nominal
from bayescal.robots import load_robot

UR5E = load_robot("universal-robots-ur5e")[0]
GRAVITY = np.array([1.0, -2.0, -9.0])


def some(n, seed=0):
    return np.random.default_rng(seed).normal(size=(3, 7, n))


def torque_of(m, q, dq, ddq, gravity=GRAVITY):
    """Torques (N, n) of a mechanism by its regressor."""
    return np.einsum("njkp,kp->nj", regressor(m, q, dq, ddq, gravity), m.inertials)


def test_torques_are_those_of_mujoco(null_log):
    m = read_log(null_log).mechanism
    assert torque_of(m, *some(3)) == pytest.approx(inverse(model_of(m), *some(3), GRAVITY), abs=1e-10)
    # a payload is a body of its mass
    assert payload_of(m) == pytest.approx(inertial(1.0, m.payload_centre, 0.03**2 * np.eye(3)))


def test_what_base_and_tool_carry_is_that_of_mujoco(null_log):
    m = read_log(null_log).mechanism
    q, dq, ddq = some(3)
    model = model_of(m)
    loads = Loads.of(m, (q, dq, ddq), GRAVITY, m.inertials, np.zeros(7))
    assert loads.joints == pytest.approx(inverse(model, q, dq, ddq, GRAVITY), abs=1e-10)
    data = mujoco.MjData(model)
    for k in range(7):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
        mujoco.mj_inverse(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        moment, force = data.cfrc_int[1].reshape(2, 3)  # about the centre of mass of the arm
        assert loads.base[k] == pytest.approx(moment + np.cross(data.subtree_com[1], force), abs=1e-10)
        turning, origin = data.cacc[-1].reshape(2, 3)
        rate, frame = data.cvel[-1, :3], data.xmat[-1].reshape(3, 3)
        # spatial vectors are those of the point that is at the centre of mass of the arm
        arm = data.xpos[-1] + frame @ m.payload_centre - data.subtree_com[1]
        velocity = data.cvel[-1, 3:] + np.cross(rate, arm)
        pull = origin + np.cross(turning, arm) + np.cross(rate, velocity)
        assert loads.tool[k] == pytest.approx(frame.T @ pull, abs=1e-10)


def test_a_base_that_turns_about_the_first_axis_is_a_joint_that_does(null_log):
    m = read_log(null_log).mechanism
    q, still = some(3)[0], np.zeros((7, 3))
    ways = (still, np.array([0.0, 0.0, 2.0])), (still + np.array([2.0, 0.0, 0.0]), np.zeros(3))
    turned, joint = (
        Loads.of(m, (q, still, ddq), np.zeros(3), m.inertials, np.ones(7), base).joints for ddq, base in ways
    )
    assert np.max(np.abs(joint)) > 0.5
    assert turned == pytest.approx(joint, abs=1e-12)


def test_a_robot_of_dh_rows_is_the_same_arm():
    m, _ = mechanism_of(replace(UR5E, inertias=np.tile(0.01 * np.eye(3), (6, 1, 1))))
    torque = torque_of(m, *some(6, 1), np.array([0, 0, -9.81]))
    assert torque == pytest.approx(inverse(model_of(m), *some(6, 1)), abs=1e-9)


def test_an_arm_warms_up_through_all_motions_of_a_log(null_log):
    """By time alone: a body of one time constant, since the log began, however it is divided into motions."""
    log = read_log(null_log)
    time = np.concatenate([m.time for m in log.motions]) - log.motions[0].time[0]
    by_time = [[w.rise for w in warming(s) if w.driver == "time"] for s in all_signals(log)]
    for share, rises in zip(FORMS.warm_up, zip(*by_time, strict=True), strict=True):
        expected = 1.0 - np.exp(-time / (share * time[-1]))
        assert np.concatenate(rises) == pytest.approx(expected, abs=1e-9)
        assert np.all(np.diff(np.concatenate(rises)) > 0.0)


@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_torques_at_rest_hold_the_weights_of_the_robot(convention):
    """In standard and in modified DH, by the statics of the arm: where its file has the centres of mass."""
    robot = replace(UR5E, convention=convention, flange=np.eye(4))
    q, still = some(6, 2)[0], np.zeros((7, 6))
    none = np.zeros(7), np.zeros((7, 3))
    loads = gravity_loads(robot, chain_of(robot), link_angles(robot, q), GRAVITY, *none)
    torque = torque_of(mechanism_of(robot)[0], q, still, still)
    assert torque == pytest.approx(-loads.moments[:, 1:, 2], abs=1e-9)


@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_energies_are_those_of_the_links_of_the_robot(convention):
    """By differences of their frames; inertias have any axes in the frame that the file states them in."""
    root = np.random.default_rng(5).normal(size=(6, 3, 3))
    inertias = 0.1 * root @ root.swapaxes(1, 2)
    robot = replace(UR5E, convention=convention, flange=np.eye(4), inertias=inertias)
    q, dq, _ = some(6, 3)
    momentum = torque_of(mechanism_of(robot)[0], q, 0.0 * q, dq, np.zeros(3))
    chain = chain_of(robot)

    def links(t):
        joints = frames(chain, link_angles(robot, q + t * dq))[:, 1:-1]
        return joints if convention == "mdh" else joints @ chain.link[1:]

    now, rate = links(0.0), (links(1e-6) - links(-1e-6)) / 2e-6
    spin = now[..., :3, :3].swapaxes(-1, -2) @ rate[..., :3, :3]
    turn = np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)
    speed = np.einsum("nkij,kj->nki", rate[..., :3, :3], robot.centres_of_mass) + rate[..., :3, 3]
    twice = np.einsum("k,nki->n", robot.masses, speed**2)
    twice += np.einsum("nki,kij,nkj->n", turn, inertias, turn)
    assert np.sum(momentum * dq, axis=1) == pytest.approx(twice, rel=1e-6)


def test_assumed_inertias_are_those_of_links_of_their_length():
    """0.3 of a link's length as its radius of gyration, of a short link a quarter of the longest length."""
    m, notes = mechanism_of(replace(UR5E, inertias=None))
    length = np.hypot(UR5E.a, UR5E.d)
    assert length.min() < length.max() / 4 < np.median(length) * 4
    expected = UR5E.masses * (0.3 * np.maximum(length, length.max() / 4)) ** 2
    assert np.diagonal(m.inertia, axis1=1, axis2=2) == pytest.approx(np.tile(expected[:, None], 3))
    assert "no inertias" in str(notes)


def test_power_does_not_depend_on_the_coupling(null_log):
    m = read_log(null_log).mechanism
    coupled = replace(m, coupling=np.array([[1.0, 0, 0], [0, 1, 0], [0, 0.5, -1]]))
    reading, speed, _ = some(3)
    q, dq = reading @ coupled.coupling.T, speed @ coupled.coupling.T
    power = np.sum(torque_of(coupled, reading, speed, 0.0 * reading) * speed, axis=1)
    assert power == pytest.approx(np.sum(torque_of(m, q, dq, 0.0 * q) * dq, axis=1))


@pytest.mark.parametrize("name", ["robotstudio-so101", "fanuc-lrmate200ic"])
def test_a_reading_of_the_opposite_sense_turns_about_the_reversed_axis(name):
    """The same torques as with the signs in the coupling; such an arm is not coupled."""
    robot, _ = load_robot(name)
    m, _ = mechanism_of(robot)
    assert m.coupled == (name == "fanuc-lrmate200ic")
    plain = replace(m, axis=np.tile([0.0, 0.0, 1.0], (m.n, 1)), coupling=robot.link_from_reading)
    assert np.any(m.axis != plain.axis)
    assert torque_of(m, *some(m.n)) == pytest.approx(torque_of(plain, *some(m.n)), abs=1e-10)


def test_every_column_of_the_baseline_is_the_derivative_of_the_torque(null_parts):
    s = replace(null_parts[4], log=replace(null_parts[4].log, u_constant=0.05))
    start = nominal(s.log, np.array([5.0, 20.0, 5.0]))
    seen = 0
    assert "constant 2" in {term.name for term, _ in baseline(s, start, np.ones(3))}
    for term, column in baseline(s, start, np.ones(3)):
        step = 1e-4 * term.sd
        if term.name == "alignment":  # five points of noisy torques against a spline: of kept rows
            after, before = (replace(start, shift=start.shift + d) for d in (step, -step))
            slope = s.kept(before.measured(s) - after.measured(s)) / (2 * step)
            assert np.std(slope - s.kept(column)) < 0.05 * np.std(slope)
            continue
        if term.name.startswith(FORM):  # where a model is linearised it is 0
            way = start.reversal(s)
            slope = -start.gain * start.coulomb * (way - way**3)
            slope *= [term.channel in (ALL, j) for j in range(3)]
        else:
            both = [start.moved({term.name: d}) for d in (step, -step)]
            slope = (both[0].shown(s) - both[1].shown(s)) / (2 * step)
        expected = column if term.channel == ALL else np.zeros_like(slope)
        if term.channel != ALL:
            expected[:, term.channel] = column
        inner = slice(5, -5)
        scale = max(np.abs(expected).max(), 1e-6)
        assert slope[inner] == pytest.approx(expected[inner], abs=1e-5 * scale), term
        seen += 1
    assert seen > 40


@pytest.mark.parametrize("name", ["payload", "payload-offset", "base-tilt", "armature"])
def test_columns_of_effects_are_derivatives_of_the_torque(null_parts, name):
    s = null_parts[4]
    heavier = replace(s.log.motions[4], payload=2.0 * s.log.motions[4].payload)
    s = replace(s, log=replace(s.log, motions=(*s.log.motions, heavier)))
    at = nominal(s.log, np.array([5.0, 20.0, 5.0]))
    scale = Scale(np.ones(3), np.ones(3), 0.8)
    columns = [c for c in EFFECTS[name].forms(s, at, scale) if c[0].setting in ("", DENSE)]
    step = 1e-5

    def changed(k, size):
        m, log = s.log.mechanism, s.log
        if name == "payload":
            by = {EVERY: 1.0, "mass": s.payload > 0.0, DENSE: s.payload}
            moved = replace(s, payload=s.payload + size * by[columns[k][0].setting or columns[k][0].driver])
        elif name == "payload-offset":
            centre = m.payload_centre + size * np.eye(3)[k]
            moved = replace(s, log=replace(log, mechanism=replace(m, payload_centre=centre)))
        elif name == "base-tilt":
            gravity = log.gravity + size * np.cross(np.eye(3)[k], log.gravity)
            moved = replace(s, log=replace(log, gravity=gravity))
        else:
            return replace(at, armature=at.armature + size * np.eye(3)[k]).torque(s)
        return at.torque(moved)

    for k, (_, term, column) in enumerate(columns):
        slope = (changed(k, step) - changed(k, -step)) / (2 * step)
        slope = slope if column.ndim == 2 else slope[:, term.channel]
        assert column == pytest.approx(slope, abs=1e-5 * max(np.abs(slope).max(), 1.0))


def test_bodies_on_links_have_the_torques_of_their_terms(null_parts):
    """Those of the arm with them, by `regressor`."""
    s = null_parts[4]
    at, scale = nominal(s.log, np.array([5.0, 20.0, 5.0])), Scale(np.ones(3), np.ones(3), 0.8)
    rng = np.random.default_rng(0)
    seen = set()
    for effect, k, setting in (
        ("inertia", 1, BODY_ON_IT), ("inertia", 1, DENSE), ("inertia", 2, BODY_ON_IT),
        ("payload", 2, ""), ("payload", 2, ELSEWHERE), ("payload", 2, f"{AS_LINK} {DENSE}"),
        ("payload", 2, f"{AS_LINK} {BODY_ON_IT}"),
    ):  # fmt: skip
        site = "tool" if effect == "payload" else f"joint {k + 1}"
        every = EFFECTS[effect].forms(s, at, scale)
        columns = [c for c in every if (c[0].site, c[0].setting) == (site, setting) and c[0].driver != "mass"]
        size_of = {t.name: rng.uniform(0.1, 0.3) for _, t, _ in columns}
        by = added(s.log.mechanism, k, at.bodies[k])
        bodies = at.bodies.copy()
        bodies[k] = with_body(bodies[k], sum(by[name] * size for name, size in size_of.items()))
        wanted = replace(at, bodies=bodies).load(s) - at.load(s)
        torque = sum(size_of[t.name] * column for _, t, column in columns)
        assert np.abs(wanted).max() > 0.1
        np.testing.assert_allclose(torque, wanted, atol=1e-9)
        seen |= set(size_of)
    assert len(seen) == 19


def test_motions_at_uneven_times_are_sampled_evenly(null_log):
    log = read_log(null_log)
    even = all_signals(log)[0]
    m = log.motions[0]
    keep = np.sort(np.random.default_rng(0).choice(len(m.time), 480, replace=False))
    keep[0], keep[-1] = 0, len(m.time) - 1
    s = all_signals(replace(log, motions=(of_rows(m, keep), *log.motions[1:])))[0]
    assert np.ptp(np.diff(s.time)) < 1e-9
    speed = np.interp(s.time[30:-30], even.time, even.dq[:, 1])
    assert np.sqrt(np.mean((s.dq[30:-30, 1] - speed) ** 2)) < 0.05 * np.sqrt(np.mean(speed**2))


def test_a_torque_of_the_arm_also_displaces_a_position_servo(null_parts):
    s = null_parts[0]
    stiffness = np.array([1000.0, 2000.0, 500.0])
    motions = tuple(replace(m, command=m.position) for m in s.log.motions)
    log = replace(s.log, controller=Controller("position", stiffness, None), motions=motions)
    slow = np.sin(0.5 * (s.time - s.time[0]))
    tracked = replace(s, log=log, stuck=None)
    term = Term("mass", "kg", 1.0, 1, moves=True)
    _, numbers, columns = assembled([(term, slow)], tracked)
    assert [len(k) for k in numbers] == [0, 1, 0, 0, 1, 0]
    inner = slice(40, -40)
    assert columns[4][inner, 0] == pytest.approx(slow[inner] / 2000.0, abs=1e-6)
    sensor = assembled([(Term("offset", "N m", 1.0, 1), slow)], tracked)
    assert [len(k) for k in sensor[1]] == [0, 1, 0, 0, 0, 0]
    every = assembled([(Term("mass", "kg", 1.0, moves=True), np.tile(slow[:, None], 3))], tracked)
    assert [len(k) for k in every[1]] == [1] * 6
    assert [len(k) for k in assembled([(term, slow)], s)[1]] == [0, 1, 0]
    held = replace(tracked, stuck=0.1)
    of_moving = assembled([(term, slow * held.weight[:, 1])], tracked)[2][4]
    assert assembled([(term, slow)], held)[2][4] == pytest.approx(of_moving)
