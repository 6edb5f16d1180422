"""Tables and programs as files: columns, messages with line and column, and nothing half written."""

import csv
from dataclasses import replace

import numpy as np
import program_texts as programs
import pytest
from cases import refused
from compensate_arms import arm_with

from bayescal.compensating import compensate_file
from bayescal.compensating.position import positions
from bayescal.errors import BayescalError
from bayescal.fitted.file import write_arm
from bayescal.fitted.gate import Use
from bayescal.programs.tools import nominal_arm
from bayescal.public.arms import CompensationResult

POSES = "id,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg,note\n"
ROWS = 'a,450,0,200,180,0,0,"one, two"\nb,450,60,200,180,10,30,\nc,1450,0,150,170,0,90,far\n'


@pytest.fixture(scope="module")
def session(cube):
    return cube(seed=1, count=40).dataset


@pytest.fixture(scope="module")
def arm(session):
    return arm_with(("geometry",), session)


def table(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def read(content):
    return list(csv.DictReader(content.decode().splitlines()))


def degrees(rows, form):
    return np.radians([[float(r[form.format(k)]) for k in range(1, 7)] for r in rows])


def check_units(arm, rows, goals, found):
    """Columns in the units of their names: of the arm at the written readings, for goals (C, 3), m."""
    readings, tool = degrees(rows, "j{}_deg"), arm.dataset.tools[0].name
    there = positions(arm, readings, tool=tool)
    np.testing.assert_allclose(there.poses[:, :3, 3], goals, atol=2e-8)
    before = arm.at(np.array([own.nominal for own in found]), tool=tool).points
    for column, values in (
        ("u_mm", there.uncertain.u),
        ("U_mm", there.uncertain.expanded),
        ("error_mm", np.linalg.norm(before - goals, axis=1)),
    ):
        np.testing.assert_allclose([float(r[column]) for r in rows], 1e3 * values, rtol=1e-4, atol=6e-6)
    assert [r["inside_probed_region"] for r in rows] == [str(x).lower() for x in there.inside.tolist()]


def test_columns_are_kept_and_corrected_readings_added(arm, tmp_path):
    done = compensate_file(arm, table(tmp_path / "t.csv", POSES + ROWS))
    rows = read(done.text)
    assert [r["id"] for r in rows] == ["a", "b", "c"]
    assert rows[0]["note"] == "one, two"
    added = "j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg,u_mm,inside_probed_region,reason,error_mm,solutions"
    assert done.text.decode().splitlines()[0] == f"{POSES.strip()},{added},U_mm,verdict"
    shown = CompensationResult(arm, done)
    for column, values in (("u_mm", shown.u), ("U_mm", shown.U)):
        np.testing.assert_allclose([float(row[column] or np.nan) for row in rows], 1e3 * values, rtol=1e-4)
    np.testing.assert_allclose(degrees(rows[:2], "j{}_deg"), shown.readings[:2], atol=1e-8)
    assert np.isnan(shown.readings[2]).all()
    check_units(arm, rows[:2], np.array([[0.45, 0, 0.2], [0.45, 0.06, 0.2]]), done.corrected[:2])
    assert [int(r["solutions"]) for r in rows[:2]] == [own.solutions for own in done.corrected[:2]]
    assert rows[2]["reason"].startswith("out of reach")
    assert [rows[2][k] for k in ("j1_deg", "u_mm", "inside_probed_region")] == ["", "", ""]


def test_nominal_readings_are_kept_under_another_name(arm, session, tmp_path):
    q = np.degrees(session.measurements.readings[:2])
    header = ",".join(f"j{k}_deg" for k in range(1, 7))
    text = "\r\n".join([header + ",payload_kg", *(",".join(map(str, row)) + ",0.5" for row in q), ""])
    done = compensate_file(arm, table(tmp_path / "t.csv", text))
    assert b"\r\n" in done.text
    rows = read(done.text)
    assert float(rows[0]["j1_nominal_deg"]) == pytest.approx(q[0, 0])
    assert abs(float(rows[0]["j1_deg"]) - q[0, 0]) > 1e-6
    assert done.targets[0].payload == 0.5
    assert rows[0]["solutions"] == ""  # none was searched


@pytest.mark.parametrize(("text", "message"), [
    (POSES.replace("rz_deg", "rz_rad") + ROWS, r"t\.csv:1: column `rz_rad` has a wrong unit; write `rz_deg`"),
    (POSES.replace(",rz_deg", "") + ROWS, r"t\.csv:1: column `rz_deg` is missing; give all of x_mm"),
    (POSES + "a,450,0,2oo,180,0,0,\n", r"t\.csv:2: `z_mm` is not a number: '2oo'"),
    (POSES + "a,450,,200,180,0,0,\n", r"t\.csv:2: `y_mm` is empty; fill the cell in"),
    ("\n", r"t\.csv: there are no targets"),
    (POSES + "a,450,0,200,180,0,0\n", r"t\.csv:2: 7 cells, the header has 8"),
    (POSES, r"t\.csv:1: no rows below the header"),
    (POSES.replace("note", "u_mm") + ROWS, "column `u_mm` is written by a compensation"),
    ("id,note_mm\na,1\n", "the table has neither poses nor joints"),
    (POSES.replace("note", "tool") + "a,450,0,200,180,0,0,pen\n", r"there is no tool `pen`; tools: ball"),
    (POSES.replace("note", "payload_kg") + "a,450,0,200,180,0,0,-1\n", r"t\.csv:2: `payload_kg` is -1"),
])  # fmt: skip
def test_bad_tables(arm, tmp_path, text, message):
    refused(message, lambda: compensate_file(arm, table(tmp_path / "t.csv", text)))


def test_a_payload_or_a_time_that_is_no_number_is_refused(arm, tmp_path):
    source = table(tmp_path / "t.csv", POSES + ROWS)
    for state, option in (({"payload": np.nan}, "--payload-kg"), ({"time": np.inf}, "--at-time-s")):
        with pytest.raises(BayescalError, match=f"{option}: is not a finite number"):
            compensate_file(arm, source, **state)


OF_PROGRAM = {"fanuc": {"tool": "ball"}, "urscript": {"tcp": np.array([0, 0, 0.1, 0, 0, 0])}}
"""The tool of a program, where it is not that of the session."""


@pytest.mark.parametrize("name", ["fanuc", "abb", "robodk", "urscript"])
def test_a_program_is_corrected_in_place(arm, tmp_path, name):
    suffix = {"fanuc": ".LS", "abb": ".mod", "robodk": ".csv", "urscript": ".script"}[name]
    source = table(tmp_path / f"prog{suffix}", getattr(programs, name.upper()))
    done = compensate_file(arm, source, payload=2.5, **OF_PROGRAM.get(name, {}))
    assert done.format == name
    assert {t.payload for t in done.targets} == {2.5}
    assert done.text != source.read_bytes()
    assert len(done.text.splitlines()) == len(source.read_bytes().splitlines())
    assert done.save(tmp_path / "out") == ("out", "out.positions.csv")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["out", "out.positions.csv", source.name])
    rows = read((tmp_path / "out.positions.csv").read_bytes())
    flange = nominal_arm(arm.dataset.robot, arm.dataset.tools[0])
    goals = [
        t.pose[:3, 3] if t.pose is not None else flange.tool_poses(flange.frames(t.readings[None]))[0, :3, 3]
        for t in done.targets
    ]
    for row, own in zip(rows, done.corrected, strict=True):
        np.testing.assert_allclose(degrees([row], "j{}_nominal_deg")[0], own.nominal, atol=1e-8)
    if "tcp" not in OF_PROGRAM.get(name, {}):
        check_units(arm, rows, np.array(goals), done.corrected)
    # the targets of the corrected program are the corrected ones
    again = compensate_file(arm, tmp_path / "out", format_=name, **OF_PROGRAM.get(name, {}))
    for own, target in zip(done.corrected, again.targets, strict=True):
        if target.pose is not None:
            np.testing.assert_allclose(target.pose, own.pose, atol=2e-7)
        else:
            np.testing.assert_allclose(target.readings, own.readings, atol=2e-7)


