"""`bayescal verify` of an exported file, with the command line as users call it."""

import json
import re
import shutil
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("mujoco")

import bayescal as bc
from bayescal.cli import app, verify  # noqa: F401  (it registers its command)
from bayescal.errors import BayescalError


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A fitted session and its MJCF file."""
    folder = tmp_path_factory.mktemp("run")
    session = bc.simulate(contacts=80, later=12, repeats=5, spheres=2, placements=2, seed=3)
    bc.fit(session, samples=0).save(folder / "fit")
    bc.export(folder / "fit", "mjcf").save(folder / "arm.xml")
    return folder


def beside(run: Path, path: Path) -> None:
    """Copy the sidecar of the exported file to another file."""
    shutil.copy(run / "arm.xml.bayescal.json", f"{path}.bayescal.json")


def test_simulator_has_the_fitted_arm_and_its_gap(run):
    result = bc.verify(run / "fit", run / "arm.xml")
    record = result.record
    assert result.passed
    assert list(record["max_difference_um"]) == ["nominal", "geometry", "+ compliance"]
    assert record["max_difference_um"]["+ compliance"] < 0.02
    for kind in ("planes", "distances"):
        found = record["measured"][kind]
        assert found["after_rms_um"] == pytest.approx(found["predicted_after_rms_um"], rel=0.05)
        assert found["before_rms_um"] == pytest.approx(found["predicted_before_rms_um"], rel=0.05)
    assert record["measured"]["planes"]["after_rms_um"] < 0.1 * record["measured"]["planes"]["before_rms_um"]


def test_command_writes_a_record_and_fails_for_another_arm(run, tmp_path):
    text = (run / "arm.xml").read_text()
    pos = re.search(r'<body name="link3" .*?pos="(\S+) ', text)
    wrong = tmp_path / "wrong.xml"
    wrong.write_text(text[: pos.start(1)] + repr(float(pos[1]) + 1e-6) + text[pos.end(1) :])
    beside(run, wrong)
    out = tmp_path / "out"
    arguments = ["verify", str(run / "fit"), str(wrong), "--out", str(out)]
    found = CliRunner().invoke(app, arguments)
    assert found.exit_code == 1
    assert "FAILED: + compliance differs by up to 1 µm" in found.output
    assert json.loads((out / "verify.json").read_text())["passed"] is False


def test_missing_simulator_is_one_line_with_the_extra(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(BayescalError, match=re.escape("pip install 'bayescal[mujoco]'")):
        bc.verify(run / "fit", run / "arm.xml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><worldbody/></mujoco>", "no actuator and sensor 'J1'"),
        ("<mujoco>", "not XML"),
        ("<mujoco><worldbody><joint/></worldbody></mujoco>", "MuJoCo refuses the file"),
    ],
)
def test_other_files_are_refused(run, tmp_path, text, message):
    (tmp_path / "other.xml").write_text(text)
    beside(run, tmp_path / "other.xml")
    with pytest.raises(BayescalError, match=message):
        bc.verify(run / "fit", tmp_path / "other.xml")


def test_a_simulation_that_diverges_is_refused_and_writes_no_log(run, tmp_path, monkeypatch):
    """MuJoCo would start it again, and write a log into the working folder."""
    monkeypatch.chdir(tmp_path)
    text = (run / "arm.xml").read_text()
    (tmp_path / "wild.xml").write_text(re.sub(r' damping="[^"]+"', ' damping="-1e7"', text))
    beside(run, tmp_path / "wild.xml")
    with pytest.raises(BayescalError, match="unstable at pose 1"):
        bc.verify(run / "fit", tmp_path / "wild.xml")
    assert {p.name for p in tmp_path.iterdir()} == {"wild.xml", "wild.xml.bayescal.json"}


@pytest.mark.parametrize("installed", [("MuJoCo", "Pinocchio"), ("Pinocchio",), ("MuJoCo",)], ids=len)
def test_urdf_has_the_geometry_in_both_simulators(run, monkeypatch, installed):
    pytest.importorskip("pinocchio")
    for name in {"MuJoCo", "Pinocchio"} - set(installed):
        monkeypatch.setitem(sys.modules, name.lower(), None)
    bc.export(run / "fit", "urdf").save(run / "arm.urdf")
    result = bc.verify(run / "fit", run / "arm.urdf")
    assert result.passed
    assert tuple(name.split()[1] for name in result.record["max_difference_um"]) == installed
    planes = result.record["measured"]["planes"]
    assert planes["predicted_after_rms_um"] < planes["after_rms_um"] < planes["before_rms_um"]
    lacks = result.record["not_in_file_rms_um"]
    assert list(lacks) == ["compliance"]
    assert lacks["compliance"] > 0.5 * planes["after_rms_um"]
    assert "without these effects" in str(result)


def test_formats_without_a_simulator_are_refused(run):
    bc.export(run / "fit", "robot.yaml").save(run / "arm.yaml")
    with pytest.raises(BayescalError, match=re.escape("format robot.yaml; bayescal verifies mjcf and urdf")):
        bc.verify(run / "fit", run / "arm.yaml")
