"""Warnings of a diagnosis say what the validation errors show."""

from dataclasses import replace

import numpy as np
from made_up_errors import NOISE, held

from bayescal.gap.outcome.notes import increased

SCATTER = np.random.default_rng(2).standard_normal(60)
UNSURE = np.arange(60) < 6


def errors(sure, unsure):
    """Rows with errors of these sizes, in units of the noise; six have 20 times the uncertainty."""
    found = held(NOISE * SCATTER * np.where(UNSURE, unsure, sure))
    return replace(found, by_parameters=np.where(UNSURE, 20 * NOISE, 0.0)[:, None])


def test_nothing_is_said_of_errors_that_decrease():
    assert not list(increased(errors(3.0, 20.0), errors(1.0, 20.0)))


def test_errors_that_increase_where_they_are_less_probable():
    (told,) = increased(errors(1.0, 1.0), errors(3.0, 1.0))
    assert told.endswith("describe the calibration rows only; do not use them")


def test_errors_that_increase_in_rows_of_large_uncertainty_only():
    """The RMS increases and so does the log density: no contradiction, and no reason to drop the effects."""
    (told,) = increased(errors(3.0, 10.0), errors(1.0, 20.0))
    assert "but so does their log density" in told
    assert "do not use them" not in told


def test_an_increase_within_its_uncertainty_is_no_reason_to_drop_the_effects():
    """Errors of other rows by other amounts, in the sum a little larger."""
    change = np.where(np.arange(60) % 2, 1.4, 0.7)
    more = replace(errors(1.0, 1.0), residual=errors(1.0, 1.0).residual * change)
    (told,) = increased(errors(1.0, 1.0), more)
    assert told.startswith("validation errors do not decrease with the named effects (from ")
    assert "within its uncertainty" in told
    assert "do not use them" not in told
