"""The arm of a log in simulators: the same torques, and what a file cannot hold."""

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from motion.made import RATE, inverse

import bayescal as bc
from bayescal.errors import BayescalError
from bayescal.exporting.log_arm import FORMATS, export_log
from bayescal.exporting.sidecar import mujoco
from bayescal.verifying.log_torque import COPY


@pytest.fixture(scope="module")
def run(tmp_path_factory, null_log):
    folder = tmp_path_factory.mktemp("export") / "run"
    bc.fit(null_log, samples=0).save(folder)
    return folder


@pytest.mark.parametrize("to", FORMATS)
def test_every_format_has_the_bodies_and_says_what_it_lacks(run, tmp_path, to):
    exported = bc.export(run, to)
    root = ElementTree.fromstring(exported.content)
    masses = [
        float(e.get("value") or e.get("mass") or e.text)
        for e in root.iter()
        if e.tag in ("mass", "inertial") and (e.get("mass") or e.tag == "mass")
    ]
    fitted = bc.load(run).parameters.estimate
    assert masses == pytest.approx([fitted[f"mass of link {k}"] for k in (1, 2, 3)], rel=1e-6)
    path, beside = exported.save(tmp_path / "arm.xml")
    missing = [part["part"] for part in json.loads(beside.read_text())["not_expressed"]]
    assert ("rotors" in missing) == (to != "mjcf")
    assert "offsets of the torque" in missing
    assert "not in the file" in str(exported)
    assert path.read_text() == exported.content


def test_what_a_file_lacks_has_its_size_whatever_its_sign(run):
    record = bc.load(run).record
    negative = [
        p | {"estimate": -abs(p["estimate"])} if p["name"].startswith("offset") else p
        for p in record["parameters"]
    ]
    sizes = [-p["estimate"] for p in negative if p["name"].startswith("offset")]
    assert export_log(run, {**record, "parameters": negative}, "mjcf").missing["offset"] == tuple(sizes)
    assert min(sizes) > 0.0


def test_simulators_load_the_same_arm(run):
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 4, 3))
    models = [mujoco().MjModel.from_xml_string(bc.export(run, to).content) for to in ("mjcf", "urdf")]
    for model in models:
        model.dof_frictionloss[:], model.dof_damping[:], model.dof_armature[:] = 0.0, 0.0, 0.0
    a, b = (inverse(model, q, dq, ddq) for model in models)
    assert a == pytest.approx(b, abs=1e-6)


def test_the_exported_arm_needs_the_torques_that_were_measured(run, tmp_path):
    file, _ = bc.export(run, "mjcf").save(tmp_path / "arm.xml")
    result = bc.verify(run, file)
    assert result.passed
    data = result.data
    assert np.all(data.difference < 1e-9)
    withheld = bc.load(run).withheld
    assert data.fitted == pytest.approx(withheld.rms_Nm, rel=0.15)
    assert np.all(data.nominal[1:] > 2.0 * data.fitted[1:])
    assert result.save(tmp_path / "verify") == ("verify.json",)
    assert "the file is the arm that was fitted" in str(result)


def test_torques_are_compared_at_the_times_of_the_fit(run, tmp_path):
    """Torques that are logged two rows late, and a fit that states it: the same errors."""
    file, _ = bc.export(run, "mjcf").save(tmp_path / "arm.xml")
    late = Path(shutil.copytree(run, tmp_path / "late"))
    record = json.loads((late / "fit.json").read_text())
    record["torque_shift_ms"] += 2e3 / RATE
    (late / "fit.json").write_text(json.dumps(record))
    (path,) = (late / COPY).glob("*.csv.gz")
    table = pd.read_csv(path)
    torques = [name for name in table.columns if name.startswith("torque")]
    table[torques] = table.groupby("motion")[torques].shift(2).bfill()
    table.to_csv(path, index=False)
    assert bc.verify(late, file).data.fitted == pytest.approx(bc.verify(run, file).data.fitted, rel=0.03)


def test_another_arm_is_not_the_one_that_was_fitted(run, tmp_path):
    text = bc.export(run, "mjcf").content
    wrong = tmp_path / "wrong.xml"
    mass = text.split('mass="')[2].split('"')[0]
    wrong.write_text(text.replace(f'mass="{mass}"', f'mass="{1.01 * float(mass)}"', 1))
    result = bc.verify(run, wrong)
    assert not result.passed
    assert "the file is not the arm that was fitted" in str(result)
    wrong.write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(BayescalError, match="has 0 joints, the log 3"):
        bc.verify(run, wrong)
    wrong.write_text("<mujoco><no/></mujoco>")
    with pytest.raises(BayescalError, match="MuJoCo does not load it"):
        bc.verify(run, wrong)


def test_other_formats_and_options_are_refused(run):
    with pytest.raises(BayescalError, match="cannot be written as kuka"):
        bc.export(run, "kuka")
    with pytest.raises(BayescalError, match="leave other options out"):
        bc.export(run, "mjcf", with_="backlash")
