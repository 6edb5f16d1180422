"""Files of an export: none of the user is overwritten, and what a file states can be read again."""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from export_arms import fake, session_of

from bayescal.errors import BayescalError
from bayescal.exporting.export import export
from bayescal.exporting.robot import robot_text
from bayescal.exporting.sidecar import read_sidecar


@pytest.fixture(scope="module")
def arm():
    return fake(session_of(), ("geometry", "compliance"))


@pytest.fixture(scope="module")
def table(arm):
    """A DH table: arm.csv, arm.json beside it, and the sidecar."""
    return export(arm, "dh-csv", force=True)


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.mark.parametrize("name", ["arm.csv", "arm.json", "arm.csv.bayescal.json"])
def test_a_file_of_the_user_is_not_overwritten(table, tmp_path, name):
    (tmp_path / name).write_text('{"schema": "of the user"}')
    before = contents(tmp_path)
    with pytest.raises(BayescalError, match=f"{name}: exists and is no .*; give another --out"):
        table.save(tmp_path / "arm.csv")
    assert contents(tmp_path) == before


def test_an_unchanged_export_is_replaced_and_a_changed_one_is_kept(table, tmp_path):
    table.save(tmp_path / "arm.csv")
    table.save(tmp_path / "arm.csv")
    record = json.loads((tmp_path / "arm.csv.bayescal.json").read_text())
    assert list(record["beside"]) == ["arm.json"]
    (tmp_path / "arm.json").write_text("edited")
    before = contents(tmp_path)
    with pytest.raises(BayescalError, match=r"arm\.json: exists and is no unchanged export"):
        table.save(tmp_path / "arm.csv")
    assert contents(tmp_path) == before


class Killed(BaseException):
    """The process is gone."""


@pytest.mark.parametrize("earlier", [False, True])
@pytest.mark.parametrize("after", range(5))
def test_no_file_is_without_its_sidecar_after_a_kill(table, arm, tmp_path, monkeypatch, earlier, after):
    """Killed after each of the four renames: two files, and the sidecar before and after them."""
    path, other = tmp_path / "arm.csv", export(arm, "dh-csv", force=True, name="other")
    other = replace(other, written=replace(other.written, content="other", beside={".json": "other"}))
    if earlier:
        other.save(path)
    own, calls = Path.replace, []

    def renamed(part, target):
        calls.append(target)
        if len(calls) > after:
            raise Killed
        return own(part, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", renamed)
        if after < 4:
            with pytest.raises(Killed):
                table.save(path)
        else:
            table.save(path)
    assert calls[0].name == "arm.csv.bayescal.json"
    files = {file.name for file in table.files(path)}
    there = contents(tmp_path)
    assert "arm.csv.bayescal.json" in there or not there
    if there:
        known = json.loads(there["arm.csv.bayescal.json"])
        listed = {"arm.csv": known["sha256"], **known["beside"]}
        replaced = known.get("replaces", {})
        for name in there.keys() - {"arm.csv.bayescal.json"}:
            assert sha256(there[name]).hexdigest() in {listed[name], replaced.get(name)}
        complete = all(sha256(there.get(n, b"")).hexdigest() == d for n, d in listed.items())
        if complete:
            read_sidecar(path)
        else:
            with pytest.raises(
                BayescalError, match=r"the export was interrupted before arm\.\w+ was in place"
            ):
                read_sidecar(path)
    table.save(path)
    assert contents(tmp_path).keys() == files
    assert "replaces" not in read_sidecar(path)


def test_the_file_to_patch_is_none_of_the_written_ones(table, tmp_path):
    table.save(tmp_path / "arm.csv")
    for name in ("arm.csv", "arm.json", "arm.csv.bayescal.json"):
        own = replace(table, options=replace(table.options, into=str(tmp_path / name)))
        with pytest.raises(BayescalError, match=f"{name}: is the file to patch itself"):
            own.save(tmp_path / "arm.csv")


def test_two_files_of_one_name_are_refused(table, tmp_path):
    with pytest.raises(BayescalError, match=r"arm\.json: a further file would have this name"):
        table.save(tmp_path / "arm.json")
    assert not contents(tmp_path)


def test_robot_yaml_names_joints_that_were_made_rigid(arm):
    """A negative compliance is not physical: the file has none, and says so."""
    names = [p.name for p in arm.model.parameters]
    values = arm.values.copy()
    assert "Rigid" not in robot_text(arm, "the sidecar")
    for name in ("compliance J3", "compliance J5"):
        values[names.index(name)] = -1e-6
    assert "\n# Rigid here, because the estimated compliance is negative: J3, J5.\n" in robot_text(
        replace(arm, values=values), "the sidecar"
    )


@pytest.mark.parametrize("time", [np.nan, np.inf])
def test_a_time_that_is_no_number_is_refused(arm, time):
    with pytest.raises(BayescalError, match="--at-time-s: is not a finite number; give a number of s"):
        export(arm, "robot.yaml", time=time, force=True)
