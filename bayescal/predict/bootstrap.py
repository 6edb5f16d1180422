"""The bootstrap of validation errors: rows that belong together are resampled together."""

from __future__ import annotations

import numpy as np

from bayescal.model.scene import Scene

RESAMPLES = 2000
BLOCKS = 40
"""Blocks into which rows without a stop or repeat are cut, in order of time."""


def blocks(scene: Scene, rows: np.ndarray) -> np.ndarray:
    """Block labels (R,) of rows in order of time: a stop or a group of repeats, else neighbours in time."""
    m = scene.dataset.measurements
    given = m.stop if m.stop is not None else m.repeat
    own = np.full(len(rows), "") if given is None else given[rows].astype(str)
    rest = np.unique(rows[own == ""])
    place = np.searchsorted(rest, rows) * min(BLOCKS, max(len(rest), 1)) // max(len(rest), 1)
    target = m.target[rows]
    labels = [f"{target[k]} {g}" if g else f"after {place[k]}" for k, g in enumerate(own)]
    return np.unique(labels, return_inverse=True)[1]


def resampled(block: np.ndarray, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Means (RESAMPLES, K) of values (K, R) over block bootstrap samples, the same ones for all K."""
    labels, inverse = np.unique(block, return_inverse=True)
    draws = rng.multinomial(len(labels), np.full(len(labels), 1.0 / len(labels)), size=RESAMPLES)
    sums = np.stack([np.bincount(inverse, v) for v in values], axis=1)
    return (draws @ sums) / (draws @ np.bincount(inverse))[:, None]
