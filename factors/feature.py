"""What an artefact's paper speaks of: the point, axis or plane that a target at a state x is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from factors.cylinder import Cylinder
from factors.distance import Distance
from factors.fixed_point import FixedPoint
from factors.instrument import Instrument
from factors.kind import Kind, tilted
from factors.plane import Plane
from factors.sphere import Sphere
from factors.turns import cross_matrix, left_jacobian, turned


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


def feature(kind: Kind, x: np.ndarray) -> Feature:
    """The feature of a target at its states x (..., size)."""
    return OF[type(kind)](kind, x)


def _slopes(x: np.ndarray) -> np.ndarray:
    return np.zeros((*x.shape, 3))


def _centre(kind: Sphere | FixedPoint | Distance, x: np.ndarray) -> Feature:
    by = _slopes(x)
    by[..., :3, :] = np.eye(3)
    return Feature(kind.centre + x[..., :3], by)


def _origin(kind: Instrument, x: np.ndarray) -> Feature:
    by = _slopes(x)
    arm = (turned(x[..., :3]) @ (kind.frame[:3, 3] - kind.pivot)[:, None])[..., 0]
    by[..., :3, :] = np.swapaxes(-cross_matrix(arm) @ left_jacobian(x[..., :3]), -1, -2)
    by[..., 3:, :] = np.eye(3)
    return Feature(kind.pivot + x[..., 3:] + arm, by)


def _face(kind: Plane, x: np.ndarray) -> Feature:
    by, turn = _slopes(x), _slopes(x)
    normal, turn[..., :2, :] = tilted(kind.normal, kind.tangents, x[..., :2])
    by[..., :2, :] = x[..., 2, None, None] * turn[..., :2, :]
    by[..., 2, :] = normal
    return Feature(kind.pivot + x[..., 2:] * normal, by, normal, turn)


def _axis(kind: Cylinder, x: np.ndarray) -> Feature:
    by, turn = _slopes(x), _slopes(x)
    axis, turn[..., :2, :] = tilted(kind.axis, kind.tangents, x[..., :2])
    by[..., 2:4, :] = kind.tangents
    return Feature(kind.point + x[..., 2:4] @ kind.tangents, by, axis, turn)


OF: dict[type, Callable[[Any, np.ndarray], Feature]] = {
    Plane: _face,
    Cylinder: _axis,
    Sphere: _centre,
    FixedPoint: _centre,
    Distance: _centre,
    Instrument: _origin,
}
"""Of each kind how its feature is found."""
