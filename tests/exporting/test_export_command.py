"""`bayescal export` on run folders of `fit` and `gap`."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from cases import cases

import bayescal as bc

OPTIONS = {"contacts": 90, "later": 10, "repeats": 5, "spheres": 0, "seed": 1}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The run folder of a fit, without the dataset that it was made from."""
    folder = tmp_path_factory.mktemp("runs") / "fit"
    bc.fit(bc.simulate(**OPTIONS), samples=0).save(folder, pictures=False)
    return folder


def test_a_file_and_its_sidecar(run, tmp_path, command):
    code, text, errors = command("export", run, "--to", "urdf", "--out", tmp_path / "arm.urdf")
    assert code == 0, errors
    assert "not in the file" in text
    assert "alternative      --without compliance fits the session again" in text
    record = json.loads((tmp_path / "arm.urdf.bayescal.json").read_text())
    assert record["schema"] == "bayescal-export/1"
    (missing,) = record["not_expressed"]
    assert missing["effect"] == "compliance"
    assert missing["max_um"] > missing["rms_um"] > 10
    assert record["remaining"]["max_um"] == pytest.approx(missing["max_um"])
    written = {w["parameter"]: w for w in record["written"]}
    saved = {p["name"]: p for p in json.loads((run / "arm.json").read_text())["parameters"]}
    assert written["a2"]["value"] == saved["a2"]["value"]
    assert written["a2"]["u"] == pytest.approx(saved["a2"]["u"])
    assert written["a2"]["element"] == "joint[@name='J3']/origin"
    assert {p.name for p in Path(tmp_path).iterdir()} == {"arm.urdf", "arm.urdf.bayescal.json"}


@pytest.mark.parametrize("to", ["robot.yaml", "sdf", "dh-csv", "joint-zeros"])
def test_every_format(run, tmp_path, command, to):
    code, text, errors = command("export", run, "--to", to, "--out", tmp_path / "arm")
    assert code == 0, errors
    assert "parameters of the arm" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    cases("export_refusals"),
)
def test_bad_input_is_one_line(run, tmp_path, command, arguments, message):
    code, _, errors = command("export", run, *arguments, "--out", tmp_path / "arm")
    assert code == 1
    assert message in errors
    assert errors.count("\n") == 1
    assert not list(Path(tmp_path).iterdir())


def test_no_run(tmp_path, command):
    code, _, errors = command("export", tmp_path, "--to", "urdf")
    assert code == 1
    assert "there is no arm.json" in errors


def test_a_result_in_memory_is_its_run_folder(run):
    session = bc.simulate(**OPTIONS)
    here = bc.export(bc.fit(session, samples=0), "robot.yaml").content
    there = bc.export(run, "robot.yaml").content
    assert [line.partition(" ")[0] for line in here.splitlines()] == [
        line.partition(" ")[0] for line in there.splitlines()
    ]
    found = [np.array(re.findall(r"-?\d+\.\d+(?:e-?\d+)?", text), float) for text in (here, there)]
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)
