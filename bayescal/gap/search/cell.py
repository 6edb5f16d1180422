"""One generic cell, and what cells of several kinds share: smooth functions, rotations at a joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.effects import Circumstances, Parameter
from bayescal.effects.joints import LINK, READING, turned
from bayescal.effects.location import Driver, Site
from bayescal.gap.settings import CELLS


@dataclass(frozen=True)
class Cell:
    """A site, a coordinate, and its sets of columns: one smooth set, or many local ones.

    With `clusters` it is a random error, drawn anew in each cluster of rows: its only set has one
    parameter, the motion by that error. Without sets they are those of `cells.sets_of`.
    """

    site: Site
    driver: Driver
    sets: tuple[tuple[Parameter, ...], ...]
    known: bool = False  # whether a known effect has this same function
    clusters: np.ndarray | None = None  # (N,) int, equal for rows that share a random error


def smooth(x: np.ndarray, fitted: np.ndarray, waves: int = CELLS.waves) -> list[np.ndarray]:
    """Cosines of 1 to `waves` half periods over the range of a coordinate x (N,)."""
    mine = x[fitted]
    low, high = float(np.min(mine)), float(np.max(mine))
    if not high > low:
        return []
    u = np.clip((x - low) / (high - low), 0.0, 1.0)
    return [np.cos(np.pi * k * u) for k in range(1, waves + 1)]


def at_joint(c: Circumstances, j: int, drivers: list[np.ndarray], side: str = LINK) -> tuple[Parameter, ...]:
    """Rotations of the link of a joint, or of all links that its reading moves."""
    return tuple(Parameter("", "rad", turned(c.robot, j, d, side), CELLS.angle) for d in drivers)


def moves(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides of a joint where an error rotates different links: both where its reading moves several links."""
    return (LINK, READING) if np.count_nonzero(c.robot.link_from_reading[:, j - 1]) > 1 else (LINK,)


def passes(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides of a joint with different motions: both where several readings move its link."""
    return (LINK, READING) if np.count_nonzero(c.robot.link_from_reading[j - 1]) > 1 else (LINK,)


def sides_of(c: Circumstances, j: int) -> tuple[str, ...]:
    """Sides on which a joint moves, or its error rotates, differently."""
    return max(moves(c, j), passes(c, j), key=len)
