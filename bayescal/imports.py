"""Imports of SciPy and emcee without parts that take long and that nothing here uses."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

UNUSED = ("f2py", "testing")
"""Modules of NumPy that SciPy imports when it copies the names of NumPy: they read Fortran, and test."""


@contextmanager
def without_unused_numpy() -> Iterator[None]:
    """Within, an empty module stands for each of `UNUSED` that is not imported: a fifth of a second."""
    empty = {name: ModuleType(f"numpy.{name}") for name in UNUSED if name not in vars(np)}
    for name, module in empty.items():
        setattr(np, name, module)
    try:
        yield
    finally:
        for name, module in empty.items():
            if vars(np)[name] is module:  # else imported meanwhile
                delattr(np, name)


@contextmanager
def without_scipy_stats() -> Iterator[None]:
    """Within, `from scipy.stats import gaussian_kde` gives a function that imports it when it is called.

    emcee imports it for a move that is not used here; it takes half a second.
    """
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
