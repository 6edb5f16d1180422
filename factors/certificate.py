"""What an artefact's certificate ties together: whitened residuals of one or two targets.

Each function returns one that takes the targets' states x (..., size) and returns residuals
(..., rows), already divided by their standard uncertainties, and their gradients by every x,
(..., rows, size).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from factors.cylinder import Cylinder
from factors.kind import Feature, Kind, feature
from factors.relation import Relation, aligned, apart, between_faces, off_plane, square
from factors.sphere import Sphere

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
