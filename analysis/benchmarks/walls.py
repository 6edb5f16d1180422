"""Faces, their certificates and contacts on plain arrays: what the peers share, in NumPy or in JAX.

A second writing of `factors.contacts` and `factors.certificate`; the tests hold the two together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Walls:
    """F faces and C contacts, face after face."""

    first: np.ndarray  # (F + 1,) int, where each face's contacts begin
    normal: np.ndarray  # (F, 3) nominal
    basis: np.ndarray  # (F, 2, 3) directions of tilt
    pivot: np.ndarray  # (F, 3) m
    sd: np.ndarray  # (F, 3) prior, rad, rad and m
    radius: np.ndarray  # (C,) m
    sigma: np.ndarray  # (C,) m
    parallel: np.ndarray  # (K, 5) two faces, distance, its uncertainty (m), that of a direction (rad)
    perpendicular: np.ndarray  # (L, 3) two faces, uncertainty of their angle (rad)


def place(xp: Any, walls: Walls, z: Any) -> tuple[Any, Any]:
    """Unit normals (F, 3) and shifts along them (F,), m, at the faces' whitened parameters z (F, 3)."""
    x = z * walls.sd
    raw = walls.normal + x[:, :1] * walls.basis[:, 0] + x[:, 1:2] * walls.basis[:, 1]
    return raw / xp.sqrt(xp.sum(raw * raw, axis=1, keepdims=True)), x[:, 2]


def contact_residuals(xp: Any, walls: Walls, normal: Any, shift: Any, p: Any) -> Any:
    """Whitened residuals (C,) of ball centres p, three rows (C,) in m."""
    out = []
    for k in range(len(walls.normal)):
        at = slice(int(walls.first[k]), int(walls.first[k + 1]))
        n, pivot = normal[k], walls.pivot[k]
        offset = n[0] * pivot[0] + n[1] * pivot[1] + n[2] * pivot[2] + shift[k]
        out.append(n[0] * p[0][at] + n[1] * p[1][at] + n[2] * p[2][at] - offset)
    return (xp.concatenate(out) - walls.radius) / walls.sigma


def tie_residuals(xp: Any, walls: Walls, normal: Any, shift: Any) -> Any:
    """Whitened residuals (3 K + L,) of the certificates."""
    out = [xp.zeros(0)]
    for row in walls.parallel:
        a, b = int(row[0]), int(row[1])
        facing = np.sign(walls.normal[a] @ walls.normal[b])
        middle = 0.5 * (walls.pivot[a] + walls.pivot[b])
        from_a, from_b = walls.pivot[a] - middle, walls.pivot[b] - middle
        sign = np.sign(walls.normal[a] @ from_a - facing * (walls.normal[b] @ from_b))
        turned = walls.basis[a] @ (normal[a] - facing * normal[b]) / row[4]
        gap = normal[a] @ from_a + shift[a] - facing * (normal[b] @ from_b + shift[b])
        out += [turned, xp.reshape((sign * gap - row[2]) / row[3], (1,))]
    for row in walls.perpendicular:
        out.append(xp.reshape(normal[int(row[0])] @ normal[int(row[1])] / row[2], (1,)))
    return xp.concatenate(out)
