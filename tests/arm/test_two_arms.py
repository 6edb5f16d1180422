"""A chain through two arms against MuJoCo, which has the tree of the URDF: poses, torques, masses."""

import mujoco
import numpy as np
import pytest
from cases import refused
from urdf_texts import words

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.statics import Loads, centre_of_mass, gravity_in_f0, gravity_loads, hinges, placed
from bayescal.robots.urdf import robot_from_urdf

GRAVITY = np.array([0.3, -0.5, -9.7])
CHAIN = "l_tool..r_tool"


def link(rng, name):
    origin = f'<origin xyz="{words(rng.normal(0, 0.1, 3))}" rpy="{words(rng.normal(0, 1, 3))}"/>'
    inertia = '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
    mass = f'<mass value="{rng.uniform(0.5, 5.0)}"/>'
    return f'<link name="{name}"><inertial>{origin}{mass}{inertia}</inertial></link>'


def joint(rng, name, kind, parent, child):
    origin = f'<origin xyz="{words(rng.normal(0, 0.3, 3))}" rpy="{words(rng.normal(0, 1, 3))}"/>'
    axis = f'<axis xyz="{words(rng.normal(0, 1, 3))}"/>'
    more = f'{axis}<limit lower="-2" upper="2" effort="9" velocity="1"/>'
    return (
        f'<joint name="{name}" type="{kind}">{origin}<parent link="{parent}"/><child link="{child}"/>'
        f"{more if kind != 'fixed' else ''}</joint>"
    )


def two_arms(seed):
    """A URDF of two arms with any origins and axes on a torso that turns: the first has a slide."""
    rng = np.random.default_rng(seed)
    parts = ['<link name="world"/>', link(rng, "torso"), joint(rng, "waist", "revolute", "world", "torso")]
    for side, kinds in (("l", ("revolute", "prismatic", "revolute")), ("r", 4 * ("revolute",))):
        before = "torso"
        for k, kind in enumerate(kinds, start=1):
            parts += [link(rng, f"{side}{k}"), joint(rng, f"{side}j{k}", kind, before, f"{side}{k}")]
            before = f"{side}{k}"
        parts += [link(rng, f"{side}_tool"), joint(rng, f"{side}_fix", "fixed", before, f"{side}_tool")]
    return '<robot name="two">' + "".join(parts) + "</robot>"


@pytest.fixture(params=range(3))
def case(request):
    """A robot, its model in MuJoCo, and readings (5, 7)."""
    text = two_arms(request.param)
    compiler = '<robot name="two"><mujoco><compiler fusestatic="false"/></mujoco>'
    model = mujoco.MjModel.from_xml_string(text.replace('<robot name="two">', compiler))
    model.opt.gravity[:] = GRAVITY
    readings = np.random.default_rng(request.param + 100).uniform(-1.0, 1.0, (5, 7))
    return robot_from_urdf(text.encode(), "two.urdf", CHAIN), model, readings


def pose(data, name):
    body, out = data.body(name), np.eye(4)
    out[:3, :3], out[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    return out


def test_poses_and_torques_are_those_of_the_tree(case):
    robot, model, readings = case
    assert robot.joint_names == ("lj3", "lj2", "lj1", "rj1", "rj2", "rj3", "rj4")
    assert robot.ground.link == 3
    chain, q = chain_of(robot), link_angles(robot, readings)
    ours = frames(chain, q)[:, -1]
    nothing = np.zeros(len(q)), np.zeros((len(q), 3))
    torques = gravity_loads(robot, chain, q, GRAVITY, *nothing).torques(robot.slides)
    data = mujoco.MjData(model)
    for k, values in enumerate(readings):
        for name, value in zip(robot.joint_names, values, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_forward(model, data)
        theirs = np.linalg.inv(pose(data, "l_tool")) @ pose(data, "r_tool")
        np.testing.assert_allclose(theirs, ours[k], atol=1e-12)
        theirs = [-data.joint(name).qfrc_bias[0] for name in robot.joint_names]
        np.testing.assert_allclose(torques[k], theirs, rtol=1e-10, atol=1e-10)


def test_loads_of_single_masses_add_up(case):
    robot, _, readings = case
    chain, q = chain_of(robot), link_angles(robot, readings)
    mass, centre = np.full(len(q), 1.7), np.tile([0.05, 0.02, 0.1], (len(q), 1))
    whole = gravity_loads(robot, chain, q, GRAVITY, mass, centre)
    places = frames(chain, q)
    down, about = gravity_in_f0(chain, places, GRAVITY), hinges(chain, places)
    first, held_at = robot.ground.load
    bodies = [(0, first, np.broadcast_to(held_at, (len(q), 3)))]
    centres = (centre_of_mass(robot, chain, i) for i in range(1, robot.n + 1))
    bodies += [(i, robot.masses[i - 1], placed(places[:, i], centre)) for i, centre in enumerate(centres, 1)]
    bodies += [(robot.n, 1.7, placed(places[:, -1], centre))]
    turn = np.tile(np.eye(3), (len(q), 1, 1))
    single = [about.by_mass(i, m * down, at, turn)[0] for i, m, at in bodies]
    total = Loads(sum(s.moments for s in single), sum(s.weights for s in single))
    np.testing.assert_allclose(total.moments, whole.moments, atol=1e-11)
    np.testing.assert_allclose(total.weights, whole.weights, atol=1e-11)


@pytest.mark.parametrize("asked", ["l_tool..", "..r_tool", "l_tool..l_tool", "l_tool..none", "none..r_tool"])
def test_links_that_are_no_two(asked):
    refused(r"two links|no link is called", lambda: robot_from_urdf(two_arms(0).encode(), "two.urdf", asked))


def test_a_chain_from_a_link_that_stands_is_one_arm():
    whole = robot_from_urdf(two_arms(0).encode(), "two.urdf", "world..r_tool")
    assert whole.ground is None
    assert whole.joint_names == ("waist", "rj1", "rj2", "rj3", "rj4")
