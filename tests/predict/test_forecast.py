"""Predicted distance errors of the workspace: between which points, and what each part adds."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.dataset import Dataset
from bayescal.estimate import Estimate, estimate
from bayescal.model import build
from bayescal.model.scene import Scene
from bayescal.posterior import gaussian
from bayescal.predict import Validation, forecast

NO_CHECKS = Validation((), (), (), (), ())


def with_two_tools(d: Dataset) -> Dataset:
    """The session with a tool of the same place, but another name, in the second half of its rows."""
    tools = (*d.tools, replace(d.tools[0], name="second"))
    tool = (np.arange(len(d.measurements.ids)) >= len(d.measurements.ids) // 2).astype(int)
    return replace(d, tools=tools, measurements=replace(d.measurements, tool=tool))


@pytest.fixture(scope="module")
def fitted(cube) -> Estimate:
    data = with_two_tools(cube(seed=6, count=60).dataset)
    return estimate(build(Scene(data), ("geometry",)), robust=False)


@pytest.fixture(scope="module")
def draws(fitted) -> np.ndarray:
    return gaussian(fitted, 0, 400).flat


def test_pairs_are_of_one_tool_and_no_shorter_than_a_fifth_of_the_longest(fitted, draws):
    found = forecast(fitted, draws, NO_CHECKS, 0.0).workspace
    assert 100 < found.count <= 2 * (20 * 19 // 2)  # 40 rows, 20 of each tool
    assert found.shortest > 0.2 * found.longest


def test_an_unexplained_error_adds_twice_its_square_to_the_variance(fitted, draws):
    """It moves both ends of a distance; its share is of the sum of all parts."""
    plain = forecast(fitted, draws, NO_CHECKS, 0.0)
    assert plain.unexplained_share == 0.0
    excess = plain.workspace.rms / np.sqrt(2.0)
    found = forecast(fitted, draws, NO_CHECKS, excess)
    assert found.workspace.rms == pytest.approx(np.sqrt(2.0) * plain.workspace.rms, rel=0.08)
    assert found.unexplained_share == pytest.approx(0.5, abs=0.08)
    assert found.prior_share == pytest.approx((1 - found.unexplained_share) * plain.prior_share)
    assert found.prior_rms == plain.prior_rms
