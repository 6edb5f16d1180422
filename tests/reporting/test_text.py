"""Numbers as text."""

import numpy as np
import pytest

from bayescal.reporting.shared.text import parameter_notes, size


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        (99.6e-6, "m", "100 µm"),
        (99.4e-6, "m", "99 µm"),
        (0.0123e-6, "m", "0.012 µm"),
        (4567e-6, "m", "4600 µm"),
        (np.inf, "m", "-"),
    ],
)
def test_size(value: float, unit: str, words: str) -> None:
    """Two significant digits, without an exponent where that is readable."""
    assert size(value, unit) == words


def test_u_of_a_compliance_does_not_contain_that_of_masses():
    assert len(parameter_notes(["geometry"])) == 1
    assert "masses" in parameter_notes(["geometry", "compliance"])[-1]
