"""A scan for ripple: which waves a turn of each joint explain most of what the baseline leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.motion.estimate import Estimate
from bayescal.motion.linear import fitted, normal
from bayescal.motion.settings import SEARCH


@dataclass(frozen=True)
class Waves:
    """Joints, from 0, and waves a turn that explain most, with the logs of their shares of all tried."""

    steady: tuple[tuple[int, float], ...] = ()  # of one phase
    spread: float = 0.0
    changing: tuple[tuple[int, float], ...] = ()  # whose phase differs from piece to piece of the motions
    changing_spread: float = 0.0


def waves_of(estimate: Estimate) -> Waves:
    """Scan a grid of waves a turn, and multiples of a turn of the motor where the gear ratio is known."""
    table, noise = estimate.table(), estimate.noise
    residuals = table.residuals(fitted(normal(table, noise), np.arange(len(table.terms))).values)
    steady, changing, tried = [], [], 0
    log = table.parts[0].signals.log
    for j in range(log.n):
        turned = float(np.ptp(np.concatenate([p.signals.q[:, j] for p in table.parts])))
        low, high, part = SEARCH.waves
        waves = np.arange(low, high, max(part * 2.0 * np.pi / max(turned, 1e-3), part))
        gear = log.mechanism.gear_ratio[j]
        if not np.isnan(gear):
            of_motor = np.array(SEARCH.of_motor) * abs(gear)
            waves = np.unique(np.r_[waves, of_motor[of_motor > high]])
        score, size, loose = np.zeros(len(waves), complex), np.zeros(len(waves)), np.zeros(len(waves))
        for p, r in zip(table.parts, residuals, strict=True):
            x = noise.whitened(p.signals.kept(np.exp(1j * p.signals.q[:, j : j + 1] * waves)), j)
            y = noise.whitened(r[:, j], j)
            for rows in np.array_split(np.arange(len(y)), SEARCH.pieces):
                along, square = x[rows].conj().T @ y[rows], np.sum(np.abs(x[rows]) ** 2, axis=0)
                score += along
                size += square
                loose += np.abs(along) ** 2 / np.maximum(square, 1.0)
        strength = np.abs(score) ** 2 / np.maximum(size, 1.0)
        steady += [(j, float(waves[k])) for k in _peaks(strength, SEARCH.ripples)]
        changing += [(j, float(waves[k])) for k in _peaks(loose, SEARCH.changing)]
        tried += len(waves)
    shares = [float(np.log(max(len(chosen), 1) / tried)) for chosen in (steady, changing)]
    return Waves(tuple(steady), shares[0], tuple(changing), shares[1])


def _peaks(x: np.ndarray, count: int) -> list[int]:
    """The largest local maxima."""
    return [k for k in np.argsort(-x).tolist() if x[k] == np.max(x[max(k - 2, 0) : k + 3])][:count]
