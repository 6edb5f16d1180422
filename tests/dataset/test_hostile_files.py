"""Files that no session has: endless, nested, aliased, with control characters, or elsewhere on the disk."""

import os
import socket
import time

import pytest
from tiny_dataset import SETTINGS, TABLE, write

from bayescal.dataset import read_dataset
from bayescal.errors import BayescalError, listed, shown
from bayescal.robots import load_robot
from bayescal.storage.reading import CONTROL, read_json

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join(['*' + old] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
"""Ten lines that stand for 9^9 values."""
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


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
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
    ],
    ids=lambda value: shown(value, 24),
)  # fmt: skip
def test_settings(tmp_path, old, new, words):
    error = refused(write(tmp_path, changed(SETTINGS, old, new)))
    assert words in str(error)
    assert error.where
    assert error.remedy


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("t2,calibrate", "t2,cal\x1b[31mibrate", "control character \\x1b"),
        ("t2,calibrate", "t\u202e2,calibrate", "control character \\u202e"),
        ("t2,calibrate", "t2," + "x" * 100_000, "a cell has 100000 characters"),
        ("payload_kg", "p" * 100_000, "a cell has 100000 characters"),
        ("0.983,29.728", "1e308,29.728", "`j1_deg` holds 1e+308"),
        ("-270.87", "-1e308", "`x_mm` holds -1e+308"),
        (",0.02,90", ",1e-300,90", "at least 1e-09, or empty"),
        (",0,21.5", ",1e308,21.5", "`time_s` holds 1e+308"),
        (",0,21.5", ",0,-300", "`temperature_c` holds -300: below -273.15 c"),
    ],
    ids=lambda value: shown(value, 24),
)
def test_table(tmp_path, old, new, words):
    error = refused(write(tmp_path, table=changed(TABLE, old, new)))
    assert words in str(error)
    assert error.where.startswith("measurements.csv:")
    assert error.remedy


def test_thousands_of_tools_are_not_all_named(tmp_path):
    more = "".join(f"  m{i}: {{centre_mm: [1, 2, 3]}}\n" for i in range(3000))
    settings = changed(SETTINGS, "  mirror:", more + "  mirror:")
    assert "and 2996 more" in str(refused(write(tmp_path, settings, changed(TABLE, "top,ball", "top,"))))


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
    folder = write(tmp_path, changed(SETTINGS, "fanuc-lrmate200ic", "arms/robot.yaml"))
    (folder / "arms").mkdir()
    (folder / "arms" / "robot.yaml").write_bytes(load_robot("fanuc-lrmate200ic")[1])
    (folder / "measurements.csv").rename(folder / "first.csv")
    (folder / "measurements.csv").symlink_to("first.csv")
    assert read_dataset(folder).robot.name == "fanuc-lrmate200ic"


def test_an_anchor_is_still_allowed(tmp_path):
    settings = changed(SETTINGS, "noise:\n  contact_mm: 0.005", "noise:\n  contact_mm: &r 0.005")
    settings = changed(settings, "u_distance_mm: 0.003", "u_distance_mm: *r")
    assert read_dataset(write(tmp_path, settings)).certificates[0].u_distance == pytest.approx(5e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 200_000, "nested too deeply"),
        ('{"a": NaN}', "NaN"),
        ('{"a": 1e999}', "1e999"),
        ("{", "invalid"),
    ],
    ids=["nested", "nan", "infinite", "broken"],
)
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
