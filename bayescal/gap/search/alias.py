"""Ripples that the poses of a session do not distinguish from low harmonics of the same angle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.effects import Circumstances, Parameter
from bayescal.gap.settings import SEARCH

ALIASED = "the poses do not distinguish it from a low harmonic of the angle"
HARMONICS = 2  # the orders that other effects have


def unaliased(parameters: Sequence[Parameter], c: Circumstances) -> list[bool]:
    """Whether the poses of a session show a ripple as what it is; True for any other parameter.

    A parameter with more than two periods per revolution is a ripple. At angles on a raster, or at a few
    angles, it has the values of a low harmonic (sampling theorem); within a small range it is slow.
    It is aliased if a straight line and the harmonics explain nearly all of it at the fitted measurements.
    """
    out = [True] * len(parameters)
    ripples: dict[int, list[int]] = {}
    for k, p in enumerate(parameters):
        if p.driver.kind == "angle" and p.driver.order > HARMONICS:
            ripples.setdefault(p.driver.joint, []).append(k)
    for j, own in ripples.items():
        angle = c.q[c.fitted, j - 1]
        slow = [np.ones_like(angle), angle]
        slow += [f(k * angle) for k in range(1, HARMONICS + 1) for f in (np.sin, np.cos)]
        directions, size, _ = np.linalg.svd(np.column_stack(slow), full_matrices=False)
        basis = directions[:, size > 1e-9 * size[0]]
        waves = np.column_stack([np.asarray(parameters[k].terms[0].driver)[c.fitted] for k in own])
        left = np.mean((waves - basis @ (basis.T @ waves)) ** 2, axis=0)
        for k, square in zip(own, left, strict=True):
            out[k] = bool(square > SEARCH.aliased / 2)
    return out
