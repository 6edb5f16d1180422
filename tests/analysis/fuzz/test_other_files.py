"""Files beside a dataset: classes that once gave a traceback, waited for ever or lost rows."""

import io
import json
import os
import re
import zipfile

import pytest
from cases import refused

from analysis.fuzz.commands import command
from bayescal.compensating import compensate_file
from bayescal.errors import BayescalError
from bayescal.exporting import offsets
from bayescal.exporting.mjcf.scene_arm import read_scene
from bayescal.fitted.file import read_arm
from bayescal.importing import log
from bayescal.importing.log import sheet_lines
from bayescal.reporting.page.build import write_report
from bayescal.robots import load_robot
from bayescal.robots.tree import MOST
from bayescal.storage.folders import LIST, check_unchanged
from bayescal.storage.reading import read_json

ROBOT = '<robot name="a"><link name="root"/>{}</robot>'


def chain(count: int) -> str:
    """Fixed joints in a row."""
    return "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="fixed"><parent link="{f"l{k - 1}" if k else "root"}"/>'
        f'<child link="l{k}"/></joint>'
        for k in range(count)
    )


@pytest.mark.parametrize(("text", "words"), [
    (ROBOT.format("<link>" * 300 + "</link>" * 300), "arm.urdf: more than 200 levels"),
    (ROBOT.format("<x/>" * 50_001), "arm.urdf: more than 50000 elements"),
    (ROBOT.format(chain(MOST)), f"has {2 * MOST + 1} links and joints, at most {MOST} are read"),
    ('<?xml version="1.0" encoding="nowhere"?><robot/>', "arm.urdf:1: not XML"),
    (ROBOT.format('<joint name="j" type="fixed"><parent link="inf"/><child link="root"/></joint>'),
     "joint `j` names a link `inf` that is not there"),
    (ROBOT.format('<joint name="j" type="fixed"><parent link="root"/><axis/></joint>'), "not a URDF"),
    (ROBOT.format('<link name="a"><inertial><mass value="1e308"/></inertial></link>'),
     "the mass of `a` has the number 1e+308; no arm has more than 1e+06"),
    (ROBOT.format('<joint name="j" type="continuous"><parent link="root"/><child link="a"/>'
                  '<axis xyz="0 0 1e308"/></joint><link name="a"/>'),
     "the axis of `j` has the number 1e+308; no arm has more than 10000"),
    (ROBOT.format('<joint name="j" type="nan"><parent link="root"/><child link="a"/></joint>'),
     "joint `j` has the type `nan`; known: revolute"),
], ids=["levels", "elements", "links", "encoding", "link", "axis", "mass", "long axis", "type"])  # fmt: skip
def test_a_robot_in_xml_that_is_refused(tmp_path, text, words):
    (tmp_path / "arm.urdf").write_text(text)
    refused(re.escape(words), lambda: load_robot(str(tmp_path / "arm.urdf")))


def test_an_included_pipe_is_not_waited_for(tmp_path):
    space = 'xmlns:xacro="http://ros.org/wiki/xacro"'
    (tmp_path / "arm.xacro").write_text(f'<robot name="a" {space}><xacro:include filename="part"/></robot>')
    os.mkfifo(tmp_path / "part")
    refused("part is not a regular file", lambda: load_robot(str(tmp_path / "arm.xacro"), allow_xacro=True))


@pytest.mark.parametrize(("text", "words"), [
    ("<mujoco/>", "has no <worldbody>"),
    ("<mujoco><worldbody>" + "<body>" * 300 + "</body>" * 300 + "</worldbody></mujoco>", "more than 200"),
    ('<!DOCTYPE a [<!ENTITY b "c">]><mujoco/>', "has a DOCTYPE"),
])  # fmt: skip
def test_a_scene_that_is_refused(tmp_path, text, words):
    (tmp_path / "scene.xml").write_text(text)
    refused(words, lambda: read_scene(tmp_path / "scene.xml"))


def test_text_around_a_scene_is_kept_whatever_it_says(tmp_path):
    before, behind = "<!-- <mujoco> µ -->\n", "\n<!-- </mujoco> -->\n"
    text = f'{before}<mujoco model="a>b"><worldbody/></mujoco>{behind}'
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    scene = read_scene(tmp_path / "scene.xml")
    assert scene.xml.text == text
    scene.root.set("model", "b")
    assert scene.xml.text == text.replace("a>b", "b")


@pytest.mark.parametrize(("text", "words"), [
    ("kinematics: " + "[" * 20_000, "more than 30 levels"),
    ("kinematics:\n" + "".join(
        f"  {link}: {{x: .nan, y: 0, z: 0, roll: 0, pitch: 0, yaw: nan}}\n" for link in offsets.LINKS
    ) + "  hash: a\n", "no calibration of ur_robot_driver"),
], ids=["levels", "nan"])  # fmt: skip
def test_a_calibration_of_a_ur_that_is_refused(tmp_path, text, words):
    (tmp_path / "mine.yaml").write_text(text)
    refused(words, lambda: offsets._read(str(tmp_path / "mine.yaml")))


