"""Distances of many segments from a shape, by the compiled function of one."""

import numpy as np

from bayescal.arm.shapes import Shape
from bayescal.probing.sweep import least


def distances(shape: Shape, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Signed distances (K,), m, of segments from `a` to `b` (K, 3), m in F0, from a shape."""
    numbers, planes = shape.numbers
    row = np.append(numbers, np.zeros(15 - len(numbers)))
    return np.array([least(shape.kind, row, planes, p, q) for p, q in zip(a, b, strict=True)])