def test_files_of_the_user_are_not_overwritten(arm, tmp_path):
    """Neither the corrected file nor the table of positions; the same content again is no change."""
    done = compensate_file(arm, table(tmp_path / "prog.LS", programs.FANUC), tool="ball")
    out, listed = tmp_path / "out.LS", tmp_path / "out.LS.positions.csv"
    for path in (out, listed):
        path.write_bytes(b"of the user")
        refused(f"{path.name}: exists with another content; give another", lambda: done.save(out))
        assert path.read_bytes() == b"of the user"
        assert {p.name for p in tmp_path.iterdir()} == {"prog.LS", path.name}
        path.unlink()
    done.save(out)
    done.save(out)
    assert out.read_bytes() == done.text


def test_a_program_in_another_frame_must_say_which(arm, tmp_path):
    framed = programs.FANUC.replace(b"UF : 0, UT : 1,\t\tCONFIG", b"UF : 2, UT : 1,\t\tCONFIG")
    source = table(tmp_path / "prog.ls", framed)
    message = r"prog\.ls: its poses are not in the frame of the base \(line 9, P\[1"
    refused(message, lambda: compensate_file(arm, source))
    assert compensate_file(arm, source, frame="base", tool="ball").corrected


TOOLS = [
    ("fanuc", {}, r"prog\.ls, line 9, P\[1\]: the pose of its tool is not in the program \(UT : 1\)"),
    ("kuka", {}, r"line 4: its tool \(\$TOOL={X .*\) is 53.9 mm and 0 deg away from `ball`; give "
     r"--tcp=10,0,100,0,0,0"),
    ("urscript", {}, r"line 3: its tool \(set_tcp\(p\[.*\) is 63.2 mm and 0 deg away from `ball`"),
    ("urscript", {"tcp": np.array([0, 0, 0.1, 0, 0, 0.2])}, r"is 0 mm and 11.5 deg away from `tcp`"),
    ("two_tools", {"tool": "ball"}, r"the program has several tools \(UT : 1, UT : 2\)"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "options", "message"), TOOLS)
