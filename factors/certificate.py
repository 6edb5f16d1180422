"""What an artefact's paper ties together: whitened residuals between one or two targets.

Each function takes the kinds and states x (..., size) of its targets and returns residuals
(..., rows), already divided by their standard uncertainties, and their gradients by every x,
(..., rows, size).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from factors.kind import tilted
from factors.plane import Plane
from factors.sphere import Sphere

Residual = tuple[np.ndarray, tuple[np.ndarray, ...]]
Certificate = Callable[..., Residual]


def parallel(a: Plane, b: Plane, distance: float, u_distance: float, u_angle: float) -> Certificate:
    """Two faces parallel to `u_angle` (rad, a direction) and `distance` +- `u_distance` (m) apart.

    The distance is measured where artefacts' papers measure it, at the faces' middle: the signed
    distances of both faces from the point midway between the pivots.
    """
    facing = np.sign(a.normal @ b.normal)  # -1 for the two sides of a block, 1 for a step
    middle = 0.5 * (a.pivot + b.pivot)
    nominal = a.normal @ (a.pivot - middle) - facing * (b.normal @ (b.pivot - middle))
    basis = a.tangents

    def residual(xa: np.ndarray, xb: np.ndarray) -> Residual:
        na, da = tilted(a.normal, basis, xa[..., :2])
        nb, db = tilted(b.normal, b.tangents, xb[..., :2])
        gap = _gap(a, na, xa, middle) - facing * _gap(b, nb, xb, middle)
        r = np.empty((*gap.shape, 3))
        r[..., :2] = (na - facing * nb) @ basis.T / u_angle
        r[..., 2] = (np.sign(nominal) * gap - distance) / u_distance
        ja, jb = np.zeros((*gap.shape, 3, 3)), np.zeros((*gap.shape, 3, 3))
        ja[..., :2, :2] = np.swapaxes(da @ basis.T, -1, -2) / u_angle
        jb[..., :2, :2] = -facing * np.swapaxes(db @ basis.T, -1, -2) / u_angle
        scale = np.sign(nominal) / u_distance
        ja[..., 2, :2] = scale * (da @ (a.pivot - middle))
        jb[..., 2, :2] = -facing * scale * (db @ (b.pivot - middle))
        ja[..., 2, 2] = scale
        jb[..., 2, 2] = -facing * scale
        return r, (ja, jb)

    return residual


def _gap(face: Plane, normal: np.ndarray, x: np.ndarray, middle: np.ndarray) -> np.ndarray:
    return normal @ (face.pivot - middle) + x[..., 2]


def perpendicular(a: Plane, b: Plane, u_angle: float) -> Certificate:
    """Two faces square to `u_angle` (rad)."""

    def residual(xa: np.ndarray, xb: np.ndarray) -> Residual:
        na, da = tilted(a.normal, a.tangents, xa[..., :2])
        nb, db = tilted(b.normal, b.tangents, xb[..., :2])
        ja, jb = np.zeros((*na.shape[:-1], 1, 3)), np.zeros((*na.shape[:-1], 1, 3))
        ja[..., 0, :2] = (da @ nb[..., None])[..., 0] / u_angle
        jb[..., 0, :2] = (db @ na[..., None])[..., 0] / u_angle
        return np.sum(na * nb, axis=-1, keepdims=True) / u_angle, (ja, jb)

    return residual


def distance(centre_a: np.ndarray, centre_b: np.ndarray, distance: float, u_distance: float) -> Certificate:
    """Two centres (their nominal places, m) `distance` +- `u_distance` (m) apart; x begin with the centre."""

    def residual(xa: np.ndarray, xb: np.ndarray) -> Residual:
        out = (centre_a + xa[..., :3]) - (centre_b + xb[..., :3])
        length = np.linalg.norm(out, axis=-1, keepdims=True)
        ja = np.zeros((*length.shape[:-1], 1, xa.shape[-1]))
        jb = np.zeros((*length.shape[:-1], 1, xb.shape[-1]))
        ja[..., 0, :3] = out / length / u_distance
        jb[..., 0, :3] = -out / length / u_distance
        return (length - distance) / u_distance, (ja, jb)

    return residual


def diameter(sphere: Sphere, diameter: float, u_diameter: float) -> Certificate:
    """A sphere's certified diameter +- `u_diameter`, m."""

    def residual(x: np.ndarray) -> Residual:
        j = np.zeros((*x.shape[:-1], 1, 4))
        j[..., 0, 3] = 1.0 / u_diameter
        return (sphere.diameter + x[..., 3:4] - diameter) / u_diameter, (j,)

    return residual
