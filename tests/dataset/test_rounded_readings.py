"""Steps of readings: what displays, files and encoders make of them."""

import numpy as np
import pytest

from bayescal.dataset.consistency import step_of

READINGS = np.random.default_rng(3).uniform(-170.0, 170.0, 200)


@pytest.mark.parametrize("step", [0.01, 0.005, 1e-4, 360 / 2**13, 360 / 2**19])
def test_the_step_of_rounded_readings_is_found(step):
    assert step_of(np.rint(READINGS / step) * step) == pytest.approx(step)


def test_steps_that_a_file_rounds_once_more_are_found():
    step = 360 / 2**14
    assert step_of(np.round(np.rint(READINGS / step) * step, 4)) == pytest.approx(step)


def test_readings_of_full_digits_and_few_values_have_no_step():
    assert step_of(READINGS) == 0.0
    assert step_of(np.tile([10.0, 20.0, 30.0], 50)) == 0.0
