"""Where the tool is: one uncertainty for positions, compensated targets and budgets, checked by draws."""

from dataclasses import replace

import numpy as np
import pytest
from cases import refused, robot_file, without_draws
from compensate_arms import arm_with

import bayescal as bc
from bayescal.arm.inverse import poses_apart
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.compensating.position import Frame, Region, expanded, frame_of, positions
from bayescal.compensating.solve import compensated
from bayescal.dataset.write import taken
from bayescal.errors import BayescalError
from bayescal.fitted.arm import of_fit
from bayescal.fitted.gate import Use
from bayescal.model import ARM
from bayescal.programs.text import Target
from bayescal.programs.tools import nominal_arm, tool_of
from bayescal.public.positions import Positioned
from bayescal.robots import load_robot

DRAWS = 3000


@pytest.fixture(scope="module")
def fitted(tracker):
    """Without the compliances that the arm has: what is not modelled is most of the uncertainty."""
    return bc.fit(tracker(seed=3, count=80).dataset, "geometry", samples=0)


@pytest.fixture(scope="module")
def noisy(tracker):
    """An instrument with a noise that is half of the stated one: its place is much of the uncertainty."""
    session = tracker(seed=3, count=80, noise=1e-3).dataset
    return bc.fit(replace(session, noise=replace(session.noise, point=2e-3)), "geometry", samples=0)


@pytest.fixture(scope="module")
def arm(fitted):
    return of_fit(fitted.data)


@pytest.fixture(scope="module")
def readings(arm):
    return arm.dataset.measurements.readings[[3, 17, 40, 66]]


def test_the_session_has_a_discrepancy(arm, readings):
    """Else the tests below would check parameters alone; the cross terms with these are seen."""
    assert arm.beyond.variances
    poses = arm.at(readings)
    alone = np.trace(poses.by_parameters @ arm.covariance @ np.swapaxes(poses.by_parameters, 1, 2), 0, 1, 2)
    assert np.max(np.abs(np.log(alone / np.trace(poses.covariance, 0, 1, 2)))) > 0.2


def test_a_point_whose_error_is_unexplained_has_the_degrees_of_freedom_of_that(arm):
    """And where half of the variance is known, four times as many (JCGM 100, G.4.1)."""
    beyond = replace(arm.beyond, excess=5e-5, excess_dof=7.0, by_noise={})
    alone, bare = 3.0 * 5e-5**2, np.zeros((1, 3, len(arm.values)))
    assert beyond.dof_of(np.array([alone]), {}, bare) == pytest.approx(7.0)
    assert beyond.dof_of(np.array([2.0 * alone]), {}, bare) == pytest.approx(28.0)


@pytest.mark.parametrize(
    ("session", "frame"), [("fitted", "base"), ("fitted", "tracker"), ("noisy", "tracker")]
)
def test_covariance_by_draws_of_all_unknowns(session, frame, request):
    """Draws of arm, target and functions together, through the kinematics: no slope, no elimination."""
    fitted = request.getfixturevalue(session)
    arm = of_fit(fitted.data)
    readings = arm.dataset.measurements.readings[[3, 17, 40, 66]]
    stated = fitted.data.stated
    wide, rng = stated.wide.model, np.random.default_rng(0)
    plain = stated.plain
    z = plain.z + rng.standard_normal((DRAWS, len(plain.z))) @ np.linalg.cholesky(plain.covariance).T
    drawn = stated.draws(z, rng)
    rows = [arm.dataset.measurements.readings.tolist().index(q.tolist()) for q in readings]
    points = wide.motion(np.array(rows)).points(wide.deviations(drawn[:, wide.slices[ARM]]))
    points = np.moveaxis(points, -1, 1) + arm.beyond.excess * rng.standard_normal((DRAWS, len(rows), 3))
    if frame == "tracker":
        block = wide.block_of["tracker"]
        states = map(block.state, drawn[:, wide.slices["tracker"]])
        at = np.array([block.kind.describe(state)["frame"] for state in states])
        points = np.einsum("sji,scj->sci", at[:, :3, :3], points - at[:, None, :3, 3])
    expected = np.array([np.cov(points[:, k].T) for k in range(len(rows))])
    found = positions(arm, readings, frame=frame)
    size = np.trace(expected, 0, 1, 2)
    np.testing.assert_allclose(found.uncertain.u, np.sqrt(size), rtol=0.05)
    off = np.abs(found.uncertain.covariance - expected).max(axis=(1, 2))
    assert off == pytest.approx(0, abs=0.07 * size.max())
    away = np.linalg.norm(points - points.mean(axis=0), axis=2)
    within = np.mean(away <= found.uncertain.expanded, axis=0)
    assert np.all(within > 0.945)  # more where the variances have few degrees of freedom


