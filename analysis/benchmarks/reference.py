"""A motion by the NumPy reference of the chain, against which its kernel is tested and timed."""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import points, wrenches
from bayescal.arm.motion import Motion
from bayescal.arm.transforms import AXES


def points_reference(motion: Motion, values: np.ndarray) -> np.ndarray:
    """`Motion.points` at values (..., P), (..., 3, C), m."""
    found = points(motion.chain, motion.q, motion.tool, motion.displacements(values))
    return np.swapaxes(found, -1, -2)


def columns_reference(motion: Motion, values: np.ndarray, u: np.ndarray) -> np.ndarray:
    """`Motion.columns` at values (P,) along u (3, C), (P, C)."""
    wrench = wrenches(motion.chain, motion.q, motion.tool, motion.displacements(values), u.T)
    out = np.zeros((motion.size, motion.count))
    for parameter, term in motion.terms:
        out[parameter] += wrench[:, term.frame, AXES.index(term.axis)] * term.driver
    return out
