"""Logs in the layouts of makers, written from a known session, come back as that session.

Layouts: SpatialAnalyzer, manual, 'Exporting ASCII Formatted Points'; FANUC LS and POSREG.VA, as controllers
save them; KUKA DAT, E6AXIS; ABB RAPID reference manual, jointtarget; Universal Robots, csv_writer.py of the
RTDE client; RoboDK-API, calibration scripts (in test_import_logs.py). FARO CAM2, API and Renishaw RCS do not
publish the layout of their exports: these tests have columns that such exports state in their headers.
"""

import datetime
import sys
from dataclasses import replace

import numpy as np
import pytest
from made_up_logs import spatial_analyzer
from sessions import with_columns

from bayescal.dataset import Target, read_dataset, write_dataset
from bayescal.dataset.consistency import nominal
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert, write

ARM = "fanuc-lrmate200ic"
USUAL = {"robot": ARM, "noise": "10 um"}


@pytest.fixture(scope="module")
def tracked(tracker):
    """Forty rows called P1 to P40."""
    return with_columns(tracker(seed=3, count=40).dataset, ids=tuple(f"P{i + 1}" for i in range(40)))


@pytest.fixture
def seen(tracked, tmp_path):
    """The tracker's points, exported by SpatialAnalyzer."""
    return spatial_analyzer(tracked, tmp_path / "sa.txt", np.arange(40))


def same(got, data, atol=1e-9):
    rows = got.dataset.measurements
    assert rows.ids == data.measurements.ids
    np.testing.assert_allclose(rows.readings, data.measurements.readings, atol=atol)
    np.testing.assert_allclose(rows.xyz, data.measurements.xyz, atol=1e-9)
    assert got.wrong == ""


def digits(values):
    return [f"{v:.9f}".replace("0.", ".", 1) if abs(v) < 1 else f"{v:.9f}" for v in values]


def fanuc_ls(data):
    out = ["/PROG  CALIB", "/ATTR", 'COMMENT\t\t= "calibration";', "/MN"]
    out += ["   1:J P[1] 100% FINE    ;", "/POS"]
    for i, q in enumerate(np.degrees(data.measurements.readings), 1):
        j = digits(q)
        halves = (range(3), range(3, 6))
        first, second = (",\t".join(f"J{k + 1}= {j[k]} deg" for k in half) for half in halves)
        out += [f'P[{i}:"pose {i}"]{{', "   GP1:", "\tUF : 0, UT : 1,\t", f"\t{first},", f"\t{second}"]
        out += ["   GP2:", "\tUF : 0, UT : 1,\t", "\tJ1=   100.000  mm", "};"]
    out += ["P[99]{", "   GP1:", "\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',"]
    out += ["\tX =   450.0  mm,\tY = .0  mm,\tZ = 200.0  mm,", "\tW = .0 deg,\tP = .0 deg,\tR = .0 deg"]
    return "\r\n".join([*out, "};", "/END"])


def fanuc_va(data):
    out = ["[*POSREG*]$POSREG  Storage: CMOS  Access: RW  : ARRAY[1,100] OF Position Reg"]
    for i, q in enumerate(np.degrees(data.measurements.readings), 1):
        j = digits(q)
        out += [f"    [1,{i}] =   'pose {i}'   Group: 1"]
        named = [f"J{k + 1} =  {j[k]} deg" for k in range(6)]
        out += [f"  {'   '.join(some)} " for some in (named[:3], named[3:])] + [""]
    out += ["    [1,41] =   '' Uninitialized", "    [1,42] =   'home' "]
    out += ["  Group: 1   Config: N U T, 0, 0, 0"]
    out += ["  X:  -820.507   Y:  2309.503   Z:   945.836", "  W:    90.594   P:    -1.149   R:  -160.248"]
    return "\r\n".join(out)


def kuka_dat(data):
    out = ["&ACCESS RVP", "DEFDAT CALIB PUBLIC", "EXT BAS (BAS_COMMAND :IN,REAL :IN )"]
    for i, q in enumerate(np.degrees(data.measurements.readings), 1):
        joints = ",".join(f"A{k} {v:.9f}" for k, v in enumerate(q, 1))
        out.append(f"DECL E6AXIS P{i}={{{joints},E1 0.0,E2 0.0}}")
        out.append(f'DECL FDAT F{i}={{TOOL_NO 1,BASE_NO 0,POINT2[] " "}}')
    out += ["DECL E6POS XHOME={X 450.0,Y 0.0,Z 200.0,A 0.0,B 0.0,C 180.0,S 2,T 35,E1 0.0}"]
    out += [";DECL E6AXIS OLD={A1 1.0,A2 2.0,A3 3.0,A4 4.0,A5 5.0,A6 6.0}", "ENDDAT"]
    return "\r\n".join(out)