def test_a_program_with_another_tool_is_refused(arm, tmp_path, name, options, message):
    two = programs.FANUC.replace(b"/MN\r\n", b"/MN\r\n   0:  UTOOL_NUM=2 ;\r\n")
    source = table(tmp_path / "prog.ls", two if name == "two_tools" else getattr(programs, name.upper()))
    with pytest.raises(BayescalError, match=message):
        compensate_file(arm, source, format_="fanuc" if name == "two_tools" else name, **options)


def test_a_position_that_is_not_used_stops_nothing(arm, tmp_path):
    far = programs.FANUC.replace(b"450.000", b"4500.000")
    source = table(tmp_path / "prog.ls", far)
    refused(r"P\[1\]: no solution: out of reach", lambda: compensate_file(arm, source, tool="ball"))
    source.write_bytes(far.replace(b"L P[1:start]", b"L PR[1]"))
    done = compensate_file(arm, source, tool="ball")
    assert done.notes[0] == "prog.ls, line 9, P[1]: not used by the program, and without solution; kept"
    assert b"X =   4500.000  mm" in done.text
    rows = read(done.positions)
    assert [bool(r["j1_deg"]) for r in rows] == [True, False]
    assert rows[1]["reason"].startswith("out of reach")


def test_a_warning_stands_in_every_file(arm, tmp_path):
    source = table(tmp_path / "prog.ls", programs.FANUC)
    done = compensate_file(arm, source, tool="ball", warning="not calibrated")
    assert b"\r\n   1:  !not calibrated ;\r\n   2:J P[2]" in done.text.replace(b"   1:J", b"   2:J")
    assert {r["verdict"] for r in read(done.positions)} == {"not calibrated"}
    done = compensate_file(arm, table(tmp_path / "t.csv", POSES + ROWS), warning="not calibrated")
    assert {r["verdict"] for r in read(done.text)} == {"not calibrated"}


