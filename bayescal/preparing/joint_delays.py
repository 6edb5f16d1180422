"""Delays of torques behind positions, joint by joint, whatever the masses of the arm are.

The torque of a joint is linear in the inertial parameters of the bodies (`bayescal.motion.dynamics`): all of
them are free, so that only the geometry of the arm counts. Friction is a function of speed and direction. At
a reversal and at rest it is none (stiction, pre-sliding): it makes torques seem some ms early, or 10 to 30 ms
late. Delays therefore follow from rows in which the joint slides; from all rows where both agree.

Signals of a joint log at equal steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import minimum_filter1d, uniform_filter1d
from scipy.signal import butter, sosfiltfilt

from bayescal.logs import Log, Motion
from bayescal.motion.dynamics import regressor

STEP = 4e-3
"""s, of signals that are compared: far below the periods of motions."""
SMOOTH = 0.1
"""s, over which speeds are averaged."""


def speeds(time: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Velocities (N, n), rad/s, from positions (N, n) and stamps (N,), over `SMOOTH`: stamps may scatter."""
    wide = max(round(float(SMOOTH / np.median(np.diff(time)))), 1)
    turned, took = np.gradient(position, axis=0), np.gradient(time)[:, None]
    both = [np.asarray(uniform_filter1d(x, wide, axis=0, mode="nearest")) for x in (turned, took)]
    return both[0] / both[1]


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

    def resampled(values: np.ndarray | None) -> np.ndarray | None:
        if values is None:
            return None
        even = np.column_stack([np.interp(grid, motion.time, column) for column in values.T])
        return even if every == 1 else np.asarray(uniform_filter1d(even, every, axis=0)[::every])

    position = resampled(motion.position)
    assert position is not None
    step, measured = raw * every, resampled(motion.velocity)
    velocity = np.gradient(position, step, axis=0) if measured is None else measured
    return Uniform(step, position, velocity, measured, resampled(motion.torque), resampled(motion.command))


