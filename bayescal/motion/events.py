"""Unknown causes that are no function of the motion: torques that change at once and come back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate
from scipy.special import logsumexp

from bayescal.motion.cells import UNKNOWN
from bayescal.motion.effects import Form, joint
from bayescal.motion.linear import Fit, Sparse
from bayescal.motion.products import Bank
from bayescal.motion.search import SCALE_PRIOR, SCALES
from bayescal.motion.settings import EVENTS
from bayescal.motion.signals import Signals

Found = tuple[Form, float, Sparse]
"""A form, its evidence, nats, and its columns."""


@dataclass(frozen=True)
class _Event:
    gain: float  # nats
    motion: int
    row: int  # at which it begins
    pulse: np.ndarray  # rows of it


def events(bank: Bank, fit: Fit) -> Iterator[Found]:
    """Torques of each joint that change at once and come back, where these explain what a fit leaves."""
    order, n = bank.noise.order, len(bank.size)
    every = bank.table.residuals(fit.values)
    left = [[bank.noise.whitened(r[:, j], j) for j in range(n)] for r in every]
    tried = np.log(len(EVENTS.constants) * sum(map(len, every)))
    pulses = [_pulse(bank.table.parts[0].signals, constant) for constant in EVENTS.constants]
    for j in range(n):
        candidates = []
        for pulse in pulses:
            shape = bank.noise.whitened(np.r_[np.zeros(order), pulse], j)[order:] * bank.size[j]
            for p, residual in enumerate(left):
                if len(shape) > len(residual[j]) - order:
                    continue
                score = correlate(residual[j][order:], shape, "valid")
                gain = _averaged(score**2, float(shape @ shape)) - tried
                rows = np.flatnonzero(gain > 0.0).tolist()
                candidates += [_Event(float(gain[k]), p, k + order, pulse) for k in rows]
        chosen: list[_Event] = []
        for c in sorted(candidates, key=lambda c: -c.gain):
            apart = all(
                c.motion != o.motion or abs(c.row - o.row) > max(len(c.pulse), len(o.pulse)) for o in chosen
            )
            if apart and len(chosen) < EVENTS.most:
                chosen.append(c)
        if chosen:
            form = Form(UNKNOWN, joint(j), "time, single events", f"{len(chosen)} of them")
            columns = [np.zeros((len(part.residual), len(chosen))) for part in bank.table.parts]
            for k, event in enumerate(chosen):
                end = event.row + len(event.pulse)
                columns[event.motion][event.row : end, k] = event.pulse * bank.size[j]
            yield form, sum(c.gain for c in chosen), [{j: x} for x in columns]


def _pulse(s: Signals, constant: float) -> np.ndarray:
    """A torque that changes at once and comes back with a time constant, as rows that are kept show it."""
    since = s.time - s.time[len(s.time) // 3]
    rows = s.kept(np.where(since < 0.0, 0.0, np.exp(-np.maximum(since, 0.0) / constant)))
    first = int(np.argmax(np.abs(rows) > EVENTS.visible))
    return rows[first : first + round(EVENTS.length * constant / (s.step * s.every)) + 2]


def _averaged(square: np.ndarray, size: float) -> np.ndarray:
    """Log Bayes factors of single columns by their squared scores and information, averaged over scales."""
    by = SCALES**2 * size
    nats = 0.5 * square[..., None] * SCALES**2 / (1.0 + by) - 0.5 * np.log1p(by)
    return np.asarray(logsumexp(nats + SCALE_PRIOR, axis=-1))
