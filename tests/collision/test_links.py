"""Capsules follow the arm: without gaps from base to ball, as wide as published ones, or as stated."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rigid
from bayescal.dataset import Tool
from bayescal.errors import BayescalError
from bayescal.probing.scene import arm_capsules, link_radii
from bayescal.robots import builtin_robots, load_robot, robot_to_yaml

PROBE = Tool("ball", np.array([0.06, 0.0, 0.12]), 0.003)
STANDARD = """\
schema: bayescal-robot/1
name: standard
convention: dh
joints:
  - {name: J1, alpha_deg: 90, a_mm: 50, d_mm: 400, offset_deg: 0, limits_deg: [-160, 160]}
  - {name: J2, alpha_deg: 0, a_mm: 432, d_mm: 0, offset_deg: 0, limits_deg: [-60, 200]}
  - {name: J3, alpha_deg: -90, a_mm: 120, d_mm: 149, offset_deg: 0, limits_deg: [-220, 50]}
  - {name: J4, alpha_deg: 90, a_mm: 0, d_mm: 433, offset_deg: 0, limits_deg: [-170, 170]}
links:
  - {mass_kg: 10, centre_of_mass_mm: [0, -100, 0]}
  - {mass_kg: 8, centre_of_mass_mm: [-200, 0, 80], radius_mm: 123}
  - {mass_kg: 4, centre_of_mass_mm: [0, 0, 60]}
  - {mass_kg: 2, centre_of_mass_mm: [0, -50, 0]}
"""


def robot_named(name: str, folder):
    if name != "standard":
        return load_robot(name)[0]
    (folder / "robot.yaml").write_text(STANDARD, encoding="utf-8")
    return load_robot("robot.yaml", folder)[0]


@pytest.mark.parametrize("name", [*builtin_robots(), "standard"])
def test_capsules_follow_the_arm_from_base_to_ball(name, tmp_path):
    robot = robot_named(name, tmp_path)
    arm = NominalArm(robot, PROBE.centre)
    low, high = np.clip(robot.limits, -np.pi, np.pi).T
    readings = arm.readings_of(np.random.default_rng(0).uniform(low, high, (20, robot.n)))
    frames, capsules = arm.frames(readings), arm_capsules(robot, PROBE)

    def world(capsule, end):
        return frames[:, capsule.frame, :3, :3] @ end + frames[:, capsule.frame, :3, 3]

    here, radius = frames[:, 0, :3, 3], 0.1
    for capsule in capsules[:-1]:
        gap = np.linalg.norm(world(capsule, capsule.a) - here, axis=1).max()
        assert gap <= 0.26 * radius + PROBE.ball_radius + 0.02 * ("stylus" in capsule.name), capsule
        here, radius = world(capsule, capsule.b), capsule.radius
    assert np.allclose(here, arm.ball(frames))
    assert np.allclose(world(capsules[-1], capsules[-1].a), arm.ball(frames))


def test_a_link_with_both_lengths_is_an_l():
    robot, _ = load_robot("fanuc-lrmate200ic")
    elbow, forearm = (c for c in arm_capsules(robot, PROBE) if c.name == "link 3")
    assert np.allclose(np.stack([elbow.a, elbow.b, forearm.b]), [[0, 0, 0], [0.075, 0, 0], [0.075, 0.32, 0]])


@pytest.mark.parametrize(
    ("name", "beside"), [("universal-robots-ur5", 0.136), ("universal-robots-ur10", 0.176)]
)
def test_an_upper_arm_stands_beside_its_common_normal(name, beside):
    """Along axis 2 by the shoulder offset that the manufacturer's description gives."""
    robot, _ = load_robot(name)
    tube = max((c for c in arm_capsules(robot, PROBE) if c.name == "link 2"), key=lambda c: c.length)
    assert tube.a[2] == pytest.approx(beside, abs=0.025)
    assert tube.b[2] == pytest.approx(beside, abs=0.025)


PUBLISHED = {  # mm, by link: see bayescal/collision/links.py
    "fanuc-lrmate200id": ({2: 130, 3: 80}, 0.5, 1.0),
    "universal-robots-ur5e": ({1: 60, 2: 60, 3: 47, 4: 40, 5: 40}, 1.0, 1.95),
    "universal-robots-ur10": ({1: 78, 2: 78, 3: 50, 4: 50, 5: 46}, 1.0, 2.05),
    "franka-panda": ({1: 60, 2: 60, 3: 60, 4: 60, 6: 50}, 1.0, 1.6),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_assumed_radii_are_between_those_of_industrial_and_collaborative_arms(name):
    robot, _ = load_robot(name)
    stated, low, high = PUBLISHED[name]
    assumed = 1e3 * link_radii(replace(robot, radii=None))
    for link, radius in stated.items():
        assert low <= assumed[link] / radius <= high, link
    assert np.all(np.diff(assumed) <= 0)
    if robot.radii is not None:
        assert [1e3 * robot.radii[link - 1] for link in stated] == pytest.approx(list(stated.values()))


def test_a_stated_radius_replaces_the_assumed_one(tmp_path):
    robot = robot_named("standard", tmp_path)
    radii = link_radii(robot)
    assert radii[2] == pytest.approx(0.123)
    assert radii[3] < 0.123
    first, *_, last = (c for c in arm_capsules(robot, PROBE) if c.frame == 2)
    assert [first.radius, last.radius] == [radii[2], radii[3]]  # the last along axis 3, about its joint
    (tmp_path / "robot.yaml").write_text(robot_to_yaml(robot), encoding="utf-8")
    assert np.array_equal(load_robot("robot.yaml", tmp_path)[0].radii, robot.radii, equal_nan=True)


@pytest.mark.parametrize("radius", ["0", "-5", "wide", ".nan"])
def test_a_radius_that_cannot_be_is_refused(radius, tmp_path):
    (tmp_path / "robot.yaml").write_text(STANDARD.replace("123", radius), encoding="utf-8")
    with pytest.raises(BayescalError, match="radius_mm"):
        load_robot("robot.yaml", tmp_path)


def test_the_tool_ends_in_a_thin_stylus():
    robot, _ = load_robot("fanuc-lrmate200ic")
    body, shaft, tip, ball = (c for c in arm_capsules(robot, PROBE) if c.frame == robot.n + 1)
    length = np.linalg.norm(PROBE.centre)
    assert np.linalg.norm(body.b) + body.radius == pytest.approx(length - 0.05)
    assert shaft.radius < PROBE.ball_radius < body.radius
    assert [c.probe for c in (body, shaft, tip, ball)] == [False, False, True, True]
    reflector = Tool("reflector", np.array([0.0, 0.0, 0.1]))
    assert [c.probe for c in arm_capsules(robot, reflector) if c.frame == robot.n + 1] == [False]
    assert not [c for c in arm_capsules(robot, Tool("flange", np.zeros(3))) if c.frame == robot.n + 1]


def test_a_column_below_the_base():
    robot, _ = load_robot("fanuc-lrmate200ic")
    foot = arm_capsules(robot, PROBE, stand=0.33)[0]
    assert foot.frame == 0
    assert np.allclose(foot.a, [0, 0, -0.33])
    assert np.allclose(rigid(None, foot.b), np.eye(4))
