"""Causes not in the list that are reserved: no constant may be chosen on them."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from analysis.world.motion.effects import of_joint, place, scaled
from analysis.world.motion.log import Act, Log
from analysis.world.motion.outside import _all, _joint


def spalled_bearing(rng: np.random.Generator, log: Log) -> Act:
    """A spalled bearing: short knocks once per turn of the motor, of random strength."""
    j = _joint(rng, log)
    turn = log.session.q[:, j] * log.arm.gear[j] / rng.uniform(2.5, 4.5) / (2 * np.pi)
    count = np.floor(turn).astype(int)
    strength = rng.exponential(1.0, np.ptp(count) + 1)[count - count.min()]
    shape = strength * np.exp(-((((turn - count) - 0.5) / 0.09) ** 2)) * np.tanh(log.session.dq[:, j] / 0.05)
    return of_joint(log, j, "spalled-bearing", "motor angle, knocks", "N m", _all(log, j), shape)


def sensor_hysteresis(rng: np.random.Generator, log: Log) -> Act:
    """A torque sensor with hysteresis: it reads less on the way up than on the way down."""
    j = _joint(rng, log)
    tau = log.torque[:, j]
    play = rng.uniform(0.05, 0.25) * np.std(tau)
    out, state = np.empty(len(tau)), tau[0]
    for k, value in enumerate(tau):
        state = min(max(state, value - play), value + play)
        out[k] = state
    return of_joint(log, j, "sensor-hysteresis", "direction of the change of torque", "1", 5.0, out - tau)


def stiff_grease(rng: np.random.Generator, log: Log) -> Act:
    """Grease that sets in a pause: more friction in the first seconds of each motion."""
    j, s = _joint(rng, log), log.session
    gone = np.concatenate([np.cumsum(np.abs(s.dq[r, j])) * s.step for r in s.runs])
    shape = np.tanh(s.dq[:, j] / log.arm.transition) * np.exp(-gone / rng.uniform(0.3, 1.5))
    return of_joint(
        log, j, "stiff-grease", "way since the pause times direction", "N m", 3 * log.arm.coulomb[j], shape
    )


def sloshing(rng: np.random.Generator, log: Log) -> Act:
    """A liquid in the tool that sloshes: a weakly damped oscillator driven by the wrist."""
    s, n = log.session, log.arm.size
    w, damping = 2 * np.pi * rng.uniform(0.8, 2.2), rng.uniform(0.02, 0.08)
    keep = np.exp(-damping * w * s.step)
    bottom = [1, -2 * keep * np.cos(w * s.step), keep**2]
    out = np.zeros_like(log.torque)
    pull = np.sin(s.q[:, n - 2]) + 0.1 * s.ddq[:, 1] + 0.1 * s.ddq[:, n - 2]
    for run in s.runs:
        wave = lfilter([(w * s.step) ** 2], bottom, pull[run] - pull[run.start]) - (
            pull[run] - pull[run.start]
        )
        out[run, n - 2], out[run, n - 3], out[run, 1] = wave, 0.7 * wave, 1.5 * wave
    where = place("tool", "resonance", "sloshing")
    return scaled("sloshing", "", where, "N m", 60.0, out, log, hertz=w / (2 * np.pi))


def dragging_brake(rng: np.random.Generator, log: Log) -> Act:
    """A brake that drags in some motions."""
    j, s = _joint(rng, log), log.session
    hit = rng.permutation(len(s.runs)) < max(2, len(s.runs) // 3)
    on = np.repeat(hit, [r.stop - r.start for r in s.runs])
    shape = np.tanh(s.dq[:, j] / log.arm.transition) * on
    return of_joint(
        log, j, "dragging-brake", "direction, in some motions", "N m", 3 * log.arm.coulomb[j], shape
    )


def supply_sag(rng: np.random.Generator, log: Log) -> Act:
    """A supply that sags: all currents read too low while the arm takes much power."""
    s, tau = log.session, rng.uniform(0.05, 0.3)
    power = np.maximum(0, np.sum(log.torque * s.dq, axis=1))
    keep = np.exp(-s.step / tau)
    late = np.concatenate([lfilter([1 - keep], [1, -keep], power[run]) for run in s.runs])
    where = place("log", "power of the arm times torque", "supply-sag")
    return scaled(
        "supply-sag", "", where, "1", 1.0, -log.torque * (late / late.max())[:, None], log, tau_s=tau
    )


def belt_wave(rng: np.random.Generator, log: Log) -> Act:
    """A belt with a thick place: a wave of the angle whose phase creeps, for the belt slips on its pulley."""
    j, s = _joint(rng, log), log.session
    waves, creep = rng.uniform(5, 15), rng.uniform(0.02, 0.1)
    slip = np.cumsum(np.abs(s.dq[:, j])) * s.step * creep * waves
    shape = np.abs(np.sin(waves * s.q[:, j] / 2 + slip / 2)) ** 3
    return of_joint(log, j, "belt-wave", "angle, with a phase that creeps", "N m", _all(log, j), shape)


FURTHER = (spalled_bearing, sensor_hysteresis, stiff_grease, sloshing, dragging_brake, supply_sag, belt_wave)
"""Reserved causes."""
