"""Plain cases, brute force, contacts that must not count, and the way to them."""

from dataclasses import replace

import numpy as np
import pytest
from cases import EXAMPLE, file_text, refused
from rails import rail_session
from segments import distances

from bayescal.arm.motion import NominalArm
from bayescal.arm.shapes import FIXED, Box, Capsule, HalfSpace, ball
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import Tool, read_dataset
from bayescal.probing.bodies import PASSING, arm_capsules, link_radii
from bayescal.probing.clearance import Clearance, path_free, retracted
from bayescal.probing.motions import CLEAR
from bayescal.probing.scene import Scene, Solid, on_table, scene_of
from bayescal.probing.sweep import Pair, signed_distances
from bayescal.robots import builtin_robots, load_robot, robot_to_yaml

TOOL = Tool("ball", np.array([0.06, 0.0, 0.12]), 0.003)
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def session():
    dataset = read_dataset(EXAMPLE)
    scene = scene_of(dataset)
    rows = dataset.measurements
    return dataset, scene, rows.readings, scene.touched([dataset.targets[i].name for i in rows.target])


def mate(*solids: Solid) -> Clearance:
    return Clearance.of(load_robot("fanuc-lrmate200ic")[0], TOOL, solids)


def cube(x: float, y: float, z: float) -> Solid:
    return Solid("cube", (Box(rigid(None, np.array([x, y, z])), np.full(3, 0.1143)),))


def why(clearance: Clearance, readings, touched=None) -> str:
    hit = clearance.collides(np.radians(np.atleast_2d(readings)), touched)
    return words(clearance, int(hit[0]))


def words(clearance: Clearance, hit: int) -> str:
    """What collides, by an answer of the check."""
    if not hit:
        return ""
    pair = clearance.pairs[hit - 1]
    other = clearance.solids[pair.solid] if pair.solid >= 0 else clearance.capsules[pair.other]
    return f"{clearance.capsules[pair.capsule].name} and {other.name}"


# stretched out along x: elbow at (75, 0, 300), wrist at (395, 0, 375), flange at (475, 0, 375) mm
ZERO = np.zeros(6)


def test_plain_hits_and_misses():
    assert why(mate(), ZERO) == ""
    assert why(mate(cube(0.4, 0, 0.375)), ZERO).endswith("and cube")
    assert why(mate(cube(0.4, 0.5, 0.375)), ZERO) == ""
    assert why(mate(cube(0.075, 0.1143 + 0.05, 0.25)), ZERO) == "link 2 and cube"  # nearer than its radius
    assert why(mate(cube(0.075, 0.1143 + 0.08, 0.0)), ZERO) == ""
    solid = Solid("ball", (ball(np.array([0.3, 0.06, 0.375]), 0.0254),))
    assert why(mate(solid), ZERO) == "link 3 and ball"


def test_an_arm_that_folds_onto_itself():
    ur5 = Clearance.of(load_robot("universal-robots-ur5")[0], TOOL)
    assert why(ur5, [0, -90, 90, -90, -90, 0]) == ""
    folded = why(ur5, [0, -90, 172, 0, 0, 0])
    assert "link 2" in folded or "base" in folded
    assert why(ur5, [0, -90, 90, -90, 180, 0]) == ""  # the flange beside the first wrist, 95 mm between axes


def test_below_the_table():
    standing = on_table((cube(0.45, 0, 0.15),), UP)
    assert standing[-1].shapes[0].offset == pytest.approx(0.15 - 0.1143)
    alone = mate(standing[-1])
    assert why(alone, ZERO) == ""  # the shoulder is always lower than it
    for lean in ([0, 90, 0, 0, 0, 0], [0, 60, -60, 0, 0, 0]):
        assert why(alone, lean).endswith("and table")


