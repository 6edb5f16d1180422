"""A fit to a simulated camera session finds hand-eye, what is fixed, and the arm within their uncertainty."""

import numpy as np
import pytest
from camera_sessions import FIXED, FOCAL, ON_FLANGE, camera_session

from bayescal.estimate import estimate
from bayescal.model import ARM, build
from bayescal.model.model import with_parameters
from bayescal.model.scene import Scene
from factors.turns import rotation_vector


@pytest.mark.parametrize("mount", FIXED)
def test_truth_is_within_the_uncertainty(mount):
    off, count = [], 0
    zeros = np.array([0.0, 1e-3, -2e-3, 1.5e-3, 1e-3, 0.0])
    for seed in range(4):
        scene = Scene(camera_session(mount, images=25, seed=seed, arm=zeros))
        model = build(scene, ("geometry",))
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
