"""Signals of a motion without a model of the arm: speeds, delays, filters, corrupt values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, coherence, csd, sosfiltfilt, welch

from bayescal.logs import Motion

STEP = 4e-3
"""s, of signals that are compared: far below the periods of `WIDE`."""
SMOOTH = 0.1
"""s, over which speeds are averaged."""
BAND = (0.3, 8.0)
"""Hz, in which torques and accelerations are compared: below, other torques; above, noise (assumed)."""
WIDE = (0.3, 20.0)
"""Hz, in which velocities, positions and commands are compared."""
REVERSAL = 0.03
"""rad/s: scale of the reversal of friction among the drivers of a torque (assumed)."""
EDGE = 30
"""Rows at either end that filters disturb."""
STEPS = 4
"""Iterations of a delay."""
FARTHEST = 0.1
"""s: no longer delay is sought in an iteration."""
COHERENT = 0.95
"""Squared coherence from which on two signals are compared by frequency."""
HALF = np.sqrt(0.5)
STEEP = 30.0
"""Times by which a spectrum falls over an octave if it is filtered: noise with memory falls four times."""
LEAST = 5.0
"""Hz: no filter of torques is sought below."""
SPIKE = 30.0
"""Robust standard deviations of the difference from neighbours: a corrupt value (assumed)."""
OUT = 0.02
"""Of the range of a signal: a smaller deviation is noise, or a fast motion (assumed)."""
CLIPPED = (5, 0.001)
"""Rows, and fraction of them, at the largest value of a torque that is limited."""


def speeds(time: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Velocities (N, n), rad/s, from positions (N, n) and stamps (N,), averaged over `SMOOTH`."""
    wide = max(round(float(SMOOTH / np.median(np.diff(time)))), 1)
    return np.asarray(uniform_filter1d(np.gradient(position, time, axis=0), wide, axis=0, mode="nearest"))


@dataclass(frozen=True)
class Uniform:
    """A motion at equal steps, its median one: arrays (N, n), None where not measured."""

    step: float
    position: np.ndarray
    velocity: np.ndarray
    measured: np.ndarray | None
    torque: np.ndarray | None
    command: np.ndarray | None


def uniform(motion: Motion) -> Uniform:
    """A motion at equal steps; `velocity` is that of the positions where none is measured.

    Of a faster log, means of as many rows as make `STEP`: the same for all signals, so that delays are kept.
    """
    raw = float(np.median(np.diff(motion.time)))
    grid = np.arange(motion.time[0], motion.time[-1] + raw / 2, raw)
    every = max(round(STEP / raw), 1)

    def at(values: np.ndarray | None) -> np.ndarray | None:
        if values is None:
            return None
        even = np.column_stack([np.interp(grid, motion.time, column) for column in values.T])
        return even if every == 1 else np.asarray(uniform_filter1d(even, every, axis=0)[::every])

    position = at(motion.position)
    assert position is not None
    step, measured = raw * every, at(motion.velocity)
    velocity = np.gradient(position, step, axis=0) if measured is None else measured
    return Uniform(step, position, velocity, measured, at(motion.torque), at(motion.command))


def torque_drivers(of: Uniform, joint: int) -> np.ndarray:
    """Columns (N, k) in which the torque of a joint is about linear, without masses of the arm.

    Accelerations and products of velocities of all joints, friction, sines and cosines of angles and of their
    sums from the second joint on, in which gravity acts.
    """
    v, q = of.velocity, of.position
    sums = np.cumsum(q[:, 1:], axis=1)
    angles = [f(each) for each in (q, sums) for f in (np.cos, np.sin)]
    friction = [np.tanh(v[:, [joint]] / REVERSAL), v[:, [joint]]]
    return np.column_stack([np.gradient(v, of.step, axis=0), *friction, v[:, [joint]] * v, *angles])


def delay(columns: np.ndarray, signal: np.ndarray, step: float, band: tuple[float, float]) -> float:
    """Delay (s) of a signal (N,) behind the linear combination of columns (N, k) that explains it best.

    Both are filtered to `band`, Hz, by the same filter without phase. Gauss-Newton on the delay, with the
    coefficients by least squares in each iteration; nan where there are too few rows.
    """
    high = min(band[1], 0.4 / step)
    if len(signal) < 4 * EDGE or high <= 2 * band[0]:
        return np.nan
    filters = _bandpass(band[0], high, round(1 / step, 3))
    drivers, target = sosfiltfilt(filters, columns, axis=0), sosfiltfilt(filters, signal)
    grid, inner, out = step * np.arange(len(signal)), slice(EDGE, -EDGE), 0.0
    coefficients = np.linalg.lstsq(drivers[inner], target[inner], rcond=1e-8)[0]
    for _ in range(STEPS):
        shifted = np.column_stack([np.interp(grid - out, grid, column) for column in drivers.T])
        slope = -np.gradient(shifted @ coefficients, step)[:, None]
        solved = np.linalg.lstsq(np.hstack([shifted, slope])[inner], target[inner], rcond=1e-8)[0]
        coefficients, change = solved[:-1], solved[-1]
        out += float(np.clip(change, -FARTHEST, FARTHEST))
    return out if np.any(slope[inner]) else np.nan


