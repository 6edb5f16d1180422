"""What an artefact's certificate ties together: whitened residuals of its targets.

Each function returns one that takes the targets' states x (..., size) and returns residuals
(..., rows), already divided by their standard uncertainties, and their gradients by every x,
(..., rows, size).

How two features stand to each other: angles and lengths with their slopes by both.

A relation takes both nominal features, which choose sides and directions, and returns a function of any
two: values (..., rows) and their slopes (..., rows, 3) by place and direction of the first, then of the
second; None where nothing depends on one.

Certified coordinates of an artefact's points are its form, wherever it stands. Points p of one placement are
the certified points c, turned and shifted by an unknown pose. After the best fit of c to p (Kabsch, Acta
Cryst. A 32 (1976) 922) the rest e = R'(p - t) - c, in the frame of the artefact, is free of the pose in the
directions N that no rigid motion moves: N e has the covariance N S N', where S is that of the coordinates.
With a flat prior of the pose nothing else of the coordinates can be seen. Points on one line leave a rotation
about it undetermined: there the form is the lengths between neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

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


CORRELATION = 0.9
"""Of the errors of one artefact at two placements: clamps and temperature change the rest (assumed)."""
STRAIGHT = 0.02
"""Width over length up to which points count as on one line."""
EXACT = 1e-4
"""Of the root mean square uncertainty, assumed of every relation: the covariance then has an inverse."""


def colouring(times: int) -> np.ndarray:
    """Lower factor (times, times) of the correlation of one certified length at so many placements."""
    return np.linalg.cholesky(CORRELATION + (1.0 - CORRELATION) * np.eye(times))


def whitening(times: int) -> np.ndarray:
    """What whitens one certified length at so many placements, (times, times), of unit variance each."""
    return np.linalg.inv(colouring(times))


def again(each: Sequence[Certificate], targets: int) -> Certificate:
    """One certified length at several placements, of so many targets each: its error is of the artefact."""
    white = whitening(len(each))

    def residual(*x: np.ndarray) -> Residual:
        rows, slopes = [], []
        for k, function in enumerate(each):
            r, by = function(*x[k * targets : (k + 1) * targets])
            rows.append(r)
            slopes += [np.concatenate([w * slope for w in white[:, k]], axis=-2) for slope in by]
        whitened = np.tensordot(np.stack(rows, axis=-1), white, (-1, -1))  # (..., rows, placements)
        return np.moveaxis(whitened, -1, -2).reshape(*rows[0].shape[:-1], -1), tuple(slopes)

    return residual if len(each) > 1 else each[0]


Form = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Values (..., m) of points (..., k, 3), 0 where they are as certified, and their slopes (..., m, k, 3)."""


@dataclass(frozen=True)
class Shape:
    """What certified coordinates state of placed points, whitened.

    Attributes
    ----------
    forms : tuple of (indices of targets, Form)
        One for each placement.
    whiten : np.ndarray, shape (m, m)
        Of the stacked values of all placements.
    by_coordinate : np.ndarray, shape (m, 3 K)
        Slopes of the stated values by the certified coordinates, 1/m.
    """

    forms: tuple[tuple[np.ndarray, Form], ...]
    whiten: np.ndarray
    by_coordinate: np.ndarray


