"""Joint logs of the independent simulator: dynamics, noise, the wanted lambda, the format, and the kinds."""

import gzip
import io
import json
import re
from functools import cache
from itertools import product

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.transform import Rotation

from analysis.world.motion import arms, mix, noise, outside_third
from analysis.world.motion.arms import U
from analysis.world.motion.build import make, total
from analysis.world.motion.dynamics import about_origin, regressor
from analysis.world.motion.size import TRACK, detectability
from bayescal.logs import read_log

SEED = 4
GRAVITY = [0.0, 0.0, -9.81]
SITE = re.compile(r"joint [1-7]|tool|base|log")
CAUSES = (*mix.OUTSIDE, *mix.FURTHER, *mix.THIRD)


@cache
def short(kind: str = "null", number: int = 0, motions: int = 2):
    """A log of excitations, and one pick-and-place, of three seconds each."""
    return make(SEED, number, [kind], motions=motions, length=3.0)


def number_of(name: str) -> int:
    return next(k for k in range(16) if mix.recipe(SEED, k, ["single"]).names == (name,))


def mujoco_arm(mujoco, arm):
    """The same arm in MuJoCo."""
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia = False
    spec.option.gravity = GRAVITY
    parent = spec.worldbody
    for j in range(arm.size):
        turn = Rotation.from_euler("xyz", arm.chain.rpy[j]).as_quat(scalar_first=True)
        parent = parent.add_body(pos=arm.chain.origin[j], quat=turn)
        parent.add_joint(axis=[0, 0, 1], armature=arm.armature[j])
        parent.mass, parent.ipos, parent.explicitinertial = arm.mass[j], arm.centre[j], True
        parent.fullinertia = arm.inertia[j][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return spec.compile()


@pytest.mark.parametrize("sort", arms.SORTS)
def test_torques_are_those_of_mujoco(sort):
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng(0)
    arm = arms.true(rng, arms.nominal(rng, sort))
    model = mujoco_arm(mujoco, arm)
    data = mujoco.MjData(model)
    q, dq, ddq = rng.uniform(-2, 2, (3, 5, arm.size))
    found = regressor(arm.chain, q, dq, ddq, GRAVITY) @ arm.parameters + arm.armature * ddq
    for k in range(5):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(found[k], data.qfrc_inverse, atol=1e-9)


def test_inertia_about_the_origin_is_that_of_points():
    rng = np.random.default_rng(1)
    points, weights = rng.standard_normal((7, 3)), rng.uniform(1, 2, 7)
    mass, centre = weights.sum(), weights @ points / weights.sum()

    def inertia(at):
        x = points - at
        far = np.sum(x**2, axis=1)[:, None, None] * np.eye(3)
        return np.einsum("k,kij->ij", weights, far - x[:, :, None] * x[:, None])

    found = about_origin(np.array([mass]), centre[None], inertia(centre)[None])[0]
    wanted = inertia(0.0)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    np.testing.assert_allclose(found, [mass, *(mass * centre), *wanted], rtol=1e-12)


def test_whitened_noise_is_white_and_of_variance_one():
    rng = np.random.default_rng(3)
    made = noise.Noise(np.array([3.0]), np.array([0.4]), np.array([0.02]), np.array([0.5]))
    runs = [slice(0, 100_000)]
    white = noise.white(made, 0, noise.sampled(rng, made, runs, 0.008)[:, 0], runs, 0.008)
    assert np.std(white) == pytest.approx(1.0, abs=0.01)
    for lag in (1, 2, 10, 60):
        assert np.mean(white[lag:] * white[:-lag]) == pytest.approx(0.0, abs=0.015)


def covariance(made: noise.Noise, j: int, time: np.ndarray) -> np.ndarray:
    """Of the noise of a joint, from its definition."""
    apart = np.abs(time[:, None] - time)
    parts = ((1 - made.slow[j], made.fast_s[j]), (made.slow[j], made.slow_s[j]))
    return made.rms[j] ** 2 * sum(share * np.exp(-apart / tau) for share, tau in parts)


def dense_lambda(made, torque: np.ndarray) -> float:
    """Lambda by dense algebra from the covariance of the noise; armatures and inertials have their priors."""
    log, base, drawn = made.log, made.base, made.drawn
    far = np.linalg.norm(drawn.centre, axis=1)
    precision = np.zeros(base.size)
    n = log.arm.size
    for k in range(n):
        own = np.trace(drawn.inertia[k]) / 3
        first = np.hypot(U["mass"] * drawn.mass[k] * np.abs(drawn.centre[k]), drawn.mass[k] * drawn.centre_u)
        mass, lever = drawn.mass[k], far[k]
        second = np.hypot(U["inertia"] * (own + mass * lever**2), 2 * mass * lever * drawn.centre_u)
        precision[10 * k : 10 * k + 10] = np.array([U["mass"] * drawn.mass[k], *first, *[second] * 6]) ** -2
    precision[10 * n : 10 * n + 2] = log.u_alignment**-2, U["friction_transition"] ** -2
    stride = 5 if log.current else 4
    for j in range(n):
        precision[10 * n + 2 + stride * j] = (U["armature"] * drawn.armature[j]) ** -2
        if log.current:
            precision[10 * n + 6 + stride * j] = log.u_constant**-2
    normal, right, norm = np.diag(precision), np.zeros(base.size), 0.0
    for j, run in product(range(n), log.session.of("calibrate")):
        root = np.linalg.cholesky(covariance(log.noise, j, log.session.time[run]))
        columns = np.zeros((run.stop - run.start, base.size))
        columns[:, base.places[j]] = base.columns[j][run]
        both = solve_triangular(root, np.column_stack([columns, torque[run, j]]), lower=True)
        normal += both[:, :-1].T @ both[:, :-1]
        right += both[:, :-1].T @ both[:, -1]
        norm += both[:, -1] @ both[:, -1]
    return norm - right @ cho_solve(cho_factor(normal), right)


@pytest.mark.parametrize("name", ["load-friction", "delay", "ripple", "asymmetric-friction"])
def test_lambda_of_a_log_is_the_wanted_one(name):
    made = short("single", number_of(name), 5)
    act, size = made.acts[0]
    wanted = made.truth["lambda_goal"][name]
    change = act.apply(size)
    assert made.truth["lambda"]["value"] == pytest.approx(wanted, rel=0.02)
    # the filter leaves the first rows of a motion out
    assert dense_lambda(made, change.torque) == pytest.approx(wanted, rel=0.15)


def test_columns_of_the_baseline_are_what_its_parameters_change():
    made = short()
    s, arm, base = made.log.session, made.log.arm, made.base
    for change, column in ((1e-3, 10 * arm.size + 1),):
        wider = arm.transition * np.exp(change)
        moved = arm.coulomb * (np.tanh(s.dq / wider) - np.tanh(s.dq / arm.transition))
        for j in range(arm.size):
            slope = base.columns[j][:, list(base.places[j]).index(column)]
            np.testing.assert_allclose(slope * change, moved[:, j], atol=1e-3 * change * arm.coulomb[j])
    exact = made.log.at(np.full(len(s.time), -1e-4)) - made.log.torque
    pairs = zip(base.columns, base.places, strict=True)
    rate = np.stack([c[:, list(p).index(10 * arm.size)] for c, p in pairs], axis=1)
    np.testing.assert_allclose(1e-4 * rate[5:-5], exact[5:-5], atol=0.1 * np.abs(exact).max())


def test_an_inertial_error_is_absorbed_but_for_its_prior():
    made = short()
    drawn, n = made.drawn, made.log.arm.size
    columns = np.zeros((len(made.log.torque), n))
    for j in range(n):
        columns[:, j] = made.base.columns[j][:, list(made.base.places[j]).index(10 * (n - 1))]
    sd = U["mass"] * drawn.mass[-1]
    assert made.base.squared(columns * sd) <= 1.0 + 1e-6  # one standard deviation costs one at most


@pytest.mark.parametrize("name", mix.LISTED)
def test_every_form_of_an_effect_changes_what_is_measured(name):
    made = short("single", number_of(name), 5)
    function, forms = mix.LISTED[name]
    assert len(forms) >= 3
    seen = []
    for form in forms:
        act = function(np.random.default_rng(5), made.log, form)
        size = 0.5 * min(act.usual * 4, act.most)
        one = made.log.seen(act, size)
        parts = detectability(made.base, one)
        assert act.name == name
        assert sum(parts.values()) > 1e-6, form
        assert sum(detectability(made.base, made.log.seen(act, 0.0)).values()) == pytest.approx(0.0, abs=1e-9)
        assert all(SITE.fullmatch(w["site"]) and w["driver"] and w["effect"] == name for w in act.where)
        moved = [x.ravel() for x in (one.torque, one.link, one.track) if x is not None]
        seen.append(np.concatenate(moved) / size)
    same = any(np.allclose(a, b) for k, a in enumerate(seen) for b in seen[:k])
    assert not same or name in ("payload", "delay")  # without a load, or a servo, two forms are the same


@pytest.mark.parametrize("cause", CAUSES, ids=lambda c: c.__name__)
def test_a_cause_outside_the_list_is_not_absorbed(cause):
    made = short(motions=5)
    act = cause(np.random.default_rng(6), made.log)
    assert sum(detectability(made.base, act.apply(0.5 * act.most)).values()) > 10.0
    assert act.name not in mix.LISTED
    assert all(SITE.fullmatch(w["site"]) for w in act.where)


def test_the_moment_about_an_axis_is_the_torque_of_its_joint():
    log = short(motions=5).log
    base, *joints = outside_third.moments(log)
    np.testing.assert_allclose(np.stack([m[:, 2] for m in joints], axis=1), log.rigid, atol=1e-9)
    np.testing.assert_allclose(base[:, 2], log.rigid[:, 0], atol=1e-9)  # joint 1 is above the base
    signs = outside_third.held(np.array([3.0, 1, -1, -2, 1, 2]), 1.5)
    np.testing.assert_array_equal(signs, [1, 1, 1, -1, -1, 1])


@pytest.mark.parametrize(
    ("kind", "name"), [("null", ""), ("single", "servo-stiffness"), ("single", "backlash")]
)
def test_a_log_is_read_and_hides_its_truth(tmp_path, kind, name):
    made = short(kind, number_of(name) if name else 0)
    (tmp_path / "dataset.yaml").write_text(made.texts["dataset.yaml"])
    (tmp_path / "motion.csv.gz").write_bytes(gzip.compress(made.texts["motion.csv"].encode()))
    log, s = read_log(tmp_path), made.log.session
    assert [m.role for m in log.motions] == ["calibrate", "validate"]
    assert log.mechanism.mass == pytest.approx(made.drawn.mass)
    assert np.any(np.abs(log.mechanism.mass / made.log.arm.mass - 1) > 0.02)
    assert np.concatenate([m.position for m in log.motions]) == pytest.approx(s.q, abs=np.radians(0.5))
    torque = np.concatenate([m.torque for m in log.motions])
    change = total(made.log, [made.log.seen(act, size) for act, size in made.acts]).torque
    off = (torque - made.log.torque - change) / made.log.noise.rms
    limit = 1.4 if not made.log.current else 20.0  # a torque constant is off by some per cent
    assert np.all(np.sqrt(np.mean(off**2, axis=0)) < limit)
    hidden = json.dumps(made.truth)
    assert "servo-stiffness" not in made.texts["dataset.yaml"]
    assert not re.search("lambda|truth|effect", made.texts["dataset.yaml"])
    assert hidden == json.dumps(make(SEED, int(made.truth["world"]), [kind], motions=2, length=3.0).truth)


def test_a_servo_is_off_by_its_torque_over_its_stiffness():
    made = short("single", number_of("servo-stiffness"))
    act, size = made.acts[0]
    table = pd.read_csv(io.StringIO(made.texts["motion.csv"]))
    gain = yaml.safe_load(made.texts["dataset.yaml"])["controller"]["kp_Nm_per_rad"]
    j = act.detail["joint"] - 1
    error = np.radians(table[f"command{j + 1}_deg"] - table[f"q{j + 1}_deg"]).to_numpy()
    stated = made.log.torque[:, j] / gain[j]
    true = stated / (1 - act.detail["sign"] * size)
    assert np.degrees(np.std(error - true)) == pytest.approx(TRACK, rel=0.3)
    np.testing.assert_allclose(act.apply(size).track[:, j], true - stated, atol=1e-12)
    # a servo is also off by the torque of an effect
    log, n = made.log, made.log.arm.size
    function, forms = mix.LISTED["load-friction"]
    act = function(np.random.default_rng(7), log, forms[0])
    change = log.seen(act, 0.1)
    assert np.any(change.torque)
    np.testing.assert_allclose(change.track * log.stiffness, change.torque, atol=1e-12)
    sensor, forms = mix.LISTED["torque-drift"]
    assert log.seen(sensor(np.random.default_rng(7), log, forms[0]), 0.1).track is None
    causes = [cause(np.random.default_rng(7), log) for cause in mix.THIRD]
    assert [log.seen(act, act.usual).track is None for act in causes] == [act.sensed for act in causes]
    late = mix.LISTED["delay"][0](np.random.default_rng(7), log, "command").apply(2e-3)
    asked = log.session.motions[0].path(log.session.since[log.session.runs[0]] + 2e-3)[0]
    moved = log.session.q[log.session.runs[0]]
    torque = log.at(np.full(len(log.torque), -2e-3)) - log.torque
    rest = (late.track - torque / log.stiffness)[log.session.runs[0]]
    np.testing.assert_allclose(rest[:, :n], asked - moved, atol=1e-7)
