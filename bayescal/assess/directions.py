"""Directions in space that the fitted data probe: a residual measures the ball along one direction only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.model import Model

BARELY = 0.15
"""Share of the best-seen direction's amplitude below which a direction counts as not probed."""
AN_AXIS = 0.98
"""Cosine from which on a direction goes by the name of an axis of the base."""


@dataclass(frozen=True)
class Directions:
    """How well each direction is probed."""

    axes: np.ndarray  # (3, 3) rows: unit vectors in F0, the best-seen first
    share: np.ndarray  # (3,) of the best-seen one's amplitude

    @property
    def missing(self) -> np.ndarray:
        """Directions (K, 3) that are hardly probed."""
        return self.axes[self.share < BARELY]


def directions(model: Model) -> Directions:
    """Principal axes of the directions in which a model's fitted residuals see the ball."""
    seen = []
    for block in model.states:
        _, u, _ = block.kind.linearise(np.zeros(len(block.kind.sd)), model.scene.points[block.rows].T)
        seen.append(np.moveaxis(u, 1, 2).reshape(-1, 3))
    # at least three rows, so that the thin decomposition has all three axes; memory linear in the rows
    _, share, axes = np.linalg.svd(np.concatenate([*seen, np.zeros((3, 3))]), full_matrices=False)
    return Directions(axes, share / max(share[0], 1e-30))


def in_words(seen: Directions) -> str:
    """What is missing, by the names of F0's axes: ``hardly a row looks along (0.71, 0.00, 0.71)``; or ""."""
    if not len(seen.missing):
        return ""
    if len(seen.missing) == 1:
        return f"hardly a row looks along {_name(seen.missing[0])} of the base"
    return f"all measurements look along {_name(seen.axes[0])} of the base"


def _name(axis: np.ndarray) -> str:
    k = int(np.argmax(np.abs(axis)))
    if abs(axis[k]) > AN_AXIS:
        return "xyz"[k]
    return "({})".format(", ".join(f"{v + 0.0:.2f}" for v in axis * np.sign(axis[k])))
