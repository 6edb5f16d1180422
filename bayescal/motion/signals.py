"""Motions as uniform samples with derivatives, their filters, and the band in which a log tells of torques.

A filter is linear: the equation of torques holds after it too, if every column has passed it, however
nonlinear a driver is in the speed. What is kept is the band that has content, at about its own rate: in an
empty band a noise model would amplify nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import minimum_filter1d, uniform_filter1d
from scipy.signal import butter, firwin, sosfiltfilt
from scipy.sparse import csr_matrix

from bayescal.errors import BayescalError
from bayescal.logs import Log, Motion
from bayescal.logs.types import SERVO, SHORTEST
from bayescal.motion.dynamics import Followed, inertia_matrix, regressor
from bayescal.motion.fit_settings import SERVOS
from bayescal.motion.settings import OUTCOME, SIGNALS


def low_passed(x: np.ndarray, step: float, band: float = SIGNALS.wide) -> np.ndarray:
    """Samples (N, ...) below a frequency, Hz: a Butterworth filter, forward and backward."""
    return np.asarray(sosfiltfilt(_sections(min(band * 2.0 * step, SIGNALS.nyquist)), x, axis=0))


@cache
def _sections(cut: float) -> np.ndarray:
    """Of a Butterworth filter; its design takes longer than its use."""
    return np.asarray(butter(SIGNALS.order, cut, output="sos"))


def derivative(x: np.ndarray, step: float) -> np.ndarray:
    """Derivative (N, ...) of samples by nine points; second order at the ends.

    At a fifth of the sampling rate it is 0.5 % too small, by five points 7 %.
    """
    out, inner = np.gradient(x, step, axis=0, edge_order=2), len(x) - 8
    if inner > 0:
        weights = enumerate((0.8, -0.2, 4.0 / 105.0, -1.0 / 280.0), 1)
        out[4:-4] = sum(w * (x[4 + k :][:inner] - x[4 - k :][:inner]) for k, w in weights) / step
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
    over: float = SIGNALS.over[-1]  # cut-off of the speeds by which friction reverses, over that of rows

    @classmethod
    def of(cls, log: Log) -> Bands:
        """The widest in which the noise of speeds does not hide when friction changes its direction."""
        least = rounded(np.concatenate([m.position for m in log.motions]))
        if log.torque_kind == SERVO:
            return cls(SERVOS.band, least)
        noise = []
        for motion in log.motions:
            step, _, x = uniform(motion, motion.position)
            noise.append((len(x), step, noise_of_positions(x, least)))

        def speeds(bands: Bands) -> float:
            """Standard deviation of the noise of the speeds, rad/s, of the joint with the largest."""
            each = [gain(count, step, bands.reversing) * sd for count, step, sd in noise]
            return float(np.max(np.median(each, axis=0)))

        every = [cls(SIGNALS.band, least, over) for over in SIGNALS.over]
        return next((bands for bands in every if speeds(bands) < SIGNALS.blurred), every[-1])

    @property
    def wide(self) -> float:
        """Cut-off of positions before they are differentiated, Hz: what it takes away, rows do not keep."""
        return self.rows * SIGNALS.over[-1]

    @property
    def reversing(self) -> float:
        """The same for the speeds by which friction reverses: it is not linear in them."""
        return self.rows * self.over

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
    q = np.concatenate(few)
    torques = inertia_matrix(m, m.inertials, q, np.zeros(len(q)))
    return np.mean((torques + np.diag(np.nan_to_num(m.armature))) ** 2, axis=0).T


def impulse(count: int, step: float, cut: float) -> np.ndarray:
    """Answer (N, 1) of the low-pass to an impulse."""
    out = np.zeros((count, 1))
    out[count // 2] = 1.0
    return low_passed(out, step, cut)


def gain(count: int, step: float, cut: float) -> float:
    """Standard deviation of a speed, rad/s, by white noise of 1 rad of positions that pass the low-pass."""
    return float(np.linalg.norm(derivative(impulse(count, step, cut), step)))


def uniform(motion: Motion, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Step, s, uniform times (N,), and samples (M, ...) of a motion at these."""
    steps = np.diff(motion.time)
    step = max(float(np.median(steps)), 1.0 / SIGNALS.fastest)
    time = np.arange(motion.time[0], motion.time[-1], step)
    if float(np.ptp(steps)) < SIGNALS.even * step and len(time) >= len(motion.time) - 1:
        return step, motion.time, x
    return step, time, CubicSpline(motion.time, x)(time)


