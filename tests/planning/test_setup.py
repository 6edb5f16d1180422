"""Setups of a session: regions of targets, what validates, refusals."""

import re
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from cases import EXAMPLE, cases, refused
from segments import distances
from sessions import of_targets

from analysis.planning import ways as study
from analysis.planning.sampled import Cell, Table
from bayescal.arm.shapes import Box, Cylinder, Hull
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.dataset import Certificate, Patch, PlanSettings, Target, read_dataset, write_dataset
from bayescal.dataset.contacts import connected
from bayescal.dataset.read import read_settings
from bayescal.dataset.regions import Session, side
from bayescal.dataset.solids import hull_stl
from bayescal.dataset.target_kinds import KINDS
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene
from bayescal.planning import order as orders
from bayescal.planning.candidates import candidates
from bayescal.planning.order import Transits, _stations
from bayescal.planning.pool import CLEAR
from bayescal.planning.setup import EDGE, continued, read_setup, regions_of
from bayescal.probing.clearance import Clearance
from bayescal.probing.contacts import LINE
from bayescal.probing.motions import seconds_between
from bayescal.probing.scene import Solid, placements
from bayescal.probing.sweep import signed_distances

HALF = 0.1143  # m, of the cube's edge


@pytest.fixture(scope="module")
def example():
    return read_dataset(EXAMPLE)


def bare(dataset, **changes):
    """The session without rows."""
    setup = read_setup(EXAMPLE).dataset
    assert not setup.measurements.ids
    return replace(setup, **changes)


def test_regions_of_the_cube_are_its_faces():
    """A single face of an axis makes the cube as deep as its other edges: its centre is (450, 0, 150) mm."""
    setup = read_setup(EXAMPLE)
    for name, region in setup.regions.items():
        if not name.startswith("cube"):
            continue
        normal = np.asarray(next(t for t in setup.dataset.targets if t.name == name).values["normal"])
        assert np.allclose(region.centre, [0.45, 0, 0.15] + HALF * normal, atol=1e-9)
        assert np.allclose(region.half @ normal, 0)
        assert np.allclose(np.linalg.norm(region.half, axis=1), (1 - 2 * EDGE) * HALF, atol=1e-9)
        assert abs(region.half[0] @ region.half[1]) < 1e-12
    # rows of a setup are ignored with a note
    assert "745 rows" in setup.notes[0]
    assert "--after" in setup.notes[0]


def test_contacts_of_the_example_lie_in_their_regions(example):
    """An oracle of the inference: 680 contacts that were made without it."""
    points, m = Scene(example).points, example.measurements
    for k, target in enumerate(example.targets):
        if target.kind != "plane":
            continue
        region = continued(example).regions[target.name]
        away = points[m.target == k] - region.centre
        place = away @ region.half.T / np.sum(region.half**2, axis=1)
        assert np.abs(place).max() < 1.02  # the cube was out of place by some mm
        assert np.ptp(place, axis=0).min() > 1.5


def test_spheres_of_certified_distances_validate(example):
    assert continued(example).validated == read_setup(EXAMPLE).validated
    assert len(continued(example).validated) == 15


def test_of_spheres_alone_the_last_placements_validate(tmp_path, example):
    names = [f"ball.{ball}@{k}" for ball in "ABC" for k in range(1, 6)]
    dataset = of_targets(bare(example), *names)
    from bayescal.dataset.write import write_files

    write_files(dataset, tmp_path)
    (tmp_path / "measurements.csv").unlink()
    setup = read_setup(tmp_path)
    assert setup.validated == {"ball.A@5", "ball.B@5", "ball.C@5"}
    assert [note.partition(";")[0] for note in setup.notes] == ["no table is stated"]


def test_groups_that_pairs_connect():
    assert connected("abcde", [("d", "b"), ("b", "a")]) == [["d", "b", "a"], ["c"], ["e"]]


