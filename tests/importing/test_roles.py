"""Validation measurements by rule: whole stops, the same at every call, and never all rows or none."""

import re
from dataclasses import replace

import numpy as np
import pytest
from cases import cases
from made_up_logs import said, table

from bayescal.dataset import write_dataset
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert
from bayescal.importing.roles import stops_of, with_roles

ARM = "fanuc-lrmate200ic"


@pytest.fixture(scope="module")
def tracked(tracker):
    return tracker(seed=3, count=40).dataset


@pytest.fixture(scope="module")
def stopped(tracked):
    """Three rows a stop, of 14 stops, the last of one row; named b0, b1, ..."""
    stop = np.array([f"b{i // 3}" for i in range(40)])
    return replace(tracked, measurements=replace(tracked.measurements, stop=stop))


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


@pytest.mark.parametrize(
    ("rule", "stops", "words"),
    [
        ("every:5", {4, 9}, "5 of 40|6 of 40"),
        ("every 5", {4, 9}, "stop 5 of every 5, 14 stops"),
        ("stop", {4, 9}, "stop 5 of every 5"),
        ("last:20%", {11, 12, 13}, "7 of 40 rows (the last 3 of 14 stops)"),
        ("stops 'b1?'", {10, 11, 12, 13}, "stops b1?"),
        ("stops:b0, b13", {0, 13}, "4 of 40"),
    ],
)
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
    together = replace(data, measurements=replace(data.measurements, stop=np.full(60, "s")))
    with pytest.raises(BayescalError, match="measured at the same stop; name the targets of whole stops"):
        with_roles(together, "targets *.+?", "--validate")


@pytest.mark.parametrize(
    ("rule", "words"),
    cases("role_refusals"),
)
def test_refused(tracked, rule, words):
    with pytest.raises(BayescalError, match="^--validate: .*" + words):
        with_roles(tracked, rule, "--validate")


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
