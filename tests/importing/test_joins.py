"""Files of one session that are joined: by time, by id with several reflectors, conditions; and refusals."""

import re
from dataclasses import replace

import numpy as np
import pytest
from cases import cases, refused
from made_up_logs import said, table
from scipy.spatial.transform import Rotation
from sessions import with_columns

from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import read_dataset, write_dataset
from bayescal.dataset.cameras import flange_poses
from bayescal.dataset.consistency import nominal
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert, write
from bayescal.importing.roles import stops_of, with_roles
from bayescal.model.scene import Scene

ARM = "fanuc-lrmate200ic"
USUAL = {"robot": ARM, "noise": "10 um"}
START = 1795305600.0
"""s since 1970, of 2026-11-22T00:00:00Z."""


@pytest.fixture(scope="module")
def tracked(tracker):
    return tracker(seed=3, count=40).dataset


def lines(path, header, rows, separator=","):
    path.write_text("\n".join(separator.join(map(str, row)) for row in [header, *rows]), encoding="utf-8")
    return path


def controller(data, path):
    """A log of a controller, every 2 s: time since 1970, joints that are at rest for 8 s of every 10 s."""
    q = np.degrees(data.measurements.readings)
    rows = []
    for k in range(5 * len(q)):
        at, part = divmod(k, 5)
        here, there = q[at], q[min(at + 1, len(q) - 1)]
        reading = here if part < 4 else (here + there) / 2
        rows.append([START + 2.0 * k, *map(repr, reading.tolist())])
    return lines(path, ["t", *(f"A{j}" for j in range(1, 7))], rows)


def points(data, path, which, shift=0.3, zone="Z"):
    """What a tracker exports: names, coordinates and ISO time stamps, in the middle of each standstill."""
    rows = []
    for i in which:
        seconds = 10.0 * i + 4.0 + shift
        stamp = f"2026-11-22T{int(seconds // 3600):02d}:{int(seconds // 60) % 60:02d}:{seconds % 60:05.2f}"
        rows.append([f"P{i}", *map(repr, (1e3 * data.measurements.xyz[i]).tolist()), stamp + zone])
    return lines(path, ["Name", "X", "Y", "Z", "Time"], rows)


BY_TIME = "j*=A* deg, time=t epoch_s"
STAMPED = "id=Name, x=X mm, y=Y mm, z=Z mm, time=Time iso"


def shuffled(path, seed):
    """The rows of a file in another order."""
    head, *rows = path.read_text(encoding="utf-8").split("\n")
    np.random.default_rng(seed).shuffle(rows)
    path.write_text("\n".join([head, *rows]), encoding="utf-8")


@pytest.mark.parametrize("mixed", [(), (0,), (1,), (0, 1)])
@pytest.mark.parametrize("pair", ["time:1 s", "id"])
def test_rows_of_any_order_are_joined(tracked, tmp_path, mixed, pair):
    """What is measured at a pose does not depend on where its rows are in the two files."""
    which = [i for i in range(40) if i not in (7, 20)]
    log = controller(tracked, tmp_path / "ctrl.csv")
    map_, name = BY_TIME, "P{}"
    if pair == "id":
        rows = [[f"P{i}", *np.degrees(tracked.measurements.readings[i])] for i in range(40)]
        log, map_ = lines(log, ["Name", *(f"A{j}" for j in range(1, 7))], rows), "j*=A* deg, id=Name"
    seen = points(tracked, tmp_path / "tracker.csv", which)
    for k in mixed:
        shuffled((log, seen)[k], k)
    got = convert(Request(log, map_, points=seen, points_map=STAMPED, pair=pair, **USUAL))
    rows = got.dataset.measurements
    assert sorted(rows.ids) == sorted(name.format(i) for i in which)
    of = [int(own[1:]) for own in rows.ids]
    np.testing.assert_allclose(rows.readings, tracked.measurements.readings[of], atol=1e-9)
    np.testing.assert_allclose(rows.xyz, tracked.measurements.xyz[of], atol=1e-9)
    np.testing.assert_allclose(rows.time, 10.0 * np.array(of), atol=1e-6)  # since the first in time
    assert not any("the arm moved" in note for note in got.notes)


