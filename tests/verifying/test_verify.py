"""`bayescal verify` of an exported file, with the command line as users call it."""

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from camera_sessions import camera_session
from cases import refused
from sessions import tracker
from typer.testing import CliRunner

import bayescal as bc
from bayescal.cli import app
from bayescal.effects import EFFECTS
from bayescal.errors import BayescalError
from bayescal.public import as_text
from bayescal.reporting.exports import report
from bayescal.verifying.gap import Gap, read_reported
from bayescal.verifying.simulator import TOGETHER, Level, limit


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A fitted session and its MJCF file."""
    folder = tmp_path_factory.mktemp("run")
    session = bc.simulate(contacts=50, later=12, repeats=3, spheres=2, placements=1, seed=3)
    bc.fit(session, samples=0).save(folder / "fit", pictures=False)
    bc.export(folder / "fit", "mjcf").save(folder / "arm.xml")
    return folder


@pytest.fixture(scope="module")
def urdf(run) -> Path:
    """The URDF file of the session."""
    return bc.export(run / "fit", "urdf").save(run / "arm.urdf")[0]


@pytest.fixture(scope="module")
def complete(run):
    return bc.verify(run / "fit", run / "arm.xml")


@pytest.fixture(scope="module")
def lacking(run, urdf):
    return bc.verify(run / "fit", urdf)


def beside(run: Path, path: Path) -> None:
    """Copy the sidecar of the exported file to another file."""
    shutil.copy(run / "arm.xml.bayescal.json", f"{path}.bayescal.json")


def test_simulator_has_the_fitted_arm_and_its_gap(complete):
    result, record = complete, complete.record
    assert result.passed
    assert list(record["max_difference_um"]) == ["nominal", "geometry", "+ compliance"]
    assert record["max_difference_um"]["+ compliance"] < 0.02
    for level in result.data.levels:
        squares = [x**2 for x in level.differences]
        numbers = (max(squares) ** 0.5, (sum(squares) / len(squares)) ** 0.5)
        stated = [record[f"{key}_difference_um"][level.name] for key in ("max", "rms")]
        assert stated == pytest.approx([1e6 * x for x in numbers])
        assert record["limit_um"][level.name] == pytest.approx(1e6 * level.limit)
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
    beside_it = tmp_path / "wrong.xml.bayescal.json"
    beside_it.write_text(json.dumps(json.loads(beside_it.read_text()) | {"carried_kg": 1.25}))
    assert "it carries 1.25 kg beside the tool" in " ".join(CliRunner().invoke(app, arguments).output.split())


@pytest.mark.parametrize(("off", "passed"), [
    ([0.0] * 99 + [2.9e-6], True),
    ([0.0] * 99 + [3.1e-6], False),  # one pose is beyond the limit
    ([1.1e-6] * 100, False),  # none is, and all together are off
    ([-0.9e-6, 0.9e-6] * 50, True),
])  # fmt: skip
def test_a_level_passes_within_both_of_its_limits(off, passed):
    level = Level("geometry", np.abs(off), 3e-6)
    assert level.passed == passed
    assert level.rms == pytest.approx(np.linalg.norm(off) / 10.0)


def test_no_model_has_a_wider_limit_than_all_together():
    every = [name for name, effect in EFFECTS.items() if effect.simulated_within]
    assert len(every) > 10
    for names in ([], *([name] for name in every), every):
        least = max((EFFECTS[name].simulated_within for name in names), default=0.0)
        assert min(least, TOGETHER) <= limit(names) <= TOGETHER


def test_missing_simulator_is_one_line_with_the_extra(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    refused(re.escape("pip install 'bayescal[mujoco]'"), lambda: bc.verify(run / "fit", run / "arm.xml"))


@pytest.mark.parametrize(("text", "message"), [
    ("<mujoco><worldbody/></mujoco>", "no actuator and sensor `J1`"),
    ("<mujoco>", "not XML"),
    ('<!DOCTYPE x [<!ENTITY a "b">]><mujoco model="&a;"/>', "has a DOCTYPE or entities"),
    ("<mujoco><worldbody><joint/></worldbody></mujoco>", "MuJoCo refuses the file"),
])  # fmt: skip
def test_other_files_are_refused(run, tmp_path, text, message):
    (tmp_path / "other.xml").write_text(text)
    beside(run, tmp_path / "other.xml")
    refused(message, lambda: bc.verify(run / "fit", tmp_path / "other.xml"))


def test_a_simulation_that_diverges_is_refused_and_writes_no_log(run, tmp_path, monkeypatch):
    """MuJoCo would start it again, and write a log into the working folder."""
    monkeypatch.chdir(tmp_path)
    text = (run / "arm.xml").read_text()
    (tmp_path / "wild.xml").write_text(re.sub(r' damping="[^"]+"', ' damping="-1e7"', text))
    beside(run, tmp_path / "wild.xml")
    refused("unstable at pose 1", lambda: bc.verify(run / "fit", tmp_path / "wild.xml"))
    assert {p.name for p in tmp_path.iterdir()} == {"wild.xml", "wild.xml.bayescal.json"}


@pytest.mark.parametrize("installed", [("MuJoCo", "Pinocchio"), ("Pinocchio",), ("MuJoCo",)], ids=len)
def test_urdf_has_the_geometry_in_both_simulators(run, urdf, lacking, monkeypatch, installed):
    for name in {"MuJoCo", "Pinocchio"} - set(installed):
        monkeypatch.setitem(sys.modules, name.lower(), None)
    result = lacking if len(installed) == 2 else bc.verify(run / "fit", urdf)
    assert result.passed
    assert tuple(name.split()[1] for name in result.record["max_difference_um"]) == installed
    planes = result.record["measured"]["planes"]
    assert planes["predicted_after_rms_um"] < planes["after_rms_um"] < planes["before_rms_um"]
    lacks = result.record["not_in_file_rms_um"]
    assert list(lacks) == ["compliance"]
    assert lacks["compliance"] > 0.5 * planes["after_rms_um"]
    assert "without these effects" in str(result)


def changed(urdf, tmp_path, what, by):
    """A copy of the URDF and its sidecar, with another text."""
    copy = tmp_path / "copy.urdf"
    text = urdf.read_text()
    assert re.search(what, text)
    copy.write_text(re.sub(what, by, text))
    shutil.copy(f"{urdf}.bayescal.json", f"{copy}.bayescal.json")
    return copy


def test_continuous_joints_turn_by_their_angles(run, urdf, tmp_path):
    """Pinocchio states such a joint by a cosine and a sine."""
    found = bc.verify(run / "fit", changed(urdf, tmp_path, 'type="revolute"', 'type="continuous"'))
    assert found.passed
    assert [name.split()[1] for name in found.record["max_difference_um"]] == ["MuJoCo", "Pinocchio"]


@pytest.mark.parametrize("only", ["mujoco", "pinocchio"])
@pytest.mark.parametrize(("what", "by", "message"), [
    ('<joint name="J3"', '<joint name="elbow"', "J3"),
    ('"flange"', '"wrist"', "flange"),
    ('<child link="J4_link"', '<child link="J6_link"', "refuses the file"),
    (r'<\?xml version="1.0"\?>', '<!DOCTYPE x [<!ENTITY a "b">]>', "has a DOCTYPE or entities"),
], ids=["joint", "link", "tree", "doctype"])  # fmt: skip
def test_a_urdf_that_a_simulator_refuses(run, urdf, tmp_path, monkeypatch, only, what, by, message):
    monkeypatch.setitem(sys.modules, {"mujoco": "pinocchio", "pinocchio": "mujoco"}[only], None)
    refusal = refused(message, lambda: bc.verify(run / "fit", changed(urdf, tmp_path, what, by)))
    assert "copy.urdf" in str(refusal)


def test_a_file_that_pinocchio_alone_refuses_is_refused(run, urdf, monkeypatch):
    """It is not taken for a simulator that is not installed."""
    import pinocchio as pin

    def refuse(text):
        raise ValueError("made up")

    monkeypatch.setattr(pin, "buildModelFromXML", refuse)
    refused("Pinocchio refuses the file: made up", lambda: bc.verify(run / "fit", urdf))


def test_before_and_after_of_a_urdf_are_of_its_geometry(run, urdf, monkeypatch):
    """Of a baseline with compliance, a URDF would lack the compliance too."""
    from bayescal.verifying import result
    from bayescal.verifying.gap import Reported

    monkeypatch.setattr(result, "read_reported", lambda folder: Reported(baseline=("geometry", "compliance")))
    planes = bc.verify(run / "fit", urdf).record["measured"]["planes"]
    assert planes["before_rms_um"] == pytest.approx(planes["after_rms_um"], rel=0.01)


def test_a_file_that_is_worse_than_the_arm_before_says_so(complete, lacking):
    """The springs of an arm are in an MJCF file and not in a URDF."""
    assert (complete.record["worse"], lacking.record["worse"]) == ([], ["distances"])
    assert "larger errors" not in str(complete)
    text = " ".join(str(lacking).split())
    assert "the file has larger errors than before (nominal): distances (" in text
    assert "export to a format that holds these effects, or with --without compliance" in text


def test_a_remark_and_the_table_give_points_the_same_errors(lacking):
    """Both are RMS lengths of the error vector, and the record has its coordinates."""
    v = lacking.data
    gap = Gap("nominal", {"points": 9}, *({"points": 1e-4}, {"points": 2e-4}), {"points": (1e-4, 1e-4)})
    text = " ".join(as_text(report(replace(v, gap=gap))).split())
    assert "points (346 µm, 173 before)" in text
    assert "points 9 173 346 173 173" in text


SIDECARS = {
    "no format": (lambda s: s.pop("format"), "`format`: Field required"),
    "no row": (lambda s: s["state"].pop("row"), r"`state\.row`: Field required"),
    "another row": (lambda s: s["state"].update(row="x9"), r"the session has no row `state\.row`"),
    "tool": (lambda s: s["tools"][0].update(centre_mm=[1, 2]), "`tools.0.centre_mm"),
    "no tools": (lambda s: s["tools"].clear(), "`tools` are not ball"),
    "effect": (lambda s: s["not_expressed"][0].pop("rms_um"), r"`not_expressed\.0\.rms_um`"),
    "number": (lambda s: s["root_in_f0"][0].__setitem__(3, "0"), r"`root_in_f0\.0\.3`"),
    "joints": (lambda s: s["joints"].pop("J6"), "are not of an arm with 6 joints"),
    "no joints": (lambda s: s.pop("joints"), "`joints`: Field required"),
    "tip": (lambda s: s.update(tip=3), "`tip`: Input should be a valid string"),
}


@pytest.mark.parametrize("edit", SIDECARS)
def test_an_edited_sidecar_is_refused_in_one_line(run, urdf, tmp_path, edit):
    change, message = SIDECARS[edit]
    copy = changed(urdf, tmp_path, "<robot", "<robot")
    sidecar = tmp_path / "copy.urdf.bayescal.json"
    record = json.loads(sidecar.read_text())
    change(record)
    sidecar.write_text(json.dumps(record))
    refusal = refused(message, lambda: bc.verify(run / "fit", copy))
    assert str(sidecar) in str(refusal)
    assert str(refusal).endswith("export the arm again")


@pytest.mark.parametrize(("text", "message"), [
    ("{", "invalid JSON"), ("[]", "incomplete"), ('{"shrinkage": {"planes": {"a": 1}}}', "before_rms_um"),
])  # fmt: skip
def test_a_broken_record_of_the_run_is_one_line(run, urdf, tmp_path, text, message):
    folder = tmp_path / "run"
    shutil.copytree(run / "fit", folder)
    (folder / "gap.json").write_text(text)
    refused(rf"gap\.json: .*{message}.*; repeat bayescal gap", lambda: bc.verify(folder, urdf))


def test_formats_without_a_simulator_are_refused(run):
    bc.export(run / "fit", "robot.yaml").save(run / "arm.yaml")
    with pytest.raises(BayescalError, match=re.escape("format robot.yaml; bayescal verifies mjcf and urdf")):
        bc.verify(run / "fit", run / "arm.yaml")


def test_errors_that_a_fit_reports_are_those_of_its_first_and_last_level(tmp_path):
    """Of points per coordinate, of which the record states the lengths; not known where none are measured."""
    levels = [{"heldout_planes_rms_um": x, "distance_rms_um": None, "points_rms_um": x} for x in (90, 50, 20)]
    (tmp_path / "fit.json").write_text(json.dumps({"ladder": levels}))
    found = read_reported(tmp_path).rms
    assert found["planes"] == pytest.approx((90e-6, 20e-6))
    assert found["points"] == pytest.approx((90e-6 / 3**0.5, 20e-6 / 3**0.5))
    assert np.all(np.isnan(found["distances"]))


def test_errors_of_points_are_the_lengths_that_the_run_states(tmp_path):
    """As in the summary of the fit: of the error vector, not of its coordinates."""
    session = tracker(count=40).dataset
    role = np.where(np.arange(len(session.measurements.ids)) % 5, "calibrate", "validate")
    found = bc.fit(replace(session, measurements=replace(session.measurements, role=role)), samples=0)
    found.save(tmp_path / "fit", False)
    bc.export(tmp_path / "fit", "mjcf", force=True).save(tmp_path / "arm.xml")
    result = bc.verify(tmp_path / "fit", tmp_path / "arm.xml")
    points = result.record["measured"]["points"]
    stated = [level["points_rms_um"] for level in found.record["ladder"]]
    for key, length in (("before_rms_um", stated[0]), ("after_rms_um", stated[-1])):
        assert 3**0.5 * points[key] == pytest.approx(length, rel=1e-3)
        assert points[f"predicted_{key}"] == pytest.approx(points[key], rel=1e-3)
        assert f"{length:.3g}" in str(result)


def test_images_are_not_replayed(tmp_path):
    """They ended in a traceback: a simulator's TCP position is no pose of the board."""
    bc.fit(camera_session(images=6, validate=1), samples=0).save(tmp_path / "fit", False)
    bc.export(tmp_path / "fit", "mjcf", force=True).save(tmp_path / "arm.xml")
    result = bc.verify(tmp_path / "fit", tmp_path / "arm.xml")
    assert result.record["measured"] is None
    assert "no validation measurements of positions" in str(result)
    assert "passed" in str(result)