def test_a_face_without_an_extent_is_refused_and_can_be_stated(example):
    dataset = of_targets(bare(example), "cube.-x")
    refused(r"`cube.-x` can be probed is not known.*size_mm: \[width, h", lambda: regions_of(dataset))
    patch = Patch(np.array([0.3357, 0.02, 0.1]), np.array([0.2, 0.1]))
    region = regions_of(replace(dataset, plan=PlanSettings(regions={"cube.-x": patch})))["cube.-x"]
    assert np.allclose(region.centre, patch.centre)
    beside = replace(patch, centre=np.add(patch.centre, [0.01, 0.0, 0.0]))  # stated in front of the face
    dataset_of = replace(dataset, plan=PlanSettings(regions={"cube.-x": beside}))
    assert np.allclose(regions_of(dataset_of)["cube.-x"].centre, patch.centre)
    assert np.allclose(np.abs(region.half), [[0, 0.1, 0], [0, 0, 0.05]])  # width along y, height along z
    turned = replace(patch, along=np.array([0.0, 0.0, 1.0]))
    region = regions_of(replace(dataset, plan=PlanSettings(regions={"cube.-x": turned})))["cube.-x"]
    assert np.allclose(np.abs(region.half), [[0, 0, 0.1], [0, 0.05, 0]])


def test_a_probed_face_is_where_it_was_probed(example):
    """One face alone gives no box: its region is the rectangle of its contacts."""
    m, names = example.measurements, [t.name for t in example.targets]
    face = names.index("cube.-x")
    alone = tuple(
        t if t.kind != "plane" else replace(t, name=t.name.replace("cube", t.name)) for t in example.targets
    )
    region = regions_of(replace(example, targets=alone))[alone[face].name]
    points = Scene(example).points[m.target == face]
    assert np.allclose(region.centre[1:], 0.5 * (points.min(axis=0) + points.max(axis=0))[1:], atol=1e-6)
    assert np.allclose(np.abs(region.half).sum(axis=0)[1:], 0.5 * np.ptp(points, axis=0)[1:], atol=1e-6)
    assert abs(region.centre[0] - 0.3357) < 1e-9


def test_a_probed_side_of_a_cylinder_is_as_long_as_its_contacts():
    """Stated, it is as long as stated; the axis is turned in either case."""
    axis, point = rpy_matrix(np.array([0.3, -0.5, 0.2]))[2], np.array([0.4, 0.1, 0.2])
    target = Target("rod", "cylinder", {"axis": axis, "point": point, "diameter": 0.05})
    up, along = np.eye(3)[2], np.random.default_rng(0).uniform(-0.02, 0.07, 20)
    probed = point + along[:, None] * axis + 0.03 * np.cross(axis, up)
    patch = Patch(point + 0.01 * axis, np.array([0.08]))
    for session, ends in (
        (Session(up, probed=lambda: probed), [along.min(), along.max()]),
        (Session(up, patch), [-0.03, 0.05]),
    ):
        region = side(target, session)
        assert (region.centre + np.array([[-1.0], [1.0]]) * region.half - point) @ axis == pytest.approx(ends)


@pytest.mark.parametrize(("target", "centre"), [
    (Target("seat", "fixed-point", {"centre": np.array([0.4, 0, 0.1])}), [0.4, 0, 0.1]),
    (Target("bar", "distance", {"centre": np.array([0.4, 0, 0]), "length": 0.3}), [0.4, 0, 0]),
])  # fmt: skip
def test_seats_and_ball_bars_need_no_extent(example, target, centre):
    region = regions_of(bare(example, targets=(target,), certificates=()))[target.name]
    assert np.allclose(region.centre, centre)
    assert not len(region.half)
    assert np.allclose(region.up, [0, 0, 1])


def test_a_hanging_arm_probes_spheres_from_above(example):
    dataset = bare(example, gravity=np.array([0.0, 0.0, 9.81]))
    assert np.allclose(regions_of(dataset)["ball.A@1"].up, [0, 0, -1])


def test_a_kind_without_a_plan_is_refused(example, monkeypatch):
    monkeypatch.setitem(KINDS, "knob", replace(KINDS["fixed-point"], name="knob", planned=None))
    strange = Target("knob", "knob", {"centre": np.zeros(3)})
    with pytest.raises(BayescalError, match="contacts on a target of kind knob cannot be planned"):
        regions_of(bare(example, targets=(strange,), certificates=()))


def test_a_missing_noise_or_ball_is_refused(tmp_path):
    text = (EXAMPLE / "dataset.yaml").read_text()
    (tmp_path / "dataset.yaml").write_text(text.replace("contact_mm: 0.005", "point_mm: 0.005"))
    refused(r"no noise of a contact .*`noise: \{contact_mm", lambda: read_setup(tmp_path))
    (tmp_path / "dataset.yaml").write_text(text.replace("ball_radius_mm: 3, ", ""))
    refused("no tool has a ball", lambda: read_setup(tmp_path))
    refused("no such folder", lambda: read_setup(tmp_path / "nowhere"))
    refused("give the folder", lambda: read_setup(tmp_path / "dataset.yaml"))