def by_time(tracked, tmp_path, which=range(40), pair="time:1 s", map_=STAMPED, **options):
    """The log of a controller with the points of a tracker."""
    log = controller(tracked, tmp_path / "ctrl.csv")
    seen = points(tracked, tmp_path / "tracker.csv", which, **options)
    return convert(Request(log, BY_TIME, points=seen, points_map=map_, pair=pair, **USUAL))


def test_how_rows_are_paired_by_time_is_noted(tracked, tmp_path):
    which = [i for i in range(40) if i not in (7, 20)]
    got = by_time(tracked, tmp_path, which)
    assert got.dataset.measurements.ids == tuple(f"P{i}" for i in which)
    assert any("differences of 0.3 s (median), 0.3 s (maximum)" in note for note in got.notes)
    assert any(note == "38 of 200 rows of ctrl.csv are used" for note in got.notes)


@pytest.mark.parametrize(("which", "shift"), [(range(39), 3.7), (range(1, 40), -3.7)])
def test_a_tracker_whose_clock_is_wrong(tracked, tmp_path, which, shift):
    """Stamps just before or behind motions: the note says how far the arm moved."""
    wide = by_time(tracked, tmp_path, which, "time:3 s", shift=shift)
    assert any("39 of 39 measurements: check the clocks" in note for note in wide.notes)


@pytest.mark.parametrize(("pair", "map_", "words"), [
    ("time:0.1 s", STAMPED, "no rows of ctrl.csv and tracker.csv are within 0.1 s: .* differ by 0.3 s"),
    ("time", STAMPED, "`time` is not known; must be row, id or time:0.5 s"),
    ("time:1 mm", STAMPED, "`mm` is a unit of length, not of time"),
    ("time:1 s", STAMPED.replace("Time iso", "Time dmy"), "is not a date and time .dmy."),
    ("time:1 s", "id=Name, x=X mm, y=Y mm, z=Z mm", "tracker.csv: no column holds `time`"),
    ("row", STAMPED, "200 rows in ctrl.csv, 40 in tracker.csv"),
    ("near", STAMPED, "`near` is not known"),
])  # fmt: skip
def test_refused_by_time(tracked, tmp_path, pair, map_, words):
    refused(words, lambda: by_time(tracked, tmp_path, pair=pair, map_=map_))


def test_clocks_that_cannot_be_compared(tracked, tmp_path):
    words = "time since 1970 in ctrl.csv, local time in tracker.csv; pair by id"
    refused(words, lambda: by_time(tracked, tmp_path, zone=""))


def test_two_measurements_of_one_row_are_refused(tracked, tmp_path):
    with pytest.raises(BayescalError, match=r"^tracker.csv:3: two rows have the same nearest row of the log"):
        by_time(tracked, tmp_path, [0, 1, 1, 2, 3, 4, 5, 6])


@pytest.fixture(scope="module")
def reflectors(tracked):
    """Points of two reflectors at every pose, by the nominal arm and an instrument at (2, 0, 0.5) m."""
    centres = {"a": np.array([0.06, 0, 0.12]), "b": np.array([-0.05, 0.02, 0.1])}
    readings, tool = tracked.measurements.readings, tracked.tools[0]
    arms = {name: replace(tracked, tools=(replace(tool, centre=c),)) for name, c in centres.items()}
    return centres, {name: nominal(arm, readings) - [2.0, 0, 0.5] for name, arm in arms.items()}


def both_are_found(got, centres, seen, count=80):
    rows = got.dataset.measurements
    names = np.array([t.name for t in got.dataset.tools])[rows.tool]
    for name, centre in centres.items():
        own = next(t for t in got.dataset.tools if t.name == name)
        np.testing.assert_allclose(own.centre, centre, atol=1e-6)
        which = [int(i.partition(".")[0][1:]) for i in np.array(rows.ids)[names == name]]
        np.testing.assert_allclose(rows.xyz[names == name], seen[name][which], atol=1e-9)
    assert len(rows.ids) == len(set(rows.ids)) == count
    assert len(set(rows.stop.tolist()) - {""}) == count // 2


