"""Distances of segments from convex shapes: the axis of a capsule from what it may collide with; compiled.

The signed distance from a convex shape is a convex function of the point, negative inside. Along a segment it
has one minimum, which a golden-section search encloses.
"""

from __future__ import annotations

import math

import numpy as np

from bayescal.arm.compiled import compiled
from bayescal.collision.shapes import BALLS, BOX, CYLINDER, HALF_SPACE, Shape

_jit = compiled(error_model="numpy")
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
STEPS = 30  # of the search: the minimum is enclosed to 6e-7 of the segment


@_jit
def point(kind, row, planes, x, y, z):
    """Signed distance, m, of a point from a shape of `kind` with the numbers `row` (see `shapes`)."""
    if kind == BALLS:
        dx, dy, dz = row[3] - row[0], row[4] - row[1], row[5] - row[2]
        x, y, z = x - row[0], y - row[1], z - row[2]
        square = dx * dx + dy * dy + dz * dz
        if square > 0.0:
            part = min(max((x * dx + y * dy + z * dz) / square, 0.0), 1.0)
            x, y, z = x - part * dx, y - part * dy, z - part * dz
        return math.sqrt(x * x + y * y + z * z) - row[6]
    if kind == BOX:
        x, y, z = x - row[9], y - row[10], z - row[11]
        outside, inside = 0.0, -math.inf
        for k in range(3):
            beyond = abs(x * row[k] + y * row[3 + k] + z * row[6 + k]) - row[12 + k]
            inside = max(inside, beyond)
            outside += max(beyond, 0.0) ** 2
        return math.sqrt(outside) + min(inside, 0.0)
    if kind == HALF_SPACE:
        return x * row[0] + y * row[1] + z * row[2] - row[3]
    if kind == CYLINDER:
        x, y, z = x - row[3], y - row[4], z - row[5]
        along = x * row[0] + y * row[1] + z * row[2]
        over = abs(along) - row[6]
        x, y, z = x - along * row[0], y - along * row[1], z - along * row[2]
        beside = math.sqrt(x * x + y * y + z * z) - row[7]
        return math.hypot(max(over, 0.0), max(beside, 0.0)) + min(max(over, beside), 0.0)
    most = -math.inf
    for k in range(int(row[0]), int(row[1])):
        most = max(most, x * planes[k, 0] + y * planes[k, 1] + z * planes[k, 2] - planes[k, 3])
    return most


@_jit
def least(kind, row, planes, a, b):
    """Least signed distance, m, of a segment from `a` to `b` (3,), or less: by 6e-7 of its length."""
    x, y, z = a[0], a[1], a[2]
    dx, dy, dz = b[0] - x, b[1] - y, b[2] - z
    best = point(kind, row, planes, x, y, z)
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length == 0.0:
        return best
    best = min(best, point(kind, row, planes, b[0], b[1], b[2]))
    low, width = 0.0, 1.0
    t, s = 1 - GOLDEN, GOLDEN
    at_t = point(kind, row, planes, x + t * dx, y + t * dy, z + t * dz)
    at_s = point(kind, row, planes, x + s * dx, y + s * dy, z + s * dz)
    for _ in range(STEPS):
        best = min(best, at_t, at_s)
        if at_t < at_s:
            width *= GOLDEN
            at_s = at_t
            t = low + (1 - GOLDEN) * width
            at_t = point(kind, row, planes, x + t * dx, y + t * dy, z + t * dz)
        else:
            low += (1 - GOLDEN) * width
            width *= GOLDEN
            at_t = at_s
            s = low + GOLDEN * width
            at_s = point(kind, row, planes, x + s * dx, y + s * dy, z + s * dz)
    return best - width * length


def distances(shape: Shape, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Signed distances (K,), m, of segments from `a` to `b` (K, 3), m in F0, from a shape; see `least`."""
    row, planes = np.zeros(15), np.zeros((0, 4))
    numbers, planes = shape.numbers
    row[: len(numbers)] = numbers
    return np.array([least(shape.kind, row, planes, p, q) for p, q in zip(a, b, strict=True)])
