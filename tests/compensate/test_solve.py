"""Corrected readings put the tool of the fitted arm on the target, with every effect."""

from dataclasses import fields, replace

import numpy as np
import pytest
from compensate_arms import arm_with

from bayescal.arm.inverse import poses_apart
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.compensating.position import Region, frame_of
from bayescal.compensating.solve import compensated, nominal_arm
from bayescal.errors import BayescalError
from bayescal.programs.targets import Target

ALL = ("geometry", "compliance", "bending", "base-compliance", "payload", "eccentricity", "encoder-scale",
       "coupling", "gear-mesh", "hysteresis", "backlash")  # fmt: skip


@pytest.fixture(scope="module")
def session(cube):
    """Its rows within the joint limits."""
    dataset = cube(seed=1).dataset
    m, low, high = dataset.measurements, *dataset.robot.limits.T
    angles = nominal_arm(dataset.robot, dataset.tools[0]).angles_of(m.readings)
    rows = np.flatnonzero(np.all((angles > low + 0.1) & (angles < high - 0.1), axis=1))
    return replace(dataset, measurements=taken(m, rows[::2]))


@pytest.fixture(scope="module")
def arm(session):
    return _arm(("geometry", "compliance"), session)


_made = {}


def _arm(effects, session):
    key = (effects, session.name, len(session.measurements.ids))
    if key not in _made:
        _made[key] = arm_with.__wrapped__(effects, session)
    return _made[key]


def taken(measurements, rows):
    columns = {f.name: getattr(measurements, f.name) for f in fields(measurements)}
    picked = {k: v if v is None else np.asarray(v)[rows] for k, v in columns.items()}
    return replace(measurements, **{**picked, "ids": tuple(picked["ids"])})


def poses_of(arm, readings):
    nominal = nominal_arm(arm.dataset.robot, arm.dataset.tools[0])
    return nominal.tool_poses(nominal.frames(readings))


def reached(arm, found, **state):
    """Poses of the tool's frame of the fitted arm at the corrected readings."""
    poses = arm.at(np.array([own.readings for own in found]), **state)
    here = poses.flange.copy()
    here[:, :3, 3] = poses.points
    return here


def test_every_effect_is_corrected(session):
    arm = _arm(ALL, session)
    readings = session.measurements.readings[:6]
    goals = poses_of(arm, readings)
    way = np.sign(np.random.default_rng(0).standard_normal((6, 6)))
    payload = np.linspace(0, 1, 6)
    targets = [Target(str(k), goals[k], velocity=way[k], payload=payload[k]) for k in range(6)]
    found = compensated(arm, targets)
    away, turn = poses_apart(reached(arm, found, direction=way, payload_kg=payload), goals)
    assert np.abs(away).max() < 1.1e-8
    assert np.abs(turn).max() < 1.1e-6
    assert min(own.error for own in found) > 2e-4  # what was corrected
    assert sum(own.inside for own in found) >= 4
    assert all(2 <= own.solutions <= 8 for own in found)


def test_nominal_readings_stand_for_their_nominal_pose(arm, session):
    readings = session.measurements.readings[10:14]
    goals = poses_of(arm, readings)
    by_pose = compensated(arm, [Target("", pose) for pose in goals])
    by_joints = compensated(arm, [Target("", readings=q) for q in readings])
    for a, b, q in zip(by_pose, by_joints, readings, strict=True):
        np.testing.assert_allclose(a.nominal, q, atol=1e-6)
        np.testing.assert_allclose(a.readings, b.readings, atol=1e-6)
    assert [own.solutions for own in by_joints] == [0] * 4


def test_the_nearest_of_all_solutions_is_taken(arm, session):
    readings = session.measurements.readings[[5]]
    goal = poses_of(arm, readings)[0]
    other = readings[0] + np.radians([0, 0, 0, 180, 0, 180]) * np.where(readings[0] > 0, -1, 1)
    other[4] = -other[4]  # the wrist the other way round
    near = compensated(arm, [Target("", goal, other)])[0]
    assert np.abs(near.nominal - other).max() < 1e-5
    assert np.abs(near.readings - other).max() < 0.3


