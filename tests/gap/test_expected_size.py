"""The RMS to expect of a correct model, as a diagnosis states it."""

import numpy as np
import pytest

from bayescal.gap.outcome.magnitude import _measured


def test_the_expected_rms_is_that_of_a_fit():
    """A root mean square, not a median: errors with a common cause are skewed, and U = 2 RMS."""
    found = _measured("sphere distances", 3, np.ones(3), np.array([1.0, 1.0, 4.0]))
    assert found.predicted_rms == pytest.approx(np.sqrt(6.0))
    assert found.predicted_interval95[0] >= 1.0
