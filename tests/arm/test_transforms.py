"""Alignments of vectors and points: what they promise where the answer is known, and where there is none."""

import numpy as np
import pytest

from bayescal.arm.transforms import alignment, cross, length, rigid, rigid_alignment, rpy_matrix

TURN = rpy_matrix(np.array([0.4, -1.1, 2.5]))
PLACED = rigid(TURN, np.array([0.3, -2.0, 1.5]))
POINTS = np.random.default_rng(0).normal(size=(7, 3))


def moved(points: np.ndarray) -> np.ndarray:
    return points @ TURN.T + PLACED[:3, 3]


def test_exact_points_give_their_transform():
    np.testing.assert_allclose(rigid_alignment(moved(POINTS), POINTS), PLACED, atol=1e-14)
    np.testing.assert_allclose(alignment(POINTS @ TURN.T, POINTS), TURN, atol=1e-14)


def test_points_of_a_plane_are_not_reflected():
    flat = POINTS * [1, 1, 0]
    np.testing.assert_allclose(rigid_alignment(moved(flat), flat), PLACED, atol=1e-14)
    assert np.linalg.det(rigid_alignment(-POINTS, POINTS)[:3, :3]) == pytest.approx(1.0)


def test_weights_are_those_of_repeated_points():
    to = moved(POINTS) + 0.1 * np.random.default_rng(1).normal(size=(7, 3))
    count = np.array([1, 3, 1, 2, 1, 5, 1])
    repeated = rigid_alignment(np.repeat(to, count, axis=0), np.repeat(POINTS, count, axis=0))
    np.testing.assert_allclose(rigid_alignment(to, POINTS, count.astype(float)), repeated, atol=1e-13)
    assert np.abs(rigid_alignment(to, POINTS) - repeated).max() > 1e-3


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("own", [POINTS[:1], POINTS[:2], np.ones((4, 3)), np.outer([0.0, 1, 2], [1, 2, 3])])
def test_undetermined_alignments_still_bring_the_points_together(own):
    """One point, coincident points, points of a line: any of the best transforms, and no warning."""
    np.testing.assert_allclose(own @ (t := rigid_alignment(moved(own), own))[:3, :3].T + t[:3, 3], moved(own))


@pytest.mark.parametrize("shape", [(3,), (7, 3), (50, 9, 3)])
def test_lengths_and_cross_products_are_those_of_numpy(shape):
    v = np.random.default_rng(0).normal(size=(2, *shape))
    for a, b in (v, np.asfortranarray(v), 1e-9 * v):
        np.testing.assert_array_equal(length(a), np.linalg.norm(a, axis=-1))
        np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
