"""Every refusal names the file, the line and the remedy: one spoilt line at a time."""

import os
import re
import socket
import time

import numpy as np
import pytest
from cases import cases, file_text
from tiny_dataset import HEADER, SETTINGS, TABLE, line_of, write

from bayescal.dataset import read_dataset, write_dataset
from bayescal.dataset.consistency import contradictions
from bayescal.errors import BayescalError, listed, shown
from bayescal.robots import load_robot
from bayescal.storage.reading import CONTROL, read_json

SPOILT_SETTINGS = cases("dataset_refusals")


def cell(row: str, column: str, value: str) -> tuple[str, str]:
    """A row of the table, and the same with one cell changed."""
    old = TABLE.splitlines()[line_of(TABLE, f"\n{row},")]
    cells = old.split(",")
    cells[HEADER.split(",").index(column)] = value
    return old, ",".join(cells)


SPOILT_TABLE = [(*cell(*row[:3]), *row[3:]) for row in cases("table_refusals")] + cases("header_refusals")


SECONDS = 20.0
"""Processor time; a few hundredths are enough."""
LONGEST = 500


def refused(folder) -> BayescalError:
    """The refusal of a dataset: soon, on one line of printable characters."""
    start = time.process_time()
    with pytest.raises(BayescalError) as caught:
        read_dataset(folder)
    assert time.process_time() - start < SECONDS
    assert len(str(caught.value)) < LONGEST
    assert str(caught.value).isprintable()
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


@pytest.mark.parametrize(("name", "content", "where", "words"), [
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
])  # fmt: skip
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
    assert read_dataset(write(tmp_path, settings, "\n".join(kept))).noise.contact is None


def test_what_is_let_pass(tmp_path):
    """A byte order mark, blank lines, one tool unnamed, an empty velocity, time that goes back."""
    text = TABLE.replace(",ball,", ",,").replace(",mirror,", ",,")
    text = text.replace("c2,", "\n\nc2,").replace(",90,", ",5,")
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
    assert (read_dataset(write(tmp_path, table="\n".join(text))).measurements.velocity[1] == 0).all()
    text[4] = rows[4] + ",1,,1,1,1,1"
    error = refused(write(tmp_path, table="\n".join(text)))
    assert error.where == "measurements.csv:5"
    assert "j2_degps" in error.what


# --- Files that no session has: endless, nested, aliased, with control characters, or elsewhere on the disk.

