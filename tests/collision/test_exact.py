"""Distances of capsules by hand, and against those of many points of their axes."""

import numpy as np
import pytest

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.probing.shapes import FIXED, Ball, Box, Capsule, HalfSpace
from bayescal.probing.sweep import distances


def capsule(a, b, radius: float) -> Capsule:
    return Capsule(FIXED, np.array(a, float), np.array(b, float), radius)


def distance(first: Capsule, other) -> float:
    return float(distances(other, first.a[None], first.b[None])[0]) - first.radius


ROD = capsule([0, 0, 0], [1, 0, 0], 0.1)
CUBE = Box(rigid(None, np.array([0.5, 0.0, 2.0])), np.array([0.5, 0.5, 0.5]))
TURNED = Box(rigid(rpy_matrix(np.array([0, 0, np.pi / 4])), np.array([3.0, 0, 0])), np.array([1.0, 1.0, 1.0]))


@pytest.mark.parametrize(
    ("first", "other", "expected"),
    [
        (ROD, capsule([0.5, -1, 0.7], [0.5, 1, 0.7], 0.2), 0.4),  # crossing segments
        (ROD, capsule([2, 1, 0], [2, 3, 0], 0.2), np.sqrt(2) - 0.3),  # end to end
        (ROD, capsule([0.2, 0.5, 0], [0.8, 0.5, 0], 0.3), 0.1),  # parallel
        (ROD, capsule([0.2, 0.3, 0], [0.8, 0.3, 0], 0.3), -0.1),
        (ROD, CUBE, 1.4),  # along a face
        (capsule([2, 1, 0], [2, 1, 1], 0.1), CUBE, np.sqrt(1 + 0.25 + 0.25) - 0.1),  # end to corner
        (ROD, TURNED, 2 - np.sqrt(2) - 0.1),  # end to edge
        (ROD, Ball(np.array([0.3, 0.4, 0]), 0.1), 0.2),
        (ROD, Ball(np.array([1.3, 0.4, 0]), 0.1), 0.3),
        (capsule([0, 0, 0], [0, 0, 0], 0.1), Ball(np.array([0.3, 0.4, 0]), 0.1), 0.3),  # a ball
        (capsule([0, 0, 0.3], [0, 1, 0.9], 0.1), HalfSpace(np.array([0, 0, 1.0]), 0.05), 0.15),
        (capsule([0, 0, -0.3], [0, 1, 0.9], 0.1), HalfSpace(np.array([0, 0, 1.0]), 0.05), -0.45),
    ],
)
def test_distances_by_hand(first, other, expected):
    assert distance(first, other) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("kind", ["box", "ball", "capsule", "half space"])
def test_distances_by_many_points(kind):
    rng = np.random.default_rng(3)
    part = np.linspace(0, 1, 2001)[:, None]
    for _ in range(60):
        a, b = rng.uniform(-1, 1, (2, 3))
        first = capsule(a, b, rng.uniform(0.02, 0.2))
        other = {
            "box": Box(
                rigid(rpy_matrix(rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3)), rng.uniform(0.1, 0.5, 3)
            ),
            "ball": Ball(rng.uniform(-1, 1, 3), 0.2),
            "capsule": capsule(*rng.uniform(-1, 1, (2, 3)), 0.1),
            "half space": HalfSpace(rpy_matrix(rng.uniform(-3, 3, 3))[0], -0.5),
        }[kind]
        near = float(other.distance(a + part * (b - a)).min()) - first.radius
        found = distance(first, other)
        if near > 0:  # a deep overlap has a distance of its own, to leave the other
            assert found == pytest.approx(near, abs=2e-6 + 2e-3 * np.linalg.norm(b - a) ** 2 / 8)
        assert (found < 0) == (near < 0) or abs(near) < 1e-4
