"""What is predicted of rows of a located target: linear propagation against draws, and what counts how."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.dataset import Tool
from bayescal.effects.tool import LOOSE
from bayescal.errors import BayescalError
from bayescal.estimate import estimate
from bayescal.model import ARM, build
from bayescal.model.scene import Scene
from bayescal.predict import validate
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.locate import States, _check
from bayescal.predict.targets import unknown_tool
from factors.fixed_point import FixedPoint


@pytest.fixture(scope="module")
def arm_alone(tracker):
    """The arm as fitted to an instrument, and its session with other roles, as if no row was fitted."""
    session = tracker(seed=1, count=45).dataset
    found = estimate(build(Scene(session), ("geometry",)), robust=False)
    own = found.model.slices[ARM]

    def of(role: np.ndarray):
        scene = Scene(replace(session, measurements=replace(session.measurements, role=role)))
        return replace(
            found,
            model=replace(found.model, scene=scene, blocks=(), constraints=()),
            z=found.z[own],
            covariance=100.0 * found.covariance[own, own],  # far more uncertain than the noise
            weights=replace(found.weights, scale={}),
        )

    return of


@pytest.mark.parametrize("located_by", ["other rows", "the same rows"])
def test_rows_of_a_located_instrument_scatter_as_predicted(arm_alone, located_by):
    """The instrument follows the arm, and is drawn towards the noise of the rows that located it."""
    role = np.where(np.arange(45) < (12 if located_by == "other rows" else 0), "locate", "validate")
    found = arm_alone(role)
    rng = np.random.default_rng(0)
    z = rng.multivariate_normal(found.z, found.covariance, 4000, method="eigh")
    (points,) = validate(found, z, np.ones(4000)).points
    h = validation_errors(found)
    spread = {row: [] for row in h.rows}
    for row, drawn in zip(found.model.scene.rows("validate"), points.predicted.std(axis=0).T, strict=True):
        spread[row] = list(drawn)
    for row, sd in spread.items():
        np.testing.assert_allclose(np.sort(h.sd[h.rows == row]), np.sort(sd), rtol=0.08)
    noise = found.model.scene.dataset.noise.point
    if located_by == "the same rows":  # 45 x 3 coordinates, which determine the instrument and its reflector
        assert np.mean(h.noise**2) == pytest.approx(noise**2 * (1 - (6 + 3) / (3 * 45)), rel=1e-3)
    else:
        np.testing.assert_allclose(h.noise, noise)


def test_a_tool_is_unknown_where_no_fitted_row_used_it(cube):
    """Its prior is the uncertainty that is stated of it; loose where none is."""
    d = cube(seed=1, count=60).dataset
    m = d.measurements
    role, tool = np.where(np.arange(60) < 40, "calibrate", "validate"), np.where(np.arange(60) < 50, 0, 1)
    for u, expected in ((1e-3, 1e-3), (0.0, 0.0), (None, LOOSE)):
        tools = (d.tools[0], Tool("second", np.array([0.0, 0.0, 0.1]), 3e-3, u=u))
        scene = Scene(replace(d, tools=tools, measurements=replace(m, role=role, tool=tool)))
        assert unknown_tool(scene, np.arange(50, 60)) == expected
        assert unknown_tool(scene, np.arange(40, 50)) == 0.0  # of the tool that was fitted
        assert unknown_tool(scene, np.arange(45, 55)) == 0.0  # of both


@pytest.mark.parametrize(("alike", "refused"), [(0.999, False), (0.0, True)])
def test_two_places_that_the_tool_makes_up_for_are_one(alike, refused):
    """Apart are solutions by the uncertainty that an unknown tool leaves to the target."""
    size = 100.0  # posterior standard deviations of one unknown with all others known: 0.01
    information = size**2 * np.block([[np.eye(3), alike * np.eye(3)], [alike * np.eye(3), np.eye(3)]])
    x = np.array([[0.0, 0.0, 0.0], [0.08, 0.0, 0.0]])  # 8 of these standard deviations apart, or 0.4
    found = States(x, np.zeros((2, 3)), np.zeros(2), np.zeros(2), np.stack([information] * 2))
    kind = FixedPoint(np.zeros(3), np.ones(3))
    if refused:
        with pytest.raises(BayescalError, match=r"two places 80 mm apart"):
            _check("socket", found, found.some([0]), kind, strict=True)
    else:
        _check("socket", found, found.some([0]), kind, strict=True)
    _check("socket", found, found.some([0]), kind, strict=False)  # a level that only serves for comparison
