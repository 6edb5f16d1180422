"""A measuring session: the folder on disk and the `Dataset` in memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from bayescal.dataset.read import read_dataset
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


def __getattr__(name: str) -> Any:
    """Load the reader and the writer (and pydantic with them) when first asked for."""
    if name == "read_dataset":
        from bayescal.dataset.read import read_dataset

        return read_dataset
    if name == "write_dataset":
        from bayescal.dataset.write import write_dataset

        return write_dataset
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
