"""Fits of these tests are of their model alone: simpler ones are tested in `calibration/test_fit.py`."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def _one_level():
    """Without simpler levels, and a search for gross mistakes only where `test_acceptance` asks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.calibration.levels_of", lambda effects: (effects,))
        patch.setattr("bayescal.calibration.judged", lambda dataset: None)
        yield
