"""A measuring session: the folder on disk and the `Dataset` in memory."""

from __future__ import annotations

from bayescal.dataset.read import read_dataset
from bayescal.dataset.types import (
    ROLES,
    Box,
    Certificate,
    Dataset,
    Measurements,
    Noise,
    Patch,
    PlanSettings,
    Points,
    Record,
    Target,
    Tool,
)
from bayescal.dataset.write import write_dataset

__all__ = [
    "ROLES",
    "Box",
    "Certificate",
    "Dataset",
    "Measurements",
    "Noise",
    "Patch",
    "PlanSettings",
    "Points",
    "Record",
    "Target",
    "Tool",
    "read_dataset",
    "write_dataset",
]
