"""Hand-eye files: the truth within their covariance, and readable by what reads them."""

import ast
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from camera_sessions import FIXED, FOCAL, ON_FLANGE, camera_session
from scipy.spatial.transform import Rotation

from bayescal.errors import BayescalError
from bayescal.estimate import estimate
from bayescal.exporting.export import export
from bayescal.fitted.arm import of_estimate
from bayescal.model import build
from bayescal.model.scene import Scene


@pytest.fixture(scope="module", params=["flange", "fixed"])
def exported(request):
    found = estimate(build(Scene(camera_session(request.param, images=25)), ("geometry",)))
    arm = of_estimate(found, found.covariance)
    return request.param, export(arm, "hand-eye", force=True), arm


def off(matrix, true):
    """Turn about the frame's own axes and shift (6,) from a pose to the true one."""
    matrix = np.array(matrix)
    turn = Rotation.from_matrix(matrix[:3, :3].T @ true[:3, :3]).as_rotvec()
    return np.append(turn, true[:3, 3] - matrix[:3, 3])


def test_truth_is_within_the_covariance(exported):
    mount, written, arm = exported
    (camera,) = json.loads(written.written.beside[".opencv.json"])["cameras"]
    for name, true in (("on_flange", ON_FLANGE), ("fixed", FIXED[mount])):
        error, covariance = off(camera[name]["matrix"], true), np.array(camera[name]["covariance"])
        assert np.all(np.linalg.eigvalsh(covariance) > 0)
        assert error @ np.linalg.solve(covariance, error) < 25  # 6 degrees of freedom
        assert np.linalg.norm(error[3:]) < 2e-3
    focal = np.diag(camera["camera_matrix"])[:2]
    np.testing.assert_allclose(focal, FOCAL, rtol=2e-3)
    lens = {p.name: p.nominal + v for p, v in zip(arm.model.parameters, arm.values, strict=True)}
    target = arm.dataset.targets[0]
    np.testing.assert_allclose(focal, [lens[f"{target.name} f{axis}"] for axis in "xy"], rtol=1e-12)
    assert np.all(np.abs(focal - [target.values["fx"], target.values["fy"]]) > 1e-3)


def test_names_are_texts_in_files_and_no_program(exported):
    name = "x'], **{}); import os; os.abort()  # \"y: ["
    arm = exported[2]
    targets = (replace(arm.dataset.targets[0], name=name),)
    found = estimate(build(Scene(replace(arm.dataset, targets=targets)), ("geometry",)))
    out = export(of_estimate(found, found.covariance), "hand-eye", force=True).written
    (call,) = [n for n in ast.walk(ast.parse(out.beside[".launch.py"])) if isinstance(n, ast.Return)]
    texts = {n.value for n in ast.walk(call) if isinstance(n, ast.Constant)}
    assert {f"{name}_camera", f"{name}_board"} <= texts
    assert {n.func.id for n in ast.walk(call) if isinstance(n, ast.Call)} == {"LaunchDescription", "Node"}
    assert yaml.safe_load(out.content)["parameters"]["name"] == name


def test_files_of_ros(exported, tmp_path):
    mount, written, _ = exported
    yaml_file, launch, matrices, sidecar = written.save(tmp_path / "cell.yaml")
    calibration = yaml.safe_load(yaml_file.read_text())
    kind = "eye_in_hand" if mount == "flange" else "eye_on_base"
    assert calibration["parameters"]["calibration_type"] == kind
    turn = Rotation.from_quat([calibration["transform"]["rotation"][k] for k in "xyzw"]).as_matrix()
    (camera,) = json.loads(matrices.read_text())["cameras"]
    held = camera["on_flange" if mount == "flange" else "fixed"]
    np.testing.assert_allclose(turn, np.array(held["matrix"])[:3, :3], atol=1e-12)
    compile(launch.read_text(), "launch.py", "exec")
    assert json.loads(sidecar.read_text())["format"] == "hand-eye"


def test_a_session_without_a_camera(cube):
    found = estimate(build(Scene(cube(seed=1).dataset), ("joint",)))
    with pytest.raises(BayescalError, match="no camera"):
        export(of_estimate(found, found.covariance), "hand-eye", force=True)
