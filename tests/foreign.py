"""Data that others measured or simulated, in `shared/` beside the clone: tests of them run where they are."""

from pathlib import Path

import pytest
from cases import ROOT

SHARED = ROOT.parent / "shared"
DATA = SHARED / "data"
REAL, WORLDS = DATA / "real", DATA / "worlds-dev"


def needs(path: Path = DATA) -> pytest.MarkDecorator:
    """The mark of a test, or of a case, that needs a file or folder of others; see `conftest.py`."""
    return pytest.mark.foreign(path)
