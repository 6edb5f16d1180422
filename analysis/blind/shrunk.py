"""Reduction of validation errors by the refits: achieved, predicted, and of the true model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.blind.assessed import Record

WORSE = 1.05
"""Ratio of the distance RMS after / before that counts as increased: a refit adds some noise."""
BAND, SHARED = 1.96, 1.5
"""Half-width of a 95 % band in standard deviations; variance factor of distances that share centres."""
NEAR, FAR = 1.3, 1.5
"""Factors between predicted and achieved reduction that count as good, and as fair."""
MEASURES = {"planes": "plane_um", "distances": "distance_um", "points": "point_um"}
"""Keys of a record by measurement."""


def shrunk(records: Sequence[Record], key: str) -> dict[str, Any]:
    """Reduction of validation errors by the refit, in sessions with a named effect.

    `closed` is the share of the pooled excess variance that is removed. `ratio` is the pooled RMS after the
    refit over that of the true model, also for sessions with a correct verdict, and its median.
    """
    own = [r for r in records if r["named"] and r[key] and r[key]["after"] is not None]
    if not own:
        return {"count": 0, "closed": None, "ratio": None, "ratio_right": None, "ratio_median": None,
                "before_um": None, "after_um": None, "floor_um": None}  # fmt: skip
    old, new, floor = (np.array([r[key][k] for r in own]) ** 2 for k in ("before", "after", "floor"))
    excess = float(np.sum(old - floor))
    exact = np.array([r["right"] for r in own])
    return {
        "count": len(own),
        "closed": float(np.sum(old - new)) / excess if excess > 0 else None,
        "ratio": float(np.sqrt(np.sum(new) / np.sum(floor))),
        "ratio_right": float(np.sqrt(np.sum(new[exact]) / np.sum(floor[exact]))) if np.any(exact) else None,
        "ratio_median": float(np.median(np.sqrt(new / floor))),
        "before_um": float(np.sqrt(np.mean(old))),
        "after_um": float(np.sqrt(np.mean(new))),
        "floor_um": float(np.sqrt(np.mean(floor))),
    }


def made_worse(r: Record) -> bool:
    """Whether sphere distance errors increased by more than an additional parameter explains."""
    d = r["distance_um"]
    return bool(r["named"]) and d is not None and d["after"] > WORSE * d["before"]


def worse_beyond_noise(r: Record) -> bool:
    """Whether sphere distance errors increased beyond the 95 % band of the paired difference.

    With errors a before and b after the refit of the same n distances, b^2 - a^2 is the mean of
    (b - a)(a + b) over the distances. Where neither model is better, its expectation is 0 and its standard
    deviation 2 s D / sqrt(n / 1.5): s is the RMS error of the true model and D the RMS of b - a, which
    the two predictions state (their squares differ by D^2). Two distances of a plate share a centre, at about
    60 deg: they correlate by 1/4, which widens the variance of a mean by 1.5.
    """
    d = r["distance_um"]
    if not r["named"] or d is None or d["after"] <= d["before"]:
        return False
    if not (d["count"] and d["predicted_before"] and d["predicted_after"]):
        return made_worse(r)
    change = d["after"] ** 2 - d["before"] ** 2
    least = (d["after"] - d["before"]) ** 2  # errors of these RMS differ at least so much
    moved = max(d["predicted_before"] ** 2 - d["predicted_after"] ** 2, least)
    sd = 2.0 * d["floor"] * np.sqrt(moved * SHARED / d["count"])
    return bool(change > BAND * sd)


def factors(records: Sequence[Record], what: str) -> list[tuple[Record, float, float]]:
    """Sessions with a refit, and the ratios (after / before) that it predicted and achieved."""
    key = MEASURES[what]
    return [
        (r, m["predicted_after"] / m["predicted_before"], m["after"] / m["before"])
        for r in records
        if r["named"] and (m := r[key]) and m["predicted_before"] and m["predicted_after"] and m["before"]
    ]


def predicted(records: Sequence[Record], what: str) -> dict[str, Any]:
    """Achieved / predicted reduction: median, share within the factors, correlation."""
    own = factors(records, what)
    if not own:
        return {"count": 0, "median": None, "near": None, "fair": None, "correlation": None}
    said, done = np.log([f[1] for f in own]), np.log([f[2] for f in own])
    off = np.abs(done - said)
    moves = len(own) > 2 and np.std(said) > 0 and np.std(done) > 0
    return {
        "count": len(own),
        "median": float(np.exp(np.median(done - said))),
        "near": float(np.mean(off <= np.log(NEAR))),
        "fair": float(np.mean(off <= np.log(FAR))),
        "correlation": float(np.corrcoef(said, done)[0, 1]) if moves else None,
    }
