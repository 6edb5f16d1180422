"""Logs in whatever units come back as the session that they were made from, or are refused."""

import re
from dataclasses import replace
from itertools import cycle

import foreign
import numpy as np
import pytest
from cases import cases, file_text, refused
from made_up_logs import robodk, said, spatial_analyzer, table
from scipy import constants
from sessions import with_columns
from typer.testing import CliRunner

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.cli import app
from bayescal.dataset import Tool, read_dataset, write_dataset
from bayescal.dataset.consistency import nominal
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert, write
from bayescal.importing.ask import base_of
from bayescal.importing.columns import columns_of, missing_in
from bayescal.importing.log import read_log
from bayescal.importing.mapping import read_map
from bayescal.importing.units import UNITS, quantity, unit_of

ARM = "fanuc-lrmate200ic"
NOISE = "10 um"
DEG = constants.degree
DIMENSIONS = {
    "length": {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": constants.micron, "in": constants.inch},
    "angle": {"deg": DEG, "rad": 1.0, "mrad": 1e-3},
    "rate": {"degps": DEG, "radps": 1.0, "rpm": constants.pi / 30},
    "torque": {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2},
    "mass": {"kg": 1.0, "g": 1e-3, "lb": constants.pound},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": constants.minute, "h": constants.hour},
    "temperature": {"C": 1.0, "K": 1.0, "F": 5 / 9},
}
"""Of each dimension, its units in SI."""


@pytest.fixture(scope="module")
def tracked(tracker):
    """Forty points of a reflector at (60, 0, 120) mm, roughly, on an arm with errors."""
    return tracker(seed=3, count=40)


def brought(tmp_path, force=False, **request):
    write(convert(Request(**{"robot": ARM, "noise": NOISE, **request})), tmp_path / "out", force)
    return read_dataset(tmp_path / "out", judge=not force)


def same_rows(a, b):
    assert a.ids == b.ids
    np.testing.assert_array_equal(a.role, b.role)
    for name in ("readings", "xyz", "time"):
        if getattr(b, name) is not None:
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=3e-9)


QUANTITIES = {
    "length": ("x=X {u}, y=Y {u}, z=Z {u}", "xyz", "XYZ"),
    "angle": ("j*=A* {u}", "readings", "A"),
    "rate": ("j*_velocity=V* {u}", "velocity", "V"),
    "torque": ("j*_torque=M* {u}", "torque", "M"),
    "mass": ("payload=P {u}", "payload", "P"),
    "time": ("time=t {u}", "time", "t"),
    "temperature": ("temperature=T {u}", "temperature", "T"),
}
"""How a map says each quantity, and where the session has it."""


OTHERS = ("current", "speed", "force")
"""What logs of motions and rails have."""


