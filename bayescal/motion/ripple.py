"""A scan for ripple: which waves a turn of each joint explain most of what the baseline leaves."""

from __future__ import annotations

import numpy as np

from bayescal.motion.linear import Table
from bayescal.motion.noise import Noise
from bayescal.motion.settings import SEARCH


def waves_of(
    table: Table, values: dict[str, float], noise: Noise
) -> tuple[tuple[tuple[int, float], ...], float]:
    """Joints and waves a turn that explain most, and the log of their share of all that were tried.

    Parameters
    ----------
    table : Table
        Motions of role `calibrate`.
    values : dict
        The baseline, in SI.
    noise : Noise
    """
    residuals = table.residuals(values)
    out, tried = [], 0
    for j in range(table.parts[0].signals.log.n):
        turned = float(np.ptp(np.concatenate([p.signals.q[:, j] for p in table.parts])))
        low, high, part = SEARCH.waves
        waves = np.arange(low, high, max(part * 2.0 * np.pi / max(turned, 1e-3), part))
        score, size = np.zeros(len(waves), complex), np.zeros(len(waves))
        for p, r in zip(table.parts, residuals, strict=True):
            x = noise.whitened(p.signals.kept(np.exp(1j * p.signals.q[:, j : j + 1] * waves)), j)
            score += x.conj().T @ noise.whitened(r[:, j], j)
            size += np.sum(np.abs(x) ** 2, axis=0)
        explained = np.abs(score) ** 2 / np.maximum(size, 1.0)
        peaks = [
            k for k in np.argsort(-explained) if explained[k] == np.max(explained[max(k - 2, 0) : k + 3])
        ]
        out += [(j, float(waves[k])) for k in peaks[: SEARCH.ripples]]
        tried += len(waves)
    return tuple(out), float(np.log(len(out) / tried))