@dataclass(frozen=True)
class Signals:
    """One motion at uniform times: N samples of n joints."""

    name: str
    role: str
    same_as: str
    log: Log
    step: float  # s
    time: np.ndarray  # (N,) s, since the log began
    q: np.ndarray  # (N, n) rad
    dq: np.ndarray  # (N, n) rad/s
    ddq: np.ndarray  # (N, n) rad/s2
    torque: np.ndarray  # (N, n) N m
    command: np.ndarray | None  # (N, n) rad
    link: np.ndarray | None  # (N, n) rad
    temperature: np.ndarray | None  # (N,) K over the first of the log
    payload: np.ndarray  # (N,) kg
    every: int  # samples per row that is kept
    band: float = SIGNALS.band  # Hz, of the rows that are kept
    stuck: float | None = SIGNALS.stuck  # s about rest in which stiction holds a joint; None: it does not
    telling: np.ndarray | bool = True  # (n,) whether the torque of a joint tells of it
    unsure: np.ndarray = field(default_factory=lambda: np.zeros(1))  # (n,) rad/s, noise of the speeds
    reversing: np.ndarray | None = None  # (N, n) rad/s, less smooth speeds, where friction reverses by them
    measured: Signals | None = None  # with the motion as measured, where this one is simulated
    wider: float = 1.0  # noise over that of the residuals, where it is in their drivers too

    @property
    def position(self) -> np.ndarray:
        """Measured positions (N, n), rad."""
        return self.q if self.measured is None else self.measured.q

    @property
    def turning(self) -> np.ndarray:
        """Speeds (N, n), rad/s, by which friction reverses."""
        return self.dq if self.reversing is None else self.reversing

    @cached_property
    def weight(self) -> np.ndarray:
        """Weights (N, n) of rows in a fit, 0 to 1.

        0 where stiction holds a joint with any torque, and about a reversal whose time is not known.
        """
        weight = np.where(self.telling, self.free, 0.0)
        if self.log.torque_kind == SERVO:
            return weight
        fast = _faster(self.dq, np.multiply.outer(SIGNALS.still, self.unsure), 0.5 / self.band / self.step)
        return np.where(self.unsure > SIGNALS.blurred, weight * fast, weight)

    @property
    def free(self) -> np.ndarray:
        """The part (N, n) of these weights that stiction decides."""
        if self.stuck is None:
            return np.broadcast_to(1.0, self.q.shape)
        limits = SERVOS.held if self.log.torque_kind == SERVO else SIGNALS.held
        return _faster(self.dq, np.array(limits)[:, None], self.stuck / self.step)

    @property
    def rests(self) -> np.ndarray:
        """Whether each joint rests (M, n), in and about the rows that are kept."""
        slow = np.abs(self.dq) < SIGNALS.held[0]
        long = minimum_filter1d(slow.astype(float), 2 * round(SIGNALS.stuck / self.step) + 1, axis=0)
        return np.asarray(self.kept(long) > SIGNALS.resting)

    def changed(self, **values: Any) -> Signals:
        """The same with another log of one mechanism, other torques, or other rows that stiction holds."""
        out = replace(self, **values)
        out.__dict__.update({k: v for k, v in self.__dict__.items() if k in ("rigid", "tilted", "loads")})
        return out

    @cached_property
    def rigid(self) -> np.ndarray:
        """Torques (N, n, n, 10) by the inertial parameters of the bodies."""
        return regressor(self.log.mechanism, self.q, self.dq, self.ddq, self.log.gravity)

    @cached_property
    def loads(self) -> dict[bytes, np.ndarray]:
        """Torques (N, n) that the gears carry, of the last inertial parameters for which they were asked."""
        return {}

    @cached_property
    def follows(self) -> dict[bytes, Followed]:
        """What servos do by their commands, of the last model for which this was asked."""
        return {}

    @cached_property
    def tilted(self) -> np.ndarray:
        """Torques (3, N, n, n, 10) at rest by the inertial parameters, of gravity along each base axis."""
        still = np.zeros_like(self.q)
        return np.array([regressor(self.log.mechanism, self.q, still, still, axis) for axis in np.eye(3)])

    def kept(self, x: np.ndarray) -> np.ndarray:
        """Samples (N, ...) low-passed, at the rows that are kept (M, ...); the ends are left out."""
        low_pass = _low_pass(len(self.time), self.step, self.every, self.band)
        return np.asarray(low_pass @ x.reshape(len(x), -1)).reshape(-1, *x.shape[1:])

    def unfiltered(self, x: np.ndarray) -> np.ndarray:
        """Samples (N, ...) between the first and the last row that is kept."""
        half = round(SIGNALS.margin / self.step)
        return x[half : len(x) - half]

    @property
    def moves(self) -> np.ndarray:
        """Whether each joint moves (N, n), at each of these samples; of servos whether any does.

        Of a joint that rests in all motions of the role too; all samples if no joint moves in any.
        """
        moves = np.abs(self.unfiltered(self.dq)) > OUTCOME.moving
        turned = [np.ptp(m.position, axis=0) > SIGNALS.rest_range for m in self.log.of_role(self.role)]
        still = ~np.any(turned, axis=0) | (self.log.torque_kind == SERVO)
        some = np.any(moves, axis=1, keepdims=True) | ~np.any(turned)
        return moves | (some & still)


