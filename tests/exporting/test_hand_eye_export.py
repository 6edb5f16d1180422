"""Hand-eye files: the truth within their covariance, and readable by what reads them."""

import ast
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from camera_sessions import BOARD, CENTRE, FIXED, FOCAL, ON_FLANGE, camera_session, pose
from cases import refused, without_draws
from scipy.spatial.transform import Rotation

import bayescal as bc
from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.transforms import rpy_of
from bayescal.estimate import estimate
from bayescal.exporting.export import export
from bayescal.exporting.hand_eye import hand_eyes
from bayescal.fitted.arm import of_estimate, of_fit
from bayescal.model import USUAL, Scene, build
from factors.camera import NAMES
from factors.kind import rotation_vector


@pytest.fixture(scope="module", params=["flange", "fixed"])
def exported(request):
    found = estimate(build(Scene(camera_session(request.param, images=25)), ("geometry",)))
    arm = of_estimate(found, found.covariance)
    return request.param, export(arm, "hand-eye", force=True), arm, found


def off(matrix, true):
    """Turn about the frame's own axes and shift (6,) from a pose to the true one."""
    matrix = np.array(matrix)
    turn = Rotation.from_matrix(matrix[:3, :3].T @ true[:3, :3]).as_rotvec()
    return np.append(turn, true[:3, 3] - matrix[:3, 3])


def test_truth_is_within_the_covariance(exported):
    mount, written, arm, _ = exported
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
    coefficients = [lens[f"{target.name} {name}"] for name in NAMES[camera["lens"]]]
    np.testing.assert_allclose(camera["distortion"], coefficients, rtol=1e-12)


def test_the_covariance_on_the_flange_follows_from_differences(exported):
    arm = exported[2]
    tool = [p.name.split()[0] == "on-flange" for p in arm.model.parameters]
    values = arm.values.copy()
    values[tool] = [0.3, -0.5, 0.7, 0.1, 0.2, -0.1]

    def held(by):
        return hand_eyes(replace(arm, values=values + by))[0].on_flange

    steps = 1e-6 * np.eye(len(values))
    by = np.array([off(held(-s).pose, held(s).pose) / 2e-6 for s in steps]).T
    found = held(0.0).covariance
    np.testing.assert_allclose(found, by @ arm.covariance @ by.T, rtol=1e-5, atol=1e-6 * np.max(found))


def test_the_covariance_of_the_fixed_frame_is_that_of_the_fit(exported):
    """Of the unknowns of the target in it, by differences of the frame."""
    *_, arm, found = exported
    (block,), (here,) = arm.model.states, hand_eyes(arm)
    z, part = found.z[found.model.slices[block.target]], found.model.slices[block.target]
    ends = [[block.kind.describe(block.state(z + s))["frame"] for s in h * np.eye(6)] for h in (-1e-6, 1e-6)]
    by = np.array([off(a, b) / 2e-6 for a, b in zip(*ends, strict=True)]).T
    expected = by @ found.covariance[part, part] @ by.T
    size = np.sqrt(np.diag(expected))
    whole = np.outer(size, size)
    np.testing.assert_allclose(here.fixed.covariance / whole, expected / whole, atol=0.03)
    known = replace(arm, covariance=np.zeros_like(arm.covariance))
    half = replace(known, rejected=arm.dataset.measurements.ids[::2])
    fewer, all_rows = (np.trace(hand_eyes(of)[0].fixed.covariance) for of in (half, known))
    assert fewer == pytest.approx(2.0 * all_rows, rel=0.2)


