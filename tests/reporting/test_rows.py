"""Rows and arm of a record, against the residuals and frames that they come from."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.arm import chain as reference
from bayescal.estimate import calibrated
from bayescal.model.scene import Scene
from bayescal.reporting.shared.rows import arm_drawing, rows_record


@pytest.fixture(scope="module")
def found(cube):
    return calibrated(Scene(cube(seed=1, count=80).dataset), ("geometry",))


def test_rows_have_the_residuals_of_the_fit(found):
    rows, scene = rows_record(found), found.model.scene
    count = len(scene.dataset.measurements.ids)
    assert all(len(v) == count for v in rows.values() if v is not None)
    target, role = np.array(rows["target"]), np.array(rows["role"])
    for k, face in enumerate(scene.dataset.targets):
        for name in ("calibrate", "validate"):
            own = scene.rows_of(k, scene.rows(name))
            expected = 1e6 * found.residuals(found.model.block(k, own))[0]
            got = np.array(rows["residual_um"], float)[(target == face.name) & (role == name)]
            assert got == pytest.approx(expected, abs=1e-4)


def test_points_are_those_of_the_nominal_arm(found):
    scene = found.model.scene
    assert np.array(rows_record(found)["point_mm"]) == pytest.approx(1e3 * scene.points, abs=1e-3)


def test_the_arm_in_a_pose_follows_by_rotations_about_its_axes(found):
    """Product of exponentials from `arm` and `angle_deg`, as the page does it, against the chain."""
    scene, arm = found.model.scene, arm_drawing(found.model.scene)
    q = np.radians(rows_record(found)["angle_deg"][3])
    links, axes = np.array(arm["links_mm"]), np.array(arm["axes"])
    turn, shift, line = np.eye(3), np.zeros(3), [links[0]]
    for k, angle in enumerate(q):
        x, y, z = axes[k]
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        own = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        at = links[k + 1]
        line.append(turn @ at + shift)
        shift = turn @ (at - own @ at) + shift
        turn = turn @ own
    line.append(turn @ links[-1] + shift)
    frames = reference.frames(scene.chain, scene.q[3:4])[0]
    assert np.array(line) == pytest.approx(1e3 * frames[:, :3, 3], abs=0.02)
