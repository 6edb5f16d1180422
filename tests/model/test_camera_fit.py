"""A fit to a simulated camera session finds hand-eye, what is fixed, and the arm within their uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from camera_sessions import FIXED, FOCAL, ON_FLANGE, camera_session

from bayescal.effects import imaging
from bayescal.estimate import estimate
from bayescal.model import ARM, Scene, build, with_parameters
from bayescal.model.parts import view
from factors.kind import rotation_vector


@pytest.mark.parametrize("mount", FIXED)
def test_truth_is_within_the_uncertainty(mount):
    off, count = [], 0
    zeros = np.array([0.0, 1e-3, -2e-3, 1.5e-3, 1e-3, 0.0])
    for seed in range(3):
        model = build(Scene(camera_session(mount, images=20, seed=seed, arm=zeros)), ("geometry",))
        found = estimate(model)
        u = np.sqrt(np.diag(found.covariance)) * np.concatenate([model.sd, model.blocks[0].sd])
        value = dict(zip(model.names, model.physical(found.z), strict=True))
        nominal = {p.name: p.nominal for p in model.parameters}
        sd = dict(zip(model.names, u, strict=True))
        for axis, true in zip("xyz", ON_FLANGE[:3, 3], strict=True):
            off.append((value[f"on-flange {axis}"] - true) / sd[f"on-flange {axis}"])
        joints = {f"theta{j + 1}": zeros[j] for j in (1, 2, 3)}
        off += [(value[name] - nominal[name] - true) / sd[name] for name, true in joints.items()]
        off += [(value[f"cam f{a}"] - f) / sd[f"cam f{a}"] for a, f in zip("xy", FOCAL, strict=True)]
        block = model.blocks[0]
        frame = block.kind.describe(block.state(found.z[model.slices["cam"]]))["frame"]
        assert np.linalg.norm(frame[:3, 3] - FIXED[mount][:3, 3]) < 2e-3
        assert np.linalg.norm(rotation_vector(frame[:3, :3] @ FIXED[mount][:3, :3].T)) < 5e-3
        assert 0.9 < found.weights.scale["pixel"] < 1.1
        count += len(found.rejected)
    assert np.sqrt(np.mean(np.square(off))) < 1.4
    assert np.max(np.abs(off)) < 3.5
    assert count <= 2


@pytest.mark.parametrize("effects", [(), ("geometry",)])
@pytest.mark.parametrize("mount", FIXED)
def test_residuals_by_images_are_those_by_rows(mount, effects):
    scene, rng = Scene(camera_session(mount, images=6, seed=1)), np.random.default_rng(2)
    model = build(scene, effects) if effects else with_parameters(scene, (), ())
    (block,), z = model.blocks, 0.1 * rng.standard_normal((3, model.size))
    values, own = model.deviations(z[:, model.slices[ARM]]), z[:, model.slices["cam"]]
    found = block.residual(values, own)
    for k in range(3):
        r, by_arm, _ = block.linearise(values[k], own[k])
        np.testing.assert_allclose(found[k].ravel(), r, atol=1e-12)
        if effects:  # the slopes of the tool's mount, which all rows share
            step = 1e-6 * (np.arange(len(model.parameters)) == model.names.index("on-flange rx"))
            ends = [block.residual(values[k] + way * step, own[k]).ravel() for way in (1, -1)]
            np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, by_arm @ (step / 1e-6), atol=1e-6)


@pytest.mark.parametrize("rough", [0.0, 0.02])
@pytest.mark.parametrize("mount", FIXED)
def test_errors_of_a_lens_and_a_board_are_differences_of_the_images(mount, rough):
    """Of another lens, a board that is larger about its middle, and one that is bent up there.

    Where the nominal arm is rough, at the poses that the images tell.
    """
    scene = Scene(camera_session(mount, images=4, seed=3))
    rows = np.arange(len(scene.q))
    pose, target, none = scene.nominal(0, rows), scene.dataset.targets[0], np.zeros(6)
    kind = scene.kind(0, rows)
    kind = replace(kind, pixel=kind.pixels(none, pose).T)  # as at nominal geometry
    camera, board = [np.broadcast_to(p, pose.shape) for p in (pose, kind.placed(none)[..., None])][
        :: 1 if kind.carried else -1
    ]
    sighted = np.einsum("jic,jkc->cik", camera[:, :3], board)
    sighted[:, :, 3] -= np.einsum("jic,jc->ci", camera[:, :3], camera[:, 3])
    seen = view(target, kind, rows, pose + rough, len(rows), sighted if rough else np.nan * sighted)
    lens, corner, ends = kind.lens, kind.corner, (kind.corner.min(axis=0), kind.corner.max(axis=0))
    middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    local = corner - middle

    def of_lens(field, k):
        return lambda h: replace(
            kind, lens=replace(lens, **{field: getattr(lens, field) + h * one(field, k)})
        )

    def one(field, k):
        return np.eye(len(getattr(lens, field)))[k]

    def of_board(by):
        return lambda h: replace(kind, corner=corner + h * by)

    names = (("focal", "focal"), ("centre", "centre"), ("distortion", "coefficients"))
    made = [(make, [of_lens(field, k) for k in range(len(getattr(lens, field)))]) for make, field in names]
    sheared = [local * np.eye(3)[0], local * np.eye(3)[1], local[:, 1:2] * np.eye(3)[0]]
    made.append(("scale", [of_board(by) for by in sheared]))
    bent = [(1.0 - (local[:, k] / half[k]) ** 2)[:, None] * np.eye(3)[2] for k in range(2)]
    bent.append(np.prod(local[:, :2] / half[:2], axis=1)[:, None] * np.eye(3)[2])
    made.append(("bow", [of_board(b) for b in bent]))
    for make, changed in made:
        usual, wide = (imaging.of_view(seen, make, "p", times) for times in (1.0, 3.0))
        assert len(usual) == len(changed)
        for p, q, other in zip(usual, wide, changed, strict=True):
            found = {t.axis: np.asarray(t.driver) for t in p.terms}
            ends = [other(h).residual(none, pose) for h in (1e-6, -1e-6)]
            expected = (ends[0] - ends[1]) / 2e-6
            size = np.max(np.abs(expected))
            for row, axis in enumerate("uv"):
                slope = found.get(axis, 0.0 * expected[row]) / size
                np.testing.assert_allclose(slope, expected[row] / size, atol=1e-6, err_msg=p.name)
            assert q.sd == pytest.approx(3.0 * p.sd)
