"""Causes not in the list, in the measurement: clocks, converters, sensors."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from analysis.world.motion.effects import alone, of_joint, place
from analysis.world.motion.log import Act, Change, Log
from analysis.world.motion.outside import _all, _joint


def clock_drift(rng: np.random.Generator, log: Log) -> Act:
    """A clock of the torques that runs fast: their delay grows with time."""
    s = log.session
    since = s.time - s.time.mean()
    sign = rng.choice([-1, 1])

    def apply(size: float) -> Change:
        return Change(log.at(sign * size * since) - log.torque)

    return Act(
        "clock-drift", "", place("log", "rate of torque times time", "clock-drift"), "1", 1e-5, 2e-3, apply
    )


def stamp_jitter(rng: np.random.Generator, log: Log) -> Act:
    """Torques whose stamps jitter, with bursts of late ones."""
    s = log.session
    late = np.abs(rng.standard_normal(len(s.time)))
    burst = lfilter([1.0], [1.0, -0.9], rng.random(len(late)) < 0.01)
    late = np.minimum(late + 3 * burst, 8)

    def apply(size: float) -> Change:
        return Change(log.at(size * late) - log.torque)

    return Act(
        "stamp-jitter", "", place("log", "rate of torque, at random", "stamp-jitter"), "s", 2e-3, 0.05, apply
    )


def saturation(rng: np.random.Generator, log: Log) -> Act:
    """A torque that is cut at a limit."""
    j = _joint(rng, log)
    tau = log.torque[:, j]
    top = np.abs(tau).max()

    def apply(size: float) -> Change:
        limit = top * (1 - size)
        return Change(alone(log, j, np.clip(tau, -limit, limit) - tau))

    where = place(f"joint {j + 1}", "torque beyond a limit", "saturation")
    return Act("saturation", "", where, "1", 0.05, 0.9, apply, {"joint": j + 1})


def pause_offset(rng: np.random.Generator, log: Log) -> Act:
    """A sensor whose zero is another after each pause, in some motions."""
    j, s = _joint(rng, log), log.session
    out = np.zeros(len(s.time))
    for run in s.runs:
        if rng.random() < 0.6:
            out[run] = rng.standard_normal() * np.exp(-s.since[run] / rng.choice([3.0, 1e3]))
    return of_joint(log, j, "pause-offset", "motion", "N m", _all(log, j), out)


def quantised(rng: np.random.Generator, log: Log) -> Act:
    """A current that is measured in coarse steps."""
    j = _joint(rng, log)
    tau = log.torque[:, j]

    def apply(size: float) -> Change:
        return Change(alone(log, j, size * np.round(tau / size) - tau if size else 0 * tau))

    where = place(f"joint {j + 1}", "torque, in steps", "quantised-current")
    start = float(log.noise.rms[j])
    return Act(
        "quantised-current", "", where, "N m", start, 2 * float(log.arm.rated[j]), apply, {"joint": j + 1}
    )


def cross_talk(rng: np.random.Generator, log: Log) -> Act:
    """A torque sensor that also feels the torque of another joint."""
    i, j = rng.permutation(log.arm.size)[:2]
    return of_joint(
        log, j, "cross-talk", f"torque of joint {i + 1}", "1", 0.9, log.torque[:, i], by=int(i + 1)
    )


MEASUREMENT = (clock_drift, stamp_jitter, saturation, pause_offset, quantised, cross_talk)
"""Causes of the development set in the measurement."""