def test_two_reflectors_in_one_row(tracked, tmp_path, reflectors):
    centres, seen = reflectors
    numbers = np.column_stack([np.degrees(tracked.measurements.readings), 1e3 * seen["a"], 1e3 * seen["b"]])
    rows = [[f"p{i}", *row] for i, row in enumerate(numbers.tolist())]
    rows[5][-3:] = "", "", ""
    header = ["n", *(f"A{j}" for j in range(1, 7)), *(f"{k}{n}" for n in (1, 2) for k in "XYZ")]
    log = lines(tmp_path / "log.csv", header, rows)
    points = [f"{k.lower()}@{t}={k}{n} mm" for t, n in (("a", 1), ("b", 2)) for k in "XYZ"]
    got = convert(Request(log, ", ".join(["id=n, j*=A* deg", *points]), **USUAL))
    assert "1 points of 2 reflectors excluded: not measured" in got.notes
    rows = got.dataset.measurements
    assert rows.ids[:2] == ("p0.a", "p0.b")
    assert "p5.b" not in rows.ids
    both_are_found(got, centres, seen, 79)
    bare = convert(Request(log, ", ".join(["j*=A* deg", *points]), **USUAL))
    assert bare.dataset.measurements.ids[:2] == ("r2.a", "r2.b")  # of a log without ids the lines
    write(bare, tmp_path / "out")
    assert read_dataset(tmp_path / "out").measurements.ids == bare.dataset.measurements.ids


@pytest.mark.parametrize("files", [1, 2])
def test_two_reflectors_by_id(tracked, tmp_path, reflectors, files):
    centres, seen = reflectors
    log = table(tracked, tmp_path / "log.csv")
    ids = tracked.measurements.ids
    rows = [[[n, i, *x] for i, x in zip(ids, (1e3 * seen[n]).tolist(), strict=True)] for n in centres]
    header, parts = ["refl", "pose", "X", "Y", "Z"], [rows[0] + rows[1]] if files == 1 else rows
    paths = [lines(tmp_path / f"t{k}.csv", header, part) for k, part in enumerate(parts)]
    map_, points_map = said("deg").replace("role=role, ", ""), "id=pose, tool=refl, x=X mm, y=Y mm, z=Z mm"
    request = Request(log, map_, points=paths, points_map=points_map, pair="id", **USUAL)
    got = convert(request)
    both_are_found(got, centres, seen)
    readings = got.dataset.measurements.readings
    np.testing.assert_allclose(readings[::2], tracked.measurements.readings, atol=1e-9)
    twice = r"^t0.csv:2: id `.*` is given twice"
    several = "several files hold points; map `tool` .a reflector"
    with pytest.raises(BayescalError, match=twice if files == 1 else f"{several}. or `target`"):
        convert(replace(request, points_map=points_map.replace("tool=refl, ", "")))


def test_temperatures_of_another_logger(tracked, tmp_path):
    """A slow log: each row takes the nearest temperature, which may repeat."""
    log = table(tracked, tmp_path / "log.csv", "deg", "mm", clock=30.0 * np.arange(40))
    air = lines(tmp_path / "air.csv", ["s", "T"], [[300 * k, 20 + k] for k in range(6)])
    map_ = said("deg", "mm").replace("role=role, ", "")
    given = {"points": air, "points_map": "time=s s, temperature=T C", "pair": "time:200 s", **USUAL}
    rows = convert(Request(log, map_, **given)).dataset.measurements
    assert len(rows.ids) == 40
    expected = 20 + np.round(np.nextafter(30.0 * np.arange(40) / 300, 0))
    np.testing.assert_allclose(rows.temperature, expected, atol=1e-9)


def test_as_many_maps_as_files(tracked, tmp_path):
    log = table(tracked, tmp_path / "log.csv")
    with pytest.raises(BayescalError, match="2 files of points, but 3 maps"):
        convert(Request(log, said("deg"), points=[log, log], points_map=["mm", "m", "mm"], **USUAL))