def test_one_uncertainty_for_budgets_positions_and_compensations(fitted, arm, readings, tmp_path):
    with without_draws():
        fitted.save(tmp_path / "run", pictures=False)
    live, loaded = fitted.position(readings), bc.load(tmp_path / "run").position(readings)
    np.testing.assert_allclose(loaded.poses, live.poses, atol=1e-9)
    np.testing.assert_allclose(loaded.covariance, live.covariance, rtol=1e-6, atol=1e-16)
    for k, q in enumerate(readings):
        budget = bc.budget(fitted, point=np.degrees(q))
        # nearly: a budget does not limit the parameters to their priors
        assert 1e3 * live.u[k] == pytest.approx(budget.u, rel=0.01)
        assert 1e3 * live.U[k] == pytest.approx(budget.U, rel=0.03)
    done = compensated(arm, [Target("", readings=q) for q in readings])
    there = positions(arm, np.array([own.readings for own in done]))
    np.testing.assert_allclose([own.u for own in done], there.uncertain.u, rtol=1e-9)
    np.testing.assert_allclose([own.expanded for own in done], there.uncertain.expanded, rtol=1e-9)
    assert [own.inside for own in done] == there.inside.tolist()


def test_noise_of_few_measurements_widens_the_length_that_errors_do_not_exceed(tmp_path):
    fitted = bc.fit(bc.simulate(contacts=45, later=8, repeats=0, spheres=0, seed=3), samples=0)
    with without_draws():
        fitted.save(tmp_path / "run", pictures=False)
    q = np.radians([10.0, 20.0, -30.0, 40.0, 50.0, 60.0])
    budget = bc.budget(fitted, point=np.degrees(q))
    assert budget.record["effective_dof"] < 60
    for found in (fitted, bc.load(tmp_path / "run")):
        at = found.position(q, force=True)
        assert 1e3 * at.u[0] == pytest.approx(budget.u, rel=1e-4)
        assert 1e3 * at.U[0] == pytest.approx(budget.U, rel=1e-4)


def test_a_length_that_errors_do_not_exceed():
    """Of isotropic, flat and single errors, and with a variance that was estimated from few values."""
    rng = np.random.default_rng(1)
    for sides in ([1, 1, 1], [3, 1, 0.1], [1, 0, 0]):
        covariance = np.diag(np.square(np.array(sides, float)))[None]
        away = np.linalg.norm(rng.standard_normal((200_000, 3)) * sides, axis=1)
        assert np.mean(away <= expanded(covariance, np.array([1e6]))[0]) == pytest.approx(0.9545, abs=4e-3)
        scale = np.sqrt(rng.chisquare(6, 200_000) / 6)
        few = expanded(covariance, np.array([6.0]))[0]
        assert np.mean(away <= few * scale) == pytest.approx(0.9545, abs=4e-3)


def test_another_tool_is_carried_by_the_flange(arm, readings):
    """The offset of the probe has taken up zero and length of the last joint: a tool has them in its u."""
    tcp = np.array([0.03, -0.02, 0.15, 0.2, -0.1, 0.4])
    found = positions(arm, readings, tcp=tcp)
    flange = arm.at(readings).flange
    np.testing.assert_allclose(found.poses, flange @ rigid(rpy_matrix(tcp[3:]), tcp[:3]), atol=1e-12)
    axis, arms = flange[:, :3, 2], flange[:, :3, :3] @ tcp[:3]
    way = np.cross(axis, arms)
    # by the tolerances of d6, 0.3 mm, and of theta6, 2 mrad
    expected = 3e-4**2 * axis[:, :, None] * axis[:, None] + 2e-3**2 * way[:, :, None] * way[:, None]
    working = tool_of(arm, None, tcp)
    poses = working.arm.at(readings, tool="tcp")
    np.testing.assert_allclose(working.covariance(poses), expected, rtol=1e-3, atol=1e-12)
    more = found.uncertain.covariance - poses.covariance
    np.testing.assert_allclose(more, working.covariance(poses), atol=1e-15)
    own = arm.dataset.tools[0]
    for tool, message in (
        ({"tool": own.name, "tcp": tcp}, "--tcp: a tool and its pose are given"),
        ({"tcp": tcp[:5]}, "--tcp: is not six numbers"),
        ({"tool": "pen"}, "--tool: there is no tool `pen`; tools: ball"),
    ):
        with pytest.raises(BayescalError, match=message):
            positions(arm, readings, **tool)