def test_a_box_above_the_table_stands_on_a_pedestal():
    box, below = on_table((cube(0.45, 0, 0.15),), UP, height=-0.1)[0].shapes
    assert np.allclose(below.pose[:3, 3], [0.45, 0, 0.5 * (0.15 - 0.1143 - 0.1)])
    assert np.allclose(below.half, [0.1143, 0.1143, 0.5 * (0.15 - 0.1143 + 0.1)])
    assert below.lowest(UP) == pytest.approx(-0.1)
    assert len(on_table((cube(0.45, 0, 0.15),), UP)[0].shapes) == 1
    assert np.array_equal(box.half, np.full(3, 0.1143))


def test_the_contact_itself_is_no_collision(session):
    """Not by the ball and the end of the stylus, also 1 mm deep; a stylus from behind and the body are."""
    arm = mate().arm
    reading = np.radians([[0.0, 20, -40, 0, 30, 0]])
    frame = arm.frames(reading)
    ball, along = arm.ball(frame)[0], frame[0, -1, :3, :3] @ TOOL.centre / np.linalg.norm(TOOL.centre)
    for side, deep, hit in ((1, 0.0, ""), (1, 1e-3, ""), (-1, 0.0, "and wall"), (1, 0.015, "stylus")):
        centre = ball + side * (0.05 + 0.003 - deep) * along
        turn = np.linalg.qr(np.stack([along, UP, [0, 1, 0]], axis=1))[0]
        wall = Solid("wall", (Box(rigid(turn, centre), np.full(3, 0.05)),))
        assert hit in why(mate(wall), np.degrees(reading), np.array([0]))
        assert bool(why(mate(wall), np.degrees(reading), np.array([0]))) == bool(hit)
        # but of a target that is not touched they are
        assert why(mate(wall), np.degrees(reading)) or not deep


def test_every_answer_agrees_with_points_on_the_capsules(session):
    dataset, scene, readings, touched = session
    rng = np.random.default_rng(5)
    rows = rng.integers(0, len(readings), 150)
    clearance = Clearance.of(dataset.robot, dataset.tools[0], scene.solids)
    moved = readings[rows] + rng.normal(0, 0.1, (150, 6))
    hit, far = clearance.collides(moved, touched[rows]), clearance.distances(moved, touched[rows])
    frames, part = clearance.arm.frames(moved), np.linspace(0, 1, 301)[:, None]

    def along(capsule):
        pose, line = frames[:, capsule.frame], capsule.a + part * (capsule.b - capsule.a)
        return pose[:, None, :3, 3] + line @ np.swapaxes(pose[:, :3, :3], 1, 2)

    near = np.full(150, np.inf)
    placement = [s.placement for s in scene.solids]
    for capsule in clearance.capsules:
        if capsule.frame <= 1:  # the shoulder: its distance from the table does not change
            continue
        points = along(capsule)
        for s, solid in enumerate(scene.solids):
            at = np.array([solid.placement in ("", placement[t]) for t in touched[rows]])
            for k, shape in enumerate(solid.shapes):
                own = at & ~((touched[rows] == s) & (k == 0) & capsule.probe)
                away = signed_distances(shape, points).min(axis=1) - capsule.radius
                near = np.where(own, np.minimum(near, away), near)
    for a, b in clearance.self_pairs:
        first, second = clearance.capsules[a], clearance.capsules[b]
        back = frames[:, second.frame]
        local = np.einsum("mki,mij->mkj", along(first) - back[:, None, :3, 3], back[:, :3, :3])
        near = np.minimum(near, signed_distances(second, local).min(axis=1) - first.radius)
    assert 20 < np.sum(hit > 0) < 130
    sure = np.abs(near) > 1e-3
    assert np.array_equal((hit > 0)[sure], (near < 0)[sure])
    assert np.array_equal(hit > 0, far < 0)
    assert far[near > 0] == pytest.approx(near[near > 0], abs=1e-3)


