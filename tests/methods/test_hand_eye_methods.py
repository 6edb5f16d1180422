"""The solvers of OpenCV on a session of a camera, beside the estimate."""

from dataclasses import replace

import numpy as np
import pytest
from camera_sessions import ON_FLANGE, camera_session

from bayescal.calibration import fit
from bayescal.methods import compare
from bayescal.methods.published import SOLVERS, on_flange
from bayescal.model.scene import Scene

pytest.importorskip("cv2")


@pytest.mark.parametrize("mount", ["flange", "fixed"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solver_finds_the_hand_eye(mount, solver):
    scene = Scene(camera_session(mount, images=15, noise=0.01))
    np.testing.assert_allclose(on_flange(scene, 0, solver)[:, 3], ON_FLANGE[:3, 3], atol=2e-3)


def test_they_are_compared():
    session = camera_session(images=15, arm=np.array([0.0, 1e-3, -2e-3, 1.5e-3, 1e-3, 0.0]), validate=4)
    (t,) = session.targets  # errors of the lens are parameters of the model
    session = replace(session, targets=(replace(t, values=t.values | {"fx": t.values["fx"] + 3.0}),))
    rows = compare(session, ("geometry",)).rows
    error = {r.method.name: r.result.validation.point_lengths.rms for r in rows if r.result}
    fitted = fit(session, ("geometry",), samples=0).final.validation.point_lengths
    assert error["bayescal"] == pytest.approx(fitted.rms, rel=1e-3)
    assert error["bayescal"] < 0.5 * min([error[f"hand-eye {s.capitalize()}"] for s in SOLVERS])
    for row in (row for row in rows if row.result and row.method.name.startswith("hand-eye")):
        named = [p.name for p in row.result.solution.model.parameters]
        moved = {name for name, value in zip(named, row.result.solution.values, strict=True) if value}
        assert moved == {f"on-flange {axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")}
        assert set(row.result.solution.held) == set(named) - moved
