"""Filters of the samples of a log, their noise, and the band in which a log tells of torques."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from bayescal.logs import Log, Motion
from bayescal.logs.mechanism import inertial
from bayescal.logs.types import SERVO
from bayescal.motion.dynamics import carried, regressor
from bayescal.motion.fit_settings import SERVOS
from bayescal.motion.settings import SIGNALS


def low_passed(x: np.ndarray, step: float, band: float = SIGNALS.wide) -> np.ndarray:
    """Samples (N, ...) below a frequency, Hz: a Butterworth filter, forward and backward."""
    return np.asarray(sosfiltfilt(_sections(min(band * 2.0 * step, SIGNALS.nyquist)), x, axis=0))


@cache
def _sections(cut: float) -> np.ndarray:
    """Of a Butterworth filter; its design takes longer than its use."""
    return np.asarray(butter(SIGNALS.order, cut, output="sos"))


def derivative(x: np.ndarray, step: float) -> np.ndarray:
    """Derivative (N, ...) of samples by five points; third order at the ends."""
    out = np.gradient(x, step, axis=0, edge_order=2)
    out[2:-2] = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * step)
    return out


def white(x: np.ndarray) -> np.ndarray:
    """Standard deviation (n,) of white noise in smooth samples (N, n), by fourth differences."""
    return np.median(np.abs(np.diff(x, 4, axis=0)), axis=0) / (0.6745 * np.sqrt(70.0))


def rounded(x: np.ndarray) -> np.ndarray:
    """Standard deviation (n,) by the steps of readings (N, n), as of an encoder; 0 where all are alike."""
    steps = np.diff(np.sort(x, axis=0), axis=0)
    least = np.min(np.where(steps > SIGNALS.alike, steps, np.inf), axis=0, initial=np.inf)
    return np.where(np.isfinite(least), least, 0.0) / np.sqrt(12.0)


@dataclass(frozen=True)
class Bands:
    """Of a log: the band in which its torques are explained, and the noise of what explains them."""

    rows: float  # Hz, cut-off of the rows that are kept
    least: np.ndarray  # (n,) rad, standard deviation of positions by their steps

    @classmethod
    def of(cls, log: Log) -> Bands:
        """The widest."""
        least = rounded(np.concatenate([m.position for m in log.motions]))
        return cls(SERVOS.band if log.torque_kind == SERVO else SIGNALS.band, least)

    @property
    def wide(self) -> float:
        """Cut-off of positions before they are differentiated, Hz: what it takes away, rows do not keep."""
        return self.rows * SIGNALS.wide / SIGNALS.band

    def accelerations(self, log: Log) -> np.ndarray:
        """Standard deviation (n,) of the torques of nominal inertias by noise of the accelerations, N m."""
        variance = []
        for motion in log.motions:
            step, _, x = uniform(motion, motion.position)
            answer = derivative(derivative(impulse(len(x), step, self.rows), step), step)
            variance.append(np.sum(answer**2) * noise_of_positions(x, self.least) ** 2)
        return np.sqrt(_squared_inertia(log) @ np.median(variance, axis=0))

    def share(self, log: Log, noise: np.ndarray) -> float:
        """Noise of torques by that of accelerations over the whole noise (n,), N m: the largest of any joint.

        Noise of positions grows with the square of the frequency in accelerations, and with the inertias in
        torques. Where it is most of the residual, it is in the drivers too: they share an error then, which
        looks like an effect.
        """
        return float(np.max(self.accelerations(log) / np.where(noise > 0.0, noise, np.inf)))

    def narrower(self, share: float) -> Bands:
        """Those in which it may be small: it goes with the 2.5th power of the band."""
        rows = self.rows * min((SIGNALS.small / share) ** 0.4, SIGNALS.step)
        return replace(self, rows=max(rows, SIGNALS.narrow))


def noise_of_positions(position: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Standard deviation (n,) of the noise of uniform positions (N, n), at least that of their steps (n,).

    Fourth differences do not see these where a joint rests for half of a motion.
    """
    return np.maximum(white(position), least)


def _squared_inertia(log: Log) -> np.ndarray:
    """Squares (n, n) of the nominal torques by accelerations, kg2 m4, in the mean of some poses."""
    m, few = log.mechanism, [x.position[:: max(len(x.position) // SIGNALS.poses, 1)] for x in log.motions]
    q = np.repeat(np.concatenate(few), m.n, axis=0)
    bodies = np.array([inertial(*body) for body in zip(m.mass, m.centre, m.inertia, strict=True)])
    by = regressor(m, q, np.zeros_like(q), np.tile(np.eye(m.n), (len(q) // m.n, 1)), np.zeros(3))
    torques = carried(by, bodies, m, np.zeros(len(q))).reshape(-1, m.n, m.n) + np.diag(
        np.nan_to_num(m.armature)
    )
    return np.mean(torques**2, axis=0).T


def impulse(count: int, step: float, cut: float) -> np.ndarray:
    """Answer (N, 1) of the low-pass to an impulse."""
    out = np.zeros((count, 1))
    out[count // 2] = 1.0
    return low_passed(out, step, cut)


def uniform(motion: Motion, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Step, s, uniform times (N,), and samples (M, ...) of a motion at these."""
    steps = np.diff(motion.time)
    step = max(float(np.median(steps)), 1.0 / SIGNALS.fastest)
    time = np.arange(motion.time[0], motion.time[-1], step)
    if float(np.ptp(steps)) < SIGNALS.even * step and len(time) >= len(motion.time) - 1:
        return step, motion.time, x
    return step, time, CubicSpline(motion.time, x)(time)