def test_rows_that_are_earlier_than_the_row_above(tracked, tmp_path):
    clock = 30.0 * np.arange(40)
    clock[10] = 5.0
    log = table(tracked, tmp_path / "log.csv", "deg", "mm", clock=clock)
    got = convert(Request(log, said("deg", "mm"), **USUAL))
    words = "1 rows are earlier than the row above: the order of rows is taken as the order of time"
    assert words in got.notes


# --- Measured orientations in the conventions of makers, written down apart from the code under test.


@pytest.fixture(scope="module")
def posed(tracker):
    """Points with errors of the arm; orientations of a nominal arm, whose tool is turned on its flange."""
    session = tracker(seed=3, count=40)
    data = session.dataset
    tool = rpy_matrix(np.array([0.2, -0.4, 1.0]))
    flange = flange_poses(data, data.measurements.readings)[:, :3, :3]
    return data, session.frame[:3, :3].T @ flange @ tool


def rz(a):
    return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])


def rx(a):
    return np.roll(rz(a), 1, axis=(0, 1))


def ry(a):
    return np.roll(rz(a), 2, axis=(0, 1))


MADE = {
    "wpr deg": lambda w, p, r: rz(r) @ ry(p) @ rx(w),
    "rpy deg": lambda w, p, r: rz(r) @ ry(p) @ rx(w),
    "abc deg": lambda a, b, c: rz(a) @ ry(b) @ rx(c),
    "zyx rad": lambda a, b, c: rz(a) @ ry(b) @ rx(c),
    "xyz deg": lambda a, b, c: rx(a) @ ry(b) @ rz(c),
    "oat deg": lambda o, a, t: rz(o) @ ry(a) @ rz(t),
}
"""Rotations of three angles."""


@pytest.mark.parametrize("words", MADE)
def test_angles(words):
    from bayescal.importing.units import matrices

    angles = np.random.default_rng(1).uniform(-1.5, 1.5, (5, 3))
    made = [MADE[words](*row) for row in angles]
    np.testing.assert_allclose(matrices(angles, words.split()[0]), made, atol=1e-12)


def written(data, turns, path, words):
    """A log with ids, joints, points, and orientations in columns o1, o2, ..."""
    rotation = Rotation.from_matrix(turns)
    kind = words.split()[0]
    numbers = {
        "wxyz": lambda: rotation.as_quat()[:, [3, 0, 1, 2]],
        "xyzw": lambda: -rotation.as_quat(),
        "rotvec": lambda: rotation.as_rotvec(),
        "matrix": lambda: turns.reshape(-1, 9),
        "matrix-columns": lambda: turns.transpose(0, 2, 1).reshape(-1, 9),
        "abc": lambda: np.degrees(rotation.as_euler("ZYX")),
        "wpr": lambda: np.degrees(rotation.as_euler("xyz")),
        "xyz": lambda: np.degrees(rotation.as_euler("XYZ")),
        "oat": lambda: np.degrees(rotation.as_euler("ZYZ")),
    }[kind]()
    m = data.measurements
    rows = np.column_stack([np.degrees(m.readings), 1e3 * m.xyz, numbers]).tolist()
    width = numbers.shape[1]
    header = ["n", *(f"A{j}" for j in range(1, 7)), "X", "Y", "Z", *(f"o{k + 1}" for k in range(width))]
    lines(path, header, [[i, *row] for i, row in zip(m.ids, rows, strict=True)])
    return f"id=n, j*=A* deg, x=X mm, y=Y mm, z=Z mm, rotation={' '.join(header[10:])} {words}"


