"""Validation measurements replayed in the simulator: its difference from the machine, before and after."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, estimate, fitted_level
from bayescal.estimate.outliers import rejected, scale
from bayescal.exporting.mjcf.elastic import STATE
from bayescal.fitted.arm import FittedArm, Origin, of_estimate
from bayescal.model import Block
from bayescal.model.block import Oriented
from bayescal.model.scene import Scene
from bayescal.predict.errors import USUAL
from bayescal.predict.locate import Rows, locate
from bayescal.predict.targets import as_certified, centre_of, unknown_tool
from bayescal.storage.reading import read_json
from bayescal.verifying.simulator import File, Machine


@dataclass(frozen=True)
class Residuals:
    """Residuals (K, C), m, of C rows of one target, of a kind: "planes" or "points"."""

    rows: np.ndarray  # (C,) of the session
    kind: str
    values: np.ndarray
    sigma: np.ndarray  # (C,) m, stated


@dataclass(frozen=True)
class Measured:
    """Errors of an arm in validation data: residuals of targets, and errors of certified distances, m."""

    residuals: tuple[Residuals, ...]
    distance: np.ndarray  # (D,) measured by the arm minus certified

    def rms(self, kind: str, without: np.ndarray) -> float:
        """RMS error, m, of a kind ("planes", "points" or "distances") without some rows; nan without any."""
        errors = [self.distance] if kind == "distances" else []
        errors += [r.values[:, ~np.isin(r.rows, without)].ravel() for r in self.residuals if r.kind == kind]
        every = np.concatenate([np.zeros(0), *errors])
        return float(np.sqrt(np.mean(every**2))) if len(every) else float("nan")

    @property
    def gross(self) -> np.ndarray:
        """Rows that are off by far more than the others of their kind."""
        out = [np.zeros(0, int)]
        for kind in ("planes", "points"):
            residuals = [r for r in self.residuals if r.kind == kind]
            if not residuals:
                continue
            whitened, size = np.hstack([r.values / r.sigma for r in residuals]), len(residuals[0].values)
            chi2 = np.sum(whitened**2, axis=0)
            usual = max(scale(chi2, size, share=USUAL["kind"]), 1.0)
            out.append(np.concatenate([r.rows for r in residuals])[rejected(chi2, size, usual)])
        return np.concatenate(out)


def measured(arm: FittedArm, rows: np.ndarray, points: np.ndarray, noise: Mapping[str, float]) -> Measured:
    """Errors of validation measurements, for TCP positions (C, 3), m, of a simulator in these rows.

    A target that was not fitted is located from its own rows, with these points. Effects of the probe are
    those of the arm's model. Rows whose tool no fitted row used are left out, and images.
    """
    scene, m = arm.model.scene, arm.dataset.measurements
    where = np.full(len(m.ids), -1)
    where[rows] = np.arange(len(rows))
    centres, residuals = {}, []
    for t, target in enumerate(arm.dataset.targets):
        rows_of_target = scene.rows_of(t, scene.rows("validate"))
        if not len(rows_of_target) or unknown_tool(scene, rows_of_target):
            continue
        block, state = arm.model.block(t, rows_of_target), arm.states.get(target.name)
        if isinstance(block, Oriented):
            continue
        if state is None:
            apart = scene.rows_of(t, scene.rows("locate"))
            of = rows_of_target if scene.declared[t].located or not len(apart) else apart
            near = as_certified(scene, arm.model.block(t, of))
            state = _located(near, arm, points[where[of]].T, noise.get(near.group, 1.0))
            if scene.declared[t].centred:
                centres[target.name] = centre_of(near, state)
            if scene.declared[t].located:
                continue
        r = block.kind.residual(state, points[where[rows_of_target]].T) + block.at_contact(arm.values)
        residuals.append(Residuals(rows_of_target, "planes" if len(r) == 1 else "points", r, block.sigma))
    return Measured(tuple(residuals), _distances(arm, centres))


def _located(block: Block, arm: FittedArm, p: np.ndarray, noise: float) -> np.ndarray:
    """State of a target by its own rows, from TCP positions (3, C), m."""
    kind = block.touched(arm.values)
    rows = Rows(kind, p, np.tile(noise * block.sigma, (kind.rows, 1)))
    estimate, _ = locate(block.target, rows, strict=False)
    return np.asarray(estimate.x[0])


def _distances(arm: FittedArm, centres: Mapping[str, np.ndarray]) -> np.ndarray:
    """Errors (D,), m, of the certified distances between targets whose centres were located."""
    return np.array([
        np.linalg.norm(np.subtract(*(centres[name] for name in c.targets))) - c.distance
        for c in arm.dataset.certificates
        if c.kind == "distance" and c.distance is not None and all(name in centres for name in c.targets)
    ], float)  # fmt: skip


KINDS = ("planes", "points", "distances")
RECORDS = ("gap.json", "fit.json")
LEVEL = {"planes": "heldout_rms_um", "points": "point_rms_um", "distances": "distance_rms_um"}
LEVEL_OF_FIT = {"planes": "heldout_planes_rms_um", "points": "points_rms_um", "distances": "distance_rms_um"}
"""Errors of a model level in gap.json, and in fit.json, where those of points are lengths."""
NAN = float("nan")
NOT_KNOWN = (NAN, NAN)


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
    except (LookupError, TypeError, AttributeError) as error:
        what = f"is incomplete or of another version ({type(error).__name__}: {error})"
        raise BayescalError(what, str(path), again) from None


def _rms(record: Mapping[str, Any], kind: str) -> tuple[float, float]:
    """RMS errors before and after, m, as the run reports them for its own model; of points per coordinate."""
    levels = record.get("ladder", ())
    if shrinkage := record.get("shrinkage", {}).get(kind):
        return 1e-6 * shrinkage["before_rms_um"], 1e-6 * shrinkage["after_rms_um"]
    if "baseline" not in record:
        per_um = 1e-6 / 3**0.5 if kind == "points" else 1e-6
        before, after = (per_um * (level[LEVEL_OF_FIT[kind]] or NAN) for level in (levels[0], levels[-1]))
        return before, after
    for level in levels:
        if level["model"] == record["baseline"]:
            rms = 1e-6 * (level.get(LEVEL[kind]) or NAN)
            return rms, rms if record.get("effects") == [] else NAN
    return NOT_KNOWN


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


Before = Callable[[FittedArm, np.ndarray], np.ndarray]
After = Callable[[np.ndarray], np.ndarray]
"""TCP positions (C, 3), m, in rows (C,) of the session: of another arm, and of the written file."""


def simulated_gap(arm: FittedArm, before: Before, after: After, reported: Reported) -> Gap | None:
    """Replay the validation measurements; None if the session has none of positions.

    Parameters
    ----------
    arm : FittedArm
    before, after : callable
        TCP positions (C, 3), m, in rows (C,) of the session: of another arm, and of the written file.
    reported : Reported
        By the run.
    """
    rows = arm.model.scene.rows("validate", "locate")
    if not len(rows):
        return None
    earlier = before_estimate(arm, reported.baseline)
    noise = earlier.weights.scale
    old = of_estimate(earlier, earlier.covariance, Origin())
    then = measured(old, rows, before(old, rows), noise)
    now = measured(arm, rows, after(rows), {})
    without = np.intersect1d(then.gross, now.gross)
    kinds = [k for k in KINDS if np.isfinite(now.rms(k, without))]
    if not kinds:
        return None
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
    scene, options = Scene(arm.dataset, oriented=True), arm.origin.options
    fitted = fitted_level(scene, baseline, options)
    if not baseline:
        return fitted
    left_out = np.flatnonzero(np.isin(arm.dataset.measurements.ids, arm.rejected))
    if np.array_equal(np.sort(fitted.rejected), left_out):
        return fitted
    return estimate(fitted.model, options.robust, fitted.z, left_out)  # both arms with the same rows


def in_simulator(arm: FittedArm, file: File, rows: np.ndarray, state: int) -> np.ndarray:
    """TCP positions (C, 3), m, of an arm in its file; where it changes in time, in the state of each row."""
    machine = Machine.of(arm, state, file)
    if file.of_user or not any(p.driver.kind in STATE[1:] for p in arm.model.parameters):
        return machine.replayed(rows)[1]
    return np.concatenate([machine.at_row(int(row)).replayed(rows[[k]])[1] for k, row in enumerate(rows)])