LISTS = (
    f"{new}: &{new} [{', '.join(['*' + old] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(LISTS)
"""Ten lines that stand for 9^9 values."""


@pytest.mark.parametrize(("old", "new", "words"), [
    ("source: made up", BOMB, "more than 100000 values"),
    ("source: made up", "source: " + "[" * 50_000 + "]" * 50_000, "more than 30 levels"),
    ("source: made up", "source: " + "[" * 50_000, "more than 30 levels"),
    ("source: made up", "source:\n  " + "- " * 1500 + "x", "more than 30 levels"),
    ("source: made up", "source: [" + "1, " * 250_000 + "1]", "more than 100000 values"),
    ("source: made up", "source: " + "1" * 6_000_000, "at most 5 MB"),
    ("source: made up", '"' + "s" * 900 + '": x', "a key of 900 characters"),
    ("source: made up", "source: " + "s" * 30_000, "a value of 30000 characters"),
    ("source: made up", 'source: "\\e[2Jx"', "control character \\x1b"),
    ("source: made up", "source: a\x1b[2Jb", "control character \\x1b"),
    ("top: {kind: plane", '"t\\e[31mop": {kind: plane', "control character \\x1b"),
    ("name: tiny", "name: " + "n" * 5000, "`name` has 5000 characters"),
    ("fanuc-lrmate200ic", "r" * 5000, "`robot` has 5000 characters"),
    ("fanuc-lrmate200ic", "r" * 180 + "/" + "s" * 8 + ".yaml", "no such file"),
    ("fanuc-lrmate200ic", '"a\\0b.yaml"', "control character \\x00"),
    ("fanuc-lrmate200ic", "/etc/passwd", "outside the dataset folder"),
    ("fanuc-lrmate200ic", "../robot.yaml", "outside the dataset folder"),
    ("fanuc-lrmate200ic", "../arm.urdf#tip", "outside the dataset folder"),
    ("xyz_mm: [1000", "xyz_mm: [1e308", "`xyz_mm` holds 1e+308: above 1e+07 mm"),
    ("centre_mm: [561", "centre_mm: [-1e308", "below -1e+07 mm"),
    ("u_distance_mm: 0.001", "u_distance_mm: 1e-300", "no uncertainty is less than 1e-09"),
    ("u_mm: 20,", "u_mm: 1e-300,", "no uncertainty is less than 1e-09"),
], ids=lambda value: shown(value, 24))  # fmt: skip
def test_hostile_files_settings(tmp_path, old, new, words):
    error = refused(write(tmp_path, replaced(SETTINGS, old, new)))
    assert words in str(error)
    assert error.where
    assert error.remedy


@pytest.mark.parametrize(("old", "new", "words"), [
    ("t2,calibrate", "t2,cal\x1b[31mibrate", "control character \\x1b"),
    ("t2,calibrate", "t\u202e2,calibrate", "control character \\u202e"),
    ("t2,calibrate", "t2," + "x" * 100_000, "a cell has 100000 characters"),
    ("payload_kg", "p" * 100_000, "a cell has 100000 characters"),
    ("0.983,29.728", "1e308,29.728", "`j1_deg` holds 1e+308"),
    ("-270.87", "-1e308", "`x_mm` holds -1e+308"),
    (",0.02,90", ",1e-300,90", "at least 1e-09, or empty"),
    (",0,21.5", ",1e308,21.5", "`time_s` holds 1e+308"),
    (",0,21.5", ",0,-300", "`temperature_c` holds -300: below -273.15 c"),
], ids=lambda value: shown(value, 24))  # fmt: skip
def test_hostile_files_table(tmp_path, old, new, words):
    error = refused(write(tmp_path, table=replaced(TABLE, old, new)))
    assert words in str(error)
    assert error.where.startswith("measurements.csv:")
    assert error.remedy


def test_thousands_of_tools_are_not_all_named(tmp_path):
    more = "".join(f"  m{i}: {{centre_mm: [1, 2, 3]}}\n" for i in range(3000))
    settings = replaced(SETTINGS, "  mirror:", more + "  mirror:")
    assert "and 2996 more" in str(refused(write(tmp_path, settings, replaced(TABLE, "top,ball", "top,"))))


@pytest.mark.parametrize("name", ["dataset.yaml", "measurements.csv"])
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "socket", "link"])
def test_only_regular_files_of_the_folder(tmp_path, monkeypatch, name, kind):
    (tmp_path / "session").mkdir()
    path = write(tmp_path / "session") / name
    path.rename(tmp_path / name)
    words = "outside the dataset folder" if kind in ("device", "link") else "regular|cannot be read"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "socket":
        monkeypatch.chdir(path.parent)  # the names of sockets are short
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(name)
    else:
        path.symlink_to("/dev/zero" if kind == "device" else tmp_path / name)
    error = refused(path.parent)
    assert error.where == name
    assert any(word in str(error) for word in words.split("|"))


def test_links_that_lead_to_themselves(tmp_path):
    folder = write(tmp_path)
    (folder / "measurements.csv").unlink()
    (folder / "measurements.csv").symlink_to("measurements.csv")
    assert "link to itself" in str(refused(folder))


def test_a_device_is_never_read(tmp_path):
    (tmp_path / "robot.yaml").symlink_to("/dev/zero")
    with pytest.raises(BayescalError, match="not a regular file"):
        load_robot("robot.yaml", tmp_path)


