"""Values of a record as JSON holds them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """The same with lists and Python numbers, None for every number that is not finite."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        finite = np.isfinite(value)
        return (value if np.all(finite) else np.where(finite, value, np.array(None))).tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
