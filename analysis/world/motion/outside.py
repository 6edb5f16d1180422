"""Causes not in the list, in the mechanics: the correct answer is 'unknown', with a location."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from analysis.world.motion.effects import of_joint, place, scaled
from analysis.world.motion.log import Act, Log


def _joint(rng: np.random.Generator, log: Log) -> int:
    return int(rng.integers(log.arm.size))


def _all(log: Log, j: int) -> float:
    """Return the most that a torque at a joint may be."""
    return 0.6 * float(log.arm.rated[j])


def cable_spring(rng: np.random.Generator, log: Log) -> Act:
    """A cable that is taut beyond an angle, and stiffens."""
    j = _joint(rng, log)
    q = log.session.q[:, j] * rng.choice([-1, 1])
    taut = np.quantile(q, rng.uniform(0.5, 0.8))
    shape = np.maximum(0, q - taut) ** rng.uniform(1, 2)
    return of_joint(log, j, "cable-spring", "joint angle, beyond one", "N m", 50 * _all(log, j), shape)


def hard_spot(rng: np.random.Generator, log: Log) -> Act:
    """A place of the gear where it turns hard, whichever way."""
    j = _joint(rng, log)
    q, dq = log.session.q[:, j], log.session.dq[:, j]
    at, wide = np.quantile(q, rng.uniform(0.15, 0.85)), rng.uniform(0.03, 0.12)
    shape = np.exp(-(((q - at) / wide) ** 2)) * np.tanh(dq / log.arm.transition)
    return of_joint(log, j, "hard-spot", "joint angle, one place", "N m", _all(log, j), shape, at_rad=at)


def slips(rng: np.random.Generator, log: Log) -> Act:
    """Slips: the torque falls at once and comes back within a second, several times."""
    j, s = _joint(rng, log), log.session
    hit = np.sort(rng.choice(len(s.time), int(rng.integers(4, 12)), replace=False))
    shape = np.zeros(len(s.time))
    for k in hit:
        run = next(r for r in s.runs if r.start <= k < r.stop)
        after = slice(k, run.stop)
        shape[after] += np.exp(-(s.time[after] - s.time[k]) / rng.uniform(0.1, 0.5))
    return of_joint(log, j, "slips", "time, several events", "N m", _all(log, j), -shape)


def stand_resonance(rng: np.random.Generator, log: Log) -> Act:
    """A stand that sways at its resonance as the first joints accelerate."""
    s = log.session
    hertz, damping = rng.uniform(2.5, 9.0), rng.uniform(0.03, 0.1)
    w = 2 * np.pi * hertz
    ring = np.exp(-damping * w * s.step) * np.cos(w * np.sqrt(1 - damping**2) * s.step)
    bottom = [1, -2 * ring, np.exp(-2 * damping * w * s.step)]
    out = np.zeros_like(log.torque)
    for run in s.runs:
        sway = lfilter([w * s.step], bottom, s.ddq[run, 0] + 0.5 * s.ddq[run, 1])
        out[run, 0], out[run, 1] = sway, rng.choice([0.6, 0.9]) * sway
    where = place("base", "resonance", "stand-resonance")
    return scaled("stand-resonance", "", where, "N m s2/rad", 1e3, out, log, hertz=hertz, damping=damping)


def presliding(rng: np.random.Generator, log: Log) -> Act:
    """Friction with memory (Dahl): it follows the displacement since the last reversal."""
    j, s = _joint(rng, log), log.session
    dq, wide, state = s.dq[:, j], rng.uniform(0.01, 0.06), 0.0
    out = np.empty(len(dq))
    starts = {run.start for run in s.runs}
    for k, v in enumerate(dq):
        state = 0.0 if k in starts else state
        state = float(np.clip(state + s.step * v / wide * (1 - np.sign(v) * state), -1, 1))
        out[k] = state
    shape = out - np.tanh(dq / log.arm.transition)
    return of_joint(log, j, "presliding", "displacement since the reversal", "N m", 3 * log.arm.coulomb[j],
                    shape, wide_rad=wide)  # fmt: skip


def cross_friction(rng: np.random.Generator, log: Log) -> Act:
    """Friction of a joint that depends on the angle of another: a hose in the hollow wrist."""
    i, j = rng.permutation(log.arm.size)[:2]
    angle, dq = log.session.q[:, i], log.session.dq[:, j]
    shape = np.tanh(dq / log.arm.transition) * (angle - angle.mean())
    return of_joint(log, j, "cross-friction", f"angle of joint {i + 1} times direction", "N m/rad",
                    _all(log, j), shape, by=int(i + 1))  # fmt: skip


def position_friction(rng: np.random.Generator, log: Log) -> Act:
    """Friction that varies with the angle, slowly: a bent shaft, a worn range."""
    j = _joint(rng, log)
    q, dq, phase = log.session.q[:, j], log.session.dq[:, j], rng.uniform(0, 6.28)
    shape = np.tanh(dq / log.arm.transition) * np.sin(rng.uniform(1, 5) * q + phase)
    return of_joint(
        log, j, "position-friction", "joint angle times direction", "N m", 2 * log.arm.coulomb[j], shape
    )


def hose(rng: np.random.Generator, log: Log) -> Act:
    """A hose on the tool that pulls towards a fixed place: joints 4 and up feel it, by their angles."""
    s, n = log.session, log.arm.size
    out = np.zeros_like(log.torque)
    at = log.arm.home + rng.uniform(-0.6, 0.6, n) * log.arm.span
    far = np.sqrt(0.05 + np.sum((s.q - at)[:, n - 3 :] ** 2, axis=1))
    weight = rng.uniform(0.3, 1, n) * (np.arange(n) >= n - 4)
    for j in range(n):
        out[:, j] = weight[j] * np.sin(s.q[:, j] - at[j]) * np.maximum(0, far - 0.3) / far
    where = place("tool", "place of the tool", "hose")
    return scaled("hose", "", where, "N m", 40.0, out, log)


def switching(rng: np.random.Generator, log: Log) -> Act:
    """A controller that switches a compensation on and off by the speed, with a hysteresis."""
    j, s = _joint(rng, log), log.session
    speed = np.abs(s.dq[:, j])
    on, off = np.quantile(speed, [rng.uniform(0.55, 0.8), rng.uniform(0.25, 0.5)])
    out, state = np.zeros(len(speed)), 0.0
    for k, v in enumerate(speed):
        state = 1.0 if v > on else 0.0 if v < off else state
        out[k] = state
    return of_joint(log, j, "switching", "speed, with a hysteresis", "N m", _all(log, j), out)


def load_cogging(rng: np.random.Generator, log: Log) -> Act:
    """Cogging that grows with the torque."""
    j = _joint(rng, log)
    q, load = log.session.q[:, j], log.torque[:, j]
    waves, phase = float(rng.choice([log.arm.gear[j] / 2, rng.integers(12, 40)])), rng.uniform(0, 6.28)
    shape = load * np.sin(waves * q + phase)
    return of_joint(log, j, "load-cogging", "torque times motor angle", "1", 1.0, shape, waves=waves)


def thermal_offset(rng: np.random.Generator, log: Log) -> Act:
    """An offset that follows the energy of the motions of the last minute: an amplifier that warms."""
    j, s = _joint(rng, log), log.session
    tau, out, state, last = rng.uniform(10, 60), np.empty(len(s.time)), 0.0, s.time[0]
    power = log.torque[:, j] ** 2
    for k, (t, p) in enumerate(zip(s.time, power, strict=True)):
        keep = np.exp(-(t - last) / tau)
        state, last = keep * state + (1 - keep) * (p if t - last < 2 * s.step else 0.0), t
        out[k] = state
    return of_joint(log, j, "thermal-offset", "energy of the motions", "N m", _all(log, j),
                    out / max(out.max(), 1e-12), tau_s=tau)  # fmt: skip


MECHANICS = (
    cable_spring, hard_spot, slips, stand_resonance, presliding, cross_friction, position_friction, hose,
    switching, load_cogging, thermal_offset,
)  # fmt: skip
"""Causes of the development set in the mechanics."""
