"""What an artefact's certificate speaks of: the point, axis or plane that a target at a state x is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np

from factors.kind import Kind


@dataclass(frozen=True)
class Feature:
    """A point, or a point of an axis or plane and the unit vector along or normal to it.

    Parameters
    ----------
    place : (..., 3) m, in F0
    by_place : (..., size, 3) its slopes by the state
    direction, by_direction : the same of the unit vector; None of a point
    """

    place: np.ndarray
    by_place: np.ndarray
    direction: np.ndarray | None = None
    by_direction: np.ndarray | None = None


class Placed(Kind, Protocol):
    """A kind of which a certificate may speak."""

    def feature(self, x: np.ndarray) -> Feature:
        """Its feature at the states x (..., size)."""
        ...


def feature(kind: Kind, x: np.ndarray) -> Feature:
    """The feature of a target at its states x (..., size)."""
    return cast(Placed, kind).feature(x)


def slopes(x: np.ndarray) -> np.ndarray:
    """Room (..., size, 3) for slopes by the state, all zero."""
    return np.zeros((*x.shape, 3))


def point(centre: np.ndarray, x: np.ndarray) -> Feature:
    """A point whose displacement, m, leads the state."""
    by = slopes(x)
    by[..., :3, :] = np.eye(3)
    return Feature(centre + x[..., :3], by)
