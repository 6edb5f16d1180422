"""Timing on a machine that others use too: interleaved repetitions, of which the fastest counts."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np


def seconds(function: Callable[[], object], calls: int = 1) -> float:
    """Mean duration of a call, s."""
    start = time.perf_counter()
    for _ in range(calls):
        function()
    return (time.perf_counter() - start) / calls


def fastest(functions: Mapping[str, tuple[int, Callable[[], object]]], rounds: int = 9) -> dict[str, float]:
    """Duration of one call of each function, s: the fastest of `rounds` turns in which each has its calls.

    Turn and turn about, so that a slow spell of the machine falls on all alike.
    """
    for _, function in functions.values():
        function()
    turns = [{name: seconds(f, calls) for name, (calls, f) in functions.items()} for _ in range(rounds)]
    return {name: min(turn[name] for turn in turns) for name in functions}


def dgemm(size: int = 1000) -> tuple[float, Callable[[], object]]:
    """Flops of a float64 matrix product of that size, and the product."""
    a, b = np.random.default_rng(0).normal(size=(2, size, size))
    out = np.empty((size, size))
    return 2.0 * size**3, lambda: np.matmul(a, b, out=out)