def test_files_that_are_no_targets(arm, tmp_path):
    for name, text, message in (
        ("a.txt", "x", r"no format has files named \*\.txt; give --format: csv, urscript, fanuc"),
        ("a.script", "def a():\nend\n", "there are no positions of URScript"),
    ):
        with pytest.raises(BayescalError, match=message):
            compensate_file(arm, table(tmp_path / name, text))
    refused("no such file", lambda: compensate_file(arm, tmp_path / "none.csv"))
    with pytest.raises(BayescalError, match="there is no format `x`"):
        compensate_file(arm, table(tmp_path / "t.csv", POSES + ROWS), format_="x")


def test_the_command(arm, tmp_path, command, error_of, output_of):
    """The table beside it stays as it was where a target is wrong; the summary has no traceback."""
    run = tmp_path / "run"
    run.mkdir()
    write_arm(arm, run)
    source, out = table(tmp_path / "t.csv", POSES + ROWS), tmp_path / "out.csv"
    text = output_of("compensate", str(run), str(source), "--out", str(out))
    assert "out of reach" in text
    assert len(read(out.read_bytes())) == 3
    far = table(tmp_path / "far.csv", POSES + "a,4000,0,200,180,0,0,\n")
    code, text, error = command("compensate", str(run), str(far), "--out", str(tmp_path / "far-out.csv"))
    assert (code, "out of reach" in text, "far-out.csv: no target has a solution" in error) == (1, True, True)
    table(source, POSES + "a,450,,200,180,0,0,\n")
    before = out.read_bytes()
    error_of("compensate", run, source, "--out", out)
    assert out.read_bytes() == before
    assert "the output would replace the targets" in error_of("compensate", run, source, "--out", source)


def test_the_tool_and_the_verdict_by_the_command(arm, tmp_path, error_of, output_of):
    """--tcp is in mm and deg; a bad verdict is in the first line and the file; a failed fit needs --force."""
    run, source = tmp_path / "run", table(tmp_path / "p.script", programs.URSCRIPT)
    told = Use((), ("verdict of the fit: not validated",), left_out=("step is named, not confirmed",))
    run.mkdir()
    write_arm(replace(arm, use=told), run)
    tcp = ("--tcp", "0,0,100,0,0,0")
    text = output_of("compensate", run, source, "--out", tmp_path / "o.script", *tcp)
    assert text.splitlines()[0].split() == ["warning", "verdict", "of", "the", "fit:", "not", "validated"]
    assert "step is named, not confirmed" in text
    assert b"\n  # verdict of the fit: not validated\n" in (tmp_path / "o.script").read_bytes()
    error = error_of("compensate", run, source, "--out", tmp_path / "b.script", "--tcp", "0,0,100")
    assert "--tcp: `0,0,100` is not six numbers; give X,Y,Z,RX,RY,RZ in mm and deg" in error
    error = error_of("compensate", run, source, "--out", tmp_path / "b.script", *("--tcp", "0,0,100,0,0,2"))
    assert "is 0 mm and 2 deg away from `tcp`" in error
    failed = tmp_path / "failed"
    failed.mkdir()
    write_arm(replace(arm, use=Use(("the sampler did not converge",))), failed)
    options = (failed, source, "--out", tmp_path / "c.script", *tcp)
    assert "not compensated: the sampler did not converge" in error_of("compensate", *options)
    text = output_of("compensate", *options, "--force")
    assert "not to be used: the sampler did not converge" in " ".join(text.split())
    assert b"# not to be used: the sampler" in (tmp_path / "c.script").read_bytes()
