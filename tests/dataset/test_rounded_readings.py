"""Steps of readings: what displays, files and encoders make of them."""

from dataclasses import replace

import numpy as np
import pytest
from cases import EXAMPLE

from bayescal.dataset import read_dataset
from bayescal.dataset.consistency import rounded, step_of

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


@pytest.mark.parametrize("step", [0.01, 0.02, 0.05, 0.1, 360 / 2**13, 360 / 2**14])
def test_what_is_advised_is_the_rms_of_the_rounding_and_ends_the_finding(step):
    dataset = read_dataset(EXAMPLE)
    m = dataset.measurements
    shown = np.rint(np.degrees(m.readings) / step) * step
    coarse = replace(dataset, measurements=replace(m, readings=np.radians(shown)))
    said = rounded(coarse)
    assert f"steps of up to {step:.4g} deg" in said
    advised = float(said.rpartition("`noise.joint_deg: ")[2].rstrip("`"))
    assert advised == pytest.approx(np.sqrt(np.mean((shown - np.degrees(m.readings)) ** 2)), rel=0.06)
    assert rounded(replace(coarse, noise=replace(coarse.noise, joint=np.radians(advised)))) == ""
