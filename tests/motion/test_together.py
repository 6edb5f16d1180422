"""A session and a log fitted together: the exchange is exact, and other arms are refused."""

from dataclasses import replace

import numpy as np
import pytest
from cases import refused

pytest.importorskip("pinocchio")

import bayescal as bc
from analysis import together as hidden
from analysis.world import session
from bayescal.dataset import read_dataset
from bayescal.estimate import fitted_level
from bayescal.estimate.discrepancy import informed, inputs, stated
from bayescal.estimate.families import model_with
from bayescal.estimate.solver import linearise
from bayescal.logs import read_log
from bayescal.model import USUAL
from bayescal.model.scene import Scene
from bayescal.motion.together import fit_together, placed, same_arm
from bayescal.public.motions import TogetherResult

MODEL = ("geometry", "compliance")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("together")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(session.COUNT, session.SPHERES, (120, 121))
        patch.setattr(hidden, "LENGTH", 4.0)
        shape = hidden.made(folder, 1)
    return folder, hidden.truth(shape)


@pytest.fixture(scope="module")
def read(made):
    return read_dataset(made[0] / "contacts"), read_log(made[0] / "log")


@pytest.fixture(scope="module")
def level(read):
    return fitted_level(Scene(read[0], oriented=True), MODEL, USUAL)


@pytest.fixture(scope="module")
def result(made):
    return bc.fit([made[0] / "contacts", made[0] / "log"], samples=0)


def joint_information(level):
    """Information on a session's unknowns and the errors of masses, with the prior of the unknowns."""
    held = inputs(level)
    wide, own, extra = model_with(level.model, held)
    z = np.zeros(wide.size)
    z[own] = level.z
    jacobian = linearise(wide, z, level.weights).jacobian
    out = jacobian.T @ jacobian
    out[own, own] += 1.0
    return out, own, extra, np.array([p.sd for p in held])


def test_what_a_session_tells_of_masses_is_all_else_integrated_out(level):
    full, own, extra, sd = joint_information(level)
    load = extra[-4:]
    full[load, load] += 1.0
    links = extra[:-4]
    other = np.r_[own, load]
    across = full[np.ix_(links, other)]
    schur = full[np.ix_(links, links)] - across @ np.linalg.solve(full[np.ix_(other, other)], across.T)
    information, score = informed(level)
    expected = schur / np.outer(sd[:-4], sd[:-4])
    assert np.allclose(information, expected, atol=1e-6 * np.abs(expected).max())
    assert np.linalg.eigvalsh(information * np.outer(sd[:-4], sd[:-4]))[-1] > 0.05  # it does tell something
    assert score.shape == (24,)


def test_the_score_is_the_slope_of_the_least_cost(read, level):
    # the cost of the session, with all else at its best, by the mass of a link
    def cost(share):
        robot = read[0].robot
        masses = robot.masses.copy()
        masses[2] *= 1.0 + share
        heavier = replace(read[0], robot=replace(robot, masses=masses))
        at = fitted_level(Scene(heavier, oriented=True), MODEL, USUAL)
        scale = next(iter(at.weights.scale.values())) / next(iter(level.weights.scale.values()))
        return 0.5 * scale**2 * np.sum(at.linear.residual**2) + 0.5 * np.sum(at.z**2)

    information, score = informed(level)
    step = 0.02
    slope = -(cost(step) - cost(-step)) / (2.0 * step)
    assert score[8] == pytest.approx(slope, abs=0.2 * np.sqrt(information[8, 8]))


def test_the_stated_covariance_is_that_of_both(level):
    full, own, extra, sd = joint_information(level)
    prior = np.diag(1.0 / np.linspace(0.02, 0.3, 24) ** 2)  # of another measurement, in the session's own sds
    full[np.ix_(extra[:-4], extra[:-4])] += prior
    full[extra[-4:], extra[-4:]] += 1.0
    covariance = np.linalg.inv(full)
    of_links = covariance[np.ix_(extra[:-4], extra[:-4])] * np.outer(sd[:-4], sd[:-4])
    scene = level.model.scene
    robot = replace(scene.dataset.robot, mass_covariance=of_links)
    scene = Scene(replace(scene.dataset, robot=robot), oriented=True)
    of = stated(replace(level, model=replace(level.model, scene=scene))).inputs
    assert np.allclose(of.posterior[:24, :24], covariance[np.ix_(extra[:-4], extra[:-4])])
    # the load, which is not shared, follows: its information here is without what the unknowns' prior adds
    load = covariance[np.ix_(extra[-4:], extra[:-4])]
    assert np.corrcoef(of.posterior[24:, :24].ravel(), load.ravel())[0, 1] > 0.95
    # C + A V A' is the block of the inverse
    ours = level.covariance + of.slopes @ of.posterior @ of.slopes.T
    arm = slice(0, len(level.model.parameters))
    assert np.allclose(np.diag(ours)[arm], np.diag(covariance[np.ix_(own, own)])[arm], rtol=0.03)
    assert np.all(of.mean[:24] == 0.0)