def test_a_tool_of_the_dataset_that_no_row_uses(arm, readings):
    gun = replace(arm.dataset.tools[0], name="gun", centre=np.array([0, 0, 0.2]), u=1e-4)
    scene = replace(arm.model.scene, dataset=replace(arm.dataset, tools=(*arm.dataset.tools, gun)))
    both = replace(arm, model=replace(arm.model, scene=scene))
    found = positions(both, readings, tool="gun")
    same = positions(arm, readings, tcp=np.array([0, 0, 0.2, 0, 0, 0]))
    np.testing.assert_allclose(found.poses[:, :3, 3], same.poses[:, :3, 3], atol=1e-12)
    extra = found.uncertain.covariance - same.uncertain.covariance
    np.testing.assert_allclose(extra, np.broadcast_to(1e-8 * np.eye(3), extra.shape), atol=1e-12)
    assert found.inside.tolist() == positions(arm, readings).inside.tolist()
    refused("--tool: the session has several tools", lambda: positions(both, readings))


def test_the_covariance_is_along_the_axes_of_the_frame(arm, readings, monkeypatch):
    turn = rpy_matrix(np.array([0.4, -0.9, 1.3]))
    plain = positions(arm, readings)
    stand = Frame(np.eye(4), rigid(turn))
    monkeypatch.setattr("bayescal.compensating.position.frame_of", lambda *_: stand)
    found = positions(arm, readings)
    np.testing.assert_allclose(found.poses[:, :3, 3], plain.poses[:, :3, 3] @ turn, atol=1e-12)
    expected = turn.T @ plain.uncertain.covariance @ turn
    np.testing.assert_allclose(found.uncertain.covariance, expected, rtol=1e-6, atol=1e-16)


def test_direction_of_motion_and_load(fitted, arm, readings):
    """Every argument arrives: as in `FittedArm.at`."""
    heavy = fitted.position(readings, payload_kg=2.0)
    np.testing.assert_allclose(heavy.points, arm.at(readings, payload_kg=2.0).points, atol=1e-12)
    turned = fitted.position(readings, frame="tracker")
    here = fitted.position(readings)
    assert np.all(np.trace(turned.covariance, 0, 1, 2) < np.trace(here.covariance, 0, 1, 2) * 1.5)
    table = here.table
    np.testing.assert_allclose(table[["x_mm", "y_mm", "z_mm"]].to_numpy(), 1e3 * here.points)
    np.testing.assert_allclose(table["u_mm"], 1e3 * here.u)
    np.testing.assert_allclose(table["U_mm"], 1e3 * here.U)
    assert np.all(np.abs(here.U / here.u - 2.0) > 1e-3)  # of a vector: not twice its u
    np.testing.assert_array_equal(table["inside_probed_region"], here.inside)
    np.testing.assert_allclose(rpy_matrix(np.radians(table[["rx_deg", "ry_deg", "rz_deg"]].to_numpy())),
                               here.poses[:, :3, :3], atol=1e-12)  # fmt: skip
    for wrong in (readings[:, :5], np.full(6, np.nan)):
        with pytest.raises(BayescalError, match="readings: readings of shape"):
            fitted.position(wrong)
    refused("another shape than the readings", lambda: fitted.position(readings, payload_kg=[1.0, 2.0]))


def test_an_arm_that_must_not_be_used(arm, readings):
    class Result(Positioned):
        _arm = replace(arm, use=Use(("it rests on its priors",), ("verdict: not validated",)))

    refused("not used: it rests on its priors", lambda: Result().position(readings))
    text = str(Result().position(readings, force=True)).splitlines()
    assert text[:2] == ["warning: not to be used: it rests on its priors", "warning: verdict: not validated"]


# --- Corrected readings put the tool of the fitted arm on the target, with every effect.

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
def solved_arm(session):
    return _arm(("geometry", "compliance"), session)


_made = {}


def _arm(effects, session):
    key = (effects, session.name, len(session.measurements.ids))
    if key not in _made:
        _made[key] = arm_with(effects, session)
    return _made[key]


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
    goals = poses_of(arm, session.measurements.readings[:6])
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


def test_nominal_readings_stand_for_their_nominal_pose(solved_arm, session):
    readings = session.measurements.readings[10:14]
    goals = poses_of(solved_arm, readings)
    by_pose = compensated(solved_arm, [Target("", pose) for pose in goals])
    by_joints = compensated(solved_arm, [Target("", readings=q) for q in readings])
    for a, b, q in zip(by_pose, by_joints, readings, strict=True):
        np.testing.assert_allclose(a.nominal, q, atol=1e-6)
        np.testing.assert_allclose(a.readings, b.readings, atol=1e-6)
    assert [own.solutions for own in by_joints] == [None] * 4