@pytest.mark.parametrize("words", [
    "wxyz", "xyzw", "rotvec rad", "matrix", "matrix-columns", "abc deg", "wpr deg", "xyz deg", "oat deg",
])  # fmt: skip
def test_comes_back(posed, tmp_path, words):
    data, turns = posed
    map_ = written(data, turns, tmp_path / "log.csv", words)
    got = convert(Request(tmp_path / "log.csv", map_, robot=ARM, noise="10 um, 0.01 deg"))
    np.testing.assert_allclose(rpy_matrix(got.dataset.measurements.rpy), turns, atol=1e-9)
    assert got.dataset.noise.orientation == pytest.approx(np.radians(0.01))
    assert got.wrong == ""
    assert any("of the nominal arm" in note and "orientations are read as" in note for note in got.notes)
    write(got, tmp_path / "out")
    np.testing.assert_allclose(rpy_matrix(read_dataset(tmp_path / "out").measurements.rpy), turns, atol=1e-8)


CONFUSED = {"wxyz": "xyzw", "abc deg": "wpr deg", "matrix": "matrix-columns"}
CONFUSED |= {"rotvec rad": "abc rad", "xyz deg": "abc deg"}


@pytest.mark.parametrize(("made", "stated"), CONFUSED.items())
def test_another_convention_is_refused_and_the_right_one_named(posed, tmp_path, made, stated):
    data, turns = posed
    map_ = written(data, turns, tmp_path / "log.csv", made).replace(made, stated)
    draft = convert(Request(tmp_path / "log.csv", map_, robot=ARM, noise="10 um"))
    words = f"orientations as .* differ from the nominal arm by .* as {made.split()[0]} by"
    refused(words, lambda: write(draft, tmp_path / "out"))
    write(draft, tmp_path / "out", force=True)


@pytest.mark.parametrize(("words", "said"), cases("orientation_refusals"))
def test_refused(posed, tmp_path, words, said):
    data, turns = posed
    map_ = written(data, turns, tmp_path / "log.csv", "wxyz").partition(", rotation")[0]
    with pytest.raises(BayescalError, match=said):
        convert(Request(tmp_path / "log.csv", f"{map_}, {words}", robot=ARM, noise="10 um"))


def test_the_frame_of_a_tool(posed, tmp_path):
    data, turns = posed
    map_ = written(data, turns, tmp_path / "log.csv", "wxyz")
    usual = {"robot": ARM, "noise": "10 um"}
    tool = "60 0 120 mm; 0.2 -0.4 1 wpr rad"
    got = convert(Request(tmp_path / "log.csv", map_, tool=tool, **usual))
    np.testing.assert_allclose(got.dataset.tools[0].rpy, [0.2, -0.4, 1.0], atol=1e-12)
    write(got, tmp_path / "out")
    np.testing.assert_allclose(read_dataset(tmp_path / "out").tools[0].rpy, [0.2, -0.4, 1.0], atol=1e-8)
    other = convert(Request(tmp_path / "log.csv", map_, tool=tool.replace("0.2", "1.2"), **usual))
    assert "orientations as wxyz differ from the nominal arm by 57 deg" in other.wrong
    for tool, words in (
        ("0 0 31 mm; 0 0 90 wpr", "'0 0 90 wpr' is not an orientation; write"),
        ("0 0 31 mm; 2 0 0 0 wxyz", "'2 0 0 0 wxyz' is not a unit quaternion"),
        ("0 0 31 mm; 0 0 x abc deg", "has a word that is not a number"),
    ):
        with pytest.raises(BayescalError, match=words):
            convert(Request(tmp_path / "log.csv", map_, tool=tool, **usual))


# --- Validation measurements by rule: whole stops, the same at every call, and never all rows or none.


@pytest.fixture(scope="module")
def stopped(tracked):
    """Three rows a stop, of 14 stops, the last of one row; named b0, b1, ..."""
    return with_columns(tracked, stop=np.array([f"b{i // 3}" for i in range(40)]))


def test_rows_of_one_stop_repeat_or_reading_belong_together(tracked):
    rows = tracked.measurements
    stop, repeat = np.full(40, "", "<U3"), np.full(40, "", "<U3")
    stop[[0, 3]], repeat[[3, 7]] = "s", "a"
    readings = rows.readings.copy()
    readings[9] = readings[7]
    got = stops_of(replace(rows, stop=stop, repeat=repeat, readings=readings))
    assert {got[i] for i in (0, 3, 7, 9)} == {0}
    assert len(set(got)) == 37
    assert np.all(np.diff(list(dict.fromkeys(got.tolist()))) == 1)  # numbered as they first come