def test_distances_of_planes_do_not_validate(example):
    """A certified distance of a sphere from a face is calibrated on."""
    off = Certificate("distance", ("ball.A@1", "cube.+z"), 0.1, 1e-6)
    dataset = replace(of_targets(bare(example), "ball.A@1", "cube.+z"), certificates=(off,))
    patch = Patch(np.array([0.45, 0, 0.2643]), np.array([0.1, 0.1]))
    dataset = replace(dataset, plan=PlanSettings(regions={"cube.+z": patch}))
    assert continued(dataset).validated == frozenset()


def heights(setup):
    return [s.shapes[0].offset for s in setup.scene.solids if s.carries]


def test_the_table_is_the_stated_one_or_below_all_targets(example):
    dataset = of_targets(bare(example), "cube.+y", "cube.-y", "cube.-x", "cube.+z")
    assumed = continued(dataset)
    assert heights(assumed) == [pytest.approx(0.15 - HALF)]
    assert "`plan: {table_mm: 36}`" in assumed.notes[0]
    stated = continued(replace(dataset, plan=PlanSettings(table=-0.33)))
    assert heights(stated) == [-0.33]
    below = np.array([[0.45, 0.0, -0.2]])  # the cube stands on a pedestal: no arm passes under it
    assert min(signed_distances(shape, below)[0] for shape in stated.scene.solids[0].shapes) < 0
    assert not stated.notes
    assert heights(continued(replace(dataset, gravity=np.zeros(3)))) == heights(assumed)


def test_what_is_probed_is_an_obstacle(example):
    """A face that is stated alone is a wall, a seat has a post; a contact is on the surface of its solid."""
    seat = Target("seat", "fixed-point", {"centre": np.array([0.4, 0.2, 0.1])})
    patch = Patch(np.array([0.3357, 0.02, 0.1]), np.array([0.2, 0.1]))
    dataset = of_targets(bare(example), "cube.-x", "ball.A@1")
    targets = (*dataset.targets, seat)
    setup = continued(replace(dataset, targets=targets, plan=PlanSettings(regions={"cube.-x": patch})))
    around = setup.scene
    assert set(around.of) == {"cube.-x", "ball.A@1", "seat"}
    assert {solid.placement for solid in around.solids} == {""}  # a single placement stays
    wall, region = around.solids[around.of["cube.-x"]].shapes[0], setup.regions["cube.-x"]
    corners = region.centre + np.array([[1, 1], [1, -1], [-1, 0.3]]) @ region.half
    assert np.allclose(signed_distances(wall, corners), 0, atol=1e-12)
    assert np.allclose(signed_distances(wall, corners - 0.02 * np.eye(3)[0]), 0.02)
    assert np.allclose(np.linalg.det(wall.pose[:3, :3]), 1)
    assert 0 < signed_distances(around.solids[around.of["seat"]].shapes[0], seat.values["centre"]) < 0.02


# --- Motions between contacts: collisions are seen, ways around them are free, and orders avoid them.

FINE = np.radians(0.2)


@pytest.fixture(scope="module")
def pool():
    dataset = read_setup(EXAMPLE).dataset
    targets = tuple(t for t in dataset.targets if t.kind == "plane")
    certificates = tuple(c for c in dataset.certificates if c.targets[0].startswith("cube"))
    return candidates(continued(replace(dataset, targets=targets, certificates=certificates)), 32, seed=5)


def open_to_all(begin, end):
    return np.zeros(len(begin), bool)


@pytest.fixture(scope="module")
def ordered(pool):
    """Rows in sweeps without and with regard to collisions, and the transits."""
    moves = Transits(pool)
    blind = orders.ordered(pool, pool.candidates, "sweeps", np.random.default_rng(0), open_to_all)
    seeing = orders.ordered(pool, pool.candidates, "sweeps", np.random.default_rng(0), moves.blocked)
    return moves, pool.candidates[blind], pool.candidates[seeing]