def test_the_nearest_of_all_solutions_is_taken(solved_arm, session):
    readings = session.measurements.readings[[5]]
    goal = poses_of(solved_arm, readings)[0]
    other = readings[0] + np.radians([0, 0, 0, 180, 0, 180]) * np.where(readings[0] > 0, -1, 1)
    other[4] = -other[4]  # the wrist the other way round
    near = compensated(solved_arm, [Target("", goal, other)])[0]
    assert np.abs(near.nominal - other).max() < 1e-5
    assert np.abs(near.readings - other).max() < 0.3


def test_pose_of_a_program_is_where_the_nominal_model_has_the_readings(solved_arm, session):
    found = compensated(solved_arm, [Target("", readings=session.measurements.readings[3])])[0]
    np.testing.assert_allclose(found.pose, poses_of(solved_arm, found.readings[None])[0], atol=1e-12)


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
    # a joint that rests keeps its direction
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


def test_reasons(solved_arm, session):
    q = session.measurements.readings[0]
    goal = poses_of(solved_arm, q[None])[0]
    far = rigid(goal[:3, :3], np.array([3.0, 0, 0]))
    found = compensated(solved_arm, [
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


def test_region_needs_a_probed_place_and_probed_readings(solved_arm, session):
    region = Region.of(solved_arm)
    m = session.measurements
    points = solved_arm.at_rows(np.arange(4)).points
    assert region.contains(points, m.readings[:4]).all()
    assert not region.contains(points + np.array([0.0, 0.0, 0.6]), m.readings[:4]).any()
    assert not region.contains(points, m.readings[:4] + 2 * np.pi * np.eye(6)[5]).any()
    edge = np.tile(m.readings[0], (4, 1))
    low, high = region.readings[:, 4].min(), region.readings[:, 4].max()
    edge[:, 4] = low - np.radians(0.5), low - np.radians(1.5), high + np.radians(0.5), high + np.radians(1.5)
    assert region.contains(points[[0] * 4], edge).tolist() == [True, False, True, False]


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
    there = np.linalg.inv(stand.fitted) @ np.append(at.points[0], 1.0)
    np.testing.assert_allclose(there[:3], pose[:3, 3], atol=1.1e-8)
    np.testing.assert_allclose(stand.nominal @ found.pose, poses_of(arm, found.readings[None])[0], atol=1e-12)
    refused("there is no such target; known: base, ", lambda: frame_of(arm, "table"))


def test_a_plane_has_no_frame(solved_arm):
    states = {name: state for name, state in solved_arm.states.items() if name != "cube.-y"}
    with pytest.raises(BayescalError, match="did not locate this target") as caught:
        frame_of(replace(solved_arm, states=states), "cube.-y")
    assert caught.value.remedy == "give one of: base"  # of the faces none
    refused("a plane has no frame", lambda: frame_of(solved_arm, "cube.+z"))


def test_the_tool_must_be_named_if_there_are_several(solved_arm):
    with pytest.raises(BayescalError, match="there is no tool `pen`; tools: ball"):
        compensated(solved_arm, [Target("", np.eye(4))], tool="pen")


def test_orientation_of_the_tool(solved_arm, session):
    """The pose is that of the tool's own frame, where the session states one."""
    tool = replace(session.tools[0], rpy=np.array([0.3, -0.2, 0.5]))
    model = solved_arm.model
    dataset = replace(session, tools=(tool,))
    turned = replace(solved_arm, model=replace(model, scene=replace(model.scene, dataset=dataset)))
    q = session.measurements.readings[8]
    plain = compensated(solved_arm, [Target("", readings=q)])[0]
    own = compensated(turned, [Target("", poses_of(turned, q[None])[0], q)])[0]
    np.testing.assert_allclose(own.readings, plain.readings, atol=1e-6)
    axes = poses_of(solved_arm, q[None])[0, :3, :3] @ rpy_matrix(tool.rpy)
    np.testing.assert_allclose(poses_of(turned, q[None])[0, :3, :3], axes, atol=1e-12)


# --- Arms with fewer and with more than six joints.


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
    robot, _ = load_robot(robot_file("four") if name == "four" else name)
    session = session_of(tracker(seed=0).dataset, robot)
    arm = arm_with(("geometry",), session)
    q = session.measurements.readings[:5]
    goals = nominal_points(robot, session.tools[0].centre, q)
    found = compensated(arm, [Target("", readings=own) for own in q])
    readings = np.array([own.readings for own in found])
    np.testing.assert_allclose(arm.at(readings).points, goals, atol=1.1e-8)
    assert np.linalg.norm(arm.at(q).points - goals, axis=1).min() > 1e-4
    assert np.abs(readings - q).max() < 0.3
