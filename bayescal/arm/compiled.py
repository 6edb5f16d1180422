"""Functions compiled by numba, kept on disk where any folder for them can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator like `numba.njit`, which keeps the compiled code only where that is possible."""

    def compile_(function: Callable[..., Any]) -> Any:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # neither beside the module nor in the user's cache folder
            return numba.njit(**options)(function)

    return compile_