def test_links_of_both_are_the_same_bodies(read):
    bodies = same_arm(*read, MODEL)
    p = bodies.nominal * np.random.default_rng(0).uniform(0.9, 1.1, (6, 4))
    robot = bodies.on(read[0], p).robot
    again = bodies.on(read[0], bodies.nominal).robot
    assert np.allclose(again.masses, read[0].robot.masses)
    assert np.allclose(again.centres_of_mass, read[0].robot.centres_of_mass, atol=1e-9)
    # the slopes to the session are those of differences
    step = 1e-6 * np.random.default_rng(1).standard_normal((6, 4))
    moved = bodies.on(read[0], p + step).robot
    by = (bodies.to_session(p) @ step.ravel()).reshape(6, 4)
    assert np.allclose(moved.masses / robot.masses - 1.0, by[:, 0], rtol=1e-4, atol=1e-11)
    assert np.allclose(moved.centres_of_mass - robot.centres_of_mass, by[:, 1:], rtol=1e-4, atol=1e-11)


def test_frames_of_a_mechanism_are_those_of_the_regressor(null_log):
    import mujoco
    from motion.made import model_of

    m = read_log(null_log).mechanism
    q = np.array([0.3, -0.7, 1.1])
    model = model_of(m)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    assert np.allclose(placed(m, q[None])[0, :, :3, 3], data.xpos[1:], atol=1e-9)
    assert np.allclose(placed(m, q[None])[0, :, :3, :3].reshape(3, 9), data.xmat[1:], atol=1e-9)


def test_both_tell_more_than_one_alone(made, result):
    true = made[1]
    table = result.shared
    assert result.record["agreement"]["dof"] > 0
    assert table.u_both["compliance J2"] < 0.95 * table.u_alone["compliance J2"]
    z = [(row.estimate_both - true[name]) / row.u_both for name, row in table.iterrows()]
    assert np.mean(np.square(z)) < 2.0
    # the robot of the session has the masses of both
    robot, mechanism = result.data.contacts.dataset.robot, result.data.log.mechanism
    assert np.allclose(robot.masses, mechanism.mass, rtol=1e-9)
    assert robot.mass_covariance.shape == (24, 24)
    assert "ratio" in str(result)


def test_run_folders_of_both_are_read_back(result, tmp_path):
    assert result.save(tmp_path / "run", pictures=False) == ("fit.json", "contacts", "log")
    again = bc.load(tmp_path / "run")
    assert isinstance(again, TogetherResult)
    assert again.shared.equals(result.shared)
    assert again.contacts.parameters.shape == result.contacts.parameters.shape
    assert len(again.log.parameters) == len(result.log.parameters)
    refused(r"give .*run/contacts$", lambda: bc.export(tmp_path / "run", "urdf"))
    refused("each has its page", lambda: bc.report(tmp_path / "run"))
    page = (tmp_path / "run" / "log" / "report.html").read_text(encoding="utf-8")
    assert str(tmp_path / "run" / "log") in page


def test_other_arms_are_refused(read, null_log):
    dataset, log = read
    refused("6 joints, that of the log 3", lambda: same_arm(dataset, read_log(null_log), MODEL))
    place = log.mechanism.place.copy()
    place[3, 0, 3] += 0.004
    other = replace(log, mechanism=replace(log.mechanism, place=place))
    refused(r"link 4 is not .* mm and .*different arms", lambda: same_arm(dataset, other, MODEL))
    bare = replace(dataset, robot=replace(dataset.robot, masses=None))
    refused("no masses", lambda: same_arm(bare, log, MODEL))
    refused("torques", lambda: same_arm(replace(dataset, torques="measured"), log, MODEL))
    refused("without compliance", lambda: fit_together(dataset, log, ("geometry",)))
