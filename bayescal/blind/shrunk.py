"""What refits take off held-out errors: how much of the gap, to which floor, and whether as predicted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayescal.blind.judge import Record

WORSE = 1.05
"""Times the distances' rms from which on they count as made worse: refitting costs some noise."""
NEAR, FAR = 1.3, 1.5
"""Factors between predicted and achieved shrinkage within which a prediction is good, and fair."""
MEASURES = {"planes": "plane_um", "distances": "distance_um"}
"""Keys of a record by what is measured."""


def shrunk(records: Sequence[Record], key: str) -> dict[str, Any]:
    """What a refit takes off held-out errors, in worlds where something was named.

    `closed` is of the pooled excess variance over the floor; `ratio` the pooled rms after the refit over the
    floor's, once more of the worlds whose verdict is right, and its median.
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
    """Whether sphere distances rose, beyond what a parameter more costs in noise."""
    d = r["distance_um"]
    return bool(r["named"]) and d is not None and d["after"] > WORSE * d["before"]


def factors(records: Sequence[Record], what: str) -> list[tuple[Record, float, float]]:
    """Worlds with a refit, and the factors (after over before) that it predicted and achieved."""
    key = MEASURES[what]
    return [
        (r, m["predicted_after"] / m["predicted_before"], m["after"] / m["before"])
        for r in records
        if r["named"] and (m := r[key]) and m["predicted_before"] and m["predicted_after"] and m["before"]
    ]


def predicted(records: Sequence[Record], what: str) -> dict[str, Any]:
    """Achieved over predicted shrinkage: its median, how often it is near, and how the two go together."""
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