@pytest.mark.parametrize("unit", [u for u in UNITS if UNITS[u].dimension not in OTHERS and u != "steps"])
def test_any_unit_comes_back(tracked, tmp_path, unit):
    """Every quantity, in every unit that a map takes; the factors are those of SciPy."""
    rng, m = np.random.default_rng(0), tracked.dataset.measurements
    count, told = len(m.ids), next(d for d, named in DIMENSIONS.items() if unit in named)
    values = {
        "xyz": m.xyz, "readings": m.readings, "velocity": rng.uniform(-1, 1, (count, 6)),
        "torque": rng.uniform(-9, 9, (count, 6)), "payload": np.repeat([0.5, 2.0], count // 2),
        "time": 10.0 * np.arange(count), "temperature": rng.uniform(19, 24, count),
    }  # fmt: skip
    usual = {"length": "mm", "angle": "deg", "rate": "radps", "torque": "Nm", "mass": "kg", "time": "s"}
    units = usual | {"temperature": "C"} | {told: unit}
    header, columns, map_ = ["Point", "role"], [list(m.ids), m.role.tolist()], ["id=Point, role=role"]
    for dimension, (said_, name, letters) in QUANTITIES.items():
        map_.append(said_.format(u=units[dimension]))
        block = np.atleast_2d(shown(values[name], units[dimension]).T)
        many = len(letters) == 1 < len(block)
        header += [f"{letters}{k + 1}" for k in range(len(block))] if many else letters
        columns += [list(map(repr, row.tolist())) for row in block]
    mark, separator = (",", ";") if unit in ("rad", "um", "K") else (".", ",")
    lines = [header, *zip(*([c.replace(".", mark) for c in column] for column in columns), strict=True)]
    log = tmp_path / "log.csv"
    log.write_text("\n".join(separator.join(line) for line in lines), encoding="utf-8")
    noise = f"{shown(1e-5, unit)} {unit}" if told == "length" else NOISE
    got = brought(tmp_path, log=log, map=", ".join(map_), noise=noise).measurements
    for name, value in values.items():
        atol = 1e-6 if name == "torque" else 1e-8
        np.testing.assert_allclose(getattr(got, name), value, rtol=1e-5, atol=atol)


def shown(values, unit):
    """Values in SI (deg C of temperatures) as numbers of a unit."""
    if unit in ("C", "K", "F"):
        return constants.convert_temperature(np.asarray(values), "C", unit)
    return values / DIMENSIONS[next(d for d, named in DIMENSIONS.items() if unit in named)][unit]


def test_instrument_and_reflector_are_found(tracked, tmp_path):
    """To what an arm that is a millimetre or two wrong lets them be."""
    data, map_ = tracked.dataset, said("deg", "mm")
    got = brought(tmp_path, log=table(data, tmp_path / "log.csv", "deg", "mm"), map=map_)
    np.testing.assert_allclose(got.tools[0].centre, data.tools[0].centre, atol=6e-3)
    place = got.targets[0].values
    frame = rigid(rpy_matrix(place["rpy"]), place["xyz"])
    reads = np.c_[data.measurements.xyz, np.ones(40)]
    assert np.abs(reads @ (frame - tracked.frame).T).max() < 6e-3


def test_two_stations_and_two_reflectors(tracked, tmp_path):
    """Half of the rows from elsewhere, a third with another reflector, which is told."""
    data = tracked.dataset
    m, where = data.measurements, np.arange(40) % 2
    tool = (np.arange(40) % 3 == 0).astype(int)
    second = Tool("b", np.array([-0.05, 0.02, 0.1]))
    turn = rpy_matrix(np.array([0.3, -0.2, 2.0]))
    tools = (replace(data.tools[0], name="a"), second)
    at_home = nominal(replace(data, tools=tools, measurements=replace(m, tool=tool)), m.readings)
    xyz = (at_home - [1.0, 2, 3]) @ turn
    xyz[where == 1] = (at_home[where == 1] + [0.5, 0, 1]) @ turn.T
    lines = ["id,tool,at," + ",".join(f"q{j}" for j in range(1, 7)) + ",x,y,z"]
    for i in range(40):
        numbers = [*np.degrees(m.readings[i]).tolist(), *xyz[i].tolist()]
        lines.append(",".join(map(str, [f"p{i}", "ab"[tool[i]], f"s{where[i]}", *numbers])))
    (tmp_path / "log.csv").write_text("\n".join(lines), encoding="utf-8")
    map_ = "id=id, tool=tool, target=at, j*=q* deg, x=x m, y=y m, z=z m"
    got = brought(tmp_path, log=tmp_path / "log.csv", map=map_)
    found = {t.name: t.centre for t in got.tools}
    np.testing.assert_allclose([found["a"], found["b"]], [data.tools[0].centre, second.centre], atol=1e-6)
    place = {t.name: t.values["xyz"] for t in got.targets}
    np.testing.assert_allclose(place["s0"], [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(place["s1"], [-0.5, 0, -1], atol=1e-6)


def test_a_part_of_the_name_of_a_robot_is_enough(tmp_path):
    """As `import --help` has it, also in place of a template's robot; the dataset has the full name."""
    rows = ["1,2,3,4,5,6,7,8,9", "2,3,4,5,6,7,8,9,10"]
    (tmp_path / "log.csv").write_text("\n".join(["A1,A2,A3,A4,A5,A6,X,Y,Z", *rows]))
    base = base_of(Request(tmp_path / "log.csv", "j*=A* deg, x=X mm, y=Y mm, z=Z mm", robot="ur5e"))
    assert (base.robot_reference, base.robot.name) == ("universal-robots-ur5e",) * 2


def test_a_wild_row_does_not_carry_the_frame_away(tracked, tmp_path):
    xyz = tracked.dataset.measurements.xyz.copy()
    xyz[7] += [0.4, -0.3, 0.2]
    log = table(with_columns(tracked.dataset, xyz=xyz), tmp_path / "log.csv", "deg", "mm")
    refused(r"^log.csv:9: impossible reading", lambda: brought(tmp_path, log=log, map=said("deg", "mm")))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("angle", "claimed", "length", "told", "words", "tool"),
    [(*wrong, tool) for wrong, tool in zip(cases("unit_refusals"), cycle(["", "60 0 120 mm"]), strict=False)],
)
def test_a_wrong_unit_is_caught(tracked, tmp_path, angle, claimed, length, told, words, tool):
    log = table(tracked.dataset, tmp_path / "log.csv", angle, length)
    map_ = said(claimed, told)
    words += r" they agree with the nominal arm within [\d.]+ mm.*--force"
    refused(words, lambda: brought(tmp_path, log=log, map=map_, tool=tool))
    assert not (tmp_path / "out").exists()
    assert len(brought(tmp_path, force=True, log=log, map=map_, tool=tool).measurements.ids) == 40


def test_one_joint_in_another_unit_is_caught(tracked, tmp_path):
    log = table(tracked.dataset, tmp_path / "log.csv", "deg", "mm")
    map_ = "id=Point, x=X mm, y=Y mm, z=Z mm" + "".join(f", j{j}=A{j} deg" for j in range(1, 7))
    with pytest.raises(BayescalError, match=r"^log.csv: `j4` cannot be in mrad"):
        brought(tmp_path, log=log, map=map_.replace("A4 deg", "A4 mrad"))


def test_contacts_with_a_template(cube, tmp_path):
    data = cube(seed=2, count=60).dataset
    write_dataset(data, tmp_path / "template")
    log = table(data, tmp_path / "log.csv", "rad")
    usual = {"log": log, "template": tmp_path / "template", "robot": "", "noise": ""}
    got = brought(tmp_path, map=said("rad") + ", target=face", **usual)
    same_rows(got.measurements, data.measurements)
    np.testing.assert_array_equal(got.measurements.target, data.measurements.target)
    assert got.certificates == data.certificates
    with pytest.raises(BayescalError, match="cannot be in deg: the numbers are 57 times too small"):
        write(convert(Request(map=said("deg") + ", target=face", **usual)), tmp_path / "other")
    with pytest.raises(BayescalError, match=r"the target of the rows is not stated.*cube.-x"):
        convert(Request(map=said("rad"), **usual))


def test_points_of_a_tracker_paired_by_id(tracked, tmp_path):
    data = tracked.dataset
    order = np.random.default_rng(0).permutation(40)[:37]
    points = spatial_analyzer(data, tmp_path / "sa.txt", order, "m")
    log = table(data, tmp_path / "log.csv")
    usual = {"log": log, "map": said("deg"), "points": points, "robot": ARM, "noise": NOISE}
    draft = convert(Request(points_map="m", pair="id", **usual))
    assert draft.notes[0] == "excluded: 3 rows of log.csv without a partner"
    kept, rows = np.sort(order), draft.dataset.measurements
    np.testing.assert_allclose(rows.xyz, data.measurements.xyz[kept], atol=1e-7)
    np.testing.assert_allclose(rows.readings, data.measurements.readings[kept], atol=1e-9)
    with pytest.raises(BayescalError, match=r"40 rows in log.csv, 37 in sa.txt; .*pair them by id"):
        convert(Request(points_map="m", **usual))


def test_points_in_another_order_are_no_unit(tracked, tmp_path):
    """Paired by row although they were shuffled: refused, and no unit is blamed."""
    points = spatial_analyzer(tracked.dataset, tmp_path / "sa.txt", np.roll(np.arange(40), 5))
    log = table(tracked.dataset, tmp_path / "log.csv")
    draft = convert(Request(log, said("deg"), robot=ARM, noise=NOISE, points=points, points_map="mm"))
    assert draft.wrong == ""
    refused("disagree with the arm", lambda: write(draft, tmp_path / "out"))


@pytest.mark.parametrize("pose", [False, True])
def test_robodk(tracked, tmp_path, pose):
    data = tracked.dataset
    m = data.measurements
    at = np.array([[0.06, 0, 0.12], [-0.05, 0.02, 0.1]])
    both = replace(data, tools=(replace(data.tools[0], centre=at[0]), Tool("b", at[1])))
    both = with_columns(both, tool=np.arange(40) % 2, readings=np.repeat(m.readings[:20], 2, axis=0))
    both = with_columns(both, xyz=nominal(both, both.measurements.readings) - [2.0, 1, 0])
    log = robodk(both, tmp_path / "dk.csv", at[both.measurements.tool], pose, lost=(3, 8))
    draft = convert(Request(log, format="robodk", robot=ARM, noise=NOISE))
    got = draft.dataset
    assert draft.notes[0] == "2 rows of dk.csv excluded: not measured (0, 0, 0)"
    assert [t.name for t in got.tools] == ["tcp1", "tcp2"]
    np.testing.assert_allclose([t.centre for t in got.tools], at, atol=1e-9)
    np.testing.assert_allclose(got.targets[0].values["xyz"], [2, 1, 0], atol=1e-6)
    stops = got.measurements.stop.tolist()
    assert stops[0] == stops[1] != ""
    assert stops[2] == ""  # its neighbour was lost
    assert draft.line.tolist()[:4] == [1, 2, 3, 5]
    write(draft, tmp_path / "out")
    with pytest.raises(BayescalError, match="columns do not match a RoboDK table of 6 joints"):
        convert(Request(table(data, tmp_path / "log.csv"), format="robodk", robot=ARM, noise=NOISE))


def test_on_the_command_line(tracked, tmp_path):
    log = table(tracked.dataset, tmp_path / "log.csv", "deg", "mm")
    map_ = tmp_path / "map.yaml"
    map_.write_text("j*: A* deg\nid: Point\nx: X mm\ny: Y mm\nz: Z mm\ntarget: \"'leica'\"\n")
    words = ["import", str(log), "--map", str(map_), "--robot", ARM, "--noise", NOISE, "--out"]
    done = CliRunner().invoke(app, [*words, str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert re.search(r"instrument `leica` located at .*\n.*median", done.output)
    again = CliRunner().invoke(app, [*words, str(tmp_path / "out")])
    assert isinstance(again.exception, BayescalError)
    assert "not empty" in again.exception.what
    assert read_dataset(tmp_path / "out").targets[0].name == "leica"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.csv", "map.yaml", "out"]


# --- Real sessions through logs in other units, where their data are at hand.

EVERY = 4
"""One row in so many, to be quick."""


@foreign.needs()
@pytest.mark.parametrize("name", ["ur5-lasertracker", "ur10-lasertracker"])
def test_a_tracker_and_its_reflector_are_found(name, tmp_path):
    """Neither is said, the arm is as drawn; and a wrong unit is told nevertheless."""
    data = read_dataset(foreign.REAL / name)
    m = data.measurements
    clock = np.arange(len(m.ids)) if m.time is None else m.time
    log = table(data, tmp_path / "log.csv", "rad", "m", ";", ",", clock)
    lines = log.read_text(encoding="utf-8").splitlines()
    log.write_text("\n".join([lines[0], *lines[1::EVERY]]), encoding="utf-8")
    usual = {"log": log, "robot": str(foreign.REAL / name / "robot.yaml"), "noise": "30 um"}
    draft = convert(Request(map=said("rad", "m"), **usual))
    assert draft.wrong == ""
    np.testing.assert_allclose(draft.dataset.tools[0].centre, data.tools[0].centre, atol=4e-3)
    write(draft, tmp_path / "out")
    got = read_dataset(tmp_path / "out").measurements
    np.testing.assert_allclose(got.readings, m.readings[::EVERY], atol=1e-8)
    np.testing.assert_allclose(got.xyz, m.xyz[::EVERY], atol=1e-8)
    assert "57 times too small; in rad" in convert(Request(map=said("deg", "m"), **usual)).wrong
    assert "1000 times too small; in m" in convert(Request(map=said("rad", "mm"), **usual)).wrong


# --- Maps, units and files that say too little or what cannot be: one line with the remedy.


@pytest.mark.parametrize(("text", "words"), cases("import_map_refusals"))
def test_maps(text, words):
    refused(words, lambda: read_map(text, ("deg",) * 6))


def test_a_map_with_everything():
    said = "j*=Joint * deg, j2_velocity=v2 deg/s, j1_torque=#9 Nm, id=Point, target='cube.+x'"
    got = read_map(said, ("deg",) * 2)
    assert (got["j2"].name, got["j2"].unit) == ("Joint 2", UNITS["deg"])
    assert got["j2_velocity"].unit is UNITS["degps"]
    assert got["j1_torque"].name == "#9"
    assert (got["target"].name, got["target"].constant) == ("cube.+x", True)
    assert not got["id"].constant


@pytest.mark.parametrize(("name", "dimension", "value", "si"), [
    ("µm", "length", 3, 3e-6), ("°", "angle", 180, np.pi), ("deg/s", "rate", 90, np.pi / 2),
])  # fmt: skip
def test_units(name, dimension, value, si):
    assert unit_of(name, dimension, "").scale * value == pytest.approx(si, abs=1e-12)


def test_quantities():
    assert quantity("0, 0.07, 31 mm", "length", 3, "") == pytest.approx((0, 7e-5, 0.031))
    for text in ("1 2 mm", "1 2 3", "1 2 x mm", "1 2 3 deg"):
        with pytest.raises(BayescalError):
            quantity(text, "length", 3, "--tcp")


@pytest.mark.parametrize(("text", "map_", "words"), cases("import_log_refusals"))
def test_logs(tmp_path, text, map_, words):
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    refused(words, lambda: columns_of(read_log(tmp_path / "log.csv"), read_map(map_, ("deg",) * 6)))


@pytest.mark.parametrize(("said", "words"), cases("import_request_refusals"))
def test_requests(tmp_path, said, words):
    log = tmp_path / "log.csv"
    log.write_text("A1,A2,A3,A4,A5,A6,X,Y,Z\n" + "1,2,3,4,5,6,7,8,9\n" * 2, encoding="utf-8")
    usual = {"map": "j*=A* deg, x=X mm, y=Y mm, z=Z mm", "robot": ARM, "noise": "10 um"}
    refused(words, lambda: convert(Request(log, **{**usual, **said})))


@pytest.mark.parametrize(("row", "columns"), [
    ("1.5 2 3", "345"), ("P1, 1.5, 2, 3", "P1"), ("A::B 7 1.5 2 3", None), ("P1 1.5 2 3 0.1", None),
])  # fmt: skip
def test_which_columns_are_points(tmp_path, row, columns):
    """Where names and numbers cannot be told apart, it is asked for."""
    from bayescal.importing.ask import points_map

    (tmp_path / "p.txt").write_text(f"{row}\n{row}\n", encoding="utf-8")
    log = read_log(tmp_path / "p.txt")
    if columns is None:
        refused("it is not clear which of the 5 columns are x, y, z", lambda: points_map(log, "mm"))
        return
    got = columns_of(log, points_map(log, "mm"))
    np.testing.assert_allclose([got.cells[k][1] for k in "xyz"], [1.5e-3, 2e-3, 3e-3])


# --- Tables of logs: what is around the rows, units in headers, decimal marks, encodings, expressions.


def read(tmp_path, text, map_, decimal="", encoding="utf-8"):
    (tmp_path / "log.csv").write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    said = read_map(map_, ("deg",) * 2)
    return columns_of(read_log(tmp_path / "log.csv", missing=missing_in(said)), said, decimal)


LAB = file_text("lab.csv")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_a_report_with_text_around_its_rows(tmp_path, encoding):
    got = read(tmp_path, LAB, "id=Point, j1=A1, x=X, u=u", encoding=encoding)
    assert got.cells["id"].tolist() == ["P1", "P2", "P3"]
    np.testing.assert_allclose(got.cells["j1"], np.radians([10, 20, 30]), atol=1e-12)
    np.testing.assert_allclose(got.cells["x"], [1.5e-3, 2.5e-4, 1.2345], atol=1e-12)
    np.testing.assert_allclose(got.cells["u"], [3e-6, 4e-6, 5e-6], atol=1e-15)
    assert got.line.tolist() == [5, 7, 9]
    notes = "\n".join(got.notes)
    assert "2 lines of log.csv before the header left out: 'Metrology report' (line 1)" in notes
    assert "1 repetitions of the header" in notes
    assert "2 lines of log.csv behind the last row left out: 'Total points: 3' (line 10)" in notes
    assert ("Windows-1252" in notes) == (encoding == "cp1252")


def test_units_in_a_row_below_the_header(tmp_path):
    got = read(tmp_path, "A1\tX\tnote\ndeg\tm\t-\n180\t2\tgood\n", "j1=A1, x=X")
    assert (got.cells["j1"][0], got.cells["x"][0]) == (pytest.approx(np.pi), 2.0)
    assert got.unused == ("note",)


def test_a_header_in_a_comment(tmp_path):
    """NumPy's savetxt writes it so."""
    got = read(tmp_path, "# made by a script\n# q1 q2\n1 2\n3 4\n", "j1=q1 rad, j2=q2 rad")
    np.testing.assert_array_equal(got.cells["j2"], [2, 4])


@pytest.mark.parametrize(("map_", "value"), [
    ("j1=a3 + a2 deg", np.radians(12.5)),
    ("j1=-(a3 - a2) / 2 + 1 deg", np.radians(-2.75)),
    ("j1=#1 - #2 deg", np.radians(7.5)),
    ("j1_deg=a3+a2", np.radians(12.5)),
    ("x={J 1} * 2 mm", 0.04),
    ("x=J 1 mm", 0.02),
    ("x_mm=J 1", 0.02),
    ("u=U95 / 2 mm", 1e-5),
    ("payload=2 kg", 2.0),
    ("payload_g=250", 0.25),
    ("length=1e2 + .5 mm", 0.1005),
    ("j1_degps=a2", np.radians(2.5)),
    ("temperature_c=a3", 10.0),
])  # fmt: skip
def test_expressions(tmp_path, map_, value):
    got = read(tmp_path, "a3,a2,J 1,U95\n10,2.5,20,0.02\n", map_)
    assert next(iter(got.cells.values())) == pytest.approx([value], abs=1e-12)


def test_texts_of_several_columns(tmp_path):
    got = read(tmp_path, "Group,Target\nA,1\nA,2\n", "id='{Group}.{Target}', target='leica', tool=Group")
    assert got.cells["id"].tolist() == ["A.1", "A.2"]
    assert got.cells["target"].tolist() == ["leica", "leica"]


@pytest.mark.parametrize(("text", "map_", "words"), cases("log_refusals"))
def test_refused(tmp_path, text, map_, words):
    if "left out" in words:  # a line at the end without a number: left out, and the note shows it
        assert "behind the last row left out: 'p2' (line 3)" in read(tmp_path, text, map_).notes[0]
        return
    refused(words, lambda: read(tmp_path, text, map_))


def test_a_decimal_comma_that_is_stated(tmp_path):
    assert read(tmp_path, "a;b\n1;2,500\n", "x=b mm", decimal="comma").cells["x"] == pytest.approx([2.5e-3])


@pytest.mark.parametrize(("content", "words"), [
    (b"\x81\x8d,1\n", "the encoding is not known"), ("a,b\n1,2\n".encode("utf-16-le"), "not a text file"),
])  # fmt: skip
def test_bytes_that_are_no_text(tmp_path, content, words):
    refused(words, lambda: read(tmp_path, content, "x=a mm"))


MIDNIGHT = [0.0, 1.5, 86399.25, 86401.0]
"""s after 2026-11-22 00:00:00."""


@pytest.mark.parametrize(("kind", "cells", "clock"), cases("time_stamps"))
def test_time_stamps(tmp_path, kind, cells, clock):
    got = read(tmp_path, "\n".join(["t;x", *(f"{cell};1" for cell in cells)]), f"time=t {kind}, x=x mm")
    time = got.cells["time"]
    np.testing.assert_allclose(time - time[0], MIDNIGHT, atol=1e-6)
    assert got.clock == clock
    if clock == "UTC":
        assert time[0] == pytest.approx(1795305600.0)


def test_times_of_day_count_on_over_any_number_of_nights(tmp_path):
    """Rows less than half a day apart, for more than a week."""
    steps = np.random.default_rng(0).integers(60, 43_000, 40)
    cells = [f"{s // 3600 % 24:02}:{s // 60 % 60:02}:{s % 60:02}" for s in np.cumsum(steps).tolist()]
    got = read(tmp_path, "\n".join(["t;x", *(f"{cell};1" for cell in cells)]), "time=t clock, x=x mm")
    np.testing.assert_allclose(np.diff(got.cells["time"]), steps[1:])


def test_date_and_time_in_two_columns(tmp_path):
    got = read(tmp_path, "Date,Time\n22.11.2026,10:00:00\n22.11.2026,10:00:02\n", "time={Date} {Time} dmy")
    assert np.diff(got.cells["time"]).tolist() == [2.0]


@pytest.mark.parametrize(("cells", "kind", "words"), cases("time_stamp_refusals"))
def test_no_time_stamps(tmp_path, cells, kind, words):
    with pytest.raises(BayescalError, match=words):
        read(tmp_path, "\n".join(["t;x", *(f"{cell};1" for cell in cells)]), f"time=t {kind}")


def test_the_header_that_a_message_shows(tmp_path):
    from bayescal.importing.log import header_of

    for text, header in (
        (LAB, ("Point", "A1 [deg]", "X [mm]", "u / µm")),
        ("1 2\n3 4\n", ()),
        ("a,b,\n1,2,\n", ("a", "b")),
    ):
        (tmp_path / "log.csv").write_text(text, encoding="utf-8")
        assert header_of(tmp_path / "log.csv") == header