@pytest.mark.parametrize("name", [LIST, "fit.json"])
def test_a_pipe_in_a_run_folder_is_not_waited_for(tmp_path, name):
    (tmp_path / LIST).write_text('{"schema": "bayescal-files/1", "files": {"fit.json": "0"}}')
    (tmp_path / "fit.json").write_text("{}")
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    if name == LIST:
        check_unchanged(tmp_path, ["fit.json"])
    else:
        refused(r"fit\.json was changed", lambda: check_unchanged(tmp_path, ["fit.json"]))


def test_a_changed_record_gets_no_page(tmp_path):
    (tmp_path / LIST).write_text('{"schema": "bayescal-files/1", "files": {"fit.json": "0"}}')
    (tmp_path / "fit.json").write_text('{"schema": "bayescal-fit/1"}')
    with pytest.raises(BayescalError, match=r"fit\.json was changed or removed after the run"):
        write_report([tmp_path], tmp_path / "page.html", False)


def test_a_record_with_missing_entries_is_refused(tmp_path):
    (tmp_path / "fit.json").write_text('{"schema": "bayescal-fit/1", "dataset": true}')
    refused("incomplete record", lambda: write_report([tmp_path], tmp_path / "page.html", False))


def test_an_integer_of_400_digits_is_refused(tmp_path):
    (tmp_path / "arm.json").write_text(f'{{"a": {10**400}}}')
    refused("invalid JSON: 1000", lambda: read_json(tmp_path / "arm.json", ""))


def rezipped(path, change) -> None:
    """Write a workbook with its sheet changed."""
    with zipfile.ZipFile(path) as old:
        parts = {name: old.read(name) for name in old.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name, part in parts.items():
            new.writestr(name, change(part) if name.startswith("xl/worksheets/") else part)


@pytest.fixture
def book(tmp_path):
    import openpyxl

    work = openpyxl.Workbook()
    for row in range(4):
        work.active.append([row, 2.5])
    work.save(tmp_path / "log.xlsx")
    return tmp_path / "log.xlsx"


def test_rows_outside_the_stated_extent_of_a_sheet_are_read(book):
    rezipped(book, lambda part: re.sub(rb'<dimension ref="[^"]*"', b'<dimension ref="A1:A1"', part))
    assert [cells for _, cells in sheet_lines(book).kept] == [(str(k), "2.5") for k in range(4)]


def test_a_sheet_that_is_small_only_while_compressed_is_refused(book, monkeypatch):
    monkeypatch.setattr(log, "LARGEST", 10**6)
    cells = b"".join(b'<row r="%d"><c r="XFD%d"><v>1</v></c></row>' % (k, k) for k in range(1, 200))
    rezipped(
        book, lambda part: re.sub(rb"<sheetData>.*</sheetData>", b"<sheetData>%s</sheetData>" % cells, part)
    )
    refused("more than 3 million cells", lambda: sheet_lines(book))
    rezipped(book, lambda part: part + b" " * 2_000_000)
    refused("2 MB when unpacked", lambda: sheet_lines(book))


def test_a_damaged_workbook_is_refused(book):
    content = bytearray(book.read_bytes())
    with zipfile.ZipFile(io.BytesIO(content)) as parts:
        at = next(p.header_offset for p in parts.infolist() if "sheet1" in p.filename)
    content[at + 60 : at + 120] = b"\xff" * 60
    book.write_bytes(content)
    refused(r"log\.xlsx: not a workbook", lambda: sheet_lines(book))


def written(folder):
    """The run folder of a fit, and a table of targets."""
    for name, content in command("targets")[0].items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def changed_arm(record, key):
    """Entries of arm.json that no program wrote."""
    rows = [list(row) for row in record["covariance_si"]]
    rows[1][2] = 2**63
    negative = [[-value if i == j == 0 else value for j, value in enumerate(row)]
                for i, row in enumerate(record["covariance_si"])]  # fmt: skip
    return {
        "no table": record | {"targets_si": 3},
        "no list": record | {"parameters": [3]},
        "not symmetric": record | {"covariance_si": rows},
        "negative": record | {"covariance_si": negative},
        "too few": record | {"covariance_si": rows[1:]},
    }[key]


@pytest.mark.parametrize(("key", "words"), [
    ("no table", "incomplete"),
    ("no list", "incomplete"),
    ("not symmetric", "`covariance_si` is no covariance"),
    ("negative", "`covariance_si` is no covariance"),
    ("too few", "incomplete"),
])  # fmt: skip
def test_an_arm_that_was_changed_is_refused(tmp_path, key, words):
    written(tmp_path)
    path = tmp_path / "run" / "arm.json"
    record = json.loads(path.read_text())
    assert len(read_arm(tmp_path / "run").values) == len(record["parameters"])
    path.write_text(json.dumps(changed_arm(record, key)))
    refused(rf"arm\.json: .*{words}", lambda: read_arm(tmp_path / "run"))


def test_a_table_of_a_robot_program_names_its_file_and_line(tmp_path):
    written(tmp_path)
    (tmp_path / "t.csv").write_text("1,2,3,4,5,6\nx_mm,y_mm\n")
    with pytest.raises(BayescalError, match=r"t\.csv, line 2: the first 6 cells are not numbers"):
        compensate_file(read_arm(tmp_path / "run"), tmp_path / "t.csv", format_="robodk")
