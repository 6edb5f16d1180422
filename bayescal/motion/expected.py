"""The error that withheld motions should have, by what a model leaves of fitted ones, with its interval.

Withheld motions may be faster. What the torque of a model has above the band of the rows is not fitted: a
share of it is an error, of derivatives, of friction at reversals, of commands between two rows.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bayescal.logs.types import CALIBRATE, VALIDATE
from bayescal.motion.linear import Fit, Table
from bayescal.motion.noise import Noise
from bayescal.motion.settings import OUTCOME
from bayescal.motion.signals import Signals, low_passed, where_moving
from bayescal.motion.terms import Operating


@dataclass(frozen=True)
class Expected:
    """RMS (n,) of torque residuals on moving rows, N m."""

    floor: np.ndarray  # of fitted motions
    rms: np.ndarray  # expected of withheld ones
    interval95: np.ndarray  # (2, n) of the latter


def expected_of(
    model: Operating, off: Iterable[tuple[Signals, np.ndarray]], held: Table, fit: Fit
) -> Expected:
    """The withheld error that a fit lets expect.

    Parameters
    ----------
    model : Operating
        Whose torques tell what is faster than the rows.
    off : iterable
        Fitted motions, each with the residuals (N, n) of its samples, N m.
    held : Table
        The withheld motions.
    fit : Fit
        Its covariance is that of the parameters.
    """
    sums = [(_sums(x, s), _sums(_faster(model, s), s)[0], len(s.time) * s.step) for s, x in off]
    squares, counts = np.array([of for of, _, _ in sums]).swapaxes(0, 1)
    more = np.array([of for _, of, _ in sums])
    squared, rows = np.sum([_sums(_faster(model, p.signals), p.signals) for p in held.parts], axis=0)
    total = np.maximum(counts.sum(axis=0), 1.0)
    floor, inside = squares.sum(axis=0) / total, more.sum(axis=0) / total
    share = np.minimum(OUTCOME.faster**2, floor / np.maximum(inside, 1e-300))
    further = share * (squared / np.maximum(rows, 1.0) - inside)
    by = [[np.mean(np.sum(x**2, axis=1)) for x in of[: len(floor)]] for of in fit.followed(held)]
    u = np.mean(by, axis=0)
    whole = np.maximum(floor + further + u, 1e-300)
    # of the logarithms of mean squares: scatter between motions, what is further, parameters
    moved = counts > 0.0
    usual = floor + share * (more / np.maximum(counts, 1.0) - inside)
    ratio = np.where(moved, squares / np.maximum(counts, 1.0), 1.0) / np.where(usual > 0.0, usual, 1.0)
    logs = np.log(np.where(moved & (ratio > 0.0), ratio, 1.0))
    scatter = 2.0 * OUTCOME.block * len(sums) / sum(seconds for _, _, seconds in sums)
    if len(sums) > 1:
        scatter = max(scatter, float(np.mean(np.var(logs, axis=0, ddof=1))))
    variance = scatter * (1.0 / len(sums) + 1.0 / len(held.parts))
    variance = variance + (OUTCOME.unsure * further / whole) ** 2 + 2.0 * (u / whole) ** 2
    half = 0.5 * 1.96 * np.sqrt(variance)
    rms = np.sqrt(whole)
    return Expected(np.sqrt(floor), rms, rms * np.exp([-half, half]))


def widened(model: Operating, table: Table, noise: Noise) -> Table:
    """The table with the noise that faster withheld motions of servos have beside that of fitted ones."""

    def fast(role: str) -> np.ndarray:
        of = [_sums(_faster(model, p.signals), p.signals) for p in table.of_role(role).parts]
        squares, counts = np.sum(of, axis=0)
        return np.asarray(squares / np.maximum(counts, 1.0))

    more = np.maximum(fast(VALIDATE) - fast(CALIBRATE), 0.0) * OUTCOME.faster**2
    factor, n = np.ones(len(noise.sd)), len(more)
    factor[:n] = np.sqrt(1.0 + more / np.maximum(noise.sd[:n], 1e-12) ** 2)
    return table.wider(VALIDATE, factor)


def _sums(x: np.ndarray, s: Signals) -> tuple[np.ndarray, np.ndarray]:
    """Sums (n,) of squares of moving samples (N, n), and their number."""
    moving = where_moving(x, s)
    return np.nansum(moving**2, axis=0), np.sum(np.isfinite(moving), axis=0)


def _faster(model: Operating, s: Signals) -> np.ndarray:
    """What the torque of a model has above the band of the rows (N, n), N m."""
    torque = model.shown(s)
    return s.unfiltered(torque - low_passed(torque, s.step, s.band))