@lru_cache
def _bandpass(low: float, high: float, rate: float) -> np.ndarray:
    """Sections of a band-pass of second order."""
    return np.asarray(butter(2, [low, high], "bandpass", fs=rate, output="sos"))


def middle(values: Sequence[float]) -> tuple[float, float]:
    """Median of values of several motions, and its standard uncertainty by their scatter; nan without any.

    The u of a median of a normal sample is 1.25 of that of the mean.
    """
    finite = np.array([v for v in values if np.isfinite(v)])
    if len(finite) < 2:
        return (float(finite[0]) if len(finite) else np.nan), np.nan
    scatter = 1.4826 * float(np.median(np.abs(finite - np.median(finite))))
    spread = max(scatter, float(np.std(finite)) / 2)
    return float(np.median(finite)), 1.25 * spread / float(np.sqrt(len(finite)))


def cutoff(driver: np.ndarray, signal: np.ndarray, step: float) -> tuple[float, float]:
    """Gain at low frequency of a signal (N,) over its driver (N,), and the frequency, Hz, of 0.71 of it.

    Only where the two are coherent; inf where the gain does not fall there, nan where nothing is coherent.
    """
    length = min(len(signal), max(round(4 / step), 64))
    frequency, both = csd(driver, signal, fs=1 / step, nperseg=length)
    _, power = welch(driver, fs=1 / step, nperseg=length)
    _, common = coherence(driver, signal, fs=1 / step, nperseg=length)
    trusted = np.flatnonzero((common > COHERENT) & (frequency > 0))
    if len(trusted) < 3:
        return np.nan, np.nan
    trusted = trusted[: int(np.argmax(np.diff(trusted) > 3)) + 1] if np.any(np.diff(trusted) > 3) else trusted
    gain = np.abs(both[trusted]) / power[trusted]
    low = float(np.median(gain[: max(len(gain) // 8, 2)]))
    fallen = np.flatnonzero(gain < HALF * low)
    return low, float(frequency[trusted[fallen[0]]]) if len(fallen) else np.inf


def filtered(torques: Sequence[np.ndarray], step: float) -> float:
    """Frequency, Hz, above which a torque is filtered: its spectrum falls too steeply; inf if it does not.

    Parameters
    ----------
    torques : sequence of np.ndarray
        (N,) of each motion, N m.
    step : float
        s.
    """
    length = max(round(2 / step), 64)
    spectra = [welch(t - t.mean(), 1 / step, nperseg=length)[1] for t in torques if len(t) >= length]
    if not spectra:
        return np.inf
    power, frequency = np.mean(spectra, axis=0), np.fft.rfftfreq(length, step)
    edges = LEAST * 2.0 ** (0.5 * np.arange(int(2 * np.log2(0.5 / step / LEAST)) + 1))
    octaves = (power[(frequency >= low) & (frequency < low * np.sqrt(2))] for low in edges)
    level = [float(np.median(part)) for part in octaves if len(part)]
    steep = [k for k in range(len(level) - 2) if level[k] > STEEP * max(level[k + 2], 1e-300)]
    return float(edges[steep[0]]) if steep else np.inf


def spikes(values: np.ndarray) -> np.ndarray:
    """Rows of values (N, n) that deviate from both neighbours, and from the cubic through four of them.

    By more than `SPIKE` times the standard deviation of such differences, as their median and their 99th
    percentile state it, both robust against a few corrupt values, and more than `OUT` of the range.
    """
    if len(values) < 5:
        return np.zeros(0, int)
    x = values
    cubic = x[2:-2] - (4 * (x[1:-3] + x[3:-1]) - x[:-4] - x[4:]) / 6
    away = np.min(np.abs([x[2:-2] - x[1:-3], x[2:-2] - x[3:-1], cubic]), axis=0)
    scale = np.maximum(1.4826 * np.median(away, axis=0), np.percentile(away, 99, axis=0) / 2.58)
    return 2 + np.flatnonzero((away > np.maximum(SPIKE * scale, OUT * np.ptp(x, axis=0))).any(axis=1))


def clipped(values: np.ndarray) -> float:
    """The value at which a torque (N,) is limited; nan if it is not."""
    for extreme in (values.max(), values.min()):
        at = values == extreme
        run = np.flatnonzero(np.diff(np.r_[0, at.astype(int), 0]))
        longest = int(np.max(np.diff(run)[::2])) if len(run) else 0
        if longest >= CLIPPED[0] and at.sum() > CLIPPED[1] * len(values) and np.ptp(values) > 0:
            return float(extreme)
    return np.nan


def held(values: np.ndarray, moving: np.ndarray) -> float:
    """Rows for which a value (N,) is held while its joint moves; nan if it hardly moves."""
    go = moving[1:] & moving[:-1]
    new = np.diff(values) != 0
    return float(go.sum() / max(int((new & go).sum()), 1)) if go.sum() > 20 else np.nan
