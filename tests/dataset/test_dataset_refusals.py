"""Every refusal names the file, the line and the remedy: one spoilt line at a time."""

import re

import pytest
from cases import cases
from tiny_dataset import HEADER, SETTINGS, TABLE, line_of, write

from bayescal.dataset import read_dataset
from bayescal.errors import BayescalError

SPOILT_SETTINGS = cases("dataset_refusals")


def cell(row: str, column: str, value: str) -> tuple[str, str]:
    """A row of the table, and the same with one cell changed."""
    old = TABLE.splitlines()[line_of(TABLE, f"\n{row},")]
    cells = old.split(",")
    cells[HEADER.split(",").index(column)] = value
    return old, ",".join(cells)


SPOILT_TABLE = [
    (*cell("t2", "id", "t1"), 3, "id `t1` is given twice; the first is in line 2"),
    (*cell("t2", "id", ""), 3, "`id` is empty"),
    (*cell("t2", "role", "fit"), 3, "unknown role 'fit'"),
    (*cell("t2", "target", "tip"), 3, "is it `top`"),
    (*cell("t2", "target", "elsewhere"), 3, "add it to `targets`"),
    (*cell("t2", "target", ""), 3, "`target` is empty"),
    (*cell("t2", "tool", "bal"), 3, "is it `ball`"),
    (*cell("t2", "tool", ""), 3, "`tool` is empty"),
    (*cell("t2", "tool", "mirror"), 3, "has no ball; add `ball_radius_mm`"),
    (*cell("t2", "j3_deg", ""), 3, "`j3_deg` is empty"),
    (*cell("t2", "j3_deg", "nan"), 3, "`j3_deg` is nan"),
    (*cell("t2", "j3_deg", "-inf"), 3, "not a finite number"),
    (*cell("t2", "j3_deg", "1_0"), 3, "not a number: '1_0'"),
    (*cell("t2", "j3_deg", "12°"), 3, "not a number: '12°'"),
    (*cell("t2", "j2_deg", "160"), 3, "J2 is at 160 deg, its limits are -60 to 140 deg; check the reading"),
    (*cell("t2", "j3_deg", "-175"), 3, "impossible contact"),
    (*cell("t2", "j3_deg", "-190"), 3, "J3 is at -160.272 deg"),
    (*cell("t2", "j5_deg", "49.2"), 3, "impossible contact"),
    (*cell("s3", "j1_deg", "-30"), 8, "impossible contact"),
    (*cell("t2", "x_mm", "1"), 3, "`x_mm` is given, but `top` is no instrument"),
    (*cell("i2", "y_mm", ""), 17, "`y_mm` is empty"),
    (*cell("i2", "y_mm", "nan"), 17, "`y_mm` is nan"),
    (*cell("i3", "y_mm", "29.8"), 18, "impossible reading"),
    (*cell("t2", "length_mm", "1"), 3, "no distance"),
    (*cell("b2", "length_mm", ""), 15, "distance `wire` has no `length_mm`"),
    (*cell("b2", "length_mm", "-300"), 15, "`length_mm` is -300"),
    (*cell("c2", "u_mm", "0"), 11, "must be more than 0"),
    (*cell("c2", "time_s", ""), 11, "`time_s` is empty"),
    (*cell("c2", "temperature_c", "warm"), 11, "not a number"),
    (*cell("c2", "payload_kg", "-1"), 11, "`payload_kg` is -1"),
    ("t2,calibrate,top", "t2,calibrate,top,", 3, "20 cells, the header has 19"),
    ("t2,calibrate,top", '"t2,calibrate,top', None, "not CSV|cells"),
    ("t2,calibrate,top,ball,0.983", "t2,calibrate,top,ball,0,983", 3, "dot"),
    ("j6_deg", "j6", 1, "`j6` has no unit in its name; write `j6_deg`"),
    ("j6_deg", "j6_rad", 1, "`j6_rad` has a wrong unit; write `j6_deg`"),
    ("j6_deg", "j7_deg", 1, "`j7_deg`, but the robot has 6 joints"),
    ("j6_deg", "j5_deg", 1, "`j5_deg` is given twice"),
    ("j6_deg", "j6_degps", 1, "`j6_deg` is missing; the robot has 6 joints"),
    ("time_s", "j1_degps", 1, "`j2_degps` is missing; give all"),
    ("time_s", "j2_nm", 1, "`j1_nm` is missing"),
    ("time_s", "rx_deg", 1, "`ry_deg` is missing"),
    ("x_mm", "stop", 1, "`x_mm` is missing"),
    ("x_mm", "x", 1, "write `x_mm`"),
    ("temperature_c", "temperature_k", 1, "write `temperature_c`"),
    ("temperature_c", "temprature_c", 1, "is it `temperature_c`"),
    ("temperature_c", "colour", 1, "unknown column `colour`"),
    ("temperature_c", "", 1, "has no name"),
    ("target,tool", "aim,tool", 1, "unknown column `aim`"),
    ("role,target", "role,stop", 1, "`target` is missing"),
    ("target,tool", "target,stop", 1, "no column `tool`, but there are 2 tools"),
]