def test_spheres_of_another_placement_are_not_there(session):
    dataset, scene, readings, touched = session
    first = scene.of["ball.A@1"]
    clearance = Clearance.of(dataset.robot, dataset.tools[0], scene.solids)
    alone = clearance.among([replace(s, placement="") for s in scene.solids])
    rows = touched == first
    of_rows = readings[rows], touched[rows]
    assert np.all(alone.distances(*of_rows) <= clearance.distances(*of_rows))
    late = Solid("late", (ball(clearance.arm.ball(clearance.arm.frames(readings[:1]))[0], 0.1),), "2")
    assert clearance.among([late]).collides(readings[:1])[0] == 0
    assert clearance.among([replace(late, placement="")]).collides(readings[:1])[0] > 0


def test_the_scene_of_a_session(session):
    dataset, scene, _, _ = session
    block = scene.solids[scene.of["cube.+z"]]
    assert scene.of["cube.+y"] == scene.of["cube.-x"]
    assert np.allclose(block.shapes[0].pose[:3, 3], [0.45, 0, 0.15])
    assert np.allclose(block.shapes[0].half, 0.1143)
    assert [s.placement for s in scene.solids[:4]] == ["1", "1", "1", "2"]
    assert scene.solids[-1].name == "table"
    assert set(scene.of) == {t.name for t in dataset.targets}
    assert scene_of(replace(dataset, targets=dataset.targets[:1])) == Scene((), {})


def test_the_ball_is_retracted_along_the_normal(session):
    dataset, _, readings, _ = session
    rows = dataset.measurements
    of_face = rows.target < 4
    normals = np.array([dataset.targets[t].values["normal"] for t in rows.target[of_face]])
    arm, at = mate().arm, readings[of_face]
    start = arm.frames(at)
    for _ in range(4):
        at = retracted(arm, at, 0.005 * normals)
    end = arm.frames(at)
    assert np.linalg.norm(arm.ball(end) - arm.ball(start) - 0.02 * normals, axis=1).max() < 1e-3
    turned = np.einsum("mij,mij->m", start[:, -1, :3, :3], end[:, -1, :3, :3])
    assert np.percentile(np.degrees(np.arccos(np.clip((turned - 1) / 2, -1, 1))), 90) < 1.0


def test_a_lid_above_the_contact_blocks_the_way(monkeypatch):
    """Free at the contact, not on the way: and free with a shorter one. Limits are limits on the way too."""
    free = mate()
    arm, reading = free.arm, np.radians([[0.0, 20, -40, 0, 30, 0]])
    flange = arm.frames(reading)[0, -1, :3, 3]
    lid = Solid("lid", (Box(rigid(None, flange + np.array([0.02, 0, 0.09])), np.array([0.02, 0.05, 0.01])),))
    under = free.among([lid])
    gap = 0.04 - next(c.radius for c in free.capsules if c.name == "link 5") + 0.04  # to the lid, m
    assert under.collides(reading)[0] == 0
    normal = UP[None]
    assert path_free(free, reading, normal)[0] == 0
    monkeypatch.setattr("bayescal.probing.clearance.RETRACT", 1.2 * gap)
    assert words(under, path_free(under, reading, normal)[0]).endswith("and lid")
    monkeypatch.setattr("bayescal.probing.clearance.RETRACT", 0.8 * gap)
    assert path_free(under, reading, normal)[0] == 0
    angles = arm.angles_of(reading)[0]
    tight = np.stack([angles - 1e-3, angles + 1e-3], axis=1)
    stiff = replace(free, arm=replace(arm, robot=replace(arm.robot, limits=tight)))
    assert path_free(stiff, reading, normal)[0] == -1


