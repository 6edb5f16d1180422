"""Candidate contacts: they touch, are within limits, cone and reach of the tool, on all faces, and free."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from cases import EXAMPLE, refused
from made_up_plans import made_up_plan
from probing_cell import on_planes
from sessions import of_targets, with_columns
from simulated_pools import MODEL, linear, pool, pool_of

import bayescal as bc
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import Box, Dataset, Noise, Patch, PlanSettings, Target, read_dataset, write_dataset
from bayescal.dataset.consistency import CHANCE, planned
from bayescal.dataset.regions import LOWEST
from bayescal.errors import BayescalError
from bayescal.model import ARM, Scene
from bayescal.planning.candidates import Possible, candidates, session_of
from bayescal.planning.goals import CERTIFIED, POSES, REGION, VOLUME, _with_readings, certified, goals
from bayescal.planning.pool import Pool, Setup, linearised
from bayescal.planning.search import EACH, TILT
from bayescal.planning.setup import continued, read_setup
from bayescal.predict.targets import as_certified, located_target
from bayescal.probing.clearance import RETRACT, Clearance
from bayescal.probing.contacts import FASTEST
from bayescal.probing.motions import Arm

KG = 2.0


FACES = ("cube.+y", "cube.-y", "cube.-x", "cube.+z")
SPHERES = ("ball.A@1", "ball.B@1", "ball.C@1")


@pytest.fixture(scope="module")
def setup() -> Setup:
    dataset = of_targets(read_setup(EXAMPLE).dataset, *FACES, *SPHERES)
    return continued(replace(dataset, plan=PlanSettings(payloads=(KG,))))


@pytest.fixture(scope="module")
def candidate_pool(setup) -> Pool:
    return candidates(setup, 400, seed=3)


def misses(pool: Pool) -> np.ndarray:
    """Distance of the nominal tool of each row from its nominal target, by the measurement kinds, m."""
    scene_, m = Scene(pool.session), pool.session.measurements
    out = np.empty(len(m.ids))
    for t in np.unique(m.target):
        rows = np.flatnonzero(m.target == t)
        kind = scene_.kind(int(t), rows)
        out[rows] = np.linalg.norm(kind.residual(np.zeros(len(kind.sd)), scene_.points[rows].T), axis=0)
    return out


def normals(pool: Pool) -> np.ndarray:
    """Outward normals of the surface at each row, (N, 3)."""
    return -Scene(pool.session)._inward


def test_contacts_touch_their_targets(candidate_pool):
    assert misses(candidate_pool).max() < 1e-8


def test_all_faces_have_equally_many(candidate_pool):
    m, names = candidate_pool.session.measurements, [t.name for t in candidate_pool.session.targets]
    counts = Counter(names[t] for t in m.target[candidate_pool.candidates])
    assert counts == dict.fromkeys(FACES, 100)
    counts = Counter(names[t] for t in m.target[candidate_pool.validation])
    assert counts == dict.fromkeys(SPHERES, EACH)


def test_contacts_are_all_over_a_face(candidate_pool, setup):
    """Each quarter of every face has some; none is outside."""
    scene_, m = Scene(candidate_pool.session), candidate_pool.session.measurements
    for name in FACES:
        k = [t.name for t in setup.dataset.targets].index(name)
        rows, region = np.flatnonzero(m.target == k), setup.regions[name]
        place = (scene_.points[rows] - region.centre) @ region.half.T / np.sum(region.half**2, axis=1)
        assert np.abs(place).max() <= 1 + 1e-6
        quarters = Counter(map(tuple, place > 0))
        assert len(quarters) == 4
        assert min(quarters.values()) >= 10


def test_limits_are_kept_with_a_margin(candidate_pool):
    arm = Arm(candidate_pool.session.robot, candidate_pool.session.tools[0].centre)
    for readings in (candidate_pool.session.measurements.readings, candidate_pool.approach):
        angles = arm.angles_of(readings)
        assert np.all((angles >= arm.range[0] - 1e-9) & (angles <= arm.range[1] + 1e-9))
    margin = np.minimum(arm.range[0] - candidate_pool.session.robot.limits[:, 0], 1)
    assert np.all(margin >= np.radians(3.9))


def test_the_tool_is_within_its_cone(candidate_pool, setup):
    cosine = np.sum(Scene(candidate_pool.session).flange[:, :, 2] * -normals(candidate_pool), axis=1)
    assert cosine.min() > np.cos(setup.cone) - 1e-6
    assert cosine.min() < np.cos(0.8 * setup.cone)  # and directions vary over it
    narrow = replace(setup, cone=np.radians(20.0))
    own = candidates(replace(narrow, dataset=of_targets(setup.dataset, *FACES)), 24, seed=1)
    cosine = np.sum(Scene(own.session).flange[:, :, 2] * -normals(own), axis=1)
    assert cosine.min() > np.cos(narrow.cone) - 1e-6


def test_the_approach_is_straight_along_the_normal(candidate_pool):
    arm = NominalArm(candidate_pool.session.robot, candidate_pool.session.tools[0].centre)
    off = arm.ball(arm.frames(candidate_pool.approach)) - Scene(candidate_pool.session).points
    assert np.allclose(off, RETRACT * normals(candidate_pool), atol=1e-7)
    half = 0.5 * (candidate_pool.approach + candidate_pool.session.measurements.readings)
    middle = arm.ball(arm.frames(half)) - Scene(candidate_pool.session).points
    assert np.linalg.norm(middle - 0.5 * off, axis=1).max() < 0.1 * RETRACT  # joints move evenly
    # The wrist of the arm reaches most contacts with J5 of either sign
    wrist = arm.angles_of(candidate_pool.session.measurements.readings)[candidate_pool.candidates, 4]
    assert 0.2 < np.mean(wrist > 0) < 0.8


def test_velocities_are_those_of_the_approach_and_joints_come_from_both_sides(candidate_pool):
    m = candidate_pool.session.measurements
    assert np.allclose(np.sign(m.readings - candidate_pool.approach), np.sign(m.velocity))
    assert np.abs(m.velocity).max() <= FASTEST + 1e-9
    share = (m.velocity[candidate_pool.candidates] > 0).mean(axis=0)
    assert np.all((share > 0.1) & (share < 0.9)), share
    # times are not along anything
    own = m.time[candidate_pool.candidates]
    assert np.all(np.diff(np.sort(m.time)) > 0)
    for column in (*m.readings.T, m.target, m.payload):
        assert abs(np.corrcoef(own, column[candidate_pool.candidates])[0, 1]) < 0.2


def test_nothing_collides_at_contact_and_approach(candidate_pool, setup):
    """The distances of all pairs; 20 mm off nothing is near, the ball included."""
    around, m = setup.scene, candidate_pool.session.measurements
    clearance = Clearance.of(setup.dataset.robot, setup.dataset.tools[0], around.solids)
    touched = around.touched([setup.dataset.targets[t].name for t in m.target])
    assert clearance.distances(m.readings, touched).min() > -1e-6
    assert clearance.distances(candidate_pool.approach, touched).min() > -1e-6
    assert clearance.distances(candidate_pool.approach).min() > -1e-6  # 20 mm off, the ball included


def test_half_of_the_candidates_carry_the_payload(candidate_pool):
    payload = candidate_pool.session.measurements.payload
    assert set(payload) == {0.0, KG}
    assert 0.4 < np.mean(payload[candidate_pool.candidates] > 0) < 0.6
    assert np.all(payload[candidate_pool.validation] == 0)


def test_a_sphere_is_located_in_one_configuration(candidate_pool, setup):
    """The wrist does not flip, and the tool leaves one direction only as far as its cone makes it."""
    m, flange = candidate_pool.session.measurements, Scene(candidate_pool.session).flange
    arm = NominalArm(candidate_pool.session.robot, candidate_pool.session.tools[0].centre)
    most = 2 * (LOWEST - 0.98 * setup.cone + TILT)
    for t in np.unique(m.target[candidate_pool.validation]):
        rows = candidate_pool.validation[m.target[candidate_pool.validation] == t]
        wrist = arm.angles_of(m.readings[rows])[:, 4]
        assert np.all(wrist > 0) or np.all(wrist < 0)
        assert np.ptp(m.readings[rows, :3], axis=0).max() < np.radians(90)
        axes = flange[rows, :, 2]
        assert np.arccos(np.clip(axes @ axes.T, -1, 1)).max() < most


def test_the_seed_decides(setup):
    own = continued(of_targets(setup.dataset, "cube.+z", "cube.+y", "cube.-y", "cube.-x", "ball.B@1"))
    first, again, other = (candidates(own, 16, seed=s) for s in (3, 3, 4))
    readings = [p.session.measurements.readings for p in (first, again, other)]
    assert np.array_equal(readings[0], readings[1])
    assert first.dropped == again.dropped
    assert readings[0].shape != readings[2].shape or not np.allclose(readings[0], readings[2])


def test_what_is_dropped_is_counted(candidate_pool):
    assert sum(candidate_pool.dropped.values()) > len(candidate_pool.candidates)
    assert any(reason.startswith("collision with cube") for reason in candidate_pool.dropped)
    assert not candidate_pool.warnings


def unreachable(dataset: Dataset) -> Dataset:
    """With a further face 3 m away."""
    far = Target("far", "plane", {"normal": np.array([-1.0, 0, 0]), "offset": -3.0})
    settings = PlanSettings(regions={"far": Patch(np.array([3.0, 0.0, 0.2]), np.array([0.2, 0.2]))})
    return replace(dataset, targets=(*dataset.targets, far), plan=settings)


def test_a_target_out_of_reach_is_reported_and_the_others_have_its_share(setup):
    dataset = unreachable(of_targets(setup.dataset, "cube.+z", "cube.+y", "cube.-y", "cube.-x"))
    pool = candidates(continued(dataset), 40, seed=0)
    names = [t.name for t in dataset.targets]
    assert Counter(names[t] for t in pool.session.measurements.target) == dict.fromkeys(FACES, 10)
    (warning,) = pool.warnings
    assert warning.startswith("no possible contacts on far: no joint angles within the limits (100%)")


def test_nothing_within_reach_is_refused(setup):
    dataset = unreachable(of_targets(setup.dataset))
    refused("no contact is reached: no joint angles", lambda: candidates(continued(dataset), 50, seed=0))


KINDS = {
    "seat": Target("seat", "fixed-point", {"centre": np.array([0.45, 0.1, 0.1])}),
    "bar": Target("bar", "distance", {"centre": np.array([0.45, -0.1, -0.1]), "length": 0.3}),
    "wire": Target("wire", "distance", {"centre": np.array([0.45, -0.1, -0.1]), "length": np.nan}),
    "pin": Target(
        "pin",
        "cylinder",
        {"point": np.array([0.45, 0, 0]), "axis": np.array([0.0, 0, 1.0]), "diameter": 0.03},
    ),
    "tracker": Target(
        "tracker", "instrument", {"xyz": np.array([2.0, 0.3, 0.5]), "rpy": np.array([0.1, -0.2, 2.0])}
    ),
}


@pytest.mark.parametrize("name", KINDS)
def test_other_kinds_of_target(setup, name):
    """Rows satisfy the equation of their kind; what is not touched has no approach of its own."""
    pin = Patch(np.array([0.45, 0.0, 0.1]), np.array([0.15]))
    volume = Box(np.array([0.45, 0.0, 0.3]), np.array([0.3, 0.4, 0.3]))
    settings = PlanSettings(volume=volume, regions={"pin": pin} if name == "pin" else {})
    dataset = replace(of_targets(setup.dataset), targets=(KINDS[name],), plan=settings)
    dataset = replace(dataset, noise=replace(dataset.noise, point=1e-5))
    pool = candidates(continued(dataset), 40, seed=2)
    m, points = pool.session.measurements, Scene(pool.session).points
    assert len(m.ids) == 40
    assert misses(pool).max() < 1e-7
    touched = name in ("pin", "seat")
    assert (m.velocity is not None) == touched
    assert np.array_equal(pool.approach, m.readings) != touched
    turns = Scene(pool.session).flange
    assert np.linalg.norm(turns.std(axis=0)) > 0.3  # the orientation varies
    if name == "tracker":
        frame = rigid(rpy_matrix(KINDS[name].values["rpy"]), KINDS[name].values["xyz"])
        assert np.allclose(m.xyz @ frame[:3, :3].T + frame[:3, 3], points, atol=1e-8)
        assert np.all(np.abs(points - settings.volume.centre) <= 0.5 * settings.volume.size + 1e-7)
        assert np.ptp(points, axis=0).min() > 0.2
    if name == "wire":
        assert np.ptp(m.length) > 0.05
    if name == "pin":
        assert np.all(np.abs(points[:, 2] - 0.1) < 0.0751)


def test_rows_go_on_from_those_that_were_measured():
    """Columns are continued; ids do not meet; located spheres are not probed again."""
    dataset = read_dataset(EXAMPLE)
    m = dataset.measurements
    pool = candidates(continued(dataset), 40, seed=0)
    n, after = pool.measured, pool.session.measurements
    assert n == len(m.ids)
    assert len(pool.candidates) == 40
    assert not len(pool.validation)
    assert len(set(after.ids)) == len(after.ids)
    assert np.array_equal(after.readings[:n], m.readings)
    assert np.array_equal(after.velocity[:n], m.velocity)
    assert after.time[n:].min() >= m.time.max()
    assert np.isin(after.temperature[n:], m.temperature).all()
    assert np.array_equal(pool.approach[:n], m.readings)
    row = pool.candidates[:1]
    columns = (after.role, after.target, after.tool, after.readings, after.velocity)
    one = Possible(*(column[row] for column in columns), np.zeros(1), np.ones(1, int))
    again = session_of(pool.session, one, np.random.default_rng(0))
    assert len(set(again.measurements.ids)) == len(again.measurements.ids)


def test_compliances_of_the_robot_file_are_in_the_readings(setup):
    """The nominal arm of a calibrated robot file sags: readings make up for it, with the payload."""
    robot = replace(setup.dataset.robot, compliance=np.array([0, 1e-4, 2e-4, 1e-3, 1e-3, 1e-3]))
    dataset = replace(of_targets(setup.dataset, *FACES), robot=robot, plan=PlanSettings(payloads=(KG,)))
    pool = candidates(continued(dataset), 40, seed=0)
    assert misses(pool).max() < 1e-8
    rigid_arm = replace(pool.session, robot=replace(robot, compliance=None))
    assert np.abs(misses(replace(pool, session=rigid_arm))).max() > 1e-4


# --- Contacts that were never made: found whatever their share, and no measured contact is taken for one.

ROWS = 50


@pytest.fixture(scope="module")
def measured(cube):
    """A session, and the same with the readings of a plan, in the digits of plan.csv."""
    dataset = cube(seed=2, count=130).dataset
    at = on_planes(made_up_plan(dataset, count=ROWS, validation=0)).session.measurements.readings
    session = made_up_plan(dataset, count=ROWS, validation=10).session
    at = np.radians(np.round(np.degrees(at), 7))
    return session, np.concatenate([at, session.measurements.readings[ROWS:]])


def mixed(measured, rows):
    session, plan = measured
    readings = session.measurements.readings.copy()
    readings[rows] = plan[rows]
    return with_columns(session, readings=readings)


def test_a_single_contact_is_found(measured):
    for row in range(0, ROWS, 10):
        found = planned(mixed(measured, [row]))
        assert found is not None
        assert found.rows.tolist() == [row]
        assert found.chance < CHANCE


@pytest.mark.parametrize("count", [4, ROWS])
def test_and_so_are_many(measured, count):
    rows = np.sort(np.random.default_rng(0).choice(ROWS, count, replace=False))
    assert planned(mixed(measured, rows)).rows.tolist() == rows.tolist()


def test_fewer_digits_need_more_contacts(measured):
    """As a controller logs the poses of a program, in 1e-5 deg: one can be chance, six cannot."""
    session, plan = measured
    coarse = (session, np.radians(np.round(np.degrees(plan), 5)))
    assert set(planned(mixed(coarse, np.arange(6))).rows) == set(range(6))


@pytest.mark.parametrize("spread", [1e-3, 1e-5])
def test_measured_contacts_are_not(measured, spread):
    """Contacts that are off by chance: of an arm with errors of 0.5 mm, of one as good as its noise."""
    session, plan = measured
    rng = np.random.default_rng(3)
    false = 0
    for _ in range(150):
        m = replace(session.measurements, readings=plan + spread * rng.standard_normal(plan.shape))
        false += planned(replace(session, measurements=m)) is not None
    assert false <= 1  # 0.15 expected


def test_fewer_than_three_are_a_warning_with_their_chance(measured):
    """Among many sessions, two contacts are within nanometres of nominal in one of them."""
    dataset = mixed(measured, [17, 30])
    result = bc.fit(dataset, model="joint", samples=0)
    assert not result.record["verdict"]["words"].startswith("no calibration")
    (said,) = [w for w in result.record["warnings"] if "readings of a plan" in w]
    assert "perhaps not made (chance of such measured contacts" in said
    assert "not made: " not in str(result)
    assert "within 20 nm" in replace(planned(dataset), error=2e-8).words(dataset)


def test_check_and_fit_say_it(measured, tmp_path, output_of):
    dataset = mixed(measured, [17, 30, 40])
    write_dataset(dataset, tmp_path / "cell")
    said = output_of("check", tmp_path / "cell", "--json")
    (found,) = [f for f in json.loads(said)["findings"] if f["code"] == "planned_pose"]
    name = dataset.measurements.ids[17]
    assert f"3 contacts have the readings of a plan ({name}, " in found["what"]
    assert found["where"].startswith("measurements.csv:19")
    result = bc.fit(tmp_path / "cell", model="joint", samples=0)
    verdict = result.record["verdict"]
    assert verdict["words"].startswith("no calibration")
    assert not verdict["explains"]
    assert verdict["reasons"][0]["test"] == "planned_poses"
    assert name in str(result)
    assert "not valid" in str(result)


# --- Slopes of distances against differences: spheres located anew, and TCP positions moved.


def centres(found, names, z) -> dict[str, np.ndarray]:
    """Centres of spheres located anew for an arm z."""
    scene = found.model.scene
    index = {t.name: k for k, t in enumerate(scene.dataset.targets)}
    at = replace(found.estimate, z=z)
    rows = scene.rows("validate")
    blocks = (at.model.block(index[n], scene.rows_of(index[n], rows)) for n in names)
    return {b.target: located_target(at, as_certified(scene, b)).centre for b in blocks}


def test_certified_distances_follow_from_the_contacts_on_the_spheres():
    # with noise of 1 mm no contact is an outlier of an arm with errors
    d = replace(pool().session, noise=Noise(contact=1e-3))
    found = linearised(pool_of(d), MODEL)
    names = [t.name for t in d.targets if t.kind == "sphere"]
    goal = certified(found)
    assert goal.slopes.shape == (3, found.model.size)
    pairs = [c.targets for c in d.certificates if c.kind == "distance"]

    def lengths(z: np.ndarray) -> np.ndarray:
        at = centres(found, names, z)
        return np.array([np.linalg.norm(at[a] - at[b]) for a, b in pairs])

    rng = np.random.default_rng(0)
    for _ in range(3):
        z = np.zeros(found.model.size)
        z[found.model.slices[ARM]] = 0.01 * rng.standard_normal(len(found.model.parameters))
        moved = lengths(found.z + z) - lengths(found.z)
        assert goal.slopes @ z == pytest.approx(moved, rel=0.02, abs=0.02 * np.max(np.abs(moved)))
    goal = certified(linear())
    assert np.all(goal.certificate == 1e-12)
    # 11 contacts of 5 µm on a sphere: some 2 to 4 µm a coordinate, of two centres
    assert np.all((np.sqrt(goal.probing) > 2e-6) & (np.sqrt(goal.probing) < 8e-6))
    # contacts of either end count, and no others
    d, name = pool().session, pairs[0][1]
    assert [pair.index(name) for pair in pairs if name in pair] == [1, 0]
    of_target = d.measurements.target == [t.name for t in d.targets].index(name)
    coarse = with_columns(d, u=np.where(of_target, 50e-6, 5e-6))
    ratio = certified(linearised(pool_of(coarse), MODEL)).probing / goal.probing
    assert np.all(np.where([name in pair for pair in pairs], ratio > 20, np.isclose(ratio, 1.0)))


def test_distances_of_the_region_follow_from_the_tool_points():
    found = linear()
    goal = goals(pool(), found)[1]
    assert goal.over == REGION
    rows = pool().candidates[np.linspace(0, 599, 40).astype(int)]
    model = _with_readings(found.model, pool().session.measurements.readings[rows])
    motion = model.motion(len(model.scene.q) - 40 + np.arange(40))
    z = 0.01 * np.random.default_rng(0).standard_normal(len(model.parameters))
    here = found.z[found.model.slices[ARM]]
    a, b = (motion.points(model.deviations(w)) for w in (here, here + z))
    assert len(goal.slopes) > 600
    pairs = np.stack(np.triu_indices(40, 1), axis=1)
    before, after = (np.linalg.norm(p[:, pairs[:, 0]] - p[:, pairs[:, 1]], axis=0) for p in (a, b))
    moved = (after - before)[before > 0.2 * before.max()]
    assert np.allclose(goal.slopes[:, found.model.slices[ARM]] @ z, moved, atol=0.01 * np.abs(moved).max())


def test_goals_of_a_pool():
    d = pool().session
    m = d.measurements
    loaded = with_columns(d, payload=np.full(len(m.ids), 2.0), velocity=np.full(m.readings.shape, 0.1))
    rows = _with_readings(linearised(pool_of(loaded), MODEL).model, m.readings[:5]).scene.dataset.measurements
    assert not rows.payload[-5:].any()
    assert not rows.velocity[-5:].any()
    # fitted spheres are no goal where the fit uses the distance
    fitted = with_columns(d, role=np.full(len(m.role), "calibrate"))
    found = linearised(pool_of(fitted), MODEL)
    assert certified(found) is None
    assert [g.over for g in goals(pool_of(fitted), found)] == [REGION]
    # a certificate of uncertain value counts
    wide = tuple(replace(c, u_distance=1e-5) if c.kind == "distance" else c for c in d.certificates)
    goal = certified(linearised(pool_of(replace(d, certificates=wide)), MODEL))
    assert np.sqrt(goal.fixed_variance) > 1e-5


def test_mixed_ends_and_certificates_without_rows():
    d = pool().session
    m = d.measurements
    first = next(k for k, t in enumerate(d.targets) if t.kind == "sphere")
    found = linearised(pool_of(with_columns(d, role=np.where(m.target == first, "calibrate", m.role))), MODEL)
    goal = certified(found)
    assert len(goal.slopes) == 3
    own = found.model.slices[d.targets[first].name]
    assert np.sum(np.any(goal.slopes[:, own] != 0, axis=1)) == 2
    bare = with_columns(d, role=np.where(m.role == "validate", "locate", m.role))
    assert certified(linearised(pool_of(bare), MODEL)) is None  # spheres are located by their validation data


def test_volume_of_interest():
    p = pool()
    box = Box(np.array([0.45, 0.0, 0.45]), np.array([0.2, 0.3, 0.2]))
    inside = replace(p, setup=replace(p.setup, volume=box))
    goal = goals(inside, linear())[1]
    assert goal.over == VOLUME
    assert len(goal.slopes) > 400
    assert goal.note == ""
    assert goals(inside, linear())[1].slopes == pytest.approx(goal.slopes)
    edge = Box(np.array([0.9, 0.0, 0.4]), np.array([0.5, 0.5, 0.5]))
    assert "% of the volume" in goals(replace(p, setup=replace(p.setup, volume=edge)), linear())[1].note
    away = replace(p, setup=replace(p.setup, volume=Box(np.array([5.0, 0, 0]), box.size)))
    refused("out of reach", lambda: goals(away, linear()))


def test_given_poses():
    p, readings = pool(), pool().session.measurements.readings
    found = goals(replace(p, setup=replace(p.setup, poses=readings[[0, 200, 400]])), linear())
    assert [g.over for g in found] == [CERTIFIED, REGION, POSES]
    assert len(found[2].slopes) == 3
    with pytest.raises(BayescalError, match="two positions"):
        goals(replace(p, setup=replace(p.setup, poses=readings[[0, 0]])), linear())