def test_links_and_robots_within_the_folder_are_read(tmp_path):
    folder = write(tmp_path, replaced(SETTINGS, "fanuc-lrmate200ic", "arms/robot.yaml"))
    (folder / "arms").mkdir()
    (folder / "arms" / "robot.yaml").write_bytes(load_robot("fanuc-lrmate200ic")[1])
    (folder / "measurements.csv").rename(folder / "first.csv")
    (folder / "measurements.csv").symlink_to("first.csv")
    assert read_dataset(folder).robot.name == "fanuc-lrmate200ic"


def test_an_anchor_is_still_allowed(tmp_path):
    settings = replaced(SETTINGS, "noise:\n  contact_mm: 0.005", "noise:\n  contact_mm: &r 0.005")
    settings = replaced(settings, "u_distance_mm: 0.003", "u_distance_mm: *r")
    assert read_dataset(write(tmp_path, settings)).certificates[0].u_distance == pytest.approx(5e-6)


@pytest.mark.parametrize(("text", "words"), [
    ("[" * 200_000, "nested too deeply"),
    ('{"a": NaN}', "NaN"),
    ('{"a": 1e999}', "1e999"),
    ("{", "invalid"),
], ids=["nested", "nan", "infinite", "broken"])  # fmt: skip
def test_records(tmp_path, text, words):
    (tmp_path / "fit.json").write_text(text)
    with pytest.raises(BayescalError, match=words) as caught:
        read_json(tmp_path / "fit.json", "repeat the command")
    assert str(caught.value).endswith("repeat the command")


def test_messages_are_bounded_and_printable():
    hostile = "\x1b[2J\x07\u202e" + "x" * 3_000_000
    error = BayescalError(f"unknown key `{hostile}` and '{hostile}' {hostile}", hostile, f"is it {hostile}")
    assert len(str(error)) < 800
    assert str(error).isprintable()
    assert not CONTROL.search(str(error))
    assert len(shown(hostile)) == 80
    assert listed(range(9), 2) == "0, 1 and 7 more"
    assert shown("µm, 20 °C, naïve\tcafé") == "µm, 20 °C, naïve café"


# --- artefact.yaml: what follows from it for a session, what is refused, and that it is kept.

STATED = "  - {kind: distance, between: [ball.A, ball.B], distance_mm: 150.0, u_distance_mm: 0.001}\n"
USED = SETTINGS.replace(STATED, "").replace("temperature_of", "artefact: plate.yaml\ntemperature_of")
PLATE = file_text("plate.yaml")
FULL = re.sub(r", u_mm: (\[.*?\]|[\d.]+)", "", PLATE)
MATRIX = [[1e-6 * (4 * (i == j) + (i % 3 == j % 3)) for j in range(9)] for i in range(9)]


def session(folder, plate=PLATE, settings=USED):
    (folder / "plate.yaml").write_text(plate)
    return write(folder, settings)


def with_matrix(matrix=MATRIX) -> str:
    return FULL + "covariance_mm2:\n" + "".join(f"  - {row}\n" for row in matrix)


def test_distances_follow_with_their_uncertainty(tmp_path):
    data = read_dataset(session(tmp_path))
    whole, pair = data.certificates[-2:]
    assert (whole.kind, whole.targets, whole.points.of) == ("points", ("ball.A", "ball.B"), (0, 1))
    assert (pair.targets, pair.distance, pair.derived) == (("ball.A", "ball.B"), pytest.approx(0.15), True)
    along = np.array([0.6, 0.8, 0.0])
    expected = along**2 @ np.array([4 + 1, 4 + 9, 4 + 4])  # um2
    assert pair.u_distance == pytest.approx(1e-6 * np.sqrt(expected))
    assert not list(contradictions(data))


def test_a_covariance_is_used_with_its_correlations(tmp_path):
    pair = read_dataset(session(tmp_path, with_matrix())).certificates[-1]
    assert pair.u_distance == pytest.approx(1e-6 * np.sqrt(2 * 4))  # the common part of both points cancels


