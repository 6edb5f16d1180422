"""Residuals of the figures are in the order of time, whatever the targets and the order of the file."""

from dataclasses import replace

import numpy as np
import pytest
from gap_problems import unsolved

from bayescal.gap.diagnose import _residuals


@pytest.mark.parametrize("timed", [False, True])
def test_residuals_are_in_the_order_of_time(cube, timed):
    dataset = cube(seed=1).dataset
    count = len(dataset.measurements.ids)
    clock = np.random.default_rng(2).permutation(count).astype(float) if timed else None
    fitted = unsolved(replace(dataset, measurements=replace(dataset.measurements, time=clock)))
    rows, before, after = _residuals(fitted, fitted)
    assert np.all(np.diff(rows if clock is None else clock[rows]) > 0)
    np.testing.assert_array_equal(before, after)
    own = {
        int(r): v for b in fitted.model.blocks for r, v in zip(b.rows, fitted.residuals(b)[0], strict=True)
    }
    np.testing.assert_array_equal(before, [own[int(r)] for r in rows])
