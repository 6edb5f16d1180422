"""Variances of families from residuals of a made linear problem with a known discrepancy."""

import numpy as np
import pytest
from chances import least, most

import bayescal.estimate.moments as size_module
from bayescal.estimate.moments import degrees_of_freedom, variances, within_poses

ROWS, FIRST, SECOND = 600, 12, 8
FAMILY = np.repeat([0, 1], [FIRST, SECOND])


def problem(seed, size, pose=None, shared=0.0):
    """Columns and residuals of a fit by 20 parameters: functions of variances `size` and noise of one."""
    rng = np.random.default_rng(seed)
    pose = np.arange(ROWS) if pose is None else pose
    t = rng.uniform(-1, 1, (ROWS, 2))
    g = np.column_stack(
        [np.cos(np.pi * k * t[:, [0]]) for k in range(1, FIRST + 1)]
        + [np.cos(np.pi * k * t[:, [1]]) for k in range(1, SECOND + 1)]
    )
    j = rng.standard_normal((ROWS, 20))
    d = rng.standard_normal(FIRST + SECOND) * np.sqrt(np.asarray(size)[FAMILY])
    noise = rng.standard_normal(ROWS) + shared * rng.standard_normal(pose.max() + 1)[pose]
    project = np.eye(ROWS) - j @ np.linalg.pinv(j)
    return project @ g, project @ (g @ d + noise), pose


def sizes(size, **how):
    found = [variances(*problem(seed, size, **how), FAMILY, ROWS - 20, 0.025) for seed in range(40)]
    return np.array(found)


def test_the_variances_of_two_families_are_found_on_average():
    found = sizes([0.5, 0.2])
    assert np.mean(found[:, 0]) == pytest.approx(0.5, rel=0.15)
    assert np.mean(found[:, 1]) == pytest.approx(0.2, rel=0.25)


def test_an_error_that_the_rows_of_a_pose_share_is_no_discrepancy():
    pose = np.repeat(np.arange(ROWS // 6), 6)
    assert np.mean(sizes([0.0, 0.0], pose=pose, shared=2.0) > 0) < 0.08


def test_products_within_poses_of_any_size_are_summed():
    rng = np.random.default_rng(1)
    h, pose = rng.standard_normal((30, 4)), np.sort(rng.integers(0, 12, 30))
    pose = np.unique(pose, return_inverse=True)[1]
    by_hand = sum((h[pose == p].T @ h[pose == p]) ** 2 for p in np.unique(pose))
    np.testing.assert_allclose(within_poses(h, pose), by_hand)


@pytest.mark.parametrize("at_once", [1, 7])
def test_poses_in_parts_give_the_same_variances(at_once, monkeypatch):
    pose = np.unique(np.random.default_rng(2).integers(0, 300, ROWS), return_inverse=True)[1]
    given = (*problem(0, [0.5, 0.2], pose=pose), FAMILY, ROWS - 20, 0.025)
    whole = variances(*given)
    assert np.all(whole > 0)
    monkeypatch.setattr(size_module, "AT_ONCE", at_once)
    np.testing.assert_allclose(variances(*given), whole, rtol=1e-9)


def few_poses(seed, size):
    """Six functions at sixteen poses of three rows each, a quarter of which the fit takes up."""
    rng, pose = np.random.default_rng(seed), np.repeat(np.arange(16), 3)
    t, j = np.repeat(rng.uniform(0, 1, 16), 3), rng.standard_normal((48, 12))
    g, project = np.cos(np.pi * np.outer(t, np.arange(1, 7))), np.eye(48) - j @ np.linalg.pinv(j)
    e = project @ (g @ (np.sqrt(size) * rng.standard_normal(6)) + rng.standard_normal(48))
    return project @ g, e, pose


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_the_moment_equation_counts_poses_not_rows(size):
    found = [variances(*few_poses(seed, size), np.zeros(6, int), 36, 1.0)[0] for seed in range(400)]
    assert 0.75 < np.mean(found) / size < 1.05


def test_noise_has_a_family_as_often_as_its_level():
    """The chance holds with few degrees of freedom too: of 48 residuals the fit takes up 12."""
    found = [variances(*few_poses(seed, 0.0), np.zeros(6, int), 36, 0.3)[0] > 0 for seed in range(400)]
    assert least(400, 0.25) <= np.sum(found) <= most(400, 0.3)


def test_degrees_of_freedom_are_those_of_drawn_scores():
    h, _, _ = few_poses(0, 1.0)
    square = np.sum((h.T @ h @ np.random.default_rng(0).standard_normal((6, 20_000))) ** 2, axis=0)
    assert degrees_of_freedom(h) == pytest.approx(2.0 * np.mean(square) ** 2 / np.var(square), rel=0.07)
