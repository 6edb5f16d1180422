"""Candidate contacts: they touch, are within limits, cone and reach of the tool, on all faces, and free."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import Box, Dataset, Patch, PlanSettings, Target, read_dataset
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene
from bayescal.planning.candidates import candidates, session_of
from bayescal.planning.place import scene
from bayescal.planning.pool import Pool, Setup
from bayescal.planning.search import EACH, TILT
from bayescal.planning.setup import LOWEST, continued, read_setup
from bayescal.probing.approach import FASTEST
from bayescal.probing.clearance import RETRACT, Clearance
from bayescal.probing.reach import Arm

EXAMPLE = Path(__file__).parents[2] / "data" / "lrmate200ic-cube"
KG = 2.0


def small(dataset: Dataset, *names: str) -> Dataset:
    """A session with some of its targets, without rows."""
    targets = tuple(t for t in dataset.targets if t.name in names)
    certificates = tuple(c for c in dataset.certificates if {*c.targets} <= {*names})
    return replace(dataset, targets=targets, certificates=certificates)


FACES = ("cube.+y", "cube.-y", "cube.-x", "cube.+z")
SPHERES = ("ball.A@1", "ball.B@1", "ball.C@1")


@pytest.fixture(scope="module")
def setup() -> Setup:
    dataset = small(read_setup(EXAMPLE).dataset, *FACES, *SPHERES)
    return continued(replace(dataset, plan=PlanSettings(payloads=(KG,))))


@pytest.fixture(scope="module")
def pool(setup) -> Pool:
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


def test_contacts_touch_their_targets(pool):
    assert misses(pool).max() < 1e-8


def test_all_faces_have_equally_many(pool):
    m, names = pool.session.measurements, [t.name for t in pool.session.targets]
    counts = Counter(names[t] for t in m.target[pool.candidates])
    assert counts == dict.fromkeys(FACES, 100)
    counts = Counter(names[t] for t in m.target[pool.validation])
    assert counts == dict.fromkeys(SPHERES, EACH)


def test_contacts_are_all_over_a_face(pool, setup):
    """Each quarter of every face has some; none is outside."""
    scene_, m = Scene(pool.session), pool.session.measurements
    for name in FACES:
        k = [t.name for t in setup.dataset.targets].index(name)
        rows, region = np.flatnonzero(m.target == k), setup.regions[name]
        place = (scene_.points[rows] - region.centre) @ region.half.T / np.sum(region.half**2, axis=1)
        assert np.abs(place).max() <= 1 + 1e-6
        quarters = Counter(map(tuple, place > 0))
        assert len(quarters) == 4
        assert min(quarters.values()) >= 10


def test_limits_are_kept_with_a_margin(pool):
    arm = Arm(pool.session.robot, pool.session.tools[0].centre)
    for readings in (pool.session.measurements.readings, pool.approach):
        angles = arm.angles_of(readings)
        assert np.all((angles >= arm.range[0] - 1e-9) & (angles <= arm.range[1] + 1e-9))
    margin = np.minimum(arm.range[0] - pool.session.robot.limits[:, 0], 1)
    assert np.all(margin >= np.radians(3.9))


def test_the_tool_is_within_its_cone(pool, setup):
    flange = Scene(pool.session).flange
    cosine = np.sum(flange[:, :, 2] * -normals(pool), axis=1)
    assert cosine.min() > np.cos(setup.cone) - 1e-6
    assert cosine.min() < np.cos(0.8 * setup.cone)  # and directions vary over it
    narrow = replace(setup, cone=np.radians(20.0))
    own = candidates(replace(narrow, dataset=small(setup.dataset, *FACES)), 60, seed=1)
    cosine = np.sum(Scene(own.session).flange[:, :, 2] * -normals(own), axis=1)
    assert cosine.min() > np.cos(narrow.cone) - 1e-6


def test_the_approach_is_straight_along_the_normal(pool):
    arm = NominalArm(pool.session.robot, pool.session.tools[0].centre)
    begin = arm.ball(arm.frames(pool.approach))
    off = begin - Scene(pool.session).points
    assert np.allclose(off, RETRACT * normals(pool), atol=1e-7)
    half = 0.5 * (pool.approach + pool.session.measurements.readings)
    middle = arm.ball(arm.frames(half)) - Scene(pool.session).points
    assert np.linalg.norm(middle - 0.5 * off, axis=1).max() < 0.1 * RETRACT  # joints move evenly


def test_velocities_are_those_of_the_approach_and_joints_come_from_both_sides(pool):
    m = pool.session.measurements
    way = m.readings - pool.approach
    assert np.allclose(np.sign(way), np.sign(m.velocity))
    assert np.abs(m.velocity).max() <= FASTEST + 1e-9
    share = (m.velocity[pool.candidates] > 0).mean(axis=0)
    assert np.all((share > 0.1) & (share < 0.9)), share


def test_nothing_collides_at_contact_and_approach(pool, setup):
    """The distances of all pairs; 20 mm off nothing is near, the ball included."""
    around, m = scene(setup), pool.session.measurements
    clearance = Clearance.of(setup.dataset.robot, setup.dataset.tools[0], around.solids)
    touched = around.touched([setup.dataset.targets[t].name for t in m.target])
    assert clearance.distances(m.readings, touched).min() > -1e-6
    assert clearance.distances(pool.approach, touched).min() > -1e-6
    away = clearance.distances(pool.approach, np.full(len(touched), -1))
    assert away.min() > -1e-6  # 20 mm off nothing touches, the ball included


def test_half_of_the_candidates_carry_the_payload(pool):
    payload = pool.session.measurements.payload
    assert set(payload) == {0.0, KG}
    assert 0.4 < np.mean(payload[pool.candidates] > 0) < 0.6
    assert np.all(payload[pool.validation] == 0)


def test_several_branches_of_the_arm_are_found(pool):
    """The wrist of the arm reaches most contacts with J5 of either sign."""
    arm = NominalArm(pool.session.robot, pool.session.tools[0].centre)
    wrist = arm.angles_of(pool.session.measurements.readings)[pool.candidates, 4]
    assert 0.2 < np.mean(wrist > 0) < 0.8


def test_a_sphere_is_located_in_one_configuration(pool, setup):
    """The wrist does not flip, and the tool leaves one direction only as far as its cone makes it."""
    m, flange = pool.session.measurements, Scene(pool.session).flange
    arm = NominalArm(pool.session.robot, pool.session.tools[0].centre)
    most = 2 * (LOWEST - 0.98 * setup.cone + TILT)
    for t in np.unique(m.target[pool.validation]):
        rows = pool.validation[m.target[pool.validation] == t]
        wrist = arm.angles_of(m.readings[rows])[:, 4]
        assert np.all(wrist > 0) or np.all(wrist < 0)
        assert np.ptp(m.readings[rows, :3], axis=0).max() < np.radians(90)
        axes = flange[rows, :, 2]
        assert np.arccos(np.clip(axes @ axes.T, -1, 1)).max() < most


def test_the_seed_decides(setup):
    own = continued(small(setup.dataset, "cube.+z", "cube.+y", "cube.-y", "cube.-x", "ball.B@1"))
    first, again, other = (candidates(own, 40, seed=s) for s in (3, 3, 4))
    readings = [p.session.measurements.readings for p in (first, again, other)]
    assert np.array_equal(readings[0], readings[1])
    assert first.dropped == again.dropped
    assert readings[0].shape != readings[2].shape or not np.allclose(readings[0], readings[2])


def test_times_are_not_along_anything(pool):
    m = pool.session.measurements
    own = m.time[pool.candidates]
    assert np.all(np.diff(np.sort(m.time)) > 0)
    for column in (*m.readings[pool.candidates].T, m.target[pool.candidates], m.payload[pool.candidates]):
        assert abs(np.corrcoef(own, column)[0, 1]) < 0.2


def test_what_is_dropped_is_counted(pool):
    assert sum(pool.dropped.values()) > len(pool.candidates)
    assert any(reason.startswith("collision with cube") for reason in pool.dropped)
    assert not pool.warnings


def unreachable(dataset: Dataset) -> Dataset:
    """With a further face 3 m away."""
    far = Target("far", "plane", {"normal": np.array([-1.0, 0, 0]), "offset": -3.0})
    patch = Patch(np.array([3.0, 0.0, 0.2]), np.array([0.2, 0.2]))
    settings = PlanSettings(regions={"far": patch})
    return replace(dataset, targets=(*dataset.targets, far), plan=settings)


def test_a_target_out_of_reach_is_reported_and_the_others_have_its_share(setup):
    dataset = unreachable(small(setup.dataset, "cube.+z", "cube.+y", "cube.-y", "cube.-x"))
    pool = candidates(continued(dataset), 100, seed=0)
    names = [t.name for t in dataset.targets]
    counts = Counter(names[t] for t in pool.session.measurements.target)
    assert counts == dict.fromkeys(FACES, 25)
    assert len(pool.warnings) == 1
    assert pool.warnings[0].startswith(
        "no possible contacts on far: no joint angles within the limits (100%)"
    )


def test_nothing_within_reach_is_refused(setup):
    dataset = unreachable(small(setup.dataset))
    with pytest.raises(BayescalError, match="no contact is reached: no joint angles"):
        candidates(continued(dataset), 50, seed=0)


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
    settings = PlanSettings(
        volume=Box(np.array([0.45, 0.0, 0.3]), np.array([0.3, 0.4, 0.3])),
        regions={"pin": pin} if name == "pin" else {},
    )
    dataset = replace(small(setup.dataset), targets=(KINDS[name],), plan=settings)
    dataset = replace(dataset, noise=replace(dataset.noise, point=1e-5))
    pool = candidates(continued(dataset), 60, seed=2)
    m, points = pool.session.measurements, Scene(pool.session).points
    assert len(m.ids) == 60
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
    again = session_of(pool.session, _one(pool), np.random.default_rng(0))
    assert len(set(again.measurements.ids)) == len(again.measurements.ids)


def _one(pool):
    from bayescal.planning.candidates import Possible

    m, row = pool.session.measurements, pool.candidates[:1]
    return Possible(m.role[row], m.target[row], m.tool[row], m.readings[row], m.velocity[row], np.zeros(1))


def test_compliances_of_the_robot_file_are_in_the_readings(setup):
    """The nominal arm of a calibrated robot file sags: readings make up for it, with the payload."""
    robot = replace(setup.dataset.robot, compliance=np.array([0, 1e-4, 2e-4, 1e-3, 1e-3, 1e-3]))
    dataset = replace(small(setup.dataset, *FACES), robot=robot, plan=PlanSettings(payloads=(KG,)))
    pool = candidates(continued(dataset), 40, seed=0)
    assert misses(pool).max() < 1e-8
    rigid_arm = replace(pool.session, robot=replace(robot, compliance=None))
    assert np.abs(misses(replace(pool, session=rigid_arm))).max() > 1e-4
