"""Arms with fewer and with more than six joints."""

from dataclasses import replace

import numpy as np
import pytest
from compensate_arms import arm_with

from bayescal.arm.motion import NominalArm
from bayescal.compensating.solve import compensated
from bayescal.programs.targets import Target
from bayescal.robots import load_robot

FOUR = """\
schema: bayescal-robot/1
name: four
convention: mdh
joints:
  - {name: J1, alpha_deg: 0, a_mm: 0, d_mm: 200, offset_deg: 0, limits_deg: [-170, 170]}
  - {name: J2, alpha_deg: -90, a_mm: 0, d_mm: 0, offset_deg: -90, limits_deg: [-90, 120]}
  - {name: J3, alpha_deg: 0, a_mm: 400, d_mm: 0, offset_deg: 0, limits_deg: [-150, 150]}
  - {name: J4, alpha_deg: 0, a_mm: 350, d_mm: 0, offset_deg: 0, limits_deg: [-170, 170]}
"""


def session_of(base, robot):
    """Points of a robot that an instrument reads, nominal except for noise."""
    rng, m = np.random.default_rng(0), base.measurements
    low, high = 0.5 * robot.limits.T
    readings = rng.uniform(low, high, (len(m.ids), robot.n))
    rest = dict.fromkeys(("velocity", "command", "torque", "temperature", "time"))
    xyz = nominal_points(robot, base.tools[0].centre, readings) + 1e-5 * rng.standard_normal((len(m.ids), 3))
    target = replace(base.targets[0], values={"xyz": np.zeros(3), "rpy": np.zeros(3)})
    table = replace(m, readings=readings, xyz=xyz, **rest)
    return replace(base, name=robot.name, robot=robot, targets=(target,), measurements=table)


def nominal_points(robot, tool, readings):
    nominal = NominalArm(robot, tool)
    return nominal.ball(nominal.frames(readings))


@pytest.mark.parametrize("name", ["four", "franka-panda"])
def test_the_tool_point_is_corrected(tracker, tmp_path, name):
    """Of four joints without the orientation, which they cannot hold; of seven with the smallest motion."""
    (tmp_path / "four.yaml").write_text(FOUR, encoding="utf-8")
    robot, _ = load_robot(str(tmp_path / "four.yaml") if name == "four" else name)
    session = session_of(tracker(seed=0).dataset, robot)
    arm = arm_with.__wrapped__(("geometry",), session)
    q = session.measurements.readings[:5]
    goals = nominal_points(robot, session.tools[0].centre, q)
    found = compensated(arm, [Target("", readings=own) for own in q])
    readings = np.array([own.readings for own in found])
    np.testing.assert_allclose(arm.at(readings).points, goals, atol=1.1e-8)
    assert np.linalg.norm(arm.at(q).points - goals, axis=1).min() > 1e-4
    assert np.abs(readings - q).max() < 0.3
