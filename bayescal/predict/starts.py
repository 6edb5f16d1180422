"""Starting points of the search for a target: its stated position and closed-form solutions from its rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayescal.arm.transforms import rigid_alignment
from factors.cylinder import Cylinder
from factors.distance import Distance
from factors.instrument import Instrument
from factors.kind import Kind
from factors.sphere import Sphere
from factors.turns import rotation_vector


def starts(kind: Kind, p: np.ndarray) -> np.ndarray:
    """Initial states (K, size) of the search, the stated one first; p (3, C) are the ball centres, m."""
    out = [np.zeros(len(kind.sd))]
    for of, states in STARTS.items():
        if isinstance(kind, of):
            out += states(kind, p)
    return np.where(kind.sd > 0, np.stack(out), 0.0)


def centres(p: np.ndarray, length: np.ndarray) -> list[np.ndarray]:
    """Points (d,) at distances near length (C,) from points p (d, C): by least squares, and two mirrored.

    |p|^2 - L^2 = 2 p.c + const is linear in c (I. D. Coope, Circle fitting by linear and nonlinear least
    squares, J. Optim. Theory Appl. 76, 1993). Where the points nearly share a plane (a line, of d = 2),
    their centre may lie on either side of it: the two images start at the distance that the lengths give.
    """
    middle = p.mean(axis=1)
    q = p - middle[:, None]
    square = np.sum(q**2, axis=0) - length**2
    axes = np.linalg.svd(q)[0]
    out = [middle + _linear(q, square)]
    across, normal = axes[:, :-1], axes[:, -1]
    flat = across @ _linear(across.T @ q, square)
    height = np.sqrt(max(float(np.mean(length**2 - np.sum((q - flat[:, None]) ** 2, axis=0))), 0.0))
    return [*out, middle + flat + height * normal, middle + flat - height * normal]


def _linear(q: np.ndarray, square: np.ndarray) -> np.ndarray:
    design = np.column_stack([2.0 * q.T, np.ones(q.shape[1])])
    return np.linalg.lstsq(design, square, rcond=None)[0][:-1]


def _sphere(kind: Sphere, p: np.ndarray) -> Sequence[np.ndarray]:
    found = centres(p, 0.5 * kind.diameter + kind.radius)
    return [np.append(c - kind.centre, 0.0) for c in found]


def _distance(kind: Distance, p: np.ndarray) -> Sequence[np.ndarray]:
    return [c - kind.centre for c in centres(p, kind.length)]


def _cylinder(kind: Cylinder, p: np.ndarray) -> Sequence[np.ndarray]:
    across = kind.tangents @ (p - kind.point[:, None])
    return [np.array([0, 0, *c, 0]) for c in centres(across, 0.5 * kind.diameter + kind.radius)]


def _instrument(kind: Instrument, p: np.ndarray) -> Sequence[np.ndarray]:
    """The frame that best turns the readings into the points (Arun et al., PAMI 9, 1987)."""
    if p.shape[1] < 3:
        return []
    placed = rigid_alignment(p.T, kind.xyz)
    apart, origin = placed[:3, :3] @ kind.frame[:3, :3].T, placed[:3, 3]
    return [np.append(rotation_vector(apart), origin - kind.pivot - apart @ (kind.frame[:3, 3] - kind.pivot))]


STARTS: dict[type, Callable[..., Sequence[np.ndarray]]] = {
    Sphere: _sphere,
    Distance: _distance,
    Cylinder: _cylinder,
    Instrument: _instrument,
}
"""Closed-form solutions by kind; planes and fixed points are (nearly) linear in their state."""
