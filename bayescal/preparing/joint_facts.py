"""Facts of a joint log without a model of the arm: stamps, speeds, delays, filters, corrupt values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.signal import butter, coherence, csd, sosfiltfilt, welch

from bayescal.logs import Log, Motion
from bayescal.motion.dynamics import regressor
from bayescal.preparing.joint_delays import Uniform, speeds, thinned, torque_delays, uniform

WIDE = (0.3, 20.0)
"""Hz, in which velocities, positions and commands are compared."""
EDGE = 30
"""Rows at either end that filters disturb."""
STEPS = 4
"""Iterations of a delay."""
FARTHEST = 0.1
"""s: no longer delay is sought in an iteration."""
COHERENT = 0.95
"""Squared coherence from which on two signals are compared by frequency."""
STEEP = 30.0
"""Times by which a spectrum falls over an octave if it is filtered: noise with memory falls four times."""
LEAST = 5.0
"""Hz: no filter of torques is sought below."""
SPIKE = 30.0
"""Robust standard deviations of the difference from neighbours: a corrupt value (assumed)."""
OUT = 0.02
"""Of the range of a signal: a smaller deviation is noise, or a fast motion (assumed)."""
CERTAIN = 3.0
"""Standard uncertainties from which on a delay is one."""
SHORTEST = 0.5e-3
"""s: a shorter delay does not matter."""
CLIPPED = (5, 0.001)
"""Rows, and fraction of them, at the largest value of a torque that is limited."""


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
    with np.errstate(invalid="ignore"):  # a coarse encoder that rests has no power at any frequency
        _, common = coherence(driver, signal, fs=1 / step, nperseg=length)
    trusted = np.flatnonzero((common > COHERENT) & (frequency > 0))
    trusted = trusted[: int(np.argmax(np.diff(trusted) > 3)) + 1] if np.any(np.diff(trusted) > 3) else trusted
    if len(trusted) < 3:
        return np.nan, np.nan
    gain = np.abs(both[trusted]) / power[trusted]
    low = _at_rest(frequency[trusted], gain)
    fallen = np.flatnonzero(gain < np.sqrt(0.5) * low)
    return low, float(frequency[trusted[fallen[0]]]) if len(fallen) else np.inf


def _at_rest(frequency: np.ndarray, gain: np.ndarray) -> float:
    """Gain at frequency zero, from gains (K,) at the lowest frequencies (K,), Hz.

    1 / gain^2 of a filter is linear in the squared frequency while its gain is not much lower than that at
    rest. The median of all low frequencies takes a filter that begins below them for a unit.
    """
    steady = np.flatnonzero(gain < np.sqrt(0.5) * np.max(gain[:2]))
    count = max(min(len(gain) // 8, int(steady[0]) if len(steady) else len(gain)), 3)
    squared, inverse = frequency[:count] ** 2, gain[:count] ** -2.0
    slope, level = np.polyfit(squared, inverse, 1)
    return float(level**-0.5) if slope > 0 and level > 0 else float(np.median(gain[: max(count, 2)]))


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


def spikes(values: np.ndarray, span: np.ndarray) -> np.ndarray:
    """Rows of values (N, n) that deviate from both neighbours, and from the cubic through four of them.

    By more than `SPIKE` times the standard deviation of such differences, as their median and their 99th
    percentile state it, both robust against a few corrupt values, and more than `OUT` of `span`, the range
    (n,) over all motions: a joint at rest shows single steps of its encoder.
    """
    if len(values) < 5:
        return np.zeros(0, int)
    x = values
    cubic = x[2:-2] - (4 * (x[1:-3] + x[3:-1]) - x[:-4] - x[4:]) / 6
    away = np.min(np.abs([x[2:-2] - x[1:-3], x[2:-2] - x[3:-1], cubic]), axis=0)
    scale = np.maximum(1.4826 * np.median(away, axis=0), np.percentile(away, 99, axis=0) / 2.58)
    return 2 + np.flatnonzero((away > np.maximum(SPIKE * scale, OUT * span)).any(axis=1))


def clipped(values: np.ndarray) -> float:
    """The value at which a torque (N,) is limited; nan if it is not."""
    for extreme in (values.max(), values.min()):
        limited = values == extreme
        run = np.flatnonzero(np.diff(np.r_[0, limited.astype(int), 0]))
        longest = int(np.max(np.diff(run)[::2])) if len(run) else 0
        if longest >= CLIPPED[0] and limited.sum() > CLIPPED[1] * len(values) and np.ptp(values) > 0:
            return float(extreme)
    return np.nan


def held(values: np.ndarray, moving: np.ndarray) -> float:
    """Rows for which a value (N,) is held while its joint moves; nan if it hardly moves."""
    go = moving[1:] & moving[:-1]
    new = np.diff(values) != 0
    return float(go.sum() / max(int((new & go).sum()), 1)) if go.sum() > 20 else np.nan


SLOW = (0.01, 0.05)
"""rad/s: speeds below the second show how friction depends on speed; below the first a joint is at rest."""
LOADS = 0.1
"""Of the largest torque of gravity of a joint: standard deviation over the poses that counts as two poses."""
MOST = 0.2
"""Of the largest change of gravity's torque of any joint: it tells unit and sign of a torque, whatever masses
and payload are (assumed)."""
POSES = 1000
"""At which torques of gravity are computed."""
GAP, JITTER = 3.0, 0.05
"""Times the median step; relative standard deviation of steps."""


@dataclass(frozen=True)
class Joint:
    """Facts of a joint, SI; delays and their u are (2,) s, nan where they do not follow."""

    name: str
    lowest: float
    highest: float
    fastest: float
    at_rest: float  # fraction of rows
    slow: float  # s at `SLOW` speeds
    gravity: tuple[float, float]  # N m, mean and standard deviation over the poses
    torque_delay: tuple[float, float]  # of torque behind what positions predict
    torque_delays: np.ndarray  # (3, P), time, delay and weight of pieces of the motions, see `Delays`
    velocity_delay: tuple[float, float]  # of velocity behind the derivative of position
    velocity_cutoff: float  # Hz; inf if unfiltered as far as can be seen
    velocity_gain: float
    command_delay: tuple[float, float]  # of position behind command
    command_error: float  # rad, RMS
    torque_band: float  # Hz, above which the torque is filtered; inf if not
    clipped: float  # N m; nan if not
    held: float  # rows for which a position is held


@dataclass(frozen=True)
class Stamps:
    """Facts of the stamps, s: median step, relative standard deviation of steps, largest step, its place."""

    step: float
    jitter: float
    longest: float
    where: str
    gaps: int


def joints_of(log: Log) -> tuple[Joint, ...]:
    """Facts of all joints."""
    even = [uniform(m) for m in log.motions]
    velocity = [speeds(m.time, m.position) for m in log.motions]
    steps = [np.gradient(m.time) for m in log.motions]
    position = np.concatenate([m.position for m in log.motions])
    gravity = gravity_torques(log, position[:: max(len(position) // POSES, 1)])
    torques = [m.torque for m in log.motions if m.torque is not None]
    raw = float(np.median(np.concatenate([np.diff(m.time) for m in log.motions])))
    nothing, every = (np.nan, np.nan), np.abs(np.concatenate(velocity))
    moves = np.any(every > SLOW[0], axis=0)
    measured = [_measured(even, j) if moves[j] else (nothing, nothing) for j in range(log.n)]
    late = any(is_late(*of) for of, _ in measured)  # such velocities would make the torques early
    fair = [replace(e, velocity=np.gradient(e.position, e.step, axis=0)) if late else e for e in even]
    delays = torque_delays(log, fair)
    out = []
    for j, name in enumerate(log.mechanism.joint_names):
        speed = every[:, j]
        slow = (speed > SLOW[0]) & (speed < SLOW[1])
        commands = [(e.command[:, j], e.position[:, j], e.step) for e in even if e.command is not None]
        lag, (low, high) = measured[j]
        errors = [c - p for c, p, _ in commands]
        out.append(
            Joint(
                name=name,
                lowest=float(position[:, j].min()),
                highest=float(position[:, j].max()),
                fastest=float(speed.max()),
                at_rest=float(np.mean(speed <= SLOW[0])),
                slow=float(np.concatenate(steps)[slow].sum()),
                gravity=(float(gravity[:, j].mean()), float(gravity[:, j].std())),
                torque_delay=(delays[j].value, delays[j].u) if moves[j] else nothing,
                torque_delays=delays[j].pieces,
                velocity_delay=lag,
                velocity_cutoff=high,
                velocity_gain=low,
                command_delay=_delay(commands) if moves[j] else nothing,
                command_error=float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else np.nan,
                torque_band=filtered([t[:, j] for t in torques], raw) if torques else np.inf,
                clipped=clipped(np.concatenate([t[:, j] for t in torques])) if torques else np.nan,
                held=_held(log.motions, velocity, j),
            )
        )
    return tuple(out)


def gravity_torques(log: Log, position: np.ndarray) -> np.ndarray:
    """Torques (N, n), N m, by which gravity loads the joints of the nominal arm at readings (N, n)."""
    still = np.zeros_like(position)
    parts = regressor(log.mechanism, position, still, still, log.gravity)
    return np.asarray(np.einsum("cjkp,kp->cj", parts, log.mechanism.inertials))


def torque_gains(log: Log, even: Sequence[Uniform]) -> np.ndarray:
    """Measured torques over those of the nominal masses, beside friction and offset; (n,).

    Nan of joints whose torque by gravity changes little.
    """
    out = np.full(log.n, np.nan)
    q, v, a, torque, _ = thinned(log, even, POSES)
    gravity = gravity_torques(log, q)
    change = np.where(gravity.std(axis=0) > LOADS * abs(gravity.mean(axis=0)), gravity.std(axis=0), 0.0)
    by = regressor(log.mechanism, q, v, a, log.gravity)
    nominal = np.einsum("cjkp,kp->cj", by, log.mechanism.inertials)
    for j in np.flatnonzero(change > MOST * change.max()):
        speed = v[:, j]
        drivers = np.column_stack([nominal[:, j], np.tanh(speed / SLOW[1]), speed, np.ones(len(speed))])
        out[j] = np.linalg.lstsq(drivers, torque[:, j], rcond=None)[0][0]
    return out


def is_late(delay: float, u: float) -> bool:
    """Whether a delay is one, s: beyond its u, and long enough to matter; not where it is unknown."""
    return abs(delay) > max(CERTAIN * u, SHORTEST)


def _measured(even: Sequence[Uniform], j: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Of measured velocities against those of the positions: delay and u, s; gain, and cut-off, Hz."""
    pairs = [
        (np.gradient(e.position[:, j], e.step), e.measured[:, j], e.step)
        for e in even
        if e.measured is not None
    ]
    transfer = [pair for p in pairs if np.isfinite((pair := cutoff(*p))[0])]
    low, high = (float(x) for x in np.median(transfer, axis=0)) if transfer else (np.nan, np.nan)
    return _delay(pairs, high), (low, high)


