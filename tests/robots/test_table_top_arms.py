"""The table-top arms against MuJoCo with the published description of each: places, gravity and inertia."""

import numpy as np
import pytest
from cases import DATA

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.statics import gravity_loads
from bayescal.planning.candidates import candidates
from bayescal.planning.setup import read_setup
from bayescal.preparing.artefacts import Room
from bayescal.preparing.folder import start
from bayescal.probing.scene import Sizes
from bayescal.robots import full_name, load_robot

mujoco = pytest.importorskip("mujoco")
ARMS = {"so101": "robotstudio-so101", "koch": "koch-v1-1"}


@pytest.fixture(scope="module", params=ARMS)
def pair(request):
    """A robot, and MuJoCo's model of the same one."""
    model = mujoco.MjModel.from_xml_path(str(DATA / "robots" / f"{request.param}.xml"))
    return load_robot(full_name(request.param))[0], model, mujoco.MjData(model)


@pytest.mark.parametrize("part", ARMS)
def test_a_part_of_the_name_is_enough(part):
    assert full_name(part) == ARMS[part]


def test_artefacts_suit_the_arm():
    """Five joints reach four faces of a small cube; two of the faces are opposite, for the scale."""
    room = Room.of(load_robot("koch-v1-1")[0])
    assert room.cube.edge == 0.0508
    assert len(room.faces) == 4
    assert len({face[1] for face in room.faces}) == 3


def test_the_proposed_places_can_be_planned(tmp_path):
    """Five joints turn the tool on its way off a face, and touch a wall with the side of the ball."""
    start(tmp_path / "new", "so101", ["cube"])
    pool = candidates(read_setup(tmp_path / "new"), 80, validation=False)
    counts = np.bincount(pool.session.measurements.target[pool.candidates], minlength=4)
    assert counts.min() >= 10, counts


def test_a_larger_arm_has_a_larger_cube():
    assert Sizes.of(load_robot("mecademic-meca500")[0]).edge == 0.2286


def test_flange_gravity_and_inertia(pair):
    robot, model, data = pair
    site = model.site("flange").id
    for q in np.random.default_rng(1).uniform(-3, 3, (20, 5)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        ours = frames(chain_of(robot), link_angles(robot, q[None]))[0, -1]
        np.testing.assert_allclose(ours[:3, 3], data.site_xpos[site], atol=1e-9)
        turn = ours[:3, :3].ravel()
        np.testing.assert_allclose(turn, data.site_xmat[site], atol=2e-6)  # digits of a quaternion
    # gravity
    q = np.random.default_rng(2).uniform(-3, 3, (20, 5))
    gravity = np.array([0.5, -0.4, -9.7])
    model.opt.gravity[:] = gravity
    angles = link_angles(robot, q)
    loads = gravity_loads(robot, chain_of(robot), angles, gravity, np.zeros(20), np.zeros((20, 3)))
    for k in range(20):
        data.qpos[:], data.qvel[:] = q[k], 0.0
        mujoco.mj_forward(model, data)
        of_readings = robot.link_from_reading.T @ loads.moments[k, 1:, 2]
        np.testing.assert_allclose(of_readings, -data.qfrc_bias, atol=2e-6)
    # About the last axis, which moves the last link alone
    mujoco.mj_forward(model, data)
    momenta = np.zeros(5)
    mujoco.mj_mulM(model, data, momenta, np.eye(5)[4])
    centre, mass = robot.centres_of_mass[-1], robot.masses[-1]
    about_axis = robot.inertias[-1][2, 2] + mass * (centre[0] ** 2 + centre[1] ** 2)
    assert about_axis == pytest.approx(momenta[4], rel=1e-4)
