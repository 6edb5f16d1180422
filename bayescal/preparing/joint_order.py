"""Joints of a log that are interchanged, or whose torques have the opposite sense: the nominal arm tells."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from bayescal.logs import Log
from bayescal.motion.dynamics import carried, regressor
from bayescal.preparing.joint_facts import SLOW
from bayescal.preparing.joint_signals import Uniform

ROWS = 400
"""Of a log, that decide (cost)."""
FACTOR = 4.0
"""Product of the factors by which the residuals of the joints fall, at least. Of 80 logs in the right order
it is 1.2 at most, of interchanged joints of a UR5e 60 and 160, of two links 6."""
DRIVES = 0.2
"""Share of the torque of a joint (RMS) by friction that drives its motion, at which its sign is wrong: 0.9
where it is; in 80 logs where it is not, friction resists the motion."""


def reversed_torques(log: Log, even: Sequence[Uniform]) -> tuple[str, ...]:
    """Names of joints whose torques have the opposite sense: by them friction drives the motion."""
    if log.torque_kind == "" or not log.signed or any(e.torque is None for e in even):
        return ()
    q, v, a, torque, payload = _rows(log, even)
    by = regressor(log.mechanism, q, v, a, log.gravity)
    rigid = carried(by, log.mechanism.inertials, log.mechanism, payload)
    out = []
    for name, e, load, speed, rotor in zip(
        log.mechanism.joint_names, torque.T, rigid.T, v.T, a.T, strict=True
    ):
        drivers = np.column_stack([np.tanh(speed / SLOW[1]), speed, load, rotor, np.ones(len(speed))])
        gains = np.linalg.lstsq(drivers, e, rcond=None)[0]
        friction = drivers[:, :2] @ gains[:2]
        if np.mean(friction * speed) < 0 and np.std(friction) > DRIVES * np.std(e):
            out.append(name)
    return tuple(out)


def _rows(log: Log, even: Sequence[Uniform]) -> tuple[np.ndarray, ...]:
    """Positions, velocities, accelerations, torques (N, n) and payloads (N,) of some rows."""
    every = max(sum(len(e.position) for e in even) // ROWS, 1)
    moved = [(e.position, e.velocity, np.gradient(e.velocity, e.step, axis=0), e.torque) for e in even]
    loads = [np.full(len(e.position), np.median(m.payload)) for m, e in zip(log.motions, even, strict=True)]
    return (*(np.concatenate(x)[::every] for x in zip(*moved, strict=True)), np.concatenate(loads)[::every])


def interchanged(log: Log, even: Sequence[Uniform]) -> str:
    """Two joints that are interchanged, in words, of all columns or of positions alone; "" if none are.

    Of the torques beside those of the nominal masses, friction and rotors.
    """
    if log.torque_kind == "" or any(e.torque is None for e in even):
        return ""
    (q, v, a, torque, payload), m = _rows(log, even), log.mechanism

    def rest(order: list[int], of_torque: list[int]) -> float:
        """Sum over the joints of the logarithm of the residual (RMS)."""
        by = regressor(m, q[:, order], v[:, order], a[:, order], log.gravity)
        left = torque[:, of_torque] - carried(by, m.inertials, m, payload)
        total = 0.0
        for e, speed, rotor in zip(left.T, v[:, order].T, a[:, order].T, strict=True):
            drivers = np.column_stack([np.tanh(speed / SLOW[1]), speed, rotor, np.ones(len(speed))])
            e = e - drivers @ np.linalg.lstsq(drivers, e, rcond=None)[0]
            total += float(np.log(np.sqrt(np.mean(e**2)) + 1e-12))
        return total

    own = list(range(log.n))
    stated, names = rest(own, own), m.joint_names
    found: list[tuple[float, str]] = []
    for i, k in combinations(own, 2):
        other = own.copy()
        other[i], other[k] = k, i
        both = f"{names[i]} and {names[k]}"
        found += [
            (rest(other, other), f"the columns of {both}"),
            (rest(other, own), f"the positions of {both}"),
        ]
    best = min(found, default=(stated, ""))
    return best[1] if stated - best[0] > np.log(FACTOR) else ""
