"""Proportions with intervals, and proportions by lambda."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

BANDS = ((0.0, 10.0), (10.0, 20.0), (20.0, 30.0), (30.0, 50.0), (50.0, 100.0), (100.0, np.inf))
"""Bands of lambda; no simulated session has less than 3."""


def share(records: Sequence[Any], hit: Callable[[Any], bool]) -> dict[str, Any]:
    """Hits and count with the Wilson 95 % interval; None without cases."""
    return proportion(sum(map(bool, map(hit, records))), len(records))


def proportion(hits: int, count: int) -> dict[str, Any]:
    """Hits and count with the Wilson 95 % interval."""
    ends = None
    if count:
        found = binomtest(hits, count).proportion_ci(method="wilson")
        ends = [float(found.low), float(found.high)]
    return {"count": count, "hits": hits, "interval95": ends}


def value(rate: Mapping[str, Any]) -> float | None:
    """The proportion; None without cases."""
    return rate["hits"] / rate["count"] if rate["count"] else None


def by_lambda(pairs: Iterable[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Shares in every band of lambda, of pairs of a lambda and whether it was a hit."""
    known = list(pairs)
    return [
        {"lambda": ends(band)} | share([hit for size, hit in known if band[0] <= size < band[1]], bool)
        for band in BANDS
    ]


def ends(band: tuple[float, float]) -> list[float | None]:
    """A band for JSON: None for an open end."""
    return [band[0], None if np.isinf(band[1]) else band[1]]


def mean(values: Iterable[float]) -> float | None:
    """Mean; None without values."""
    every = list(values)
    return float(np.mean(every)) if every else None
