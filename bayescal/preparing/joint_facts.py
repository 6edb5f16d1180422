"""Facts of a joint log: stamps, and of each joint what moves, what is delayed and what is filtered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.logs import Log, Motion
from bayescal.motion.dynamics import regressor
from bayescal.preparing import signals

SLOW = (0.01, 0.05)
"""rad/s: speeds below the second show how friction depends on speed; below the first a joint is at rest."""
LOADS = 0.1
"""Of the largest torque of gravity of a joint: standard deviation over the poses that counts as two poses."""
SHARE = 0.01
"""Of the largest torque of gravity of any joint: what makes a joint one that gravity loads."""
MOST = 0.2
"""Of the largest change of gravity's torque of any joint: it tells unit and sign of a torque, whatever masses
and payload are (assumed)."""
POSES = 1000
"""At which torques of gravity are computed."""
GAP, JITTER = 3.0, 0.05
"""Times the median step; relative standard deviation of steps."""

SYSTEMATIC = 0.6e-3
"""s: u of the delay of a torque for what its drivers lack. With it, deviations of joints are one u (RMS) in
eight simulated logs of another author whose delays are known."""


@dataclass(frozen=True)
class Joint:
    """Facts of a joint, SI; delays and their u are (2,) s, nan where they do not follow."""

    name: str
    lowest: float
    highest: float
    fastest: float
    rest: float  # fraction of rows
    slow: float  # s at `SLOW` speeds
    gravity: tuple[float, float]  # N m, mean and standard deviation over the poses
    torque_gain: float  # measured torque over that of the nominal masses; nan if gravity changes little
    torque_delays: np.ndarray  # (M,), of torque behind what accelerations and friction predict, by motion
    torque_delay: tuple[float, float]  # of all motions
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
    even = [signals.uniform(m) for m in log.motions]
    velocity = [signals.speeds(m.time, m.position) for m in log.motions]
    steps = [np.gradient(m.time) for m in log.motions]
    position = np.concatenate([m.position for m in log.motions])
    gravity = gravity_torques(log, position[:: max(len(position) // POSES, 1)])
    change = np.where(gravity.std(axis=0) > LOADS * abs(gravity.mean(axis=0)), gravity.std(axis=0), 0.0)
    gains = _torque_gains(log, even, change > MOST * change.max())
    torques = [m.torque for m in log.motions if m.torque is not None]
    raw = float(np.median(np.concatenate([np.diff(m.time) for m in log.motions])))
    nothing = (np.nan, np.nan)
    out = []
    for j, name in enumerate(log.mechanism.joint_names):
        speed = np.abs(np.concatenate([v[:, j] for v in velocity]))
        slow = (speed > SLOW[0]) & (speed < SLOW[1])
        derived = [np.gradient(e.position[:, j], e.step) for e in even]
        both = zip(derived, even, strict=True)
        pairs = [(d, e.measured[:, j], e.step) for d, e in both if e.measured is not None]
        commands = [(e.command[:, j], e.position[:, j], e.step) for e in even if e.command is not None]
        moves = bool((speed > SLOW[0]).any())
        transfer = [pair for p in pairs if moves and np.isfinite((pair := signals.cutoff(*p))[0])]
        low, high = (float(x) for x in np.median(transfer, axis=0)) if transfer else nothing
        late = [
            signals.delay(signals.torque_drivers(e, j), e.torque[:, j], e.step, signals.BAND)
            if moves and e.torque is not None
            else np.nan
            for e in even
        ]
        value, u = signals.middle(late)
        errors = [c - p for c, p, _ in commands]
        out.append(
            Joint(
                name=name,
                lowest=float(position[:, j].min()),
                highest=float(position[:, j].max()),
                fastest=float(speed.max()),
                rest=float(np.mean(speed <= SLOW[0])),
                slow=float(np.concatenate(steps)[slow].sum()),
                gravity=(float(gravity[:, j].mean()), float(gravity[:, j].std())),
                torque_gain=float(gains[j]),
                torque_delays=np.array(late),
                torque_delay=(value, float(np.hypot(u, SYSTEMATIC))),
                velocity_delay=_delay(pairs) if moves else nothing,
                velocity_cutoff=high,
                velocity_gain=low,
                command_delay=_delay(commands) if moves else nothing,
                command_error=float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else np.nan,
                torque_band=signals.filtered([t[:, j] for t in torques], raw) if torques else np.inf,
                clipped=signals.clipped(np.concatenate([t[:, j] for t in torques])) if torques else np.nan,
                held=_held(log.motions, velocity, j),
            )
        )
    return tuple(out)


def gravity_torques(log: Log, position: np.ndarray) -> np.ndarray:
    """Torques (N, n), N m, by which gravity loads the joints of the nominal arm at readings (N, n)."""
    still = np.zeros_like(position)
    parts = regressor(log.mechanism, position, still, still, log.gravity)
    return np.asarray(np.einsum("cjkp,kp->cj", parts, log.mechanism.inertials))


def _torque_gains(log: Log, even: Sequence[signals.Uniform], joints: np.ndarray) -> np.ndarray:
    """Measured torques over those of the nominal masses, of some joints, beside friction and offset; (n,)."""
    out = np.full(log.n, np.nan)
    if log.motions[0].torque is None or not joints.any():
        return out
    every = max(sum(len(e.position) for e in even) // POSES, 1)
    moved = [(e.position, e.velocity, np.gradient(e.velocity, e.step, axis=0), e.torque) for e in even]
    q, v, a, torque = (np.concatenate(x)[::every] for x in zip(*moved, strict=True))
    parts = regressor(log.mechanism, q, v, a, log.gravity)
    nominal = np.einsum("cjkp,kp->cj", parts, log.mechanism.inertials)
    for j in np.flatnonzero(joints):
        speed = v[:, j]
        drivers = np.column_stack([nominal[:, j], np.tanh(speed / SLOW[1]), speed, np.ones(len(speed))])
        out[j] = np.linalg.lstsq(drivers, torque[:, j], rcond=None)[0][0]
    return out


def _delay(pairs: Sequence[tuple[np.ndarray, np.ndarray, float]]) -> tuple[float, float]:
    """Delay of the signals (N,) of all motions behind their drivers (N,), and its u by their scatter."""
    each = [signals.delay(driver[:, None], signal, step, signals.WIDE) for driver, signal, step in pairs]
    return signals.middle(each)


def clock_drift(log: Log, joints: Sequence[Joint]) -> tuple[float, float]:
    """Change of the delay of torques with time, s/s, and its u; nan with fewer than four motions.

    By least squares on the medians over the joints of each motion, without the delay of each joint.
    """
    late = np.array([j.torque_delays for j in joints if np.isfinite(j.torque_delays).all()])
    if len(late) == 0 or late.shape[1] < 4:
        return np.nan, np.nan
    values = np.median(late - np.median(late, axis=1, keepdims=True), axis=0)
    time = np.array([m.time.mean() for m in log.motions])
    time -= time.mean()
    slope = float(time @ values / (time @ time))
    rest = values - values.mean() - slope * time
    return slope, float(np.sqrt(rest @ rest / (len(time) - 2) / (time @ time)))


def _held(motions: Sequence[Motion], velocity: Sequence[np.ndarray], j: int) -> float:
    fast = [np.abs(v[:, j]) > max(0.3 * np.abs(v[:, j]).max(), SLOW[1]) for v in velocity]
    values = [signals.held(m.position[:, j], go) for m, go in zip(motions, fast, strict=True)]
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


def gravity_loaded(joints: Sequence[Joint]) -> list[Joint]:
    """Joints that gravity loads."""
    most = max(abs(j.gravity[0]) + j.gravity[1] for j in joints)
    return [j for j in joints if abs(j.gravity[0]) + j.gravity[1] > SHARE * most]


def warm_up(log: Log) -> float:
    """Range of the temperature, K; nan without one."""
    values = [m.temperature for m in log.motions if m.temperature is not None]
    return float(np.ptp(np.concatenate(values))) if values else np.nan