def test_pose_of_a_program_is_where_the_nominal_model_has_the_readings(arm, session):
    found = compensated(arm, [Target("", readings=session.measurements.readings[3])])[0]
    np.testing.assert_allclose(found.pose, poses_of(arm, found.readings[None])[0], atol=1e-12)


def test_play_by_the_target_before_and_by_a_straight_line(session):
    arm = _arm(("geometry", "backlash"), session)
    start = session.measurements.readings[7]
    ends = [start, start + np.radians([3, 2, -1, 4, 0.0, -5]), start + np.radians([1, 3, 1, 5, 0.0, -9])]
    found = compensated(arm, [Target("", readings=q) for q in ends], in_sequence=True)
    goals = poses_of(arm, np.array(ends))
    for k, way in ((1, [1, 1, -1, 1, 0, -1]), (2, [-1, 1, 1, 1, 0, -1])):
        # between the readings of coupled axes the motion counts: the steps themselves, far above a standstill
        step = (ends[k] - ends[k - 1]) / 1e-3
        assert list(np.sign(np.round(step, 9))) == way
        away, _ = poses_apart(reached(arm, [found[k]], direction=step), goals[[k]])
        assert np.abs(away).max() < 1.1e-8
    line = compensated(arm, [Target("", readings=ends[0]), Target("", goals[2], ends[2], straight=True)])
    nominal = nominal_arm(arm.dataset.robot, session.tools[0])
    twist = np.concatenate([part[0] for part in poses_apart(goals[[0]], goals[[2]])])
    slopes = nominal.jacobian(nominal.frames(ends[2][None]))[0]
    end = nominal.readings_of(np.linalg.solve(slopes, twist)[None])[0] / 1e-3
    away, _ = poses_apart(reached(arm, [line[1]], direction=end), goals[[2]])
    assert np.abs(away).max() < 1.1e-8


def test_a_joint_that_rests_keeps_its_direction(session):
    arm = _arm(("geometry", "backlash"), session)
    start = session.measurements.readings[7]
    ends = [start, start + np.radians([3, 0, 0, 0, 0, 0]), start + np.radians([3, 4, 0, 0, 0, 0])]
    found = compensated(arm, [Target("", readings=q) for q in ends], in_sequence=True)
    goals = poses_of(arm, np.array(ends))
    away, _ = poses_apart(reached(arm, [found[2]], direction=np.array([1e3, 1e3, 0, 0, 0, 0])), goals[[2]])
    assert np.abs(away).max() < 1.1e-8


def test_u_is_the_covariance_of_the_point_and_the_play_of_an_unknown_direction(session):
    arm = _arm(("geometry", "backlash"), session)
    q = session.measurements.readings[4]
    known = compensated(arm, [Target("", readings=q, velocity=np.ones(6))])[0]
    spread = arm.at(known.readings, direction=np.ones(6)).covariance[0]
    assert known.u == pytest.approx(np.sqrt(np.trace(spread)), rel=1e-6)
    unknown = compensated(arm, [Target("", readings=q)])[0]
    middle = arm.at(unknown.readings)
    play = [arm.at(unknown.readings, direction=e).points - middle.points for e in np.eye(6)]
    expected = np.sqrt(np.trace(middle.covariance[0]) + np.sum(np.square(play)))
    assert unknown.u == pytest.approx(expected, rel=1e-4)
    assert np.sqrt(np.sum(np.square(play))) > 2e-5


def test_reasons(arm, session):
    q = session.measurements.readings[0]
    goal = poses_of(arm, q[None])[0]
    far = rigid(goal[:3, :3], np.array([3.0, 0, 0]))
    found = compensated(arm, [
        Target("", far), Target("", readings=q + 4.0 * np.eye(6)[0]),
        Target("", goal, admits=lambda _: False), Target("", goal),
        Target("", goal, admits=lambda _: False, strict=False),
    ])  # fmt: skip
    assert found[0].reason.startswith("out of reach by 2")
    assert found[1].reason.startswith("beyond the joint limits (J1 at ")
    assert found[2].reason == "no solution has the configuration that is stated there"
    assert found[3].reason == found[4].reason == ""
    assert all(own.readings is None and np.isnan(own.u) for own in found[:3])


