"""Certified coordinates: against a fit of pose and coordinates as unknowns, differences and draws."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from factors.certificate import CORRELATION, certified_points, form_of, shape
from factors.contacts import FixedPoint

PLATE = np.array([(x, y, 0.0) for x in (0.0, 0.15, 0.3) for y in (0.0, 0.2)])
"""Balls in a plane: no distance between them tells, to first order, that one lies above it."""
BODY = np.array([(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.0, 0.15, 0.0), (0.05, 0.05, 0.1)])
LINE = np.array([(0.0, 0.0, 0.0), (0.3, 0.3, 0.0), (0.1, 0.1, 0.0), (0.2, 0.2, 0.0)])
FORMS = {"plate": PLATE, "body": BODY, "line": LINE, "pair": LINE[:2], "three": BODY[:3]}


def spread(count: int, seed: int = 3) -> np.ndarray:
    """A full covariance of coordinates, m2, of some micrometres."""
    mixed = np.random.default_rng(seed).normal(size=(3 * count, 3 * count)) * 1e-6
    return mixed @ mixed.T


def posed(points: np.ndarray, seed: int) -> np.ndarray:
    turn = Rotation.random(random_state=seed).as_matrix()
    return points @ turn.T + np.random.default_rng(seed).normal(size=3)


def seats(points: np.ndarray) -> list[FixedPoint]:
    return [FixedPoint(p, np.full(3, 0.05)) for p in points]


def one_placement(points: np.ndarray) -> list[list[tuple[int, int]]]:
    return [[(k, k) for k in range(len(points))]]


def chi_squared(certified: np.ndarray, covariance: np.ndarray, seen: np.ndarray) -> float:
    """Smallest chi-squared of true coordinates whose rigid image is exactly `seen`, over all poses."""
    left = np.linalg.cholesky(covariance)
    u, _, v = np.linalg.svd((certified - certified.mean(axis=0)).T @ (seen - seen.mean(axis=0)))
    start = Rotation.from_matrix(u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v)

    def off(pose: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(pose[:3]) * start
        true = turn.apply(seen - seen.mean(axis=0)) + certified.mean(axis=0) + pose[3:] * 1e-3
        return np.linalg.solve(left, (true - certified).ravel())

    return float(np.sum(least_squares(off, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15).fun ** 2))


@pytest.mark.parametrize("name", ["plate", "body", "three", "pair"])
def test_as_a_fit_of_pose_and_coordinates(name):
    certified = FORMS[name]
    covariance = spread(len(certified))
    rng = np.random.default_rng(5)
    for seed in range(4):
        true = certified + (np.linalg.cholesky(covariance) @ rng.normal(size=certified.size)).reshape(-1, 3)
        seen = posed(true, seed)
        relation = certified_points(shape(certified, covariance, one_placement(certified)), seats(seen))
        r, _ = relation(*np.zeros((len(seen), 3)))
        assert len(r) == max(3 * len(certified) - 6, 1)
        assert np.sum(r**2) == pytest.approx(chi_squared(certified, covariance, seen), rel=1e-3)


def test_points_of_a_line_are_their_lengths():
    certified = LINE
    along = np.sort(certified @ [1, 1, 0] / np.sqrt(2))
    seen = posed(certified + np.outer([0, 1, 0, 0], [2e-6, 2e-6, 5e-6]), 1)
    told, by = form_of(certified)[0](seen)
    assert told == pytest.approx([0, 0, np.sqrt(8) * 1e-6], abs=1e-9)
    assert form_of(certified)[1].reshape(3, -1) @ certified.ravel() == pytest.approx(np.diff(along))
    assert by.shape == (3, 4, 3)


@pytest.mark.parametrize("name", FORMS)
def test_slopes_and_stacks(name):
    """Slopes by differences, also far from the certified form; leading axes are carried along."""
    certified = FORMS[name]
    targets = seats(posed(certified, 2))
    relation = certified_points(shape(certified, spread(len(certified)), one_placement(certified)), targets)
    x = np.random.default_rng(1).normal(size=(len(certified), 2, 3)) * 3e-3
    r, slopes = relation(*x)
    assert r.shape == (2, max(3 * len(certified) - 6, 1) if name != "line" else 3)
    for k, slope in enumerate(slopes):
        for axis in range(3):
            step = np.zeros_like(x)
            step[k, :, axis] = 1e-7
            difference = (relation(*(x + step))[0] - relation(*(x - step))[0]) / 2e-7
            atol = 1e-4 * np.abs(slope).max()
            np.testing.assert_allclose(slope[..., axis], difference, rtol=2e-5, atol=atol)


def test_an_error_of_a_coordinate_moves_the_residual_as_it_says():
    certified, covariance = BODY, spread(4)
    of = shape(certified, covariance, one_placement(certified))
    wrong = certified.copy()
    wrong[2, 1] += 1e-6
    r, _ = certified_points(of, seats(posed(wrong, 4)))(*np.zeros((4, 3)))
    np.testing.assert_allclose(r, of.by_coordinate[:, 3 * 2 + 1] * 1e-6, rtol=1e-3, atol=1e-3)


def test_draws_of_two_placements():
    """A common error of the coordinates and an own one of each placement: chi-squared of all relations."""
    certified, covariance = PLATE, spread(6)
    # two balls are hidden at the second placement
    of = shape(certified, covariance, [[(k, k) for k in range(6)], [(6 + k, k) for k in range(4)]])
    left, rng, found = np.linalg.cholesky(covariance), np.random.default_rng(8), []
    for seed in range(400):
        common, *own = (left @ rng.normal(size=(18, 3))).T
        errors = (np.sqrt(CORRELATION) * common + np.sqrt(1 - CORRELATION) * e for e in own)
        seen = [posed(certified + error.reshape(-1, 3), seed) for error in errors]
        r, _ = certified_points(of, seats(np.concatenate([seen[0], seen[1][:4]])))(*np.zeros((10, 3)))
        found.append(float(np.sum(r**2)))
    assert kstest(found, chi2(12 + 6).cdf).pvalue > 0.01


def test_exact_directions_of_a_datum_are_no_obstacle():
    """Coordinates stated from three points as datum: six of them are exact."""
    covariance = np.diag(np.array([0, 0, 0, 1, 0, 0, 1, 1, 0, 1, 1, 1]) * 1e-12)
    seen = posed(BODY + np.outer([0, 1, 0, 0], [3e-6, 0, 0]), 3)
    r, _ = certified_points(shape(BODY, covariance, one_placement(BODY)), seats(seen))(*np.zeros((4, 3)))
    assert np.sum(r**2) == pytest.approx(9, rel=1e-2)