def depths(pool, points):
    """Smallest distance, m, of anything on straight motions through readings (P, n)."""
    setup = pool.setup
    clearance = Clearance.of(setup.dataset.robot, setup.dataset.tools[0], setup.scene.solids)
    out = []
    for a, b in pairwise(points):
        number = int(np.ceil(np.abs(b - a).max() / FINE)) + 1
        out.append(clearance.distances(a + np.linspace(0, 1, number)[:, None] * (b - a)).min())
    return np.array(out)


def test_collisions_between_contacts_are_seen(pool, ordered):
    """Against distances at many configurations on each motion."""
    moves, blind, _ = ordered
    blocked = moves.blocked(blind[:-1], blind[1:])
    depth = depths(pool, pool.approach[blind])
    assert 3 < blocked.sum() < len(blind) - 3
    assert np.all(depth[blocked] < CLEAR + 1e-3)
    assert depth[~blocked].min() > CLEAR


def test_orders_avoid_collisions(ordered):
    moves, blind, seeing = ordered
    before, after = (moves.blocked(rows[:-1], rows[1:]).sum() for rows in (blind, seeing))
    assert after < 0.9 * before


def test_ways_around_are_free(pool, ordered):
    moves, _, seeing = ordered
    ways = moves.ways(seeing)
    via = ways.via
    same = np.array([not text for text in ways.changes[1:]])
    blocked = moves.blocked(seeing[:-1], seeing[1:])
    assert [len(way) > 0 for way in via[1:]] == (blocked & same).tolist()
    assert [len(way) for way in ways.leave[:1]] == [1]
    both = (np.concatenate(parts) for parts in zip(ways.leave, via, strict=True))
    points = [p for before, row in zip(both, seeing, strict=True) for p in (*before, pool.approach[row])]
    found = depths(pool, np.array(points))
    assert found.min() > CLEAR
    assert ways.clearance.min() <= found.min() + 1e-6
    assert ways.clearance.min() > min(CLEAR, LINE)
    times = orders.travel(pool, seeing, via), orders.travel(pool, seeing)
    assert times[1] < times[0] < times[1] + 10.0 * blocked.sum()


def test_no_way_is_said(pool, ordered, monkeypatch):
    """An approach inside of the cube cannot be left."""
    monkeypatch.setattr("bayescal.planning.order.WAITING", 2)  # each is searched in vain
    monkeypatch.setattr("bayescal.probing.motions.CHAINED", ((100, 20),))
    inside = pool.approach.copy()
    row = int(pool.candidates[0])
    readings = pool.session.measurements.readings[row]
    inside[row] = readings - 2 * (inside[row] - readings)
    moves = Transits(replace(pool, approach=inside))
    other = int(pool.candidates[1])
    found = moves.ways(np.array([other, row, other]))
    first, *others = found.via
    assert first is not None  # a way, straight or not
    assert others == [None, None]
    assert [bool(words) for words in found.by_hand] == [False, True, True]
    assert orders.travel(moves.pool, np.array([other, row]), [first, None]) > 0


def test_placements_that_come_one_after_the_other_are_not_between_each_other():
    assert placements(["cube.+x", "ball.A@1", "ball.B@2"]) == ["", "1", "2"]
    assert placements(["cube.+x", "ball.A@1", "ball.B@1"]) == ["", "", ""]
    setup = read_setup(EXAMPLE)
    names = ("cube.+y", "cube.-y", "cube.-x", "cube.+z", "ball.B@1", "ball.B@3")
    dataset = replace(of_targets(setup.dataset, *names), certificates=())
    pool = candidates(replace(continued(dataset), validated=frozenset(names[4:])), 8, seed=0)
    m, moves = pool.session.measurements, Transits(pool)
    one, other = (np.flatnonzero(m.target == names.index(name))[0] for name in names[4:])
    hand = pool.setup.hands[0]
    there = {key: sum(bool(s.shapes) for s in hand.place(key).clearance.solids) for key in ("1", "")}
    assert there == {"1": 3, "": 2}  # cube, one sphere, table
    assert not moves.blocked(np.array([one]), np.array([other])).any()  # the artefact is moved between them
    ways = moves.ways(np.array([one, pool.candidates[0], other]))
    assert ways.changes == ("move the artefact to placement 1", "", "move the artefact to placement 3")
    assert [len(way) > 0 for way in ways.leave] == [True, False, True]