def refused(folder) -> BayescalError:
    with pytest.raises(BayescalError) as caught:
        read_dataset(folder)
    assert "\n" not in str(caught.value)
    return caught.value


def replaced(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


def test_valid_as_it_stands(tmp_path):
    data = read_dataset(write(tmp_path))
    assert len(data.measurements.ids) == 20
    assert [t.kind for t in data.targets].count("plane") == 3


@pytest.mark.parametrize(("old", "new", "line", "words"), SPOILT_SETTINGS)
def test_settings(tmp_path, old, new, line, words):
    settings = replaced(SETTINGS, old, new)
    error = refused(write(tmp_path, settings))
    file, text = ("dataset.yaml", settings) if line in settings else ("measurements.csv", TABLE)
    assert error.where == f"{file}:{line_of(text, line)}"
    assert words in str(error)
    assert error.remedy


@pytest.mark.parametrize(("old", "new", "line", "words"), SPOILT_TABLE)
def test_table(tmp_path, old, new, line, words):
    error = refused(write(tmp_path, table=replaced(TABLE, old, new)))
    assert error.where == f"measurements.csv:{line}" if line else error.where.startswith("measurements.csv:")
    assert re.search(words.replace("(", r"\("), str(error))
    assert error.remedy


@pytest.mark.parametrize(
    ("name", "content", "where", "words"),
    [
        ("dataset.yaml", None, "dataset.yaml", "no such file"),
        ("measurements.csv", None, "measurements.csv", "no such file"),
        ("dataset.yaml", b"", "dataset.yaml", "empty"),
        ("measurements.csv", b"\n \n", "measurements.csv", "empty"),
        ("measurements.csv", HEADER.encode(), "measurements.csv:1", "no rows"),
        ("measurements.csv", TABLE.encode("utf-16"), "measurements.csv:1", "UTF-8"),
        ("measurements.csv", TABLE.replace("t3", "tü").encode("latin-1"), "measurements.csv:4", "UTF-8"),
        ("measurements.csv", TABLE.replace(",", ";").encode(), "measurements.csv:1", "commas"),
        ("dataset.yaml", b"- a\n- b\n", "dataset.yaml:1", "keys and values"),
        ("dataset.yaml", b"a: &x [*x]\n", "dataset.yaml:1", "contains itself"),
        ("dataset.yaml", b"a: 1\n\tb: 2\n", "dataset.yaml:2", "not YAML"),
    ],
)
def test_whole_files(tmp_path, name, content, where, words):
    folder = write(tmp_path)
    (folder / name).unlink() if content is None else (folder / name).write_bytes(content)
    error = refused(folder)
    assert error.where == where
    assert words in str(error)


def test_folder(tmp_path):
    assert "no such folder" in str(refused(tmp_path / "nowhere"))
    assert "give the folder" in str(refused(write(tmp_path) / "dataset.yaml"))


def test_urdf(tmp_path):
    error = refused(write(tmp_path, replaced(SETTINGS, "fanuc-lrmate200ic", "arm.urdf")))
    assert error.where == "arm.urdf"
    assert "no such file" in error.what


def test_own_uncertainty_replaces_stated_noise(tmp_path):
    settings = replaced(SETTINGS, "  contact_mm: 0.005\n", "")
    kept = [r for r in TABLE.splitlines() if r.split(",")[2] in ("target", "tracker") or r.startswith("c2")]
    data = read_dataset(write(tmp_path, settings, "\n".join(kept)))
    assert data.noise.contact is None


def test_what_is_let_pass(tmp_path):
    """A byte order mark, blank lines, one tool unnamed, an empty velocity, time that goes back."""
    text = (
        TABLE.replace(",ball,", ",,")
        .replace(",mirror,", ",,")
        .replace("c2,", "\n\nc2,")
        .replace(",90,", ",5,")
    )
    settings = replaced(SETTINGS, "  mirror: {centre_mm: [60, 0, 120], u_mm: 1}\n", "")
    folder = write(tmp_path, replaced(settings, "name: tiny", "name: 12"), text)
    (folder / "measurements.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    data = read_dataset(folder)
    assert data.name == "12"
    assert data.measurements.line[9] == 13
    assert set(data.measurements.tool) == {0}


def test_velocity_at_rest_and_incomplete(tmp_path):
    columns = ",".join(f"j{i + 1}_degps" for i in range(6))
    rows = TABLE.splitlines()
    speeds = ["1,-1,0.5,0,0,2", ",,,,,"] + ["0,0,0,0,0,1"] * (len(rows) - 3)
    text = [f"{rows[0]},{columns}"] + [f"{r},{v}" for r, v in zip(rows[1:], speeds, strict=True)]
    data = read_dataset(write(tmp_path, table="\n".join(text)))
    assert (data.measurements.velocity[1] == 0).all()
    text[4] = rows[4] + ",1,,1,1,1,1"
    error = refused(write(tmp_path, table="\n".join(text)))
    assert error.where == "measurements.csv:5"
    assert "j2_degps" in error.what
