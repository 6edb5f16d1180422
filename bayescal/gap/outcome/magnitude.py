"""Size of the gap, its reduction by the named effects, and validation errors of model levels.

The size compares validation errors with the noise of a contact and with the expected errors, the reduction
those of two models on the same validation planes, sphere distances and points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import nan

import numpy as np

from bayescal.estimate import STATED_WORTH, Estimate
from bayescal.estimate.unexplained import AGAIN, IMAGE, P_VALUE, STATED_FACTOR, noise_again, stated_noise
from bayescal.gap.result import VALIDATION_CONTACTS, VALIDATION_POINTS, Magnitude, Measured, Shrinkage, Step
from bayescal.gap.settings import OUTCOME
from bayescal.predict.crossvalidation import (
    LEFT_OUT,
    RESAMPLES,
    bootstrap_interval95,
    independent_distances,
    interval95,
    resampled,
    resampled_distances,
)
from bayescal.predict.errors import CentreDistances, ValidationErrors, kept
from bayescal.statistics import chi2_isf, chi2_sf, f_isf, f_sf, rms


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of a contact, or of one coordinate of a point, m."""

    sd: float
    dof: float
    source: str  # "repeats", "images", "fit" or "stated"

    @property
    def interval95(self) -> tuple[float, float]:
        """95 % interval by chi-squared, m."""
        low, high = self.sd * np.sqrt(self.dof / chi2_isf([0.025, 0.975], self.dof))
        return float(low), float(high)

    def draws(self, rng: np.random.Generator) -> np.ndarray:
        """Draws (RESAMPLES,) of the standard deviation, m."""
        return self.sd * np.sqrt(self.dof / rng.chisquare(self.dof, RESAMPLES))


def noise_floor(final: Estimate, group: str) -> NoiseFloor:
    """Noise of a contact: from repeats where there are enough, else from residuals of the fullest model.

    Repeats that scatter more than these residuals (F test) contain more than noise: a change between them.
    Without repeats, residuals far above the stated noise are regarded as model error, not as noise.

    Parameters
    ----------
    final : Estimate
        Of the fullest model: an effect that it explains (a step between two repeats) is not noise.
    group : str
        Kind of noise group.
    """
    stated, scale, dof = stated_noise(final, group), final.weights.scale[group], final.dof[group]
    if group in AGAIN:
        repeats, count = noise_again(final, group)
        if repeats is not None and not f_sf((repeats / (scale * stated)) ** 2, count, dof) < P_VALUE:
            return NoiseFloor(repeats, float(count), "images" if group == IMAGE else "repeats")
    if dof < OUTCOME.fewest_dof or chi2_sf(dof * (scale / STATED_FACTOR) ** 2, dof) < P_VALUE:
        return NoiseFloor(stated, STATED_WORTH, "stated")
    return NoiseFloor(scale * stated, dof, "fit")


