"""The stand under gravity: axes of F0 about which an arm's weight tilts its base, for any mounting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.arm.motion import Term
from bayescal.effects.joints import carries
from bayescal.effects.vocabulary import Circumstances

LEANING = np.sin(np.radians(5.0))
"""Sine of an angle below which two axes count as parallel."""


@dataclass(frozen=True)
class Tilt:
    """A horizontal axis about which the gravity moment turns the base; vectors are unit, in F0.

    A weight has no moment about the vertical, so there are two.
    """

    name: str  # of the axis of F0 nearest to it
    axis: np.ndarray  # (3,)
    across: np.ndarray  # (3,) the other horizontal axis: a hinge below the base displaces it along this
    moment: np.ndarray  # (N,) about the axis through the undisplaced base's origin, N m


def vertical(c: Circumstances) -> np.ndarray:
    """Upwards in F0, (3,); zeros without gravity."""
    size = float(np.linalg.norm(c.gravity))
    return -c.gravity / size if size > 0 else np.zeros(3)


def first_axis(c: Circumstances) -> np.ndarray:
    """Axis of the first joint in F0, (3,), nominal."""
    return (c.chain.base @ c.chain.link[0])[:3, 2]


def tilts(c: Circumstances) -> tuple[Tilt, ...]:
    """Horizontal axes about which a moment acts in any row."""
    up = vertical(c)
    if c.moments is None or not up.any():
        return ()
    a, b = (k for k in range(3) if k != int(np.argmax(np.abs(up))))
    first = np.eye(3)[a] - up[a] * up
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    second *= np.sign(second[b])
    moment = c.moments[:, 0] @ c.chain.base[:3, :3].T  # in F0's axes
    pairs = (("xyz"[a], first, second), ("xyz"[b], second, first))
    found = (Tilt(name, axis, across, moment @ axis) for name, axis, across in pairs)
    return tuple(t for t in found if carries(t.moment))


def base_terms(c: Circumstances, kind: str, along: np.ndarray, driver: np.ndarray) -> tuple[Term, ...]:
    """Rotation ("r") or translation ("t") of the base, about or along a vector (3,) in F0; driver (N,)."""
    parts = c.chain.base[:3, :3].T @ along
    return tuple(
        Term(0, f"{kind}{axis}", part * driver)
        for axis, part in zip("xyz", parts, strict=True)
        if abs(part) > 1e-12
    )