@pytest.mark.parametrize("plate", [PLATE, with_matrix()], ids=["u", "covariance"])
def test_it_comes_back(tmp_path, plate):
    data = read_dataset(session(tmp_path, plate))
    write_dataset(data, tmp_path / "out")
    again = read_dataset(tmp_path / "out")
    stated = [[(c.kind, c.targets) for c in session_.certificates] for session_ in (data, again)]
    assert stated[0] == stated[1]
    one, other = data.certificates[-2].points, again.certificates[-2].points
    assert (one.names, one.of, one.placements) == (other.names, other.of, other.placements)
    np.testing.assert_allclose(other.coordinates, one.coordinates, atol=1e-12)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-8, atol=1e-24)


def test_its_content_is_part_of_the_hash(tmp_path):
    one = read_dataset(session(tmp_path)).sha256
    assert read_dataset(session(tmp_path, PLATE.replace("90,", "90.1,"))).sha256 != one


def test_a_wrong_unit_of_its_coordinates_is_named(tmp_path):
    data = read_dataset(session(tmp_path, PLATE.replace("[90, 120, 0]", "[0.09, 0.12, 0]")))
    (found,) = contradictions(data)
    assert (found.place, found.remedy) == (("artefact",), "the certified value looks like m: write it in mm")


@pytest.mark.parametrize(("plate", "line", "words"), [
    (PLATE.replace(", u_mm: 0.002", ""), "ball.A", "neither `u_mm` nor `covariance_mm2`"),
    (with_matrix().replace("[0, 120, 0]", "[0, 120, 0], u_mm: 0.001"), "spare", "both `u_mm` and"),
    (with_matrix(MATRIX[:8]), "covariance", "is not 9 x 9; 3 points have 9 coordinates"),
    (with_matrix([[x + 1e-6 * (i < j) for j, x in enumerate(row)] for i, row in enumerate(MATRIX)]),
     "covariance", "not symmetric"),
    (with_matrix((np.array(MATRIX) - 5.5e-6 * np.eye(9)).tolist()), "covariance", "no covariance"),
    (PLATE.replace("[90, 120, 0]", "[0, 120, 0]"), "spare", "`ball.B` and `spare` have the same coord"),
    (PLATE.replace("ball.", "sphere."), "points", "no two targets of one placement"),
    (PLATE.replace("u_mm: 0.002", "u_mm: [0, 0, 0]").replace("[0.001, 0.003, 0.002]", "[0, 0, 0]"),
     "ball.B", "has no uncertainty"),
    (PLATE.replace("u_mm: 0.002", "u_mm: 0"), "ball.A", "more than 0"),
    (PLATE.replace("mm: [0, 0, 0]", "m: [0, 0, 0]"), "ball.A", "is it `mm`"),
    (PLATE.replace("artefact/1", "artefact/2"), "schema", "another version"),
])  # fmt: skip
def test_refusals(tmp_path, plate, line, words):
    with pytest.raises(BayescalError) as caught:
        read_dataset(session(tmp_path, plate))
    assert words in str(caught.value)
    assert caught.value.where == f"plate.yaml:{line_of(plate, line)}"


def test_a_distance_is_certified_once(tmp_path):
    settings = SETTINGS.replace("temperature_of", "artefact: plate.yaml\ntemperature_of")
    with pytest.raises(BayescalError, match="is certified by dataset"):
        read_dataset(session(tmp_path, settings=settings))


@pytest.mark.parametrize("path", ["../plate.yaml", "/etc/hostname", "none.yaml"])
def test_it_lies_in_the_folder(tmp_path, path):
    (tmp_path / "in").mkdir()
    (tmp_path / "plate.yaml").write_text(PLATE)
    with pytest.raises(BayescalError, match=r"outside the dataset folder|no such file"):
        read_dataset(session(tmp_path / "in", settings=USED.replace("plate.yaml", path)))