def test_the_way_ends_at_the_limit_towards_which_a_joint_moves():
    """At the lower limit as at the upper one, and at no limit that the joint moves away from."""
    free, reading = mate(), np.radians([[0.0, 20, -40, 0, 30, 0]])
    arm = free.arm
    begin, end = (arm.angles_of(q)[0] for q in (reading, retracted(arm, reading, 0.02 * UP[None])))
    moved = np.flatnonzero(np.abs(end - begin) > 5e-3)
    assert {*np.sign(end - begin)[moved]} == {-1.0, 1.0}
    for joint in moved:
        for side, sign in enumerate((-1.0, 1.0)):
            limits = np.tile([-10.0, 10.0], (arm.robot.n, 1))
            limits[joint, side] = begin[joint] + sign * 1e-3
            near = replace(free, arm=replace(arm, robot=replace(arm.robot, limits=limits)))
            blocked = sign * (end - begin)[joint] > 0
            assert path_free(near, reading, UP[None])[0] == (-1 if blocked else 0)


# --- Distances of capsules by hand, and against those of many points of their axes.


def capsule(a, b, radius: float) -> Capsule:
    return Capsule(FIXED, np.array(a, float), np.array(b, float), radius)


def distance(first: Capsule, other) -> float:
    return float(distances(other, first.a[None], first.b[None])[0]) - first.radius


ROD = capsule([0, 0, 0], [1, 0, 0], 0.1)
CUBE = Box(rigid(None, np.array([0.5, 0.0, 2.0])), np.array([0.5, 0.5, 0.5]))
TURNED = Box(rigid(rpy_matrix(np.array([0, 0, np.pi / 4])), np.array([3.0, 0, 0])), np.array([1.0, 1.0, 1.0]))


@pytest.mark.parametrize(("first", "other", "expected"), [
    (ROD, capsule([0.5, -1, 0.7], [0.5, 1, 0.7], 0.2), 0.4),  # crossing segments
    (ROD, capsule([2, 1, 0], [2, 3, 0], 0.2), np.sqrt(2) - 0.3),  # end to end
    (ROD, capsule([0.2, 0.5, 0], [0.8, 0.5, 0], 0.3), 0.1),  # parallel
    (ROD, capsule([0.2, 0.3, 0], [0.8, 0.3, 0], 0.3), -0.1),
    (ROD, CUBE, 1.4),  # along a face
    (capsule([2, 1, 0], [2, 1, 1], 0.1), CUBE, np.sqrt(1 + 0.25 + 0.25) - 0.1),  # end to corner
    (ROD, TURNED, 2 - np.sqrt(2) - 0.1),  # end to edge
    (ROD, ball(np.array([0.3, 0.4, 0]), 0.1), 0.2),
    (ROD, ball(np.array([1.3, 0.4, 0]), 0.1), 0.3),
    (capsule([0, 0, 0], [0, 0, 0], 0.1), ball(np.array([0.3, 0.4, 0]), 0.1), 0.3),  # a ball
    (capsule([0, 0, 0.3], [0, 1, 0.9], 0.1), HalfSpace(np.array([0, 0, 1.0]), 0.05), 0.15),
    (capsule([0, 0, -0.3], [0, 1, 0.9], 0.1), HalfSpace(np.array([0, 0, 1.0]), 0.05), -0.45),
])  # fmt: skip
def test_distances_by_hand(first, other, expected):
    assert distance(first, other) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("kind", ["box", "ball", "capsule", "half space"])
def test_distances_by_many_points(kind):
    rng = np.random.default_rng(3)
    part = np.linspace(0, 1, 2001)[:, None]
    for _ in range(60):
        a, b = rng.uniform(-1, 1, (2, 3))
        first = capsule(a, b, rng.uniform(0.02, 0.2))
        other = {
            "box": Box(
                rigid(rpy_matrix(rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3)), rng.uniform(0.1, 0.5, 3)
            ),
            "ball": ball(rng.uniform(-1, 1, 3), 0.2),
            "capsule": capsule(*rng.uniform(-1, 1, (2, 3)), 0.1),
            "half space": HalfSpace(rpy_matrix(rng.uniform(-3, 3, 3))[0], -0.5),
        }[kind]
        near = float(signed_distances(other, a + part * (b - a)).min()) - first.radius
        found = distance(first, other)
        if near > 0:  # a deep overlap has a distance of its own, to leave the other
            assert found == pytest.approx(near, abs=2e-6 + 2e-3 * np.linalg.norm(b - a) ** 2 / 8)
        assert (found < 0) == (near < 0) or abs(near) < 1e-4