def test_times_between_readings():
    assert seconds_between(np.zeros(3), np.array([0.1, -np.pi / 4, 0])) == pytest.approx(1.0)


# --- Planned motions by a sampling of 0.05 degrees that shares no code with the check; own solids.

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def test_sampled_motions_are_as_free_as_stated(monkeypatch, quick_search):
    """Spheres that are moved on the way, by an arm on a rail; two probes would take twice the time."""
    monkeypatch.setattr(study, "CONTACTS", 5)
    monkeypatch.setattr(study, "CANDIDATES", 16)
    found = study.checked(13, True)
    assert found["motions"] > 9
    assert found["by_hand"] == 0
    assert found["nearest_mm"] > 1.9
    assert found["overstated_mm"] < 1e3 * study.ROUNDING


@pytest.mark.parametrize("rail", [False, True])
def test_bounds_hold_on_random_motions(rail):
    """Free by the bound: nothing nearer in the samples. Not free: something nearer than a little more."""
    setup = study.setup_of(0, rail)
    cell, solids = study.cell_of(setup, 0, "1"), setup.scene.solids
    there = [replace(s, placement="", shapes=s.shapes if s.placement in ("", "1") else ()) for s in solids]
    check = Clearance.of(setup.dataset.robot, setup.dataset.tools[0], there)
    rng = np.random.default_rng(1)
    limits = setup.dataset.robot.limits
    begin = check.arm.readings_of(rng.uniform(*(0.7 * limits.T), (400, len(limits))))
    begin = begin[check.distances(begin) > 0.005][:30]
    end = begin + rng.normal(0, 0.8, begin.shape)
    floor = 0.005
    free = check.hits(begin, end, floor) == 0
    bound = check.closest(begin, end, 1e-3)
    sampled = np.array([cell.motion(a, b) for a, b in zip(begin, end, strict=True)])
    assert 5 < free.sum() < len(free) - 5
    assert sampled[free].min() > floor - 1e-6
    assert sampled[~free].max() < floor + 1e-3
    near = sampled < 0.05  # the sampler does not look farther
    assert np.all(bound[near] <= sampled[near] + 1e-6)
    near &= sampled > (-0.04 if rail else -np.inf)  # an axis inside a box has no depth in the samples
    assert near.sum() > 10
    assert np.all(sampled[near] - bound[near] < np.maximum(1.2e-3, 0.12 * np.abs(sampled[near])))


def test_solids_by_their_points():
    """Cylinder and hull against points inside and on them; the hull of a box is the box."""
    rng = np.random.default_rng(0)
    turn = rpy_matrix(rng.uniform(-3, 3, 3))
    box = Box(rigid(turn, np.array([0.1, 0.2, 0.3])), np.array([0.2, 0.1, 0.05]))
    hull = Hull((CORNERS * box.half) @ turn.T + box.pose[:3, 3])
    a, b = rng.uniform(-1, 1, (2, 200, 3))
    far, near = distances(box, a, b), distances(hull, a, b)
    assert np.all(near <= far + 1e-6)
    assert np.all(near[far > 0] > 0.85 * far[far > 0] - 1e-6)
    assert np.array_equal(near < 0, far < 0)
    axis = turn[:, 2]
    rod = Cylinder(np.array([0.1, 0.2, 0.3]), axis, 0.3, 0.1)
    angle, high = rng.uniform(0, 2 * np.pi, 40_000), rng.uniform(-0.3, 0.3, 40_000)
    size = 0.1 * np.sqrt(rng.uniform(0, 1, 40_000))
    inside = rod.centre + np.stack([size * np.cos(angle), size * np.sin(angle), high], axis=1) @ turn.T
    assert signed_distances(rod, inside).max() < 1e-12
    for start in a[:20]:
        cloud = np.linalg.norm(inside - start, axis=1).min()
        assert distances(rod, start[None], start[None])[0] == pytest.approx(cloud, abs=0.02)
    assert rod.lowest(axis) == pytest.approx(rod.centre @ axis - 0.3)
    assert hull.lowest(axis) == pytest.approx(box.lowest(axis))


def stated(tmp_path, text):
    """The example's set-up with own solids."""
    lines = (EXAMPLE / "dataset.yaml").read_text().replace("temperature_of: arm\n", text)
    (tmp_path / "dataset.yaml").write_text(lines)
    return read_settings(tmp_path / "dataset.yaml")[0]