def abb_mod(data):
    out = ["MODULE Calib", "  ! CONST jointtarget old:=[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];"]
    for i, q in enumerate(np.degrees(data.measurements.readings), 1):
        joints = ",".join(f"{v:.9f}" for v in q)
        out += [f"  LOCAL CONST jointtarget P{i}:=[[{joints}],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];"]
    away = ",".join(["9E+09"] * 6)
    out.append(f"  CONST robtarget p10:=[[450,0,200],[0,1,0,0],[0,-1,0,1],[{away}]];")
    return "\n".join([*out, "ENDMODULE"])


LISTED = {"fanuc-ls": (fanuc_ls, "P"), "fanuc-va": (fanuc_va, "PR")}
LISTED |= {"kuka-dat": (kuka_dat, "P"), "abb-mod": (abb_mod, "P")}


@pytest.mark.parametrize("name", LISTED)
def test_positions_of_controllers_with_points_of_spatial_analyzer(tracked, seen, tmp_path, name):
    text, prefix = LISTED[name]
    log = tmp_path / "robot.txt"
    log.write_text(text(tracked), encoding="utf-8", newline="")
    by = {"pair": "id"} if prefix == "P" else {"pair": "row"}
    got = convert(Request(log, format=name, points=seen, points_map="mm", **by, **USUAL))
    same(got, with_columns(tracked, ids=tuple(f"{prefix}{i + 1}" for i in range(40))))
    assert any("1 Cartesian positions of robot.txt left out" in line for line in got.understood)


def test_listings_without_joints_are_refused(tracked, tmp_path):
    log = tmp_path / "robot.mod"
    log.write_text("CONST robtarget p:=[[4,0,2],[0,1,0,0],[0,-1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]];")
    words = r"no joint positions .1 Cartesian positions do not state the readings"
    with pytest.raises(BayescalError, match=words):
        convert(Request(log, format="abb-mod", **USUAL))
    log.write_text(kuka_dat(tracked).replace(",A6 ", ",B6 "), encoding="utf-8")
    with pytest.raises(BayescalError, match=r"^robot.mod:4: `P1` has 5 joints, the robot has 6"):
        convert(Request(log, format="kuka-dat", **USUAL))


