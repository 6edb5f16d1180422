"""Largest differences that an arm in a simulator may have from the fitted arm."""

from __future__ import annotations

from collections.abc import Sequence

from bayescal.effects.selection import plain

LIMITS = {
    "nominal": 1e-9,
    "joint": 5e-8,
    "geometry": 1e-9,
    "compliance": 2e-8,
    "payload": 2e-8,
    "base-compliance": 1e-7,
    "encoder-scale": 5e-8,
    "coupling": 5e-8,
    "eccentricity": 5e-8,
    "second-harmonic": 5e-8,
    "gear-mesh": 5e-8,
    "bending": 5e-7,
    "hysteresis": 5e-7,
    "hardening": 5e-7,
    "backlash": 2e-6,
}
"""Maximum difference of the TCP positions, m, that each effect of a model adds; others add none."""
TOGETHER, TOGETHER_RMS = 3e-6, 1e-6
"""Maximum and RMS difference, m, of any model."""


def limit(effects: Sequence[str]) -> float:
    """Maximum difference of a model with these effects, m."""
    return min(sum(LIMITS.get(plain(name), 0.0) for name in effects or ("nominal",)), TOGETHER)