def test_own_solids_are_read_written_and_avoided(tmp_path):
    (tmp_path / "block.stl").write_bytes(hull_stl(0.05 * CORNERS))
    text = (
        "solids:\n"
        "  vice: {kind: box, centre_mm: [450, 200, -40], size_mm: [120, 80, 60], rpy_deg: [0, 0, 30]}\n"
        "  post: {kind: cylinder, centre_mm: [300, -350, 100], diameter_mm: 60, length_mm: 400}\n"
        '  block: {kind: mesh, file: block.stl, xyz_mm: [400, 0, 500], placement: "2"}\n'
    )
    dataset = stated(tmp_path, text)
    assert [s.kind for s in dataset.solids] == ["box", "cylinder", "mesh"]
    np.testing.assert_allclose(np.ptp(dataset.solids[2].points, axis=0), 0.1, atol=1e-9)
    write_dataset(replace(read_dataset(EXAMPLE), solids=dataset.solids), tmp_path / "copy")
    for one, other in zip(dataset.solids, read_dataset(tmp_path / "copy").solids, strict=True):
        np.testing.assert_allclose(one.pose, other.pose, atol=1e-9)
        np.testing.assert_allclose(one.size, other.size)
        assert (one.name, one.placement, one.file) == (other.name, other.placement, other.file)
    around = continued(replace(read_setup(EXAMPLE).dataset, solids=dataset.solids)).scene
    assert [s.placement for s in around.solids[-3:]] == ["", "", "2"]
    hit = Clearance.of(dataset.robot, dataset.tools[0], [replace(around.solids[-1], placement="")])
    arm = hit.arm
    inside = arm.readings_of(np.random.default_rng(0).uniform(*arm.robot.limits.T, (60_000, 6)))
    deep = np.linalg.norm(arm.ball(arm.frames(inside)) - [0.4, 0, 0.5], axis=1) < 0.05
    assert deep.any()
    assert np.all(hit.collides(inside[deep]) > 0)


@pytest.mark.parametrize(("entry", "words"), cases("solid_refusals"))
def test_solids_that_are_refused(entry, words, tmp_path):
    refused(re.escape(words), lambda: stated(tmp_path, f"solids:\n  a: {entry}\n"))


def test_the_sampler_sees_an_overlap():
    """A point arm of one joint that turns through a thin wall."""
    table = Table(np.array([[0.0, 0.0, 0.0, 0.0]]), "mdh", np.eye(1), np.eye(4), np.eye(4), np.array([False]))
    tip = np.array([1.0, 0, 0])
    wall = ("box", np.eye(3), np.array([0.7, 0.7, 0.0]), np.array([0.01, 0.01, 0.5]))
    cell = Cell(table, [(1, tip, tip, 0.05, False)], [], {(0, 0)}, [[wall]])
    assert cell.motion(np.array([0.0]), np.array([1.5])) < -0.03
    assert cell.motion(np.array([0.0]), np.array([0.6])) > 0.05
    solid = Solid("wall", (Box(rigid(None, wall[2]), wall[3]),))
    assert signed_distances(solid.shapes[0], tip) > 0.5


def test_what_a_person_does_before_a_row_is_said_at_each_change():
    """Also before the first: the arm begins without a payload."""
    measured = SimpleNamespace(tool=np.array([0, 0, 1, 1]), payload=np.array([2.0, 2.0, 0.0, 1.0]))
    tools = [SimpleNamespace(name=name) for name in ("long", "short")]
    transits = Transits(SimpleNamespace(session=SimpleNamespace(measurements=measured, tools=tools)))
    assert transits._changes(np.arange(4), np.array(["A", "A", "B", "B"])) == (
        "mount tool long; move the artefact to placement A; attach 2 kg to the tool",
        "",
        "mount tool short; move the artefact to placement B; remove the payload",
        "attach 1 kg to the tool",
    )


def test_the_tool_changes_only_where_it_has_to():
    """Two placements of the artefact, two tools: the second placement begins with the tool of the first."""
    m = SimpleNamespace(target=np.zeros(8, int), tool=np.tile([0, 1], 4))
    stations = _stations(m, np.repeat(["a", "b"], 4), np.arange(8))
    assert [m.tool[rows].tolist() for rows in stations] == [[0, 0], [1, 1], [1, 1], [0, 0]]