def shape(
    coordinates: np.ndarray, covariance: np.ndarray, placements: Sequence[Sequence[tuple[int, int]]]
) -> Shape:
    """The relations between targets that certified coordinates state.

    Parameters
    ----------
    coordinates : np.ndarray, shape (K, 3)
        m, in any frame.
    covariance : np.ndarray, shape (3 K, 3 K)
        m2; positive semi-definite.
    placements : sequence
        Of each placement its targets: (index of the target, index of its point), two or more.
    """
    forms, slopes = [], []
    for placement in placements:
        points = [point for _, point in placement]
        form, by_points = form_of(coordinates[points])
        by = np.zeros((len(by_points), len(coordinates), 3))
        by[:, points] = by_points
        forms.append((np.array([target for target, _ in placement]), form))
        slopes.append(by.reshape(len(by), -1))
    by = np.concatenate(slopes)
    of = np.repeat(np.arange(len(slopes)), [len(s) for s in slopes])
    alike = np.where(of[:, None] == of, 1.0, CORRELATION)
    exact = EXACT**2 * np.trace(covariance) / len(covariance)
    whiten = np.linalg.inv(np.linalg.cholesky(alike * (by @ covariance @ by.T) + exact * np.eye(len(by))))
    return Shape(tuple(forms), whiten, whiten @ by)


def form_of(certified: np.ndarray) -> tuple[Form, np.ndarray]:
    """The form of points (k, 3), m, and the slopes (m, k, 3) of its values by their coordinates."""
    arms = certified - certified.mean(axis=0)
    across, size, _ = np.linalg.svd(arms, full_matrices=False)
    if len(certified) == 2 or size[1] < STRAIGHT * size[0]:
        return _in_line(certified, np.argsort(across[:, 0]))
    count = len(certified)
    turns = np.cross(np.eye(3)[:, None], arms)  # (3, k, 3)
    motions = np.concatenate([np.tile(np.eye(3), count), turns.reshape(3, -1)])
    free = np.linalg.qr(motions.T, mode="complete")[0][:, 6:].T.reshape(-1, count, 3)

    def values(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out = p - p.mean(axis=-2, keepdims=True)
        u, _, v = np.linalg.svd(arms.T @ out)
        u[..., -1] *= np.linalg.det(u @ v)[..., None]  # a rotation, no reflection
        turn = np.swapaxes(u @ v, -1, -2)  # out = turn @ arm
        seen = out @ turn
        deviations = np.einsum("mki,...ki->...m", free, seen - arms)
        # the rotation follows the points: sum of arm x seen is 0
        spread = np.einsum("...ki,kj->...ij", seen, arms)
        inertia = np.sum(arms * seen, axis=(-1, -2))[..., None, None] * np.eye(3) - spread
        lever = np.sum(np.cross(seen[..., None, :, :], free), axis=-2)  # (..., m, 3)
        by_turn = lever @ np.linalg.inv(inertia)
        by = free - np.cross(by_turn[..., :, None, :], arms)
        return deviations, by @ np.swapaxes(turn, -1, -2)[..., None, :, :]

    return values, free


def _in_line(certified: np.ndarray, order: np.ndarray) -> tuple[Form, np.ndarray]:
    """Lengths between neighbours of points on a line."""
    lengths = np.linalg.norm(np.diff(certified[order], axis=0), axis=1)
    steps = np.zeros((len(lengths), len(certified)))
    steps[np.arange(len(lengths)), order[1:]] = 1.0
    steps[np.arange(len(lengths)), order[:-1]] = -1.0

    def values(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        way, length = direction(steps @ p)
        return length[..., 0] - lengths, steps[:, :, None] * way[..., None, :]

    return values, values(certified)[1]


def certified_points(of: Shape, targets: Sequence[Kind]) -> Certificate:
    """Targets, points of an artefact, as its certified coordinates state them to stand to each other."""

    def residual(*x: np.ndarray) -> Residual:
        places = [feature(t, state) for t, state in zip(targets, x, strict=True)]
        values, slopes = [], [np.zeros(0)] * len(targets)
        first = 0
        for members, form in of.forms:
            value, by = form(np.stack([places[k].place for k in members], axis=-2))
            values.append(value)
            white = of.whiten[:, first : first + value.shape[-1]]
            first += value.shape[-1]
            for i, k in enumerate(members):
                slopes[k] = white @ by[..., i, :] @ np.swapaxes(places[k].by_place, -1, -2)
        return np.concatenate(values, axis=-1) @ of.whiten.T, tuple(slopes)

    return residual
