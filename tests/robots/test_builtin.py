"""Every built-in robot against a second source, typed in here: a DH table, or a URDF's joint origins.

Poses of the flange at random readings, in formulas of their own; nothing is read from the built-in files.
"""

import numpy as np
import pytest
from cases import ROOT, cases

from bayescal.arm.chain import Robot, chain_of, frames, link_angles
from bayescal.arm.statics import gravity_loads
from bayescal.robots import builtin_robots, load_robot

# alpha (deg), a, d (mm), offset (deg) of standard rows Rz Tz Tx Rx, and how far the source may be off (mm)
STANDARD = cases("robot_rows")

# origin xyz (mm), rpy (deg) and axis of each joint, then the flange's; where F0 stands in the root (mm)
ORIGINS = cases("robot_origins")
OWN_TEST = {"fanuc-lrmate200ic", "robotstudio-so101"}  # tests/arm/test_pinocchio.py; test_table_top_arms.py

# Arms with a spherical wrist of four manufacturers: axes of a URDF and rpy (deg) of its tool0; then offsets
# (deg) and signs of the modified rows in robotkinematicscatalogue 1.1.2, and whether J3 is against the floor
MAKERS = {
    "kuka": ("-z +y +y -x +y -x", (0, 90, 0), (0, 0, -90, 0, 0, 180), (-1, 1, 1, -1, 1, -1), False),
    "abb": ("+z +y +y +x +y +x", (0, 90, 0), (0, -90, 0, 0, 0, 180), (1, 1, 1, 1, 1, 1), False),
    "fanuc": ("+z +y -y -x -y -x", (180, -90, 0), (0, -90, 0, 0, 0, 0), (1, 1, -1, -1, -1, -1), True),
    "yaskawa": ("+z +y -y -x -y -x", (180, -90, 0), (0, -90, 0, 0, 0, 0), (1, 1, -1, -1, -1, -1), False),
}
# x, z (mm) of the joint origins and of the flange in the URDF of ROS-Industrial, and the height of F0; then
# d1, a1, a2, a3, d4, d6 (mm) of the catalogue
WRISTED = cases("robot_wrists")
ROUNDED = {"abb-irb1200-7-70": 0.1}
"""mm: lengths that the catalogue has rounded."""


