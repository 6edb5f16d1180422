"""What distance error to expect between two points of the workspace that was probed, and on what it rests.

Small residuals on planes do not prove an arm: a plane says nothing of distances along it. So the error
that leads a report is one of distances, by the posterior. Where certified spheres or an instrument were
kept back, it stands beside what they measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.estimate import Estimate
from bayescal.estimate.flatness import FORM
from bayescal.model.block import ARM
from bayescal.predict.intervals import interval95
from bayescal.predict.validation import Validation
from factors.instrument import Instrument

POINTS = 40
"""Points of a workspace between which distances are predicted, evenly out of all rows."""
DRAWS = 400
"""Posterior draws that predict them."""
SHORTEST = 0.2
"""Of the longest distance: shorter ones say little of the arm."""


@dataclass(frozen=True)
class DistanceErrors:
    """Errors of some distances, as predicted and, where anything tells, as measured; m."""

    over: str  # what they are between
    count: int
    shortest: float
    longest: float
    errors: np.ndarray  # (S, K) by posterior draw
    measured: float | None  # root mean square

    @property
    def draws(self) -> np.ndarray:
        """Root mean square errors (S,), m, by posterior draw."""
        return _rms(self.errors)

    @property
    def rms(self) -> float:
        """Root mean square error to expect, m."""
        return float(np.sqrt(np.mean(self.draws**2)))

    @property
    def interval(self) -> tuple[float, float]:
        """Central 95 % interval of the root mean square error, m."""
        low, high = interval95(self.draws)
        return float(low), float(high)

    def within(self, tolerance: float) -> float:
        """Probability that the error of a distance is within a tolerance, m; 1 of no distance."""
        return float(np.mean(np.abs(self.errors) <= tolerance)) if self.errors.size else 1.0


@dataclass(frozen=True)
class Forecast:
    """Predicted distance errors, and what the prediction rests on.

    Of the variance predicted over the workspace, `prior_share` is what the tolerances of the drawing allow
    and no row narrowed down, `unexplained_share` what neither noise nor parameters explain; the rest is the
    noise of the rows. `prior_rms` (m) is the root of the first part.
    """

    checked: tuple[
        DistanceErrors, ...
    ]  # held out, measured too: between certified centres, instrument readings
    workspace: DistanceErrors
    prior_rms: float
    prior_share: float
    unexplained_share: float

    @property
    def lead(self) -> DistanceErrors:
        """The distances that a summary leads with: measured ones before those of the model alone."""
        return (*self.checked, self.workspace)[0]


def forecast(fitted: Estimate, z: np.ndarray, checked: Validation, excess: float, seed: int = 0) -> Forecast:
    """Predict errors of distances.

    Parameters
    ----------
    fitted : Estimate
    z : np.ndarray, shape (S, D)
        Posterior draws.
    checked : Validation
        Of the same draws.
    excess : float
        Standard deviation of what neither noise nor parameters explain, m a coordinate.
    seed : int
        Of the draws of that.
    """
    held = (_certified(checked), _read(fitted, checked))
    workspace, prior, posterior = _workspace(fitted, z, excess, np.random.default_rng(seed))
    total = max(posterior + 2.0 * excess**2, 1e-30)
    return Forecast(
        tuple(d for d in held if d is not None), workspace, float(np.sqrt(prior)), prior / total,
        2.0 * excess**2 / total,
    )  # fmt: skip


def _certified(checked: Validation) -> DistanceErrors | None:
    if not checked.distances:
        return None
    predicted = np.stack([d.predicted for d in checked.distances], axis=1)
    lengths = [d.certified for d in checked.distances]
    measured = _rms(np.array([d.error for d in checked.distances]))
    return DistanceErrors(
        "certified centres", len(lengths), min(lengths), max(lengths), predicted, float(measured)
    )


def _read(fitted: Estimate, checked: Validation) -> DistanceErrors | None:
    """Between held-out readings of an instrument, target after target."""
    scene = fitted.model.scene
    index = {t.name: k for k, t in enumerate(scene.dataset.targets)}
    xyz, parts = scene.dataset.measurements.xyz, []
    for p in checked.points:
        rows = scene.rows_of(index[p.target], scene.rows("validate"))
        if xyz is None or not isinstance(scene.kind(index[p.target], rows), Instrument):
            continue
        pick = _evenly(len(rows), POINTS)
        at = xyz[rows[pick]].T
        pairs = _pairs(at)
        if len(pairs):
            true = _lengths(at, pairs)
            predicted = _lengths(at + p.predicted[_evenly(len(p.predicted), DRAWS)][..., pick], pairs) - true
            parts.append((true, predicted, _lengths(at + p.residuals[:, pick], pairs) - true))
    if not parts:
        return None
    true, predicted, error = (np.concatenate([part[k] for part in parts], axis=-1) for k in range(3))
    return DistanceErrors(
        "readings of the instrument", len(true), float(true.min()), float(true.max()), predicted,
        float(_rms(error)),
    )  # fmt: skip


def _workspace(
    fitted: Estimate, z: np.ndarray, excess: float, rng: np.random.Generator
) -> tuple[DistanceErrors, float, float]:
    """Between places of one tool at the session's rows; the mean variance by the priors, and in all, m^2."""
    model, scene = fitted.model, fitted.model.scene
    tool = scene.dataset.measurements.tool
    rows = scene.rows("calibrate", "validate")
    rows = rows[np.isin(tool[rows], tool[scene.rows("calibrate")])]
    rows = rows[_evenly(len(rows), POINTS)]
    motion, arm = model.motion(rows), model.slices[ARM]
    values = model.deviations(fitted.z[arm])
    at = motion.points(values)
    pairs = _pairs(at)
    pairs = pairs[tool[rows[pairs[:, 0]]] == tool[rows[pairs[:, 1]]]]
    true = _lengths(at, pairs)
    drawn = motion.points(model.deviations(z[_evenly(len(z), DRAWS), arm]))
    if excess:
        drawn = drawn + excess * rng.standard_normal(drawn.shape)
    found = DistanceErrors(
        "points of the workspace", len(pairs), float(np.min(true, initial=np.inf)),
        float(np.max(true, initial=0.0)), _lengths(drawn, pairs) - true, None,
    )  # fmt: skip
    if not model.parameters or not len(pairs):
        return found, 0.0, 0.0
    first, second = pairs.T
    along = (at[:, first] - at[:, second]) / true
    by_point = np.stack([motion.columns(values, at, axis) for axis in _axes(len(rows))])  # (3, P, N)
    by = np.einsum("ak,apk->kp", along, by_point[..., first] - by_point[..., second]) * model.sd
    # C = C J'J C + C C where the prior of z is standard normal: noise of the rows, and what the priors allow
    spread = by @ fitted.covariance[arm]
    own = [k for k, p in enumerate(model.parameters) if p.effect != FORM]
    prior = np.mean(np.sum(spread[:, own] ** 2, axis=1))
    return found, float(prior), float(np.mean(np.sum(spread[:, arm] * by, axis=1)))


def _axes(count: int) -> Sequence[np.ndarray]:
    return [np.repeat(axis[:, None], count, axis=1) for axis in np.eye(3)]


def _evenly(count: int, most: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def _pairs(at: np.ndarray) -> np.ndarray:
    """Pairs (K, 2) of points (3, N) that lie far enough apart."""
    pairs = np.stack(np.triu_indices(at.shape[1], 1), axis=1)
    lengths = _lengths(at, pairs)
    return pairs[lengths > SHORTEST * np.max(lengths, initial=0.0)]


def _lengths(at: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """DistanceErrors (..., K) between points (..., 3, N)."""
    return np.linalg.norm(at[..., pairs[:, 0]] - at[..., pairs[:, 1]], axis=-2)


def _rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square over the last axis."""
    return np.sqrt(np.mean(errors**2, axis=-1))
