"""Validation measurements replayed in the simulator: its difference from the machine, before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.exporting.fitted import FittedArm, Origin, of_estimate
from bayescal.exporting.mjcf.content import STATE
from bayescal.exporting.verify.levels import File
from bayescal.exporting.verify.measured import measured, validation_rows
from bayescal.exporting.verify.replay import Machine, replayed
from bayescal.exporting.verify.reported import KINDS, NOT_KNOWN, Reported
from bayescal.model import with_parameters
from bayescal.model.parts import parts_of
from bayescal.model.scene import Scene


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
    reported: Reported,
) -> Gap | None:
    """Replay the validation measurements; None if the session has none.

    Parameters
    ----------
    arm : FittedArm
    before, after : callable
        TCP positions (C, 3), m, in rows (C,) of the session: of another arm, and of the written file.
    reported : Reported
        By the run.
    """
    rows = validation_rows(arm)
    if not len(rows):
        return None
    earlier = before_estimate(arm, reported.baseline)
    noise = earlier.weights.scale
    old = of_estimate(earlier, earlier.covariance, Origin())
    then = measured(old, rows, before(old, rows), noise)
    now = measured(arm, rows, after(rows), {})
    without = np.intersect1d(then.gross, now.gross)
    kinds = [k for k in KINDS if np.isfinite(now.rms(k, without))]
    count = {k: sum(len(r.rows) for r in now.residuals if r.kind == k) for k in kinds}
    count |= {"distances": len(now.distance)} if "distances" in kinds else {}
    return Gap(
        ", ".join(reported.baseline) or "nominal",
        count,
        {k: then.rms(k, without) for k in kinds},
        {k: now.rms(k, without) for k in kinds},
        {k: reported.rms.get(k, NOT_KNOWN) for k in kinds},
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
    """TCP positions (C, 3), m, of an arm in its file; where it changes in time, in the state of each row."""
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