@pytest.mark.parametrize(("rule", "stops", "words"), [
    ("every:5", {4, 9}, "5 of 40|6 of 40"),
    ("every 5", {4, 9}, "stop 5 of every 5, 14 stops"),
    ("stop", {4, 9}, "stop 5 of every 5"),
    ("last:20%", {11, 12, 13}, "7 of 40 rows (the last 3 of 14 stops)"),
    ("stops 'b1?'", {10, 11, 12, 13}, "stops b1?"),
    ("stops:b0, b13", {0, 13}, "4 of 40"),
])  # fmt: skip
def test_rules(stopped, rule, stops, words):
    got, note = with_roles(stopped, rule, "--validate")
    chosen = np.isin(np.arange(40) // 3, list(stops))
    np.testing.assert_array_equal(got.measurements.role == "validate", chosen)
    assert re.search("|".join(map(re.escape, words.split("|"))), note)


def test_targets(cube):
    data = cube(seed=2, count=60).dataset
    faces = np.array([t.name for t in data.targets])[data.measurements.target]
    got, note = with_roles(data, "targets '*.+?'", "--validate")
    np.testing.assert_array_equal(got.measurements.role == "validate", np.char.find(faces, "+") > 0)
    assert "targets *.+?" in note
    together = with_columns(data, stop=np.full(60, "s"))
    with pytest.raises(BayescalError, match="measured at the same stop; name the targets of whole stops"):
        with_roles(together, "targets *.+?", "--validate")


@pytest.mark.parametrize(("rule", "words"), cases("role_refusals"))
def test_roles_refused(tracked, rule, words):
    refused("^--validate: .*" + words, lambda: with_roles(tracked, rule, "--validate"))


def test_of_an_import(tracked, tmp_path):
    log = table(tracked, tmp_path / "log.csv", "deg", "mm")
    map_ = said("deg", "mm").replace("role=role, ", "")
    usual = {"robot": ARM, "noise": "10 um"}
    none = convert(Request(log, map_, **usual))
    assert none.notes[-1].startswith("validation data: none, all 40 rows are fitted; `--validate every:5`")
    got = convert(Request(log, map_, validate="every:4", **usual))
    assert np.flatnonzero(got.dataset.measurements.role == "validate").tolist() == list(range(3, 40, 4))
    assert got.notes[-1] == "validation measurements: 10 of 40 rows (stop 4 of every 4, 40 stops)"
    mapped = convert(Request(log, map_ + ", validate=every:4", **usual))
    np.testing.assert_array_equal(mapped.dataset.measurements.role, got.dataset.measurements.role)
    with pytest.raises(BayescalError, match="`validate` is stated by the map already"):
        convert(Request(log, map_ + ", validate=every:4", validate="every:5", **usual))
    with pytest.raises(BayescalError, match="a column states the role of each row already"):
        convert(Request(log, said("deg", "mm"), validate="every:5", **usual))
    stated = convert(Request(log, said("deg", "mm"), **usual))
    count = int((tracked.measurements.role == "validate").sum())
    assert (f"{count} of 40 rows, as stated" if count else "none") in stated.notes[-1]


def test_roles_of_a_template_are_the_log_s(cube, tmp_path):
    data = cube(seed=2, count=60).dataset
    write_dataset(data, tmp_path / "template")
    log = table(data, tmp_path / "log.csv")
    map_ = "j*=A* deg, id=Point, target=face"
    got = convert(Request(log, map_, template=tmp_path / "template", validate="targets cube.+z"))
    names = np.array([t.name for t in got.dataset.targets])[got.dataset.measurements.target]
    np.testing.assert_array_equal(got.dataset.measurements.role == "validate", names == "cube.+z")


def motion_capture(data, path, hidden=(), mirrored=()):
    """Poses of two bodies in turn, m, whose rows are empty or ``nan`` where the camera saw nothing.

    Orientations of some are turned by 50 deg, as those of a flat tag that is mirrored.
    """
    rng = np.random.default_rng(4)
    turns = {name: Rotation.from_rotvec(rng.standard_normal(3)) for name in ("plate", "wand")}
    place = {"plate": np.array([0.05, 0.02, 0.04]), "wand": np.array([-0.03, 0.08, 0.1])}
    q = data.measurements.readings
    rows = []
    for i, flange in enumerate(flange_poses(data, q)):
        body = "wand" if i % 2 else "plate"
        flip = Rotation.from_rotvec(np.radians(50) * np.array([0.6, 0.8, 0.0]) * (i in mirrored))
        quat = (flip * Rotation.from_matrix(flange[:3, :3]) * turns[body]).as_quat()
        at = flange[:3, :3] @ place[body] + flange[:3, 3]
        cells = [repr(float(x)) for x in (*at, *quat)]
        cells = [["", "nan"][i % 2]] * 7 if i in hidden else cells
        rows.append([body, *cells, *(repr(float(x)) for x in np.degrees(q[i]))])
    header = ["body", "x", "y", "z", "qx", "qy", "qz", "qw", *(f"A{j}" for j in range(1, 7))]
    return lines(path, header, rows), place


def test_frames_that_motion_capture_dropped_are_left_out(tracked, tmp_path):
    log, place = motion_capture(tracked, tmp_path / "mocap.csv", hidden=(3, 8, 9))
    map_ = "j*=A* deg, x=x m, y=y m, z=z m, rotation=qx qy qz qw xyzw, tool=body"
    got = convert(Request(log, map_, robot=ARM, noise="0.1 mm, 0.02 deg"))
    assert "3 rows without a point excluded: not measured" in got.notes
    assert len(got.dataset.measurements.ids) == len(tracked.measurements.ids) - 3
    assert {t.name for t in got.dataset.tools} == set(place)
    for tool in got.dataset.tools:
        np.testing.assert_allclose(tool.centre, place[tool.name], atol=1e-6)
    write(got, tmp_path / "session")
    assert len(read_dataset(tmp_path / "session").measurements.ids) == len(got.dataset.measurements.ids)


def test_a_row_with_a_part_of_a_point_is_refused(tracked, tmp_path):
    log, _ = motion_capture(tracked, tmp_path / "mocap.csv", hidden=())
    text = log.read_text().splitlines()
    text[4] = ",".join(c if k != 2 else "nan" for k, c in enumerate(text[4].split(",")))
    log.write_text("\n".join(text))
    map_ = "j*=A* deg, x=x m, y=y m, z=z m, tool=body"
    with pytest.raises(BayescalError, match=r"mocap\.csv:5: a part of a point"):
        write(convert(Request(log, map_, **USUAL)), tmp_path / "session")


def test_mirrored_poses_are_named_and_do_not_move_the_frame(tracked, tmp_path):
    log, _ = motion_capture(tracked, tmp_path / "mocap.csv", mirrored=(1, 5, 10, 11, 30))
    map_ = "j*=A* deg, x=x m, y=y m, z=z m, rotation=qx qy qz qw xyzw, tool=body"
    got = convert(Request(log, map_, robot=ARM, noise="0.1 mm, 0.02 deg"))
    ids = [got.dataset.measurements.ids[row] for row in (1, 5, 10, 11, 30)]
    words = next(note for note in got.notes if "orientations are read" in note)
    assert "5 are turned by 50 deg" in words
    assert all(i in words for i in ids)
    plain, _ = motion_capture(tracked, tmp_path / "plain.csv")
    other = convert(Request(plain, map_, robot=ARM, noise="0.1 mm, 0.02 deg"))
    assert "turned by" not in " ".join(other.notes)
    for one, two in zip(Scene(got.dataset).tool_frames, Scene(other.dataset).tool_frames, strict=True):
        np.testing.assert_allclose(one, two, atol=1e-6)