def test_the_fixed_frame_does_not_depend_on_where_it_was_stated(exported):
    """Stated elsewhere, turned and moved, its deviation from there makes up for it; the priors are wide."""
    arm = replace(exported[2], covariance=np.zeros_like(exported[2].covariance))  # bow is of the stated place
    (here,), (block,) = hand_eyes(arm), arm.model.states
    placed = here.fixed.pose
    away = Rotation.from_rotvec([0.6, -0.4, 0.8]).as_matrix()
    stated = {"rpy": rpy_of(away.T @ placed[:3, :3]), "xyz": placed[:3, 3] + [0.1, -0.05, 0.02]}
    (target,) = arm.dataset.targets
    moved = replace(target, values=dict(target.values) | stated)
    model = build(Scene(replace(arm.dataset, targets=(moved,))), arm.effects)
    kind = model.states[0].kind
    state = np.append(rotation_vector(away), np.zeros(3))
    state[3:] = placed[:3, 3] - kind.placed(state)[:, 3]
    (there,) = hand_eyes(replace(arm, model=model, states={block.target: state}))
    np.testing.assert_allclose(there.fixed.pose, placed, atol=1e-9)
    size = np.sqrt(np.diag(here.fixed.covariance))
    apart = (there.fixed.covariance - here.fixed.covariance) / np.outer(size, size)
    np.testing.assert_allclose(apart, 0.0, atol=1e-3)


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
    mount, written, *_ = exported
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
    refused("no camera", lambda: export(of_estimate(found, found.covariance), "hand-eye", force=True))


def shifted(mount, row, held, base):
    """A session in which what is on the flange, and the base, are shifted by poses from a row on."""
    session = camera_session(mount, images=30, noise=0.1)
    m, chain = session.measurements, chain_of(session.robot)
    tool = base @ frames(chain, link_angles(session.robot, m.readings))[:, -1] @ ON_FLANGE @ held
    seen = np.linalg.inv(tool) @ FIXED[mount] if mount == "flange" else np.linalg.inv(FIXED[mount]) @ tool
    at = np.einsum("nij,nj->ni", seen[:, :3, :3], BOARD[m.pixel[:, 2].astype(int)]) + seen[:, :3, 3]
    noise = 0.1 * np.random.default_rng(1).standard_normal((len(at), 2))
    pixel = m.pixel.copy()
    pixel[row:, :2] = (at[:, :2] / at[:, 2:] * FOCAL + CENTRE + noise)[row:]
    return replace(session, measurements=replace(m, pixel=pixel))


@pytest.mark.parametrize(("mount", "site"), [("flange", "tool"), ("fixed", "base")])
def test_what_slipped_is_where_it_is_at_the_end(mount, site):
    """What is on the flange, or the base, is shifted from the 11th image on; before it at the first row."""
    slip = pose(np.degrees([2e-4, -3e-4, 2.5e-4]), [2e-4, -1.5e-4, 2e-4])
    still, row = np.eye(4), 10 * len(BOARD)
    moved = (slip, still) if site == "tool" else (still, slip)
    scene = Scene(shifted(mount, row, *moved))
    wide = replace(USUAL, prior_width=10.0)  # the shift is large against its usual prior
    found = estimate(build(scene, ("geometry", f"step@{row + 1} at {site}"), wide))
    arm = of_estimate(found, found.covariance)
    after = ON_FLANGE @ moved[0], np.linalg.inv(moved[1]) @ FIXED[mount]
    truth = {-1: after, 0: (ON_FLANGE, FIXED[mount])}
    ends = {}
    for state, true in truth.items():
        (both,) = hand_eyes(arm, state)
        ends[state] = both.on_flange, both.fixed
        for here, there in zip(ends[state], true, strict=True):
            error = off(here.pose, there)
            assert error @ np.linalg.solve(here.covariance, error) < 25
    which = int(site == "base")  # of what is on the flange, and what is fixed
    difference = off(ends[0][which].pose, ends[-1][which].pose) - off(truth[0][which], truth[-1][which])
    assert np.all(np.abs(difference[3:]) < 1e-4), difference  # of a slip of 0.3 mm; turns by their u above
    (left,) = (x for x in export(arm, "hand-eye", force=True).missing if x.effect == "step")
    assert "the file has one state" in left.why
    # of the fixed frame at the end: that of a target which is located anew for each arm
    (block,), steps = arm.model.states, 1e-7 * np.eye(len(arm.values))
    weight = np.tile(np.isin(block.rows, found.rejected, invert=True) / arm.beyond.noise_of(block) ** 2, 2)

    def located(values):
        z = found.z[found.model.slices[block.target]]
        for _ in range(3):
            r, _, by = block.linearise(values, z)
            weighted = by.T * weight
            z = z - np.linalg.solve(weighted @ by + np.eye(6), weighted @ r + z)
        return hand_eyes(replace(arm, values=values, states={block.target: block.state(z)}))[0].fixed.pose

    by = np.array([off(located(arm.values - s), located(arm.values + s)) / 2e-7 for s in steps]).T
    (known,) = hand_eyes(replace(arm, covariance=0.0 * arm.covariance))
    expected = known.fixed.covariance + by @ arm.covariance @ by.T
    size = np.sqrt(np.diag(ends[-1][1].covariance))
    apart = (ends[-1][1].covariance - expected) / np.outer(size, size)
    np.testing.assert_allclose(apart, 0.0, atol=5e-3)  # of a slip of 0.3 mm and mrad


