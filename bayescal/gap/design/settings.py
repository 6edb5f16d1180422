"""Settings of advice and blind spots; their words are those of `gap.settings`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class DesignSettings:
    """Advice and blind spots: candidate contacts and their detectability."""

    contacts: int = 40
    """Number of new contacts in an advice."""
    images: int = 12
    """The same of images."""
    better: float = 1.2
    """Factor of an intervention over the lambda of the repeated poses, required for advice (assumed)."""
    least: float = 2.0
    """Lambda that the best intervention must add to be advised (assumed)."""
    poses: int = 120
    """Maximum number of poses of the session from which new contacts are chosen (cost)."""
    payload: float = 2.0
    """Mass added by the intervention with a payload, kg."""
    faster: float = 4.0
    """Factor on the recorded velocities in the intervention with faster contacts."""
    turning: float = 4.0
    """Factor on the recorded velocities in the intervention that rotates about the stylus tip."""
    still: float = 1e-6
    """Share of a requested rotation below which an arm cannot rotate about its stylus tip (rounding)."""
    least_u: float = 1e-7
    """Smallest standard uncertainty of a certified distance, m (rounding)."""
    roughly: float = 1e-3
    """Prior standard deviation of a located centre, m: smaller than the dataset's, for rounding."""
    changed: float = 1e-9
    """Smallest relevant change of a whitened column (rounding)."""
    named: float = 50.0
    """Detectability lambda from which on an effect is nearly always named (assumed)."""
    rounding: float = 1e-11
    """Share of the square of a column below which its projection is rounding error."""
    pairs: int = 200
    """Pairs of points that replace certified distances (cost)."""
    apart: float = 50e-3
    """Least distance of such a pair, m (assumed)."""
    points: int = 64
    """Contacts among which such pairs are drawn (cost)."""


DESIGN: Final = DesignSettings()