@lru_cache(maxsize=16)
def _low_pass(count: int, step: float, every: int, band: float) -> csr_matrix:
    """Matrix (M, N) of a windowed sinc that also leaves rows out; only where it has all its samples."""
    half = round(SIGNALS.margin / step)
    taps = firwin(2 * half + 1, min(band * 2.0 * step, SIGNALS.nyquist))
    first = np.arange(0, count - 2 * half, every)
    columns = first[:, None] + np.arange(2 * half + 1)
    starts = np.arange(len(first) + 1) * len(taps)
    return csr_matrix((np.tile(taps, len(first)), columns.ravel(), starts), (len(first), count))


def _faster(speed: np.ndarray, limits: np.ndarray, about: float) -> np.ndarray:
    """Share (N, n), 0 to 1, of speeds between two limits (2, n), and the least within `about` samples."""
    share = np.clip((np.abs(speed) - limits[0]) / np.maximum(limits[1] - limits[0], 1e-12), 0.0, 1.0)
    return np.asarray(minimum_filter1d(share, 2 * round(about) + 1, axis=0))


def each(parts: Sequence[Signals]) -> Iterator[Signals]:
    """Motions one after another; each of a long log forgets the torques that it has computed."""
    for s in parts:
        yield s
        if sum(len(motion.time) for motion in s.log.motions) > SIGNALS.long:
            for signals, name in itertools.product((s, s.measured), ("rigid", "tilted")):
                vars(signals or s).pop(name, None)