# --- Capsules follow the arm: without gaps from base to ball, as wide as published ones, or as stated.

PROBE = Tool("ball", np.array([0.06, 0.0, 0.12]), 0.003)
STANDARD = file_text("robots/thick.yaml")


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

    here, radius, before = frames[:, 0, :3, 3], 0.1, "ground"
    for capsule in capsules[:-1]:
        gap = np.linalg.norm(world(capsule, capsule.a) - here, axis=1).max()
        shortened = "3" in before and capsule.name == "link 5"  # a forearm ends before the wrist
        most = 0.7 * (radius + capsule.radius) if shortened else 0.26 * radius
        assert gap <= most + PROBE.ball_radius + 0.02 * ("stylus" in capsule.name), capsule
        here, radius, before = world(capsule, capsule.b), capsule.radius, capsule.name
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
    refused("radius_mm", lambda: load_robot("robot.yaml", tmp_path))


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
    # a column below the base
    foot = arm_capsules(robot, PROBE, stand=0.33)[0]
    assert foot.frame == 0
    assert np.allclose(foot.a, [0, 0, -0.33])
    assert np.allclose(rigid(None, foot.b), np.eye(4))


def test_what_is_behind_a_link_or_a_solid_is_hidden():
    robot, _ = load_robot("fanuc-lrmate200ic")
    check = Clearance.of(robot, Tool("flange", np.zeros(3)))
    readings = np.zeros((1, 6))
    frames = check.arm.frames(readings)[0]
    elbow, wrist = frames[3, :3, 3], frames[6, :3, 3]
    middle, side = 0.5 * (elbow + wrist), np.array([0.0, 1.0, 0.0])
    assert abs((wrist - elbow) @ side) < 1e-9
    eye, behind = middle + 0.5 * side, middle - 0.5 * side
    beside = behind + np.array([0.0, 0.0, 1.2])
    assert check.hidden(readings, eye[None], behind[None, None])[0]
    assert not check.hidden(readings, eye[None], (eye + 0.1)[None, None])[0]
    assert not check.hidden(readings, eye[None], np.array([[beside]]))[0]
    # one of several points is enough; a solid hides as a link does
    assert check.hidden(readings, eye[None], np.array([[beside, behind]]))[0]
    wall = Solid("wall", (Box(rigid(None, 0.5 * (eye + beside)), np.full(3, 0.05)),))
    assert check.among([wall]).hidden(readings, eye[None], np.array([[beside]]))[0]


def test_an_arm_that_moves_on_a_rail():
    """The least distance on a motion of the carriage is that of many configurations, and never above it."""
    robot = rail_session().robot
    post = Solid("post", (Box(rigid(None, np.array([0.35, 1.07, 0.4])), np.array([0.05, 0.05, 0.4])),))
    clearance = Clearance.of(robot, TOOL, (post,))
    begin = robot.read(np.array([[0.0, 0, 30, -20, 0, 60, 0], [200, 60, 0, 10, 20, -30, 40]]))
    end = robot.read(np.array([[3000.0, 0, 30, -20, 0, 60, 0], [650, -60, 40, -20, 0, 60, 0]]))
    found = clearance.closest(begin, end, 1e-4)
    many = begin[:, None] + np.linspace(0, 1, 3001)[:, None] * (end - begin)[:, None]
    least = [clearance.distances(each).min() for each in many]
    assert least[0] < 0 < least[1]
    np.testing.assert_allclose(found, least, rtol=0.1)  # a tenth of the distance, from below
    assert np.all(found <= np.array(least) + 1e-9)
    assert list(clearance.hits(begin, end, 0.0) > 0) == [True, False]