def magnitude(
    estimate: Estimate,
    final: Estimate,
    held: ValidationErrors,
    after: ValidationErrors | None = None,
    seed: int = 0,
) -> Magnitude:
    """Size of the gap between a calibrated model and the machine.

    Parameters
    ----------
    estimate : Estimate
        Of the baseline.
    final : Estimate
        Of the fullest model, for the noise; the baseline where no effect was added.
    held : ValidationErrors
        Of the baseline.
    after : ValidationErrors, optional
        Of the fullest model: a validation contact is a gross outlier only if it is so for both.
    seed : int
        Of the bootstrap and of the simulated sessions.
    """
    rng = np.random.default_rng(seed)
    noise = noise_floor(final, held.main)
    fit = estimate.weights.scale[held.main] * stated_noise(estimate, held.main)
    factor = noise.sd / fit
    fair = kept(held, after) if after is not None else kept(held)
    mine = fair & (held.group == held.main)
    square = held.residual[mine] ** 2
    share = np.sum(held.by_parameters[mine] ** 2, axis=1)
    if held.how == LEFT_OUT:  # `noise` includes the parameters here
        share = share + np.maximum(held.noise[mine] ** 2 - fit**2, 0.0)
    else:  # measurements may have a noise of their own: images that are blurred
        share = share + (factor * held.noise[mine]) ** 2 - noise.sd**2
    total = float(np.mean(square))
    excess = total - noise.sd**2 - float(np.mean(share))
    draws = resampled(held.block[mine], np.stack([square, share]), rng)
    number = len(np.unique(held.block[mine]))
    spread = draws[:, 0] - draws[:, 1] - noise.draws(rng) ** 2
    low, high = bootstrap_interval95(excess, spread, number)
    low, high, value = (float(np.sqrt(max(v, 0.0))) for v in (low, high, excess))
    measured = [
        _contacts(held, fair & (held.kind == kind), what, factor, noise, rng)
        for kind, what in (("planes", VALIDATION_CONTACTS), ("points", VALIDATION_POINTS))
        if np.any(fair & (held.kind == kind))
    ]
    if len(held.distances.error):
        measured.insert(1, _spheres(held, factor, noise, rng))
    return Magnitude(
        held.how, float(np.sqrt(total)), noise.sd, noise.interval95, noise.source, value, (low, high),
        tuple(measured),
    )  # fmt: skip


