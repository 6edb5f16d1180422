"""Rows and arm of a record, against the residuals and frames that they come from."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.estimate import calibrated
from bayescal.model.scene import Scene
from bayescal.reporting.shared.origin import rows_record


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