def test_joints_that_may_be_off_take_no_more_than_they_move_the_arm():
    """More than the tolerance, so that no halving of the motion decides; on the line to a contact."""
    clearance = mate(cube(0.45, 0.0, 0.15))
    begin = np.radians([[23.0723509, 30.7131419, 13.3607223, 45.193579, -93.335965, 107.2603985]])
    end = np.radians([[23.82, 32.99, 14.87, 44.79, -95.68, 107.62]])
    slack = np.radians([[0.005, 0.078, 0.071, 0.017, 0.048, 0.046]])
    touched = np.zeros(1, int)
    sure, off = (clearance.closest(begin, end, 1e-3, touched, s) for s in (None, slack))
    assert 0.0 <= sure[0] - off[0] < 1.5 * slack.sum()  # m: no point is 1.5 m from an axis


@pytest.mark.parametrize("name", builtin_robots())
def test_links_at_a_constant_distance_are_not_compared_and_all_others_are(name):
    """A UR10 has a link 2 mm beside its base in every pose; a tool that may meet the forearm is compared."""
    clearance = Clearance.of(load_robot(name)[0], replace(TOOL, ball_radius=None))
    last, capsules = clearance.arm.robot.n, clearance.capsules
    for b, second in enumerate(capsules):
        for a, first in enumerate(capsules[:b]):
            away = clearance._anywhere(Pair(a, second, other=b))
            adjacent = min(second.frame, last) - min(first.frame, last) <= 1
            overlap_mostly = np.mean(away < 0) > 0.5
            varies = np.ptp(away) > 1e-6
            assert ((a, b) in clearance.self_pairs) == (varies and not adjacent and not overlap_mostly)


def test_a_ur10_can_keep_a_clearance_from_itself():
    clearance = Clearance.of(load_robot("universal-robots-ur10")[0], replace(TOOL, ball_radius=None))
    readings = clearance._sample
    assert np.mean(clearance.hits(readings, readings, CLEAR) == 0) > 0.3


@pytest.mark.parametrize("name", ["fanuc-m10ia", "unimation-puma560", "abb-irb1600-10-145"])
def test_a_tool_passes_a_forearm_whose_last_axes_meet(name):
    """With the wrist at a right angle a body on the flange is 10 mm away; the whole forearm overlaps it."""
    robot = load_robot(name)[0]
    tool = Tool("probe", np.array([0.0, 0.0, 0.12]), 0.003)
    capsules = arm_capsules(robot, tool)
    forearm = [c for c in capsules if c.name == "link 3"][-1]
    body = next(c for c in capsules if c.name == "tool probe")
    frames = NominalArm(robot, tool.centre).frames(np.zeros((1, 6)))[0]
    axis = frames[3, :3, :3] @ (forearm.b - forearm.a)
    wrist, flange = frames[4, :3, 3], frames[-1, :3, 3]
    across = np.cross(axis, [0.3, 0.5, 0.8])
    at_right_angle = wrist + np.linalg.norm(flange - wrist) * across / np.linalg.norm(across)
    end = frames[3, :3, :3] @ forearm.b + frames[3, :3, 3]
    away = np.linalg.norm(at_right_angle - end) - forearm.radius - body.radius
    assert away == pytest.approx(PASSING - body.radius)
    assert np.linalg.norm(flange - wrist) - forearm.radius < body.radius + CLEAR
    number = next(k for k, c in enumerate(capsules) if c is forearm)
    pairs = Clearance.of(robot, tool).pairs
    assert any(p.capsule == number and getattr(p.shape, "name", "") == body.name for p in pairs)
    # where its radius is stated, it is as wide up to the wrist
    thick = replace(robot, radii=np.full(robot.n, forearm.radius))
    whole = [c for c in arm_capsules(thick, tool) if c.name == "link 3"][-1]
    assert np.allclose(frames[3, :3, :3] @ whole.b + frames[3, :3, 3], wrist)