def test_a_correction_beyond_a_limit_is_refused(session):
    arm = _arm(("geometry",), session)
    limit = arm.dataset.robot.limits[0, 1]
    q = session.measurements.readings[0].copy()
    q[0] = limit - 1e-6
    both = [compensated(arm.valued(s * arm.values), [Target("", readings=q)])[0].reason for s in (1, -1)]
    assert sorted(both) == ["", "the correction takes J1 beyond its limit"]


def test_region_needs_a_probed_place_and_probed_readings(arm, session):
    region = Region.of(arm)
    m = session.measurements
    points = arm.at_rows(np.arange(4)).points
    assert region.contains(points, m.readings[:4]).all()
    away = points + np.array([0.0, 0.0, 0.6])
    assert not region.contains(away, m.readings[:4]).any()
    turned = m.readings[:4] + 2 * np.pi * np.eye(6)[5]
    assert not region.contains(points, turned).any()


def test_distance_from_a_hull_of_any_dimension():
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    flat, line = cube[cube[:, 2] == 0], cube[:2]
    for points, p, expected in (
        (cube, [0.3, 0.4, 0.5], 0.0), (cube, [1.5, 0.5, 0.5], 0.5), (cube, [2, 2, 0.5], np.sqrt(2)),
        (flat, [0.3, 0.4, 0.2], 0.2), (line, [0.3, 0, 0.5], 0.3), (cube[:1], [0, 0, 2], 2.0),
    ):  # fmt: skip
        assert Region(points, points).away(np.array(p, float)) == pytest.approx(expected, abs=1e-5)


def test_frame_of_an_instrument(tracker):
    """A pose in the instrument's frame: the instrument would read it there."""
    session = tracker(seed=2).dataset
    arm = _arm(("geometry",), session)
    stand = frame_of(arm, "tracker")
    pose = np.linalg.inv(stand.nominal) @ poses_of(arm, session.measurements.readings[[3]])[0]
    found = compensated(arm, [Target("", pose)], frame="tracker", tool=session.tools[0].name)[0]
    at = arm.at(found.readings, tool=session.tools[0].name)
    there = np.linalg.inv(stand.found) @ np.append(at.points[0], 1.0)
    np.testing.assert_allclose(there[:3], pose[:3, 3], atol=1.1e-8)
    np.testing.assert_allclose(stand.nominal @ found.pose, poses_of(arm, found.readings[None])[0], atol=1e-12)
    with pytest.raises(BayescalError, match="there is no such target; known: base, "):
        frame_of(arm, "table")


def test_a_plane_has_no_frame(arm):
    with pytest.raises(BayescalError, match="a plane has no frame"):
        frame_of(arm, "cube.+z")


def test_the_tool_must_be_named_if_there_are_several(arm):
    with pytest.raises(BayescalError, match="there is no tool `pen`; tools: ball"):
        compensated(arm, [Target("", np.eye(4))], tool="pen")


def test_orientation_of_the_tool(arm, session):
    """The pose is that of the tool's own frame, where the session states one."""
    tool = replace(session.tools[0], rpy=np.array([0.3, -0.2, 0.5]))
    model = arm.model
    dataset = replace(session, tools=(tool,))
    turned = replace(arm, model=replace(model, scene=replace(model.scene, dataset=dataset)))
    q = session.measurements.readings[8]
    plain = compensated(arm, [Target("", readings=q)])[0]
    own = compensated(turned, [Target("", poses_of(turned, q[None])[0], q)])[0]
    np.testing.assert_allclose(own.readings, plain.readings, atol=1e-6)
    axes = poses_of(arm, q[None])[0, :3, :3] @ rpy_matrix(tool.rpy)
    np.testing.assert_allclose(poses_of(turned, q[None])[0, :3, :3], axes, atol=1e-12)
