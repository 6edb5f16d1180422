"""Further causes not in the list, drawn by `--causes third`: no constant may be chosen on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import iirpeak, lfilter

from analysis.world.motion.dynamics import PARTS, _motion, _wrench, regressor
from analysis.world.motion.effects import alone, direction, of_joint, place, scaled
from analysis.world.motion.log import GRAVITY, Act, Change, Log
from analysis.world.motion.outside import _all, _joint

NEEDS: dict[str, dict] = {"eccentric-encoder": {"link": (True,)}}
"""As `mix.NEEDS`."""
FINER = 8
"""Steps in a row of the log, for what is faster than its rate."""


def moments(log: Log) -> list[np.ndarray]:
    """Return the moment (rows, 3) of links and payload about the base, and about each joint in its link."""
    s, arm = log.session, log.arm
    moved = _motion(arm.chain, s.q, s.dq, s.ddq, log.gravity)
    bodies = [np.broadcast_to(p, (len(s.q), PARTS)) for p in arm.parameters.reshape(-1, PARTS)]
    bodies[-1] = bodies[-1] + s.payload[:, None] * arm.payload(1.0)
    force, moment, out = np.zeros((len(s.q), 3)), np.zeros((len(s.q), 3)), []
    for j in range(arm.size - 1, -1, -1):
        parts = [np.einsum("nik,nk->ni", w, bodies[j]) for w in _wrench(*moved[j][1:])]
        out.append(moment + parts[1])
        force, moment = (
            np.einsum("nij,nj->ni", moved[j][0], v) for v in (force + parts[0], moment + parts[1])
        )
        moment = moment + np.cross(arm.chain.origin[j], force)
    return [moment, *out[::-1]]


def held(values: np.ndarray, band: float) -> np.ndarray:
    """Return the sign of values (rows,), which stays until they are beyond a band on the other side."""
    last = np.maximum.accumulate(np.where(np.abs(values) > band, np.arange(len(values)), 0))
    return np.sign(values[last])


def _crossing(rng: np.random.Generator, log: Log, torque: np.ndarray) -> int:
    """Draw a joint by how often a torque (rows, n) changes its sign there."""
    bands = 0.02 * log.arm.rated
    count = [np.count_nonzero(np.diff(held(torque[:, j], bands[j]))) for j in range(log.arm.size)]
    share = np.array(count) + 1e-9
    return int(rng.choice(log.arm.size, p=share / share.sum()))


def gas_spring(rng: np.random.Generator, log: Log) -> Act:
    """A gas spring between two pivots: its lever and pressure follow the angle, its seal rubs."""
    j = int(rng.choice([1, 2], p=[0.7, 0.3]))
    q, dq = log.session.q[:, j], log.session.dq[:, j]
    dead = np.median(q) + rng.choice([-1, 1]) * rng.uniform(0.3, 1.2)  # where both pivots are in line
    pivot = rng.uniform(0.35, 0.8)
    length = np.sqrt(1 + pivot**2 - 2 * pivot * np.cos(q - dead))
    stroke = (length.max() - length) / (2 * pivot)
    seal = rng.uniform(0.03, 0.15)
    lever, force = np.sin(q - dead) * pivot / length, 1 / (1 - rng.uniform(0.3, 0.6) * stroke)
    shape = force * (seal * np.abs(lever) * np.tanh(dq / log.arm.transition) - lever)
    return of_joint(log, j, "gas-spring", "joint angle, by a lever", "N m", 2 * _all(log, j), shape,
                    dead_centre_rad=dead, pivot=pivot, seal=seal)  # fmt: skip


def loose_bolts(rng: np.random.Generator, log: Log) -> Act:
    """Bolts of a link that are loose: it knocks and rings whenever its torque changes sign."""
    j, s = _crossing(rng, log, log.rigid), log.session
    side = held(log.rigid[:, j], rng.uniform(0.005, 0.02) * log.arm.rated[j])
    knock = np.diff(side, prepend=side[0]) / 2 * rng.uniform(0.6, 1.4, len(side))
    hertz, decay = min(rng.uniform(8, 22), s.rate / 6), rng.uniform(0.05, 0.2)
    keep, turn = np.exp(-s.step / decay), 2 * np.pi * hertz * s.step
    bottom = [1, -2 * keep * np.cos(turn), keep**2]
    shape = np.concatenate([lfilter([0, keep * np.sin(turn)], bottom, knock[run]) for run in s.runs])
    return of_joint(log, j, "loose-bolts", "change of sign of the torque, ringing", "N m", 2 * _all(log, j),
                    shape, hertz=hertz, decay_s=decay)  # fmt: skip


def sliding_load(rng: np.random.Generator, log: Log) -> Act:
    """A loose part in the tool: it slides to the one or the other end of its slot, as this is inclined."""
    s = log.session
    felt = -_motion(log.arm.chain, s.q, s.dq, s.ddq, log.gravity)[-1][3]  # (rows, 3), m/s2
    slots, stick = [direction(rng) for _ in range(6)], rng.uniform(0.1, 0.3) * 9.81
    ends = [held(felt @ slot, stick) for slot in slots]
    best = int(np.argmax([np.count_nonzero(np.diff(end)) for end in ends]))
    keep = np.exp(-s.step / rng.uniform(0.02, 0.08))
    end = lfilter([1 - keep], [1, -keep], ends[best], zi=[keep * ends[best][0]])[0]
    half = slots[best] * rng.uniform(0.02, 0.06)
    body = log.arm.payload(1.0, half) - log.arm.payload(1.0, -half)
    shape = log.of_load(body / 2) * end[:, None]
    where = place("tool", "inclination of the tool, two places of a mass", "sliding-load")
    return scaled("sliding-load", "", where, "kg", 3 * log.arm.load, shape, log, half_slot_m=half)


def gear_resonance(rng: np.random.Generator, log: Log) -> Act:
    """A harmonic drive whose two waves per motor turn excite its torsion: a torque in a band of speeds."""
    j, s = _joint(rng, log), log.session
    waves, phase = 2 * log.arm.gear[j], rng.uniform(0, 2 * np.pi)
    hertz, quality = min(rng.uniform(6, 16), s.rate / 6), rng.uniform(3, 9)
    top, bottom = iirpeak(hertz, quality, fs=FINER * s.rate)
    parts = []
    for run in s.runs:
        rows = np.arange(run.stop - run.start)
        fine = np.arange(FINER * (len(rows) - 1) + 1) / FINER
        wave = np.sin(waves * CubicSpline(rows, s.q[run, j])(fine) + phase)
        parts.append(lfilter(top, bottom, wave - wave[0])[::FINER])
    return of_joint(log, j, "gear-resonance", "motor angle, at a resonance", "N m", _all(log, j),
                    np.concatenate(parts), hertz=hertz, quality=quality)  # fmt: skip


def dead_time(rng: np.random.Generator, log: Log) -> Act:
    """An inverter whose dead time is not compensated: a step where the current changes sign."""
    j = _crossing(rng, log, log.torque)
    knee = rng.uniform(0.01, 0.04) * log.arm.rated[j]
    act = of_joint(log, j, "dead-time", "sign of the torque", "N m", 0.5 * _all(log, j),
                   np.tanh(log.torque[:, j] / knee), knee_Nm=knee)  # fmt: skip
    return replace(act, sensed=True)


def tilted_bearing(rng: np.random.Generator, log: Log) -> Act:
    """A bearing that rubs by the moment across its axis, not by the torque of its joint."""
    j = _joint(rng, log)
    across = np.linalg.norm(moments(log)[j + 1][:, :2], axis=1)
    shape = across / np.sqrt(np.mean(across**2)) * np.tanh(log.session.dq[:, j] / log.arm.transition)
    return of_joint(log, j, "tilted-bearing", "moment across the axis times direction", "N m",
                    4 * log.arm.coulomb[j], shape)  # fmt: skip


def soft_floor(rng: np.random.Generator, log: Log) -> Act:
    """Soft ground: the base leans by the moment of the arm, not alike about both axes."""
    s, arm = log.session, log.arm
    bearing, ratio = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.0)
    turn = np.array([[np.cos(bearing), -np.sin(bearing)], [np.sin(bearing), np.cos(bearing)]])
    lean = -(moments(log)[0][:, :2] @ turn * [1.0, ratio]) @ turn.T
    lean = lean - lean.mean(axis=0)  # it was levelled with the arm on it
    lean /= np.linalg.norm(lean, axis=1).max()
    pull = np.cross(GRAVITY, np.column_stack([lean, np.zeros(len(lean))]))  # of gravity, by rad (rows, 3)
    rest, shape = np.zeros_like(s.q), np.zeros_like(s.q)
    for k in (0, 1):
        columns = regressor(arm.chain, s.q, rest, rest, np.eye(3)[k])
        side = columns @ arm.parameters + columns[:, :, -PARTS:] @ arm.payload(1.0) * s.payload[:, None]
        shape += side * pull[:, k : k + 1]
    where = place("base", "moment on the base", "soft-floor")
    return scaled("soft-floor", "", where, "rad at the largest moment", 0.1, shape, log,
                  bearing_rad=bearing, ratio=ratio)  # fmt: skip


def nested_shafts(rng: np.random.Generator, log: Log) -> Act:
    """Shafts of a hollow wrist that rub on each other: friction by the difference of two speeds."""
    i = int(rng.integers(log.arm.size - 2, log.arm.size))
    j, ratio = i - 1, float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.5))
    dq = log.session.dq
    rub = np.tanh((dq[:, i] - ratio * dq[:, j]) / log.arm.transition)
    shape = alone(log, i, rub) + alone(log, j, -ratio * rub)
    where = [
        w
        for a, b in ((i, j), (j, i))
        for w in place(f"joint {a + 1}", f"speed against joint {b + 1}", "nested-shafts")
    ]
    return scaled("nested-shafts", "", where, "N m", 3 * log.arm.coulomb[i], shape, log,
                  joint=i + 1, by=j + 1, ratio=ratio)  # fmt: skip


def eccentric_encoder(rng: np.random.Generator, log: Log) -> Act:
    """A second encoder whose ring is eccentric, oval, or badly interpolated: a wave of the angle."""
    j = _joint(rng, log)
    waves, phase = int(rng.choice([1, 2, rng.integers(16, 65)])), rng.uniform(0, 2 * np.pi)
    shape, none = alone(log, j, np.sin(waves * log.session.q[:, j] + phase)), np.zeros_like(log.torque)

    def apply(size: float) -> Change:
        return Change(none, link=size * shape)

    where = place(f"joint {j + 1}", "joint angle, second encoder", "eccentric-encoder")
    detail = {"joint": j + 1, "waves": waves}
    return Act("eccentric-encoder", "", where, "rad", 1e-4, 0.01, apply, detail, sensed=True)


THIRD = (
    gas_spring, loose_bolts, sliding_load, gear_resonance, dead_time, tilted_bearing, soft_floor,
    nested_shafts, eccentric_encoder,
)  # fmt: skip
"""Causes of the third set."""
