"""How two features stand to each other: angles and lengths with their slopes by both.

A relation takes both nominal features, which choose sides and directions, and returns a function of any
two: values (..., rows) and their slopes (..., rows, 3) by place and direction of the first, then of the
second; None where nothing depends on one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from factors.kind import Feature, direction, tangents

Values = tuple[np.ndarray, tuple[np.ndarray | None, ...]]
Relation = Callable[[Feature, Feature], Callable[[Feature, Feature], Values]]


def aligned(a0: Feature, b0: Feature) -> Callable[[Feature, Feature], Values]:
    """Angles, rad, between two directions, about both axes across the first; either may point either way."""
    first, second = _direction(a0), _direction(b0)
    facing, basis = np.sign(first @ second), tangents(first)

    def values(a: Feature, b: Feature) -> Values:
        off = (_direction(a) - facing * _direction(b)) @ basis.T
        return off, (None, basis, None, -facing * basis)

    return values


def square(a0: Feature, b0: Feature) -> Callable[[Feature, Feature], Values]:
    """Cosine of the angle between two directions: by how much, rad, it is not a right one."""

    def values(a: Feature, b: Feature) -> Values:
        first, second = _direction(a), _direction(b)
        cosine = np.sum(first * second, axis=-1, keepdims=True)
        return cosine, (None, second[..., None, :], None, first[..., None, :])

    return values


def apart(a0: Feature, b0: Feature) -> Callable[[Feature, Feature], Values]:
    """Distance, m, of points and axes: of a point from the axis' nearest, of two axes at their middle."""
    middle = 0.5 * (a0.place + b0.place)

    def values(a: Feature, b: Feature) -> Values:
        point = b.place if b.direction is None else middle
        out = _nearest(a, point) - _nearest(b, point)
        u, length = direction(out)
        return length, (*_along(a, point, u), *_along(b, point, -u))

    return values


def off_plane(a0: Feature, b0: Feature) -> Callable[[Feature, Feature], Values]:
    """Distance, m, of a point or of an axis at the middle from a plane, on the side where it nominally is."""
    middle = 0.5 * (a0.place + b0.place)
    side = np.sign(_direction(a0) @ (_nearest(b0, middle) - a0.place))

    def values(a: Feature, b: Feature) -> Values:
        normal = side * _direction(a)
        out = _nearest(b, middle) - a.place
        gap = np.sum(normal * out, axis=-1, keepdims=True)
        return gap, (-normal[..., None, :], side * out[..., None, :], *_along(b, middle, normal))

    return values


def between_faces(a0: Feature, b0: Feature) -> Callable[[Feature, Feature], Values]:
    """Distance, m, of two planes, as certified: from the point midway between their places."""
    middle, first, second = 0.5 * (a0.place + b0.place), _direction(a0), _direction(b0)
    facing = np.sign(first @ second)  # -1 for the two sides of a block, 1 for a step
    side = np.sign(first @ (a0.place - middle) - facing * (second @ (b0.place - middle)))

    def values(a: Feature, b: Feature) -> Values:
        na, nb = side * _direction(a), -side * facing * _direction(b)
        out_a, out_b = a.place - middle, b.place - middle
        gap = np.sum(na * out_a, axis=-1, keepdims=True) + np.sum(nb * out_b, axis=-1, keepdims=True)
        slopes = na, side * out_a, nb, -side * facing * out_b
        return gap, tuple(s[..., None, :] for s in slopes)

    return values


def _direction(f: Feature) -> np.ndarray:
    assert f.direction is not None, "a point has no direction"
    return f.direction


def _nearest(f: Feature, point: np.ndarray) -> np.ndarray:
    """The point itself, or that of an axis nearest to `point`, (..., 3)."""
    if f.direction is None:
        return f.place
    return f.place + f.direction * np.sum(f.direction * (point - f.place), axis=-1, keepdims=True)


def _along(f: Feature, point: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Slopes of the nearest point along u (..., 3), by place and direction; `point` rests, or u is across."""
    if f.direction is None:
        return u[..., None, :], None
    out = point - f.place
    reach = np.sum(f.direction * out, axis=-1, keepdims=True)
    lean = np.sum(f.direction * u, axis=-1, keepdims=True)
    return (u - lean * f.direction)[..., None, :], (reach * u + lean * out)[..., None, :]
