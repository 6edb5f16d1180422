"""Rows that were measured later follow those of a session: times continue, labels stay apart."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.dataset.append import followed, taken
from bayescal.dataset.join import PAUSE


@pytest.fixture(scope="module")
def halves(cube):
    m = cube(seed=1).dataset.measurements
    m = replace(m, repeat=np.where(np.arange(len(m.ids)) % 30 == 0, "r1", ""))
    return taken(m, np.arange(60)), taken(m, np.arange(60, 120))


def test_columns_of_both_are_continued(halves):
    first, second = halves
    rows, lost = followed(first, second)
    assert lost == ()
    assert rows.ids == (*first.ids, *second.ids)
    np.testing.assert_array_equal(rows.readings, np.concatenate([first.readings, second.readings]))
    np.testing.assert_array_equal(rows.time, np.concatenate([first.time, second.time]))
    assert set(rows.repeat[:60].tolist()) == {"", "r1"}
    assert set(rows.repeat[60:].tolist()) == {"", "r1.later"}


def test_a_clock_that_begins_again_continues(halves):
    first, second = halves
    restarted = replace(second, time=second.time - second.time[0])
    rows, _ = followed(first, restarted)
    np.testing.assert_allclose(rows.time[60:], first.time[-1] + PAUSE + restarted.time)


def test_empty_cells_stand_for_nothing_and_other_columns_are_left_out(halves):
    first, second = halves
    rows, lost = followed(
        replace(first, payload=None, u=None), replace(second, time=None, torque=None, velocity=None)
    )
    assert lost == ("torque", "time")
    assert rows.time is None
    np.testing.assert_array_equal(rows.payload, [*np.zeros(60), *second.payload])
    np.testing.assert_array_equal(rows.velocity[60:], 0.0)
    assert rows.u is None
