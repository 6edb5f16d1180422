"""emcee without `scipy.stats`, whose import takes half a second and which only an unused move needs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any


@contextmanager
def without_scipy_stats() -> Iterator[None]:
    """Within, `from scipy.stats import gaussian_kde` gives a function that imports it when it is called."""
    if "scipy.stats" in sys.modules:
        yield
        return
    later = ModuleType("scipy.stats")
    later.gaussian_kde = _gaussian_kde  # type: ignore[attr-defined]
    sys.modules["scipy.stats"] = later
    try:
        yield
    finally:
        del sys.modules["scipy.stats"]


def _gaussian_kde(*args: Any, **options: Any) -> Any:
    from scipy.stats import gaussian_kde

    return gaussian_kde(*args, **options)