@pytest.mark.parametrize("mount", ["flange", "fixed"])
def test_a_scaled_board_is_seen_where_it_is_and_not_where_it_is_stated(mount):
    """Places stated 0.2 rad off, within their u: the same size of the board, and the same covariance."""
    session = camera_session(mount, images=15, scale=1.002)
    (target,), (tool,) = session.targets, session.tools

    def fitted(turn):
        turned = rpy_of(Rotation.from_rotvec(turn).as_matrix() @ FIXED[mount][:3, :3])
        on = rpy_of(ON_FLANGE[:3, :3] @ Rotation.from_rotvec(turn[::-1]).as_matrix())
        own = {"rpy": turned, "xyz": FIXED[mount][:3, 3], "u_scale": 2e-3}
        stated = replace(target, values=target.values | own, u=0.05, u_angle=0.2)
        placed = replace(tool, rpy=on, u=0.05, u_angle=0.2)
        scene = Scene(replace(session, targets=(stated,), tools=(placed,)))
        found = estimate(build(scene, ("geometry",)))
        arm = of_estimate(found, found.covariance)
        k = [p.name for p in arm.model.parameters].index("cam scale x")
        held = hand_eyes(arm)[0].on_flange.covariance
        return arm.values[k], np.sqrt(arm.covariance[k, k]), np.sqrt(np.diag(held))

    (near, u, held), (far, u_far, held_far) = fitted(np.zeros(3)), fitted(np.array([0.12, -0.1, 0.124]))
    assert far == pytest.approx(near, abs=0.02 * u)
    assert u_far == pytest.approx(u, rel=0.002)
    np.testing.assert_allclose(held_far, held, rtol=0.005)


def test_a_fit_states_the_transforms_and_the_lens_itself(tmp_path):
    session = camera_session(images=12)
    (t,) = session.targets
    lens = t.values | {"distortion": np.array([-0.001, 0.0, 0.0, 0.0, 0.0])}
    fit = bc.fit(replace(session, targets=(replace(t, values=lens),)), "geometry", samples=0)
    (stated,) = fit.record["hand_eye"]
    (transform,) = hand_eyes(of_fit(fit.data))
    np.testing.assert_allclose(stated["on_flange"]["translation_mm"], 1e3 * transform.on_flange.pose[:3, 3])
    turn = Rotation.from_quat(stated["fixed"]["quaternion_xyzw"]).as_matrix()
    np.testing.assert_allclose(turn, transform.fixed.pose[:3, :3], atol=1e-12)
    u = np.sqrt(np.diag(transform.on_flange.covariance))
    np.testing.assert_allclose(stated["on_flange"]["u_translation_mm"], 1e3 * u[3:])
    assert stated["on_flange"]["parent"] == "tool0"
    (k1,) = [p for p in fit.record["parameters"] if p["name"] == "cam k1"]
    assert k1["nominal"] == pytest.approx(-0.001)
    assert "hand-eye" in str(fit)
    with without_draws():
        fit.save(tmp_path / "run", pictures=False)
    written = json.loads((tmp_path / "run" / "arm.json").read_text())["hand_eye"]
    assert written == json.loads(json.dumps(fit.record["hand_eye"]))