def test_rtde_record_with_points_of_an_api_tracker(tracked, tmp_path):
    """A record every 0.5 s, separated by blanks; points with a time of day, in metres, and U95."""
    q = tracked.measurements.readings
    kinds = ("target_q", "actual_q", "actual_qd", "actual_TCP_pose")
    lines = [" ".join(["timestamp", *(f"{k}_{j}" for k in kinds for j in range(6))])]
    start = 12345.0  # s since the controller was started
    for k in range(8 * 40):
        row = [*q[k // 8].tolist() * 2, *[1e-4] * 6, *[0.1] * 6]
        lines.append(" ".join(map(repr, [start + 0.5 * k, *row])))
    log = tmp_path / "rtde.csv"
    log.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8")
    points = ["API export;;;;;", "No.;X [m];Y [m];Z [m];U95 [µm];Elapsed [s]"]
    for i, xyz in enumerate(tracked.measurements.xyz.tolist()):
        cells = [f"{v:.12f}".replace(".", ",") for v in xyz]
        points.append(";".join([f"P{i + 1}", *cells, "24,5", f"{start + 4 * i + 1.7:.1f}".replace(".", ",")]))
    points.append("Temperature: 20,1;;;;;")
    (tmp_path / "api.csv").write_bytes("\r\n".join(points).encode("cp1252"))
    map_ = "id=No., x=X, y=Y, z=Z, u=U95 / 2, time=Elapsed"
    given = {"points": tmp_path / "api.csv", "points_map": map_, "pair": "time:0.3 s", "robot": ARM}
    got = convert(Request(log, format="ur-rtde", **given))
    same(got, tracked)
    rows = got.dataset.measurements
    np.testing.assert_allclose(rows.u, 12.25e-6, rtol=1e-12)
    assert rows.velocity is None
    np.testing.assert_allclose(rows.time, 4.0 * np.arange(40), atol=1e-6)
    np.testing.assert_array_equal(rows.command, rows.readings)


def test_points_in_the_columns_of_faro(tracked, tmp_path):
    """A header with units, a row of statistics, and names in two columns; joints logged by KRL's CWRITE."""
    q = np.degrees(tracked.measurements.readings)
    log = tmp_path / "krl.log"
    axes = [" ".join(f"A{k} {v:.9f}" for k, v in enumerate(a, 1)) for a in q]
    stamped = [f"point {i + 1} at 2026-11-22 10:{i:02d}:00.50 {a}" for i, a in enumerate(axes)]
    log.write_text("\n".join(stamped), encoding="utf-8")
    rows = ['"Feature","Reading","X (mm)","Y (mm)","Z (mm)","RMS (mm)","Samples"']
    for i, xyz in enumerate(1e3 * tracked.measurements.xyz, 1):
        rows.append(f'"P",{i},{",".join(f"{v:.9f}" for v in xyz)},0.0041,500')
    (tmp_path / "faro.csv").write_text("\n".join(rows), encoding="utf-8-sig")
    joints = ", ".join(f"j{k}=#{2 * k + 5} deg" for k in range(1, 7))
    given = {"points": tmp_path / "faro.csv", "points_map": "id={Feature}{Reading}, x=X, y=Y, z=Z"}
    got = convert(Request(log, f"id=P{{#2}}, time={{#4}} {{#5}} iso, {joints}", pair="id", **given, **USUAL))
    same(got, tracked)
    np.testing.assert_allclose(got.dataset.measurements.time, 60.0 * np.arange(40), atol=1e-6)


def test_lengths_of_a_ball_bar(tracked, tmp_path):
    """Lengths from a pivot, as a telescoping bar reads them, with joints in one table in French format."""
    pivot = np.array([0.4, 0.0, 0.05])
    bar = Target("bar", "distance", {"centre": pivot, "length": np.nan})
    data = replace(tracked, targets=(bar,), noise=replace(tracked.noise, contact=1e-5))
    data = with_columns(data, xyz=None, time=None, rpy=None)
    length = np.linalg.norm(nominal(data, data.measurements.readings) - pivot, axis=1)
    data = with_columns(data, length=length)
    write_dataset(data, tmp_path / "template")
    q = np.degrees(data.measurements.readings)
    lines = ["Mesure;" + ";".join(f"Axe {j} (°)" for j in range(1, 7)) + ";Longueur (mm);Température (°C)"]
    for i in range(40):
        numbers = [*q[i], 1e3 * length[i], 20.5]
        lines.append(";".join([f"P{i + 1}", *(f"{v:.9f}".replace(".", ",") for v in numbers)]))
    (tmp_path / "log.csv").write_bytes("\n".join(lines).encode("latin-1"))
    map_ = "id=Mesure, j*={Axe *}, length=Longueur, temperature=Température"
    got = convert(Request(tmp_path / "log.csv", map_, template=tmp_path / "template"))
    rows = got.dataset.measurements
    np.testing.assert_allclose(rows.readings, data.measurements.readings, atol=1e-9)
    np.testing.assert_allclose(rows.length, length, atol=1e-9)
    np.testing.assert_allclose(rows.temperature, 20.5)
    write(got, tmp_path / "out")
    assert len(read_dataset(tmp_path / "out").measurements.ids) == 40


def book(path, sheets):
    import openpyxl

    work = openpyxl.Workbook()
    work.remove(work.active)
    for name, rows in sheets.items():
        sheet = work.create_sheet(name)
        for row in rows:
            sheet.append(row)
    work.save(path)
    return path


def sheet_rows(data):
    start = datetime.datetime(2026, 11, 22, 10)
    joints = [f"A{j} [deg]" for j in range(1, 7)]
    rows = [["Laser tracker session"], [], ["Point", "Time", *joints, "X [mm]", "Y [mm]", "Z [mm]", "Remark"]]
    m = data.measurements
    for i in range(40):
        numbers = [*np.degrees(m.readings[i]), *(1e3 * m.xyz[i])]
        when, remark = start + datetime.timedelta(seconds=30 * i), "ok" if i % 9 == 0 else None
        rows.append([m.ids[i], when, *map(float, numbers), remark])
    return [*rows, ["Sum of points", 40]]


BOOK = "id=Point, time=Time iso, j*=A*, x=X, y=Y, z=Z"


def test_a_workbook(tracked, tmp_path):
    path = book(tmp_path / "s.xlsx", {"Notes": [], "Data": sheet_rows(tracked)[:-1]})
    got = convert(Request(path, BOOK, **USUAL))
    same(got, tracked)
    np.testing.assert_allclose(got.dataset.measurements.time, 30.0 * np.arange(40), atol=1e-6)
    assert any("sheet `Data` of s.xlsx" in line for line in got.understood)
    words = "before the header left out: 'Laser tracker session' (line 1)"
    assert any(words in line for line in got.understood)
    assert convert(Request(tmp_path / "s.xlsx#Data", BOOK, **USUAL)).dataset.name.startswith("s")


def test_workbooks_that_are_refused(tracked, tmp_path, monkeypatch):
    def refused(name, words):
        with pytest.raises(BayescalError, match=f"^{words}"):
            convert(Request(tmp_path / name, BOOK, **USUAL))

    book(tmp_path / "two.xlsx", {"A": sheet_rows(tracked)[:-1], "B": [[1]]})
    refused("two.xlsx", "two.xlsx: 2 sheets with rows; name one: `two.xlsx#A`; there are A, B")
    refused("two.xlsx#C", "two.xlsx: no sheet `C`; there are A, B")
    rows = sheet_rows(tracked)[:-1]
    rows[5][8] = "=I5 + 1"
    book(tmp_path / "f.xlsx", {"A": rows})
    refused("f.xlsx", r"f.xlsx:6: a formula without a value: =I5 \+ 1; open and save it")
    (tmp_path / "no.xlsx").write_text("a,b\n1,2\n", encoding="utf-8")
    refused("no.xlsx", "no.xlsx: not a workbook")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    refused("two.xlsx", "two.xlsx: workbooks need the package openpyxl; install it: `pip")