def _contacts(
    held: ValidationErrors,
    mine: np.ndarray,
    what: str,
    factor: float,
    noise: NoiseFloor,
    rng: np.random.Generator,
) -> Measured:
    """Validation residuals and simulated ones: parameters of the posterior, estimated noise."""
    by, residual = held.by_parameters[mine], held.residual[mine]
    sigma = held.noise[mine] * np.where(held.group[mine] == held.main, factor, 1.0)
    count = int(np.clip(OUTCOME.normals // len(residual), 100, 2000))
    scale = noise.draws(rng)[:count] / noise.sd
    simulated = rng.standard_normal((count, by.shape[1])) @ by.T
    if held.by_readings is not None:
        by = held.by_readings[mine] * factor
        sigma = np.sqrt(np.maximum(sigma**2 - np.sum(by**2, axis=1), 0.0))
        for one in np.unique(held.block[mine]):
            image = held.block[mine] == one
            simulated[:, image] += scale[:, None] * (rng.standard_normal((count, by.shape[1])) @ by[image].T)
    simulated += scale[:, None] * sigma * rng.standard_normal((count, len(sigma)))
    contacts = len(np.unique(held.rows[mine]))
    return _measured(what, contacts, residual, np.sqrt(np.mean(simulated**2, axis=1)))


def _spheres(held: ValidationErrors, factor: float, noise: NoiseFloor, rng: np.random.Generator) -> Measured:
    d = held.distances
    scale = noise.draws(rng)[:, None] / noise.sd * (factor if held.main == "contact" else 1.0)
    simulated = rng.standard_normal((RESAMPLES, d.by_parameters.shape[1])) @ d.by_parameters.T
    simulated += scale * (rng.standard_normal((RESAMPLES, d.by_noise.shape[1])) @ d.by_noise.T)
    simulated += rng.standard_normal((RESAMPLES, d.by_certificates.shape[1])) @ d.by_certificates.T
    return _measured("sphere distances", len(d.error), d.error, np.sqrt(np.mean(simulated**2, axis=1)))


def _measured(what: str, count: int, error: np.ndarray, simulated: np.ndarray) -> Measured:
    """Measured RMS, and the one to expect: by mean squares, as a fit states it (its double is U, k = 2)."""
    low, high = interval95(simulated)
    return Measured(what, count, rms(error), rms(simulated), (float(low), float(high)))


@dataclass(frozen=True)
class Level:
    """A fitted model level, by its effects, and its validation errors."""

    model: tuple[str, ...]
    fitted: Estimate
    errors: ValidationErrors


def model_levels(levels: Sequence[Level], fair: np.ndarray | None = None) -> tuple[Step, ...]:
    """Validation errors of model levels, each with the change in log predictive density.

    Parameters
    ----------
    levels : sequence of Level
        Of one session, the nominal model first.
    fair : np.ndarray of bool, shape (R,), optional
        Residuals that are used, the same for all levels; default: all but those gross under the last two.
    """
    if fair is None:
        fair = kept(*(level.errors for level in levels[-2 if len(levels) > 2 else -1 :]))
    out: list[Step] = []
    before: np.ndarray | None = None
    for level in levels:
        h = level.errors
        density, block = log_predictive(h)
        gain, se = (0.0, 0.0) if before is None else difference(density - before, block)
        before = density
        main, points = (rms(h.residual[fair & mine]) for mine in (h.group == h.main, h.kind == "points"))
        out.append(Step(level.model, main, rms(h.distances.error), points, gain, se))
    return tuple(out)


def log_predictive(held: ValidationErrors) -> tuple[np.ndarray, np.ndarray]:
    """Log predictive density of every validation contact, (C,), nats, and its block label (C,).

    Normal with the joint covariance that the model predicts, mixed with a share of gross contacts. No contact
    is rejected here: the density of a gross contact is the same for all models, so that no single slip
    decides between two models, and an overconfident model gains nothing from rows that it does not explain.
    """
    j = held.joint
    normal = -0.5 * (j.chi2 + j.logdet + j.size * np.log(2 * np.pi))
    good = normal + np.log1p(-OUTCOME.gross_share)
    gross = -j.size * np.log(OUTCOME.gross_width) + np.log(OUTCOME.gross_share)
    return np.logaddexp(good, gross), held.block[j.first]


def difference(gain: np.ndarray, block: np.ndarray) -> tuple[float, float]:
    """Sum of gains (C,) and its standard error, by the scatter of the sums over blocks."""
    sums = np.bincount(np.unique(block, return_inverse=True)[1], gain)
    se = float(np.sqrt(len(sums)) * np.std(sums, ddof=1)) if len(sums) > 1 else nan
    return float(np.sum(gain)), se


def shrinkage(
    before: ValidationErrors,
    after: ValidationErrors,
    noise: float,
    seed: int = 0,
    noise_dof: float = float("inf"),
) -> tuple[Shrinkage, ...]:
    """Compare two models on the same validation measurements.

    Parameters
    ----------
    before, after : ValidationErrors
        Of the baseline and of the refitted model.
    noise : float
        Noise of one contact, m (of one coordinate where all rows are points).
    seed : int
        Of the bootstrap.
    noise_dof : float
        Degrees of freedom of the noise estimate.
    """
    rng = np.random.default_rng(seed)
    fair = kept(before, after)
    out = []
    for kind in ("planes", "points"):
        mine = fair & (before.kind == kind)
        if not np.any(mine):
            continue
        # replaces the noise of the fit by the best estimate, in the same proportions of rows
        main = mine & (after.group == after.main)
        sigma = np.where(main, after.noise * (noise / rms(after.noise[main])), after.noise)[mine]
        floor = sigma**2 + np.sum(after.by_parameters[mine] ** 2, axis=1)
        squares = np.stack(
            [before.residual[mine] ** 2, after.residual[mine] ** 2, floor, sigma**2 * main[mine]]
        )
        count = len(np.unique(before.rows[mine]))
        expected = expects(before.residual[mine], after.residual[mine], after.sd[mine])
        out.append(of_blocks(kind, count, squares, before.block[mine], expected, noise_dof, rng))
    if len(before.distances.error):
        distances = of_distances(before.distances, after.distances, noise_dof, rng)
        out.insert(1 if out and out[0].what == "planes" else 0, distances)
    return tuple(out)


def expects(before: np.ndarray, after: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """RMS errors that the refitted model predicts for the baseline and for itself, m.

    If the refitted model b is correct, the mean square error of the baseline a is
    E (y - a)^2 = (b - a)^2 + sd^2, for y ~ N(b, sd^2). The measured values cancel in b - a, the difference
    of the residuals, to first order: both terms depend on fitted measurements only.

    Parameters
    ----------
    before, after : np.ndarray, shape (R,)
        Residuals of the baseline and of the refitted model on the same measurements, m.
    sd : np.ndarray, shape (R,)
        Predicted by the refitted model, m.
    """
    variance = np.mean(sd**2)
    return float(np.sqrt(np.mean((before - after) ** 2) + variance)), float(np.sqrt(variance))


def of_blocks(
    what: str,
    count: int,
    squares: np.ndarray,
    block: np.ndarray,
    expected: tuple[float, float],
    noise_dof: float,
    rng: np.random.Generator,
) -> Shrinkage:
    """Share of the excess variance removed, for rows, by a paired block bootstrap.

    Parameters
    ----------
    what : str
    count : int
    squares : np.ndarray, shape (4, R)
        Squared errors before and after, expected ones, and the part of these that is noise, m2.
    block : np.ndarray, shape (R,)
    expected : tuple of float
        RMS errors before and after that the refitted model predicts, m.
    noise_dof : float
    rng : np.random.Generator
    """
    draws = resampled(block, squares, rng)
    draws[:, 2] += draws[:, 3] * _noise(noise_dof, rng)
    number = len(np.unique(block))
    interval = partial(bootstrap_interval95, blocks=number)
    return _compared(what, count, np.mean(squares[:3], axis=1), draws, number, interval, expected, noise_dof)


def of_distances(
    old: CentreDistances, new: CentreDistances, noise_dof: float, rng: np.random.Generator
) -> Shrinkage:
    """Share of the excess variance removed, for certified distances, by `resampled_distances`."""
    predicted = new.predicted_sd()
    means = np.array([np.mean(old.error**2), np.mean(new.error**2), np.mean(predicted**2)])
    pairs = resampled_distances(old, new, rng)
    of_noise = float(np.mean(np.sum(new.by_noise**2, axis=1)))
    draws = np.column_stack([pairs, means[2] + of_noise * _noise(noise_dof, rng)])
    number = independent_distances(old)

    def interval(value: float, values: np.ndarray) -> tuple[float, float]:
        low, high = interval95(values) if len(old.error) > 1 and len(values) else (nan, nan)
        return float(low), float(high)

    expected = expects(old.error, new.error, predicted)
    return _compared("distances", len(old.error), means, draws, number, interval, expected, noise_dof)


def _noise(dof: float, rng: np.random.Generator) -> np.ndarray:
    """Relative errors (RESAMPLES,) of a noise variance with some degrees of freedom."""
    return dof / rng.chisquare(dof, RESAMPLES) - 1.0 if np.isfinite(dof) else np.zeros(RESAMPLES)


def _compared(
    what: str,
    count: int,
    means: np.ndarray,
    draws: np.ndarray,
    number: float,
    interval: Callable[[float, np.ndarray], tuple[float, float]],
    expected: tuple[float, float],
    noise_dof: float,
) -> Shrinkage:
    """Reduction from mean squares (3,), m2: before, after, expected; and their draws (S, 3...)."""
    old, new, floor = means
    removed, ends = nan, (nan, nan)
    # without a significant excess this would be a ratio of two noise variances
    if old > floor * f_isf(OUTCOME.no_excess, number, min(noise_dof, OUTCOME.many)):
        removed = min((old - new) / (old - floor), 1.0)
        excess = draws[:, 0] - draws[:, 2]
        some = excess > 0
        low, high = interval(removed, np.minimum((draws[some, 0] - draws[some, 1]) / excess[some], 1.0))
        ends = low, min(high, 1.0)
    change = interval(new - old, draws[:, 1] - draws[:, 0])
    shown = np.isfinite(removed) or change[1] < 0  # there was an excess, or at least the errors fell
    claimed = bool(max(expected[1] ** 2, new) < old and shown)
    return Shrinkage(
        what, count, float(np.sqrt(old)), float(np.sqrt(new)), float(np.sqrt(floor)), float(removed), ends,
        *expected, claimed,
    )  # fmt: skip