def about(axis, angle: float, xyz=(0.0, 0.0, 0.0)) -> np.ndarray:
    """A turn about a unit axis by Rodrigues' formula, and a place (mm)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], float)
    out = np.eye(4)
    out[:3, :3] += np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    out[:3, 3] = np.array(xyz) * 1e-3
    return out


def by_rows(rows, q) -> np.ndarray:
    pose = np.eye(4)
    for (alpha, a, d, offset), angle in zip(rows, q, strict=True):
        turn = about((0, 0, 1), angle + np.radians(offset), (0, 0, d))
        pose = pose @ turn @ about((1, 0, 0), np.radians(alpha), (a, 0, 0))
    return pose


def by_origins(origins, q) -> np.ndarray:
    pose = np.eye(4)
    for (xyz, rpy, axis), angle in zip(origins, [*q, None], strict=True):
        roll, pitch, yaw = np.radians(rpy)
        pose = pose @ about((0, 0, 1), yaw, xyz) @ about((0, 1, 0), pitch) @ about((1, 0, 0), roll)
        if axis is not None:
            pose = pose @ about(axis, angle)
    return pose


def flange(robot: Robot, readings: np.ndarray) -> np.ndarray:
    return frames(chain_of(robot), link_angles(robot, readings[None]))[0, -1]


def test_each_has_a_second_source():
    assert set(builtin_robots()) == {*STANDARD, *ORIGINS, *WRISTED} | OWN_TEST
    page = (ROOT / "docs/robots.md").read_text(encoding="utf-8")
    assert all(f"| `{name}` |" in page for name in builtin_robots())


@pytest.mark.parametrize("name", STANDARD)
def test_rows(name):
    robot, _ = load_robot(name)
    rows, within = STANDARD[name]
    for q in np.random.default_rng(1).uniform(-3, 3, (50, robot.n)):
        ours, theirs = flange(robot, q), by_rows(rows, q)
        np.testing.assert_allclose(ours[:3, :3], theirs[:3, :3], atol=1e-12)
        assert np.linalg.norm(ours[:3, 3] - theirs[:3, 3]) <= within * 1e-3


@pytest.mark.parametrize("name", ORIGINS)
def test_origins(name):
    robot, _ = load_robot(name)
    origins, base = ORIGINS[name]
    for q in np.random.default_rng(2).uniform(-3, 3, (50, robot.n)):
        joints = q.copy()
        if name.startswith("fanuc"):
            joints[2] += q[1]  # the pendant's J3 is taken against the floor, the URDF's against link 2
        theirs = by_origins(origins, joints)
        theirs[:3, 3] -= np.array(base) * 1e-3
        np.testing.assert_allclose(flange(robot, q), theirs, atol=1e-12)


@pytest.mark.parametrize("name", WRISTED)
def test_two_sources_of_arms_with_a_spherical_wrist(name):
    robot, _ = load_robot(name)
    axes, tool0, offsets, signs, floor = MAKERS[name.split("-")[0]]
    places, height, (d1, a1, a2, a3, d4, d6) = WRISTED[name]
    turned = [np.eye(3)["xyz".index(axis[1])] * float(axis[0] + "1") for axis in axes.split()]
    steps = zip(places[::2], places[1::2], [*turned, None], strict=True)
    origins = [((x, 0, z), (0, 0, 0) if axis is not None else tool0, axis) for x, z, axis in steps]
    rows = zip((0, -90, 0, -90, 90, -90), (0, a1, a2, a3, 0, 0), (d1, 0, 0, d4, 0, d6), offsets, strict=True)
    modified = list(rows)
    for q in np.random.default_rng(4).uniform(-3, 3, (50, robot.n)):
        relative = q.copy()
        relative[2] += q[1] if floor else 0.0  # a FANUC's pendant shows J3 against the floor
        by_urdf = by_origins(origins, relative)
        by_urdf[2, 3] -= height * 1e-3
        found = flange(robot, q)
        np.testing.assert_allclose(found, by_urdf, atol=1e-12)
        by_catalogue = np.eye(4)
        for (alpha, a, d, offset), sign, angle in zip(modified, signs, relative, strict=True):
            twist = about((1, 0, 0), np.radians(alpha), (a, 0, 0))
            turn = about((0, 0, 1), sign * angle + np.radians(offset))
            by_catalogue = by_catalogue @ twist @ turn @ about((0, 0, 1), 0.0, (0, 0, d))
        np.testing.assert_allclose(found, by_catalogue, atol=1e-12 + 1.001e-3 * ROUNDED.get(name, 0.0))


def test_other_tables_of_lengths():
    """Tables with signs of their own: lengths alone, mm."""
    fanuc, _ = load_robot("fanuc-lrmate200id")  # UnderAutomation's Fanuc SDK: d4, d6, a1, a2, a3
    found = np.array([fanuc.d[3], fanuc.d[5], *fanuc.a[1:4]]) * 1e3
    np.testing.assert_allclose(found, np.abs([-335, -80, 50, 330, 35]))
    puma, _ = load_robot("unimation-puma560")  # Corke and Armstrong-Helouvry 1994: a2, d3, a3
    found = np.array([puma.a[2], puma.d[1] + puma.d[2], -puma.a[3]]) * 1e3
    np.testing.assert_allclose(found, [431.8, 150.05, 20.3], atol=0.06)
    kuka, _ = load_robot("kuka-iiwa7")  # pybotics, KukaLBRiiwa7
    np.testing.assert_allclose(kuka.d * 1e3, [340, 0, 400, 0, 400, 0, 126])


# masses (kg), centres (mm, in standard frames): robotics-toolbox-python, models/DH; UR16e: a model for it
TOOLBOX = cases("robot_masses")


@pytest.mark.parametrize("name", TOOLBOX)
def test_weights(name):
    """Gravity torques of the same arm in standard rows."""
    robot, _ = load_robot(name)
    rows = np.array(STANDARD[name][0], float).T * [[np.pi / 180], [1e-3], [1e-3], [np.pi / 180]]
    masses, centres = (np.array(v) for v in TOOLBOX[name])
    weights = {"masses": masses, "centres_of_mass": centres * 1e-3}
    other = Robot(name, "dh", robot.joint_names, *rows, np.zeros(6), robot.limits, np.eye(6), **weights)
    q, gravity = np.random.default_rng(3).uniform(-3, 3, (20, 6)), np.array([0.3, 0.2, -9.8])
    nothing = np.zeros(20), np.zeros((20, 3))
    loads = (gravity_loads(r, chain_of(r), q, gravity, *nothing) for r in (robot, other))
    np.testing.assert_allclose(*[load.moments[:, 1:, 2] for load in loads], atol=0.01)


def test_masses_of_the_panda():
    """Those of robotics-toolbox-python, models/DH/Panda.py."""
    robot, _ = load_robot("franka-panda")
    theirs = [4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555, 0.735522]
    np.testing.assert_allclose(robot.masses, theirs)
