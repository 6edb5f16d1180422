"""What an artefact's certificate ties together: whitened residuals of one or two targets.

Each function returns one that takes the targets' states x (..., size) and returns residuals
(..., rows), already divided by their standard uncertainties, and their gradients by every x,
(..., rows, size).

How two features stand to each other: angles and lengths with their slopes by both.

A relation takes both nominal features, which choose sides and directions, and returns a function of any
two: values (..., rows) and their slopes (..., rows, 3) by place and direction of the first, then of the
second; None where nothing depends on one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from factors.contacts import Cylinder, Sphere
from factors.kind import Feature, Kind, direction, feature, tangents

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


Residual = tuple[np.ndarray, tuple[np.ndarray, ...]]
Certificate = Callable[..., Residual]

FORMS = ("plane", "axis", "point")
"""What a target may be to a certificate, in the order in which relations take two of them."""

RELATIONS: dict[str, dict[tuple[str, str], tuple[Relation, ...]]] = {
    "parallel": {
        ("plane", "plane"): (aligned, between_faces),
        ("plane", "axis"): (square, off_plane),  # the normal is perpendicular to the axis
        ("axis", "axis"): (aligned, apart),
    },
    "perpendicular": {
        ("plane", "plane"): (square,),
        ("plane", "axis"): (aligned,),
        ("axis", "axis"): (square,),
    },
    "distance": {
        ("plane", "point"): (off_plane,),
        ("axis", "axis"): (apart,),  # of parallel ones
        ("axis", "point"): (apart,),
        ("point", "point"): (apart,),
    },
}
"""Of each kind of certificate the forms that it joins, and what it states of them: angles, then a length."""

LENGTHS = (apart, off_plane, between_faces)


def ordered(forms: tuple[str, str]) -> tuple[str, str]:
    """Two forms in the order of `FORMS`, as keys of `RELATIONS`."""
    first, second = sorted(forms, key=FORMS.index)
    return first, second


def join(
    kind: str,
    forms: tuple[str, str],
    targets: tuple[Kind, Kind],
    distance: float | None = None,
    u_distance: float | None = None,
    u_angle: float | None = None,
) -> Certificate:
    """Two targets, of these forms, as a certificate of this kind states them to stand to each other.

    Parameters
    ----------
    kind : str
        Of `RELATIONS`.
    forms : (str, str)
        Of `FORMS`, one a target.
    targets : (Kind, Kind)
    distance, u_distance : float, optional
        m; where a length is stated. Certificates state no sign: it is that of the nominal places.
    u_angle : float, optional
        rad, where a direction is stated.
    """
    swap = -1 if ordered(forms) != forms else 1
    relations = RELATIONS[kind][ordered(forms)]
    a0, b0 = (feature(t, np.zeros(len(t.sd))) for t in targets[::swap])
    stated = [_given(distance, u_distance) if r in LENGTHS else _given(0.0, u_angle) for r in relations]
    functions = [r(a0, b0) for r in relations]

    def residual(*x: np.ndarray) -> Residual:
        a, b = (feature(t, state) for t, state in zip(targets[::swap], x[::swap], strict=True))
        rows, by_a, by_b = [], [], []
        for function, (value, u) in zip(functions, stated, strict=True):
            actual, (pa, da, pb, db) = function(a, b)
            rows.append((actual - value) / u)
            by_a.append(_by_state(a, pa, da) / u)
            by_b.append(_by_state(b, pb, db) / u)
        slopes = np.concatenate(by_a, axis=-2), np.concatenate(by_b, axis=-2)
        return np.concatenate(rows, axis=-1), slopes[::swap]

    return residual


def _given(value: float | None, u: float | None) -> tuple[float, float]:
    if value is None or u is None:
        raise ValueError("a certificate lacks a value or an uncertainty that its kind states")
    return value, u


def _by_state(f: Feature, by_place: np.ndarray | None, by_direction: np.ndarray | None) -> np.ndarray:
    """Gradients (..., rows, size) by the state of a feature, from those by what makes it."""
    pairs = ((by_place, f.by_place), (by_direction, f.by_direction))
    return sum(g @ np.swapaxes(by, -1, -2) for g, by in pairs if g is not None and by is not None)


def diameter(target: Sphere | Cylinder, diameter: float, u_diameter: float) -> Certificate:
    """A sphere's or a pin's certified diameter +- `u_diameter`, m; it is the last of its state."""

    def residual(x: np.ndarray) -> Residual:
        j = np.zeros((*x.shape[:-1], 1, x.shape[-1]))
        j[..., 0, -1] = 1.0 / u_diameter
        return (target.diameter + x[..., -1:] - diameter) / u_diameter, (j,)

    return residual
