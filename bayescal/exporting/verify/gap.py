"""Validation rows replayed in the simulator: its difference from the machine, before and after."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.exporting.fitted import FittedArm, Origin, of_estimate
from bayescal.exporting.mjcf.content import STATE
from bayescal.exporting.verify.levels import File
from bayescal.exporting.verify.measured import measured, validation_rows
from bayescal.exporting.verify.replay import Machine, replayed
from bayescal.model import with_parameters
from bayescal.model.parts import parts_of
from bayescal.model.scene import Scene

KINDS = ("planes", "points", "distances")


@dataclass(frozen=True)
class Gap:
    """RMS errors, m, by kind, of an arm in the simulator before and after, and what the run predicted.

    `count` is the number of rows, or of distances; `predicted` are (before, after) of the run's own record,
    nan where it has none.
    """

    before_is: str  # the model before
    count: Mapping[str, int]
    before: Mapping[str, float]
    after: Mapping[str, float]
    predicted: Mapping[str, tuple[float, float]]


def simulated_gap(
    arm: FittedArm,
    before: Callable[[FittedArm, np.ndarray], np.ndarray],
    after: Callable[[np.ndarray], np.ndarray],
    record: Mapping[str, Any],
) -> Gap | None:
    """Replay the validation rows; None if the session has none.

    Parameters
    ----------
    arm : FittedArm
    before, after : callable
        Tool points (C, 3), m, in rows (C,) of the session: of another arm, and of the written file.
    record : mapping
        The record of the run (fit.json or gap.json).
    """
    rows = validation_rows(arm)
    if not len(rows):
        return None
    baseline = tuple(record.get("baseline", ()))
    earlier = before_estimate(arm, baseline)
    noise = earlier.weights.scale
    old = of_estimate(earlier, earlier.covariance, Origin())
    then = measured(old, rows, before(old, rows), noise)
    now = measured(arm, rows, after(rows), {})
    without = np.intersect1d(then.gross, now.gross)
    kinds = [k for k in KINDS if np.isfinite(now.rms(k, without))]
    count = {k: sum(len(r.rows) for r in now.residuals if r.kind == k) for k in kinds}
    count |= {"distances": len(now.distance)} if "distances" in kinds else {}
    return Gap(
        ", ".join(baseline) or "nominal",
        count,
        {k: then.rms(k, without) for k in kinds},
        {k: now.rms(k, without) for k in kinds},
        {k: _predicted(record, k) for k in kinds},
    )


def before_estimate(arm: FittedArm, baseline: tuple[str, ...]) -> Estimate:
    """The arm before, with its own targets: nominal, or fitted with the baseline of a diagnosis."""
    scene, o = Scene(arm.dataset, oriented=True), arm.origin
    if not baseline:
        return estimate(with_parameters(scene, (), ()), robust=o.robust)
    found = calibrated(scene, baseline, o.prior_width, o.robust, parts_of(o.without, baseline))
    left_out = np.flatnonzero(np.isin(arm.dataset.measurements.ids, arm.rejected))
    if np.array_equal(np.sort(found.rejected), left_out):
        return found
    return estimate(found.model, o.robust, found.z, left_out)  # both arms with the same rows


def in_simulator(arm: FittedArm, file: File, rows: np.ndarray, state: int) -> np.ndarray:
    """Tool points (C, 3), m, of an arm in its file; where it changes in time, in the state of each row."""
    machine = Machine.of(arm, state, file.place)
    simulator = machine.simulator(file.text, file.folder, file.name)
    if not file.place.own and any(p.driver.kind in STATE[1:] for p in arm.model.parameters):
        points = np.empty((len(rows), 3))
        for k, row in enumerate(rows):
            machine = Machine.of(arm, int(row))
            simulator.take(machine.poses)
            points[k] = replayed(simulator, machine, arm, rows[k : k + 1])[1][0]
    else:
        _, points = replayed(simulator, machine, arm, rows)
    return points


def read_record(run: Path) -> dict[str, Any]:
    """The record of a run folder: gap.json or fit.json; empty if it has none."""
    for name in ("gap.json", "fit.json"):
        if (run / name).is_file():
            return dict(json.loads((run / name).read_text(encoding="utf-8")))
    return {}


def _predicted(record: Mapping[str, Any], kind: str) -> tuple[float, float]:
    """RMS errors before and after, m, as the run reports them for its own model."""
    nan = float("nan")
    found = record.get("shrinkage", {}).get(kind)
    if found:
        return 1e-6 * found["before_rms_um"], 1e-6 * found["after_rms_um"]
    for level in record.get("ladder", ()):
        if level["model"] == record.get("baseline") and kind in LEVEL:
            rms = 1e-6 * (level.get(LEVEL[kind]) or nan)
            return rms, rms if record.get("effects") == [] else nan
    validation = record.get("validation", {})
    if kind == "planes" and validation.get("planes"):
        every = [p for p in validation["planes"] if p["role"] == "validate"]
        weight = np.array([p["count"] for p in every], float)
        means = [np.average([p[k] ** 2 for p in every], weights=weight) for k in FIT_PLANES] if every else []
        return (1e-6 * float(np.sqrt(means[0])), 1e-6 * float(np.sqrt(means[1]))) if means else (nan, nan)
    if kind == "distances" and validation.get("distances"):
        every = validation["distances"]
        before, after = (np.sqrt(np.mean([d[k] ** 2 for d in every])) for k in FIT_DISTANCES)
        return 1e-6 * float(before), 1e-6 * float(after)
    return nan, nan


LEVEL = {"planes": "heldout_rms_um", "distances": "distance_rms_um"}
FIT_PLANES = ("nominal_rms_um", "calibrated_rms_um")
FIT_DISTANCES = ("nominal_error_um", "calibrated_error_um")
