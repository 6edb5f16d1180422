"""Impossible contacts, misplaced targets and unit mistakes; and honest data that must pass."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from cases import refused
from sessions import TOOL, _some, with_columns
from tiny_dataset import SETTINGS, TABLE, write

from bayescal.dataset import Target, plausibility, read_dataset
from bayescal.dataset.consistency import contradictions
from bayescal.dataset.plausibility import suspicion
from bayescal.dataset.table import Table
from bayescal.errors import BayescalError

RNG = np.random.default_rng(7)


def impossible(target, away, table):
    """What is said of 60 rows that are `away`, m, where 0.05 m are possible: nothing explains them."""
    rows = np.full(60, 0.05), np.arange(60)
    return plausibility._impossible(target, away, *rows, table, None, lambda *_: ("", False, ""))


def scaled(factor: float, rows: slice = slice(None), columns: slice = slice(4, 10)) -> str:
    """The table with some numbers, readings of the joints if not stated, times a factor."""
    lines = TABLE.splitlines()
    for i in range(1, len(lines))[rows]:
        cells = lines[i].split(",")
        cells[columns] = [f"{float(c) * factor:.9f}" for c in cells[columns]]
        lines[i] = ",".join(cells)
    return "\n".join(lines)


@pytest.mark.parametrize(("factor", "first", "words"), [
    (np.pi / 180, 1, r"measurements.csv:2: .*look like radians"), (180 / np.pi, 1, "converted twice"),
    (np.pi / 180, 15, "look like radians"),
], ids=["radians", "converted twice", "radians of an instrument alone"])  # fmt: skip
def test_another_unit_of_all_readings_is_told(tmp_path, factor, first, words):
    lines = scaled(factor).splitlines()
    refused(words, lambda: read_dataset(write(tmp_path, table="\n".join([lines[0], *lines[first:]]))))


@pytest.mark.parametrize(("old", "new", "words"), [
    ("[475, 272, -40]", "[0.475, 0.272, -0.04]", "`ball.A` .* look like m: write them in mm"),
    ("[475, 272, -40]", "[475000, 272000, -40000]", "`ball.A` .* look like µm"),
    ("[561, -40, -50]", "[861, -40, -50]", "`cone` are nominally 2.. mm or more off"),
    ("centre_mm: [60, 0, 120], u_mm: 1", "centre_mm: [60, 500, 120], u_mm: 1", "disagree with the arm"),
])  # fmt: skip
def test_misplaced(tmp_path, old, new, words):
    settings = SETTINGS.replace(old, new)
    assert settings != SETTINGS
    assert refused(words, lambda: read_dataset(write(tmp_path, settings))).where.startswith("dataset.yaml:")


def test_a_small_session_is_no_radians(tmp_path):
    """All readings within six degrees, on a target placed as well as its loose prior says."""
    q = RNG.uniform(-3, 3, (8, 6))
    rows = [f"r{i},face,ball," + ",".join(f"{x:.4f}" for x in row) for i, row in enumerate(q)]
    header = "id,target,tool," + ",".join(f"j{i}_deg" for i in range(1, 7))
    face = "targets:\n  face: {kind: plane, normal: [1, 0, 0], offset_mm: 640}\n"
    data = read_dataset(write(tmp_path, SETTINGS.split("targets:")[0] + face, "\n".join([header, *rows])))
    assert len(data.measurements.ids) == 8


def test_a_loose_plane_may_be_tilted_and_off(tmp_path):
    """Nominal normal 12 deg wrong and 80 mm off: what a plane known only roughly looks like."""
    tilt = np.deg2rad(12)
    normal = f"[0, {np.sin(tilt):.9f}, {np.cos(tilt):.9f}]"
    settings = SETTINGS.replace("normal: [0, 0, 1], offset_mm: -93.6", f"normal: {normal}, offset_mm: -170")
    settings = settings.replace("  - {kind: parallel", "  # - {kind: parallel")
    read_dataset(write(tmp_path, settings))
    bad = TABLE.replace("0.983,29.728,-39.851,", "0.983,29.728,20,")
    refused(r"measurements.csv:3: impossible contact", lambda: read_dataset(write(tmp_path, settings, bad)))


@pytest.mark.parametrize(("socket", "moved"), [("socket.1", True), ("socket.0", False)])
def test_contacts_of_another_target_are_told(tmp_path, socket, moved):
    """Two of seven contacts on a socket were made in the one beside it, or in none of both."""
    robot, rng = read_dataset(write(tmp_path)).robot, np.random.default_rng(3)
    places = np.array([[500.0, -60, 20], [500, 60, 20]])
    at = np.repeat([0, 1 if moved else 0, 1], [5, 2, 7])
    off = np.zeros((14, 3))
    off[5:7] = [0, 70, 120] if not moved else 0
    goals = 1e-3 * (places[at] + off + rng.uniform(-2, 2, (14, 3)))
    readings = [_some(robot, lambda count, goal=goal: np.tile(goal, (count, 1)), 1, rng)[0] for goal in goals]
    named = [f"socket.{k}" for k in np.repeat([0, 1], 7)]
    lines = ["id,target," + ",".join(f"j{k}_deg" for k in range(1, 7))]
    degrees = np.degrees(readings)
    lines += [f"c{k},{named[k]}," + ",".join(f"{x:.6f}" for x in degrees[k]) for k in range(14)]
    x, y, z = 1e3 * TOOL.centre
    targets = [f"  socket.{k}: {{kind: fixed-point, centre_mm: {p.tolist()}}}" for k, p in enumerate(places)]
    settings = ["schema: bayescal-dataset/1", "name: sockets", "robot: fanuc-lrmate200ic",
                "readings: encoder",
                "gravity_mps2: [0, 0, -9.81]", f"tools: {{ball: {{centre_mm: [{x}, {y}, {z}]}}}}",
                "noise: {contact_mm: 0.1}", "targets:", *targets]  # fmt: skip
    with pytest.raises(BayescalError) as caught:
        read_dataset(write(tmp_path, "\n".join(settings), "\n".join(lines)))
    assert str(caught.value).count("; 1 more row is too far off: lines ") == 1
    assert (f"they agree with the contacts on `{socket}`: correct their target" in str(caught.value)) == moved


@pytest.mark.parametrize(("columns", "rows", "factor", "words"), [
    (slice(10, 13), slice(-6, None), 1e-3, "`x_mm`, `y_mm`, `z_mm` look like m: .* hold mm"),
    (slice(5, 6), slice(None), np.pi / 180, "`j2_deg` look like radians: .* hold deg"),
], ids=["instrument", "joint"])  # fmt: skip
def test_another_unit_of_some_columns_is_told(tmp_path, columns, rows, factor, words):
    table = scaled(factor, rows, columns)
    refused(f"values of {words}", lambda: read_dataset(write(tmp_path, table=table)))


@pytest.mark.parametrize(
    ("u_rad", "words"), [(0.1, "most contacts of `top`"), (0.01, "all contacts of `top`")]
)
def test_a_plane_is_misplaced_by_the_u_of_its_angle_too(tmp_path, u_rad, words):
    """All its contacts 100 mm off, where its place has 1 mm and its angle an arm of 300 mm."""
    settings = SETTINGS.replace("offset_mm: -93.6", f"offset_mm: -193.6, u_mm: 1, u_rad: {u_rad}")
    settings = settings.replace("  - {kind: parallel", "  # - {kind: parallel")
    refused(words, lambda: read_dataset(write(tmp_path, settings)))


@pytest.mark.parametrize(("ball", "mirror", "off", "admitted"), [
    (1, 1, 80, False), (1, 30, 80, True), (30, 1, 80, False), (1, 30, 200, False), (1, 1, 30, True),
])  # fmt: skip
def test_a_reading_is_impossible_by_the_u_of_its_own_tool(tmp_path, ball, mirror, off, admitted):
    """Beyond five times the stated u of the tool of its row, 50 mm at least."""
    settings = SETTINGS.replace("u_mm: 1}", f"u_mm: {mirror}}}")
    settings = settings.replace("ball_radius_mm: 3.0,", f"ball_radius_mm: 3.0, u_mm: {ball},")
    folder = write(tmp_path, settings, TABLE.replace("-270.87", str(-270.87 + off)))
    if admitted:
        assert read_dataset(folder).tools[1].u == mirror / 1e3
    else:
        refused("impossible reading", lambda: read_dataset(folder))


@pytest.mark.parametrize(
    ("u", "believed"), [((1, 30), True), ((30, 1), True), ((1, 5), False), ((30, 30), True)]
)
def test_a_certificate_is_judged_by_the_larger_u_of_its_targets(tmp_path, u, believed):
    """A distance certified 100 mm off the nominal places of its targets."""
    settings = SETTINGS.replace("distance_mm: 150.0", "distance_mm: 250.0")
    for y, own in zip((272, 422), u, strict=True):
        settings = settings.replace(f"[475, {y}, -40],", f"[475, {y}, -40], u_mm: {own},")
    found = list(contradictions(read_dataset(write(tmp_path, settings))))
    assert [c.place for c in found] == ([] if believed else [("certificates", 2)])


LIKE = "the certified value looks like {}: write it in mm"
TWICE = "the value was converted once too often, or the nominal places are in inches"


@pytest.mark.parametrize(("unit", "size", "words"), [
    *((*unit, LIKE) for unit in (("m", 1.0), ("cm", 0.01), ("inches", 0.0254), ("µm", 1e-6))),
    ("inches to mm, twice", 1e-3 / 25.4, TWICE),
])  # fmt: skip
def test_the_unit_of_a_certificate_is_told(tmp_path, unit, size, words):
    """A distance certified in another unit than mm."""
    settings = SETTINGS.replace("distance_mm: 150.0", f"distance_mm: {0.15 / size:.6g}")
    for y in (272, 422):
        settings = settings.replace(f"[475, {y}, -40],", f"[475, {y}, -40], u_mm: 1,")
    assert [c.remedy for c in contradictions(read_dataset(write(tmp_path, settings)))] == [words.format(unit)]


# --- No session is blamed for a unit that is only loosely known, badly placed or shuffled.


@pytest.mark.parametrize("factor", [np.pi / 180, 180 / np.pi, 1e-3, 1e3])
def test_the_factor_is_found(tracker, factor):
    data = tracker(count=30).dataset
    field = "xyz" if factor in (1e-3, 1e3) else "readings"
    found = suspicion(with_columns(data, **{field: getattr(data.measurements, field) * factor}))
    assert found is not None
    assert found.factor == pytest.approx(1 / factor)
    assert found.quantities == (("x", "y", "z") if field == "xyz" else tuple(f"j{j}" for j in range(1, 7)))
    assert found.other < 0.01 < 0.1 < found.stated


def test_nothing_is_suspected(cube, tracker):
    for data in (cube(count=60).dataset, tracker(count=30).dataset):
        assert suspicion(data) is None


def test_planes_that_are_nowhere_near(cube):
    """Offsets and normals drawn anew, up to half a metre and 30 deg off: wrong, but not by a unit."""
    rng = np.random.default_rng(5)
    data = cube(count=60).dataset
    for _ in range(15):
        targets = []
        for target in data.targets:
            normal = target.values["normal"] + rng.normal(0, 0.3, 3)
            offset = target.values["offset"] + rng.uniform(-0.5, 0.5)
            values = {"normal": normal / np.linalg.norm(normal), "offset": offset}
            targets.append(replace(target, values=values))
        assert suspicion(replace(data, targets=tuple(targets))) is None


def test_shuffled_points_and_a_wrong_tool(tracker):
    data = tracker(count=30).dataset
    for seed in range(4):
        rng = np.random.default_rng(seed)
        assert suspicion(with_columns(data, xyz=rng.permutation(data.measurements.xyz))) is None
        tool = replace(data.tools[0], centre=data.tools[0].centre + rng.normal(0, 0.2, 3))
        assert suspicion(replace(data, tools=(tool,))) is None


def test_a_number_near_the_largest_is_no_overflow(cube):
    data = cube(count=30).dataset
    readings = data.measurements.readings.copy()
    readings[2, 0] = -1e308
    with np.errstate(over="raise"):
        assert suspicion(with_columns(data, readings=readings)) is None


def test_images_that_are_too_far_off_are_named():
    away = np.full(60, 0.001)
    away[:30] = 0.06
    away[7] = 0.09
    line, stops = 4 + np.arange(60), [f"img{k // 10}" for k in range(60)]
    rows = SimpleNamespace(name="log.csv", line=line)
    table = SimpleNamespace(line=line, cells={"stop": stops}, error=partial(Table.error, rows))
    problem = impossible(Target("cam", "camera", {}), away, table)
    assert "; 29 more rows are too far off: images img0, img1, img2; " in str(problem)


@pytest.mark.parametrize(("count", "words"), [(1, "lines 5"), (3, "lines 5, 7, 9"), (25, "41, 43, ...")])
def test_all_rows_that_are_too_far_off_are_listed(count, words):
    away = np.full(60, 0.001)
    away[0], away[1 : 2 * count : 2] = 0.09, 0.06
    target, line = Target("tracker", "instrument", {}), 4 + np.arange(60)
    rows = SimpleNamespace(name="log.csv", line=line)
    problem = impossible(target, away, SimpleNamespace(line=line, error=partial(Table.error, rows)))
    assert str(problem).startswith("log.csv:4: impossible reading: 90 mm")
    assert f"; {count} more row{'s are' if count > 1 else ' is'} too far off: " in str(problem)
    assert words in str(problem)
    assert ("leave the row out" in str(problem)) == (count < 6)
    assert ("the robot" in str(problem)) == (count >= 6)  # a wrong type of arm is off in many rows
