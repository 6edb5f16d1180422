"""Reduction of the errors of validation planes, sphere distances and points by the named effects."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.gap.result import Shrinkage
from bayescal.gap.settings import OUTCOME
from bayescal.predict.crossvalidation import (
    RESAMPLES,
    bootstrap_interval95,
    independent_distances,
    interval95,
    resampled,
    resampled_distances,
)
from bayescal.predict.errors import CentreDistances, ValidationErrors, kept
from bayescal.statistics import f_isf, rms

NAN = float("nan")


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
        fit = rms(after.noise[main]) if np.any(main) else NAN
        own = np.where(main, after.noise * (noise / fit), after.noise)[mine]
        floor = own**2 + np.sum(after.by_parameters[mine] ** 2, axis=1)
        squares = np.stack(
            [before.residual[mine] ** 2, after.residual[mine] ** 2, floor, own**2 * main[mine]]
        )
        count = len(np.unique(before.rows[mine]))
        expected = expects(before.residual[mine], after.residual[mine], after.sd[mine])
        out.append(of_blocks(kind, count, squares, before.block[mine], expected, noise_dof, rng))
    if len(before.distances.error):
        found = of_distances(before.distances, after.distances, noise_dof, rng)
        out.insert(1 if out and out[0].what == "planes" else 0, found)
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
    own = np.mean(sd**2)
    return float(np.sqrt(np.mean((before - after) ** 2) + own)), float(np.sqrt(own))


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

    def interval(value: float, values: np.ndarray) -> tuple[float, float]:
        return bootstrap_interval95(value, values, number)

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
        low, high = interval95(values) if len(old.error) > 1 and len(values) else (NAN, NAN)
        return float(low), float(high)

    expected = expects(old.error, new.error, predicted)
    return _compared("distances", len(old.u), means, draws, number, interval, expected, noise_dof)


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
    removed, ends = NAN, (NAN, NAN)
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
