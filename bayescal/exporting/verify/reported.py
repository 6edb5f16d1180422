"""What a run reports of its validation measurements: RMS errors before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.reading import read_json

KINDS = ("planes", "points", "distances")
RECORDS = ("gap.json", "fit.json")
LEVEL = {"planes": "heldout_rms_um", "distances": "distance_rms_um"}
FIT_PLANES = ("nominal_rms_um", "calibrated_rms_um")
FIT_DISTANCES = ("nominal_error_um", "calibrated_error_um")
NOT_KNOWN = (float("nan"), float("nan"))


@dataclass(frozen=True)
class Reported:
    """The baseline of a run (none of a fit), and RMS errors (before, after), m, by kind; nan if not known."""

    baseline: tuple[str, ...] = ()
    rms: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def read_reported(run: Path) -> Reported:
    """What a run folder reports in gap.json or fit.json; nothing if it has none.

    Raises
    ------
    BayescalError
        If the file cannot be read, or lacks what it should state.
    """
    path = next((run / name for name in RECORDS if (run / name).is_file()), None)
    if path is None:
        return Reported()
    again = f"repeat bayescal {path.stem}"
    try:
        record = read_json(path, again)
        return Reported(tuple(record.get("baseline", ())), {kind: _rms(record, kind) for kind in KINDS})
    except (KeyError, TypeError, AttributeError) as error:
        what = f"is incomplete or of another version ({type(error).__name__}: {error})"
        raise BayescalError(what, str(path), again) from None


def _rms(record: Mapping[str, Any], kind: str) -> tuple[float, float]:
    """RMS errors before and after, m, as the run reports them for its own model."""
    found = record.get("shrinkage", {}).get(kind)
    if found:
        return 1e-6 * found["before_rms_um"], 1e-6 * found["after_rms_um"]
    for level in record.get("ladder", ()):
        if level["model"] == record.get("baseline") and kind in LEVEL:
            rms = 1e-6 * (level.get(LEVEL[kind]) or float("nan"))
            return rms, rms if record.get("effects") == [] else float("nan")
    validation = record.get("validation", {})
    if kind == "planes" and validation.get("planes"):
        every = [p for p in validation["planes"] if p["role"] == "validate"]
        weight = np.array([p["count"] for p in every], float)
        means = [np.average([p[k] ** 2 for p in every], weights=weight) for k in FIT_PLANES] if every else []
        return (1e-6 * float(np.sqrt(means[0])), 1e-6 * float(np.sqrt(means[1]))) if means else NOT_KNOWN
    if kind == "distances" and validation.get("distances"):
        every = validation["distances"]
        before, after = (np.sqrt(np.mean([d[k] ** 2 for d in every])) for k in FIT_DISTANCES)
        return 1e-6 * float(before), 1e-6 * float(after)
    return NOT_KNOWN