def thinned(log: Log, even: Sequence[Uniform], count: int) -> tuple[np.ndarray, ...]:
    """Positions, velocities, accelerations, torques (N, n) and payloads (N,) of about `count` rows."""
    every = max(sum(len(e.position) for e in even) // count, 1)
    moved = [
        (e.position, e.velocity, np.gradient(e.velocity, e.step, axis=0), e.torque,
         np.full(len(e.position), np.median(m.payload)))
        for m, e in zip(log.motions, even, strict=True)
    ]  # fmt: skip
    return tuple(np.concatenate(column)[::every] for column in zip(*moved, strict=True))


BAND = 8.0
"""Hz, below which torques and their drivers are compared: above, noise (assumed)."""
REVERSAL = 0.03
"""rad/s: scale of the reversal of friction among the drivers of a torque (assumed)."""
SLIDING = (0.05, 0.02, 0.2)
"""rad/s, rad since a reversal, and s about other rows: a joint that is faster and farther slides (assumed:
pre-sliding is over after some mrad)."""
EDGE = 0.15
"""s at either end of a piece that filters disturb."""
PIECE, PIECES = 20.0, 60
"""s of a piece of a motion, as long as a usual motion; most pieces of a log that are used."""
ROWS, LEAST = 20_000, 100
"""Rows of a log that are used, at most and at least: noise of torques is alike over some ms."""
RIDGE = 1e-6
"""Of the mean square of a driver: parameters of bodies that a joint does not feel are undetermined."""
STEPS = 3
"""Iterations of a delay; each is exact for a torque that is linear within the change."""
FARTHEST = 0.05
"""s: most change of a delay in an iteration."""
SYSTEMATIC = 0.4e-3
"""s: u of the delay of a torque for what its drivers lack. With it, deviations of joints are 0.8 u (RMS) in
45 simulated logs of two other authors whose delays are known."""
FREE = (0.1, 0.25)
"""Least degrees of freedom, and least share of them that Student's variance divides by: it has none below two
(assumed: u is at most doubled)."""
AGREE = 3.5
"""Standard uncertainties of the mean over the joints within which all rows and those of sliding joints state
one delay (assumed: 2.9 at most in 27 simulated logs whose friction is a function of speed)."""
LEFT = 0.1
"""Of what reversals change in a delay, what is left in rows of a sliding joint (assumed)."""


@dataclass(frozen=True)
class Delays:
    """Delay of the torque of a joint and its u, s, nan where unknown.

    `pieces` (3, P) are time, s, delay, s, and weight, 1/s2, of each piece of the motions, from all rows.
    """

    value: float
    u: float
    pieces: np.ndarray


@dataclass(frozen=True)
class _Piece:
    """Filtered drivers (M, n, K) and their rates; torques (N, n), and their rows (M,) that are used."""

    time: float
    step: float
    drivers: np.ndarray
    rates: np.ndarray
    torque: np.ndarray
    rows: np.ndarray
    slides: np.ndarray


def torque_delays(log: Log, even: Sequence[Uniform]) -> tuple[Delays, ...]:
    """Delays of all joints; nan without torques.

    Parameters
    ----------
    log : Log
    even : sequence of Uniform
        Its motions at equal steps.
    """
    nothing = Delays(np.nan, np.nan, np.empty((3, 0)))
    if any(e.torque is None for e in even):
        return (nothing,) * log.n
    pieces = _pieces(log, even)
    if not pieces:  # of too few rows
        return (nothing,) * log.n
    every = [_delay(pieces, j, slides=False) for j in range(log.n)]
    sliding = [_delay(pieces, j, slides=True) for j in range(log.n)]
    differences = [
        (a.value - s.value, s.u) for a, s in zip(every, sliding, strict=True) if np.isfinite([a.u, s.u]).all()
    ]
    if not differences:
        return tuple(Delays(np.nan, np.nan, a.pieces) for a in every)
    away = np.array([x / u for x, u in differences])
    if abs(away.sum()) <= AGREE * np.sqrt(len(away)):
        return tuple(every)
    both = zip(every, sliding, strict=True)
    return tuple(Delays(s.value, float(np.hypot(s.u, LEFT * (a.value - s.value))), a.pieces) for a, s in both)


def _pieces(log: Log, even: Sequence[Uniform]) -> list[_Piece]:
    """Pieces of the motions of a log, spread over it."""
    cuts = []
    for k, e in enumerate(even):
        count = max(round(len(e.position) * e.step / PIECE), 1)
        edges = np.linspace(0, len(e.position), count + 1).astype(int)
        cuts += [(k, slice(low, high)) for low, high in pairwise(edges.tolist())]
    cuts = [cuts[i] for i in np.unique(np.linspace(0, len(cuts) - 1, min(len(cuts), PIECES)).astype(int))]
    every = max(int(sum(part.stop - part.start for _, part in cuts) / ROWS), 1)
    return [piece for k, part in cuts if (piece := _piece(log, k, even[k], part, every)) is not None]


def _piece(log: Log, motion: int, e: Uniform, part: slice, every: int) -> _Piece | None:
    """One piece; None if it is too short for its filter."""
    edge, q, v = round(EDGE / e.step), e.position[part], e.velocity[part]
    high = min(BAND, 0.4 / e.step)
    if len(q) < 4 * edge + LEAST:
        return None
    assert e.torque is not None
    a = np.gradient(v, e.step, axis=0)
    bodies = regressor(log.mechanism, q, v, a, log.gravity)
    carries = log.motions[motion].loaded
    way = np.tanh(v / REVERSAL)
    of_joint = [a, way, way * np.sqrt(np.abs(v)), v, v * np.abs(v), np.abs(v), np.ones_like(v)]
    parts = [bodies.reshape(*v.shape, -1), carries * bodies[:, :, -1], np.stack(of_joint, axis=2)]
    low = butter(2, high, fs=1 / e.step, output="sos")
    drivers = sosfiltfilt(low, np.concatenate(parts, axis=2), axis=0)
    rows = np.arange(edge, len(q) - edge, every)
    speed = speeds(e.step * np.arange(len(q)), q)
    turns = np.diff(np.sign(speed), axis=0, prepend=0.0) != 0.0
    since = np.maximum.accumulate(np.where(turns, np.arange(len(q))[:, None], 0), axis=0)
    beyond = (np.abs(speed) > SLIDING[0]) & (np.abs(q - np.take_along_axis(q, since, axis=0)) > SLIDING[1])
    slides = minimum_filter1d(beyond, 2 * round(SLIDING[2] / e.step) + 1, axis=0, mode="nearest")
    return _Piece(
        float(log.motions[motion].time[0] + e.step * (part.start + part.stop) / 2),
        e.step,
        drivers[rows],
        np.gradient(drivers, e.step, axis=0)[rows],
        sosfiltfilt(low, e.torque[part], axis=0),
        rows,
        slides[rows],
    )


def _delay(pieces: Sequence[_Piece], j: int, *, slides: bool) -> Delays:
    """Delay of the torque of joint `j`, from all rows, or from those in which it slides.

    Gauss-Newton on the delay, with the coefficients by least squares; then the delay of each piece, with the
    coefficients of all. Its u is by the scatter of the pieces, by Student's distribution.
    """
    kept = [p.slides[:, j] if slides else np.ones(len(p.rows), bool) for p in pieces]
    x = np.concatenate([p.drivers[keep, j] for p, keep in zip(pieces, kept, strict=True)])
    time = np.array([p.time for p in pieces])
    if len(x) < LEAST:
        return Delays(np.nan, np.nan, np.array([time, 0.0 * time, 0.0 * time]))
    rates = np.concatenate([p.rates[keep, j] for p, keep in zip(pieces, kept, strict=True)])
    which = np.repeat(np.arange(len(pieces)), [keep.sum() for keep in kept])
    scale = np.sqrt(np.mean(x**2, axis=0))
    scale[scale == 0.0] = 1.0
    x, rates = x / scale, rates / scale
    inverse = np.linalg.inv(x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]))

    def residual(y: np.ndarray) -> np.ndarray:
        return y - x @ (inverse @ (x.T @ y))

    late, y, slope = 0.0, np.empty(0), np.empty(0)
    for _ in range(STEPS):
        y = np.concatenate([_at(p, j, late)[keep] for p, keep in zip(pieces, kept, strict=True)])
        slope = -rates @ (inverse @ (x.T @ y))
        one = residual(slope)
        late += float(np.clip(one @ y / max(one @ one, 1e-300), -FARTHEST, FARTHEST))
    y = residual(np.concatenate([_at(p, j, late)[keep] for p, keep in zip(pieces, kept, strict=True)]))
    each = residual(slope[:, None] * (which[:, None] == np.arange(len(pieces))))
    square, noise = each.T @ each, float(np.mean(y**2))
    values = late + np.linalg.pinv(square, rcond=RIDGE, hermitian=True) @ (each.T @ y)
    weight = np.diag(square) / max(noise, 1e-300)
    value, u = mean(values, weight)
    return Delays(value, float(np.hypot(u, SYSTEMATIC)), np.array([time, values, weight]))


def _at(p: _Piece, j: int, late: float) -> np.ndarray:
    """Torque of a joint at later times than those of the rows, (M,)."""
    grid = p.step * np.arange(len(p.torque))
    return np.interp(grid[p.rows] + late, grid, p.torque[:, j])


def mean(values: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """Mean of values (P,) with weights, and its u by their scatter; nan of fewer than two.

    Of few values u is that of Student's distribution (JCGM 101:2008, 6.4.9.4), with as many degrees of
    freedom as values of one weight would have.
    """
    total, square = float(np.sum(weight)), float(np.sum(weight**2))
    count = total**2 / square if square else 0.0
    free = count - 1.0
    if free < FREE[0]:
        return np.nan, np.nan
    value = float(weight @ values / total)
    scatter = float(weight @ (values - value) ** 2) / total / free
    return value, float(np.sqrt(scatter * free / max(free - 2.0, FREE[1] * free)))