def root_mean_square(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Of each joint (n,), over parts (N, n) without NaN, of which one at a time is in memory."""
    sums = [(np.nansum(np.square(part), axis=0), np.sum(np.isfinite(part), axis=0)) for part in parts]
    squares, counts = zip(*sums, strict=True)
    return np.asarray(np.sqrt(np.sum(squares, axis=0) / np.maximum(np.sum(counts, axis=0), 1)))


def where_moving(samples: np.ndarray, s: Signals) -> np.ndarray:
    """Samples (N, n) of a motion, NaN where the joint rests: stiction may hold it with any torque."""
    return np.where(s.moves, samples, np.nan)


def moving(dq: np.ndarray, noise: np.ndarray, step: float) -> np.ndarray:
    """Share (N, n) of speeds that is motion, 0 to 1: 0 where for a time they are no more than noise (n,)."""
    low, high = SIGNALS.still
    about = uniform_filter1d(dq**2, 2 * round(SIGNALS.stuck / step) + 1, axis=0)
    ratio = np.sqrt(np.maximum(about, 0.0)) / np.maximum(noise, 1e-12)  # sums that run leave less than 0
    return np.asarray(np.clip((ratio - low) / (high - low), 0.0, 1.0))


def signals_of(log: Log, motion: Motion, first: float, cold: float, bands: Bands) -> Signals:
    """A motion at uniform times.

    Positions give the derivatives: velocities of a controller may be filtered, and late.

    Parameters
    ----------
    log, motion
    first : float
        s, time at which the log begins.
    cold : float
        degC, temperature at which it begins.
    bands : Bands
        Those of the log.
    """
    assert motion.torque is not None
    step, time, position = uniform(motion, motion.position)

    def sampled(x: np.ndarray | None) -> np.ndarray | None:
        return None if x is None else uniform(motion, x)[2]

    sd = noise_of_positions(position, bands.least)

    def speed(band: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions below a frequency, Hz, their derivative, and the noise (n,) of this.

        Of a joint at rest the noise of its position would be the driver of its friction.
        """
        smooth, noise = low_passed(position, step, band), sd * gain(len(position), step, band)
        dq = derivative(smooth, step)
        moves = moving(dq, noise, step)
        return smooth, np.where(np.ptp(smooth, axis=0) > SIGNALS.rest_range, dq * moves, 0.0), noise

    q, dq, _ = speed(bands.wide)
    _, reversing, unsure = speed(bands.reversing)
    torque = sampled(motion.torque)
    assert torque is not None
    rows = float(1.0 / (step * SIGNALS.rate * bands.rows))
    stuck: float | None = SIGNALS.stuck
    if log.torque_kind == SERVO:  # friction that is smooth in the speed holds no joint
        stuck = None if log.mechanism.transition else 0.0
    warm = None if motion.temperature is None else np.interp(time, motion.time, motion.temperature) - cold
    return Signals(
        motion.name, motion.role, motion.same_as, log, step, time - first, q, dq, derivative(dq, step),
        torque, sampled(motion.command), sampled(motion.link), warm,
        np.interp(time, motion.time, motion.payload), max(int(rows), 1), bands.rows,
        stuck, unsure=unsure, reversing=reversing,
    )  # fmt: skip


def all_signals(log: Log, bands: Bands | None = None) -> tuple[Signals, ...]:
    """Every motion of a log, divided where rows are missing, in some bands: the widest by default.

    Raises
    ------
    BayescalError
        If no part of the motions of a role is long enough.
    """
    whole, log = log, log.divided
    if lost := {m.role for m in whole.motions} - {m.role for m in log.motions}:
        what = f"rows are missing in all motions of role {', '.join(sorted(lost))}"
        raise BayescalError(what, log.name, f"log {SHORTEST:g} s or more without loss")
    first = log.motions[0]
    cold = 0.0 if first.temperature is None else float(np.median(first.temperature[: SIGNALS.cold_rows]))
    bands, start = bands or Bands.of(log), float(first.time[0])
    telling = np.array([name not in log.coarse for name in log.mechanism.joint_names])
    parts = (signals_of(log, motion, start, cold, bands) for motion in log.motions)
    return tuple(s.changed(telling=telling) for s in parts)
