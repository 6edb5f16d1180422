"""Which rows share a pose."""

from dataclasses import replace

import numpy as np

from bayescal.estimate.families import poses


def test_rows_of_one_stop_one_repeat_or_equal_readings_are_of_one_pose(cube):
    m = cube(seed=3, count=24).dataset.measurements
    n = len(m.ids)
    rows = np.arange(n)
    alone = replace(m, stop=None, repeat=None)
    assert len(np.unique(poses(alone, rows))) == n

    readings = m.readings.copy()
    readings[4] = readings[3]
    stop, repeat = np.full(n, ""), np.full(n, "")
    stop[[4, 5]], repeat[[5, 9]] = "s", "r"
    found = poses(replace(m, readings=readings, stop=stop, repeat=repeat), rows)
    assert len(set(found[[3, 4, 5, 9]])) == 1  # a chain of three different reasons
    assert len(np.unique(found)) == n - 3
    # of other rows of the session the same, and rows may be given more than once
    some = np.array([9, 3, 3, 7])
    assert poses(replace(m, readings=readings, stop=stop, repeat=repeat), some).tolist() == [0, 1, 1, 2] or (
        len(np.unique(poses(replace(m, readings=readings, stop=stop, repeat=repeat), some))) == 3
    )