def _delay(
    pairs: Sequence[tuple[np.ndarray, np.ndarray, float]], cutoff: float = np.inf
) -> tuple[float, float]:
    """Delay of the signals (N,) of all motions behind their drivers (N,), and its u by their scatter.

    A filter delays what it passes, up to its `cutoff`, Hz; beyond, only noise is alike in both.
    """
    high = min(WIDE[1], cutoff) if np.isfinite(cutoff) else WIDE[1]
    band = min(WIDE[0], high / 3), high
    return middle([delay(driver[:, None], signal, step, band) for driver, signal, step in pairs])


def _held(motions: Sequence[Motion], velocity: Sequence[np.ndarray], j: int) -> float:
    fast = [np.abs(v[:, j]) > max(0.3 * np.abs(v[:, j]).max(), SLOW[1]) for v in velocity]
    values = [held(m.position[:, j], go) for m, go in zip(motions, fast, strict=True)]
    finite = [v for v in values if np.isfinite(v)]
    return float(np.median(finite)) if finite else np.nan


def stamps_of(log: Log, table: str) -> Stamps:
    """Facts of the stamps within motions."""
    steps = [np.diff(m.time) for m in log.motions]
    every = np.concatenate(steps)
    step = float(np.median(every))
    worst = max(range(len(steps)), key=lambda k: steps[k].max())
    row = int(np.argmax(steps[worst])) + 1
    usual = every[every < GAP * step]
    where = f"{table}:{log.motions[worst].line + row} (motion {log.motions[worst].name})"
    jitter, gaps = float(usual.std() / step), int((every >= GAP * step).sum())
    return Stamps(step, jitter, float(every.max()), where, gaps)
