"""`bayescal export` on run folders of `fit` and `gap`."""

import csv
import json
import re
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from cases import cases, refused, without_draws
from export_arms import calibrated_frames, fake, session_of, with_robot

import bayescal as bc
from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.transforms import rigid, rotation, rpy_matrix
from bayescal.errors import BayescalError
from bayescal.exporting.export import export
from bayescal.exporting.robot import calibrated_robot, robot_text
from bayescal.exporting.written import read_sidecar
from bayescal.reporting.exports import _alternative

OPTIONS = {"contacts": 46, "later": 4, "repeats": 2, "spheres": 0, "seed": 1}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A fit and its run folder, without the dataset that it was made from."""
    folder = tmp_path_factory.mktemp("runs") / "fit"
    result = bc.fit(bc.simulate(**OPTIONS), samples=0)
    with without_draws():
        result.save(folder, pictures=False)
    return result, folder


@pytest.fixture
def run(fitted):
    return fitted[1]


def test_a_file_and_its_sidecar(run, tmp_path, output_of):
    text = output_of("export", run, "--to", "urdf", "--out", tmp_path / "arm.urdf")
    assert "parameters of the arm" in text
    assert "not in the file" in text
    assert "alternative      --without compliance fits the session again" in text
    record = json.loads((tmp_path / "arm.urdf.bayescal.json").read_text())
    assert record["schema"] == "bayescal-export/1"
    (missing,) = record["not_expressed"]
    assert missing["effect"] == "compliance"
    assert missing["max_um"] > missing["rms_um"] > 10
    shown = re.search(r"^compliance +([\d.]+) +([\d.]+)$", text, re.MULTILINE).groups()
    assert [float(x) for x in shown] == pytest.approx([missing["rms_um"], missing["max_um"]], abs=0.5)
    assert record["remaining"]["max_um"] == pytest.approx(missing["max_um"])
    written = {w["parameter"]: w for w in record["written"]}
    saved = {p["name"]: p for p in json.loads((run / "arm.json").read_text())["parameters"]}
    assert written["a2"]["value"] == saved["a2"]["value"]
    assert written["a2"]["u"] == pytest.approx(saved["a2"]["u"])
    assert written["a2"]["element"] == "joint[@name='J3']/origin"
    assert {p.name for p in Path(tmp_path).iterdir()} == {"arm.urdf", "arm.urdf.bayescal.json"}


@pytest.mark.parametrize(("arguments", "message"), cases("export_refusals"))
def test_bad_input_is_one_line(run, tmp_path, error_of, arguments, message):
    assert message in error_of("export", run, *arguments, "--out", tmp_path / "arm")
    assert not list(Path(tmp_path).iterdir())


def test_no_run(tmp_path, error_of):
    assert "there is no arm.json" in error_of("export", tmp_path, "--to", "urdf")


def test_a_result_in_memory_is_its_run_folder(fitted):
    here, there = (bc.export(of, "robot.yaml").content for of in fitted)
    words = [[line.partition(" ")[0] for line in text.splitlines()] for text in (here, there)]
    assert words[0] == words[1]
    found = [np.array(re.findall(r"-?\d+\.\d+(?:e-?\d+)?", text), float) for text in (here, there)]
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)


# --- Files of an export: none of the user is overwritten, and what a file states can be read again.


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
    refused(f"{name}: exists and is no .*; give another --out", lambda: table.save(tmp_path / "arm.csv"))
    assert contents(tmp_path) == before


def test_an_unchanged_export_is_replaced_and_a_changed_one_is_kept(table, tmp_path):
    table.save(tmp_path / "arm.csv")
    table.save(tmp_path / "arm.csv")
    assert list(json.loads((tmp_path / "arm.csv.bayescal.json").read_text())["beside"]) == ["arm.json"]
    (tmp_path / "arm.json").write_text("edited")
    before = contents(tmp_path)
    refused(r"arm\.json: exists and is no unchanged export", lambda: table.save(tmp_path / "arm.csv"))
    assert contents(tmp_path) == before
    refused("Not a directory", lambda: table.save(tmp_path / "arm.json" / "new.csv"))
    assert all(file.exists() for file in table.save(tmp_path / "made" / "here" / "new.csv"))


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
    files = {"arm.csv", "arm.json", "arm.csv.bayescal.json"}
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
            refused(r"the export was interrupted before arm\.\w+ was in place", lambda: read_sidecar(path))
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
    refused(r"arm\.json: a further file would have this name", lambda: table.save(tmp_path / "arm.json"))
    assert not contents(tmp_path)


def test_robot_yaml_names_joints_that_were_made_rigid(arm):
    """A negative compliance is not physical: the file has none, and says so."""
    names = [p.name for p in arm.model.parameters]
    values = arm.values.copy()
    assert "Rigid" not in robot_text(arm, "the sidecar")
    for name in ("compliance J3", "compliance J5"):
        values[names.index(name)] = -1e-6
    text = robot_text(replace(arm, values=values), "the sidecar")
    assert "\n# Rigid here, because the estimated compliance is negative: J3, J5.\n" in text


@pytest.mark.parametrize("time", [np.nan, np.inf])
def test_a_time_that_is_no_number_is_refused(arm, time):
    with pytest.raises(BayescalError, match="--at-time-s: is not a finite number; give a number of s"):
        export(arm, "robot.yaml", time=time, force=True)


# --- UR calibration, DH table, joint zeros.

UR = "universal-robots-ur5e"
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
FACTORY = {
    "shoulder": (0, 0, 0.1625, 0, 0, 0),
    "upper_arm": (0, 0, 0, 1.570796327, 0, 0),
    "forearm": (-0.425, 0, 0, 0, 0, 0),
    "wrist_1": (-0.3922, 0, 0.1333, 0, 0, 0),
    "wrist_2": (0, -0.0997, -2.044881182297852e-11, 1.570796327, 0, 0),
    "wrist_3": (0, 0.0996, -2.042830148012698e-11, 1.570796326589793, 3.141592653589793, 3.141592653589793),
}
"""default_kinematics.yaml of ur_description for the UR5e."""


def kinematics(values, label="calib_12345") -> str:
    lines = ["kinematics:"]
    for link, numbers in values.items():
        lines += [f"  {link}:", *(f"    {k}: {v!r}" for k, v in zip(KEYS, numbers, strict=True))]
    return "\n".join([*lines, f"  hash: {label}"]) + "\n"


def wrist(text: str, readings: np.ndarray) -> np.ndarray:
    """Frames of wrist_3 (C, 4, 4) in base_link_inertia, as the URDF of ur_description builds them."""
    each, out = yaml.safe_load(text)["kinematics"], []
    for q in readings:
        pose = np.eye(4)
        for link, turn in zip(LINKS, q, strict=True):
            x = np.array([each[link][key] for key in KEYS])
            pose = pose @ rigid(rpy_matrix(x[3:]), x[:3]) @ rigid(rotation(2, turn))
        out.append(pose)
    return np.array(out)


@pytest.fixture(scope="module")
def ur():
    return fake(session_of(UR), ("geometry",))


def patched(ur, tmp_path, factory=FACTORY):
    """The arm in a calibration file of the driver."""
    (tmp_path / "mine.yaml").write_text(kinematics(factory))
    return export(ur, "ur-yaml", into=str(tmp_path / "mine.yaml"))


def test_ur_calibration(ur):
    out = export(ur, "ur-yaml")
    readings = ur.dataset.measurements.readings
    own = calibrated_frames(ur)[:, -2]
    np.testing.assert_allclose(wrist(out.written.content, readings), own, rtol=0, atol=1e-12)
    assert "ur_robot_driver warns" in " ".join(out.notes)
    assert not out.missing


def test_ur_calibration_with_the_hash_of_the_arm(ur, tmp_path):
    out = patched(ur, tmp_path)
    assert yaml.safe_load(out.written.content)["kinematics"]["hash"] == "calib_12345"
    readings = ur.dataset.measurements.readings
    alone = wrist(export(ur, "ur-yaml").written.content, readings)
    np.testing.assert_allclose(wrist(out.written.content, readings), alone, rtol=0, atol=1e-9)


def test_ur_calibration_of_an_arm_that_the_manufacturer_calibrated(ur, tmp_path):
    """Zeros of 0.66 deg, and a last link that is 0.33 mm longer: where the tool is in tool0 is stated."""
    factory = {link: np.array(x, float) for link, x in FACTORY.items()}
    factory["forearm"] += (2e-4, -1e-4, 3e-4, 1e-3, -5e-4, np.radians(0.66))
    factory["wrist_1"] += (1e-4, 0, -3e-4, 4e-4, 0, -np.radians(0.4))
    factory["wrist_3"][:3] += (0, 3.3e-4, 0)
    out = patched(ur, tmp_path, {k: x.tolist() for k, x in factory.items()})
    assert any("calibrated already, with zeros within 0.6" in note for note in out.notes)
    readings, record = ur.dataset.measurements.readings, out.record("mine.yaml")
    flange = wrist(out.written.content, readings) @ np.array(record["flange_in_tip"])
    flange = np.array(record["root_in_f0"]) @ flange
    np.testing.assert_allclose(flange, calibrated_frames(ur)[:, -1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(record["flange_in_tip"], np.eye(4), atol=1e-6)


def test_the_tool_in_a_tip_that_is_not_the_flange(ur, tmp_path):
    """The nominal file of an arm whose last frame is 5 mm before the flange."""
    out = patched(ur, tmp_path, FACTORY | {"wrist_3": (0, 0.0946, 0, *FACTORY["wrist_3"][3:])})
    tool = out.record("mine.yaml")["tools"][0]
    away = np.subtract(tool["centre_in_tip_mm"], tool["centre_mm"])
    np.testing.assert_allclose(away, [0, 0, 5.0], atol=1e-4)
    at = ", ".join(f"{x:.3f}" for x in tool["centre_in_tip_mm"])
    assert f"tool0 is not the flange: the centre of tool {tool['name']} is at {at} mm in it" in out.notes
    readings = ur.dataset.measurements.readings
    tips = (wrist(out.written.content, readings) @ [*(1e-3 * np.array(tool["centre_in_tip_mm"])), 1.0])[:, :3]
    np.testing.assert_allclose(tips, ur.at(readings).points, rtol=0, atol=1e-7)
    assert not any("is not the flange" in note for note in export(ur, "ur-yaml").notes)


def test_ur_calibration_of_another_arm_is_refused(ur, tmp_path):
    refused("is no arm of Universal Robots", lambda: export(fake(session_of(), ("geometry",)), "ur-yaml"))
    with pytest.raises(BayescalError, match=r"the axes of upper_arm and forearm is 612\.70 mm"):
        patched(ur, tmp_path, FACTORY | {"forearm": (-0.6127, 0, 0, 0, 0, 0)})
    (tmp_path / "mine.yaml").write_text("kinematics: {}\n")
    with pytest.raises(BayescalError, match="no calibration of ur_robot_driver"):
        export(ur, "ur-yaml", into=str(tmp_path / "mine.yaml"))


@pytest.mark.parametrize("name", ["fanuc-lrmate200ic", UR])
def test_dh_table(name):
    session, base = session_of(name), rigid(rpy_matrix(np.array([0.1, 0.2, 0.3])), np.array([0.4, 0.5, 0.6]))
    arm = fake(with_robot(session, replace(session.robot, base=base)), ("geometry", "compliance"))
    out = export(arm, "dh-csv")
    robot = calibrated_robot(arm.model, arm.values)
    rows = list(csv.DictReader(out.written.content.splitlines()))
    np.testing.assert_array_equal([float(r["a_mm"]) for r in rows], 1e3 * robot.a)
    record = json.loads(out.written.beside[".json"])
    covariance = np.array(record["covariance"])
    names = [(v["place"], v["quantity"]) for v in record["values"]]
    k, p = names.index(("J3", "a")), arm.model.names.index("a2")
    assert covariance[k, k] == pytest.approx(1e6 * arm.covariance[p, p], rel=1e-5)
    k, p = names.index(("J3", "compliance")), arm.model.names.index("compliance J3")
    assert covariance[k, k] == pytest.approx(1e12 * arm.covariance[p, p], rel=1e-5)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
    assert not out.missing
    # every cell of the table, against the numbers of the robot (rad, m) and the covariance of the other file
    of = {(v["place"], v["quantity"]): (v, own) for v, own in zip(record["values"], covariance, strict=True)}
    for k, row in enumerate(rows):
        for head in (head for head in row if head.startswith("u_")):
            key, unit = head.split("_", 2)[1:]
            v, own = of[row["joint"], key]
            stated = getattr(robot, key)[k] * {"mm": 1e3, "deg": 180 / np.pi}.get(unit, 1e6)
            u = np.sqrt(max(own[list(of).index((row["joint"], key))], 0.0))
            assert [float(row[f"{key}_{unit}"]), v["value"]] == pytest.approx([stated] * 2, rel=1e-12)
            assert [float(row[head]), v["u"]] == pytest.approx([u] * 2, rel=1e-9)
            assert unit == v["unit"].replace("/(", "_per_").split("_per")[0] or key == "compliance"
    mm, deg = ([of["base", key][0]["value"] for key in keys] for keys in ("xyz", ("roll", "pitch", "yaw")))
    place = rigid(rpy_matrix(np.radians(deg)), 1e-3 * np.array(mm))
    np.testing.assert_allclose(place, robot.base, atol=1e-12)


def test_a_compliance_of_zero_has_its_whole_u_in_a_table():
    """A file holds none below zero: derivatives through that limit had half of it."""
    arm = fake(session_of(UR), ("geometry", "compliance"))
    k = arm.model.names.index("compliance J3")
    values = arm.values.copy()
    values[k] = -arm.model.parameters[k].nominal
    arm = replace(arm, values=values)
    assert calibrated_robot(arm.model, values).compliance[2] == 0.0
    record = json.loads(export(arm, "dh-csv", force=True).written.beside[".json"])
    (u,) = (v["u"] for v in record["values"] if (v["place"], v["quantity"]) == ("J3", "compliance"))
    assert u == pytest.approx(1e6 * np.sqrt(arm.covariance[k, k]), rel=1e-5)


@pytest.mark.parametrize(("rms", "stated"), [(0.0, False), (1e-9, False), (2e-6, True), (np.nan, True)])
def test_no_refit_is_proposed_for_what_moves_nothing(rms, stated):
    missing = SimpleNamespace(effect="compliance", rms=rms)
    found = SimpleNamespace(missing=(missing,), arm=SimpleNamespace(effects=("geometry", "compliance")))
    assert bool(_alternative(found)) is stated


def test_joint_zeros():
    """Readings with the corrections added move the nominal arm as the arm with these zeros alone."""
    session = session_of()
    coupling = session.robot.link_from_reading.copy()
    coupling[2, 1:3] = 0.5, 1.0  # not its own inverse
    arm = fake(with_robot(session, replace(session.robot, link_from_reading=coupling)), ("joint",))
    size = len(arm.values)
    arm = replace(arm, covariance=0.005 * (np.eye(size) + np.ones((size, size))))
    out = export(arm, "joint-zeros")
    rows = list(csv.DictReader(out.written.content.splitlines()))
    large = export(replace(arm, values=100.0 * arm.values), "joint-zeros").written.content
    for row in csv.DictReader(large.splitlines()):
        ticks = float(row["correction_deg"]) / 360.0 * 4096
        assert float(row["correction_ticks_4096"]) == pytest.approx(ticks, abs=0.5)
    correction = np.array([float(r["correction_rad"]) for r in rows])
    readings, robot = arm.dataset.measurements.readings, arm.dataset.robot
    shown = frames(chain_of(robot), link_angles(robot, readings + correction))[:, -1]
    zeros = np.array([p.unit == "rad" and p.effect == "joint" for p in arm.model.parameters])
    own = arm.valued(np.where(zeros, arm.values, 0.0)).at(readings).flange
    np.testing.assert_allclose(shown, own, rtol=0, atol=1e-12)
    # u by draws of the parameters, each evaluated as the corrections are
    rng, by = np.random.default_rng(0), []
    for z in rng.standard_normal((400, len(arm.values))):
        drawn = replace(arm, values=arm.values + np.linalg.cholesky(arm.covariance) @ z)
        table = csv.DictReader(export(drawn, "joint-zeros").written.content.splitlines())
        by.append([float(r["correction_rad"]) for r in table])
    u = np.array([float(r["u_rad"]) for r in rows])
    np.testing.assert_allclose(u, np.std(by, axis=0), rtol=0.12, atol=1e-12)
    np.testing.assert_allclose([float(r["u_deg"]) for r in rows], np.degrees(u), rtol=1e-9)
    np.testing.assert_allclose([float(r["correction_deg"]) for r in rows], np.degrees(correction), rtol=1e-9)
    assert [r["u_rad"] == "0.0" for r in rows] == [True, False, False, False, False, True]
    assert out.missing[0].effect == "joint"
    assert all(name.startswith("encoder-scale") for name in out.missing[0].parameters)
