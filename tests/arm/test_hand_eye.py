"""Closed forms for cameras: exact without noise, and hardly moved by a bad image."""

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayescal.arm.hand_eye import angle, board_poses, decided, half_turns, hand_eye, inverse, product

RNG = np.random.default_rng(0)
IMAGES = 30


def poses(count, turn, low, high):
    matrices = Rotation.from_rotvec(turn * RNG.standard_normal((count, 3))).as_matrix()
    return np.concatenate([matrices, RNG.uniform(low, high, (count, 3))[..., None]], axis=2)


ON_FLANGE, FIXED = poses(2, 1.0, [-0.1, 0, 0.05], [0.1, 0.1, 0.2])
FLANGE = poses(IMAGES, 1.0, [-0.5, -0.5, 0.1], [0.5, 0.5, 0.9])
SEEN = product(inverse(FIXED), product(FLANGE, ON_FLANGE))


def test_hand_eye_is_exact():
    found = hand_eye(FLANGE, SEEN)
    np.testing.assert_allclose(found.on_flange, ON_FLANGE, atol=1e-12)
    np.testing.assert_allclose(found.fixed, FIXED, atol=1e-12)
    assert found.determined


def test_a_bad_image_hardly_matters():
    seen = SEEN.copy()
    seen[3] = SEEN[11]
    found = hand_eye(FLANGE, seen)
    np.testing.assert_allclose(found.on_flange, ON_FLANGE, atol=1e-9)
    assert np.argmax(found.off) == 3


def test_rotations_about_one_axis_do_not_determine_it():
    flange = FLANGE.copy()
    flange[:, :, :3] = Rotation.from_rotvec(np.outer(RNG.uniform(-2, 2, IMAGES), [0, 0.6, 0.8])).as_matrix()
    assert not hand_eye(flange, product(inverse(FIXED), product(flange, ON_FLANGE))).determined


@pytest.mark.parametrize("depth", [0.0, 0.03], ids=["flat", "solid"])
def test_poses_of_a_board(depth):
    board = np.array([[0.03 * x, 0.03 * y, depth * (x == y)] for y in range(4) for x in range(6)])
    true = poses(IMAGES, 0.4, [-0.1, -0.1, 0.5], [0.1, 0.1, 0.9])
    image, corner = np.repeat(np.arange(IMAGES), len(board)), np.tile(board, (IMAGES, 1))
    at = np.einsum("rij,rj->ri", true[image, :, :3], corner) + true[image, :, 3]
    xy = at[:, :2] / at[:, 2:]
    np.testing.assert_allclose(board_poses(corner, xy, image), true, atol=1e-9)
    order = RNG.permutation(len(image))
    np.testing.assert_allclose(board_poses(corner[order], xy[order], image[order]), true, atol=1e-9)
    xy[5] += 0.05  # a corner that is taken for another
    np.testing.assert_allclose(board_poses(corner, xy, image)[0], true[0], atol=5e-3)
    with warnings.catch_warnings(action="error"):
        once = np.where((image == 0)[:, None], 0.0, xy)  # all corners of an image at one place
        assert np.isnan(board_poses(corner, once, image)[0]).all()
    few = (image > 0) | (np.arange(len(image)) < 3)
    assert np.isnan(board_poses(corner[few], xy[few], image[few])[0]).all()


def test_the_arm_decides_between_two_poses_of_a_small_tag_seen_from_afar():
    rng = np.random.default_rng(2)
    tag = 0.02 * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    turns = Rotation.from_euler("xy", rng.uniform(-0.5, 0.5, (60, 2))).as_matrix()
    true = np.concatenate([turns, np.tile([[0.1], [0.0], [1.0]], (60, 1, 1))], axis=2)
    image, corner = np.repeat(np.arange(60), 4), np.tile(tag, (60, 1))
    at = np.einsum("rij,rj->ri", true[image, :, :3], corner) + true[image, :, 3]
    xy = at[:, :2] / at[:, 2:] + 0.5 / 900 * rng.standard_normal((240, 2))
    alone = board_poses(corner, xy, image)
    wrong = angle(alone, true) > 0.25
    assert np.sum(wrong) > 10
    near = true.copy()
    near[:, :, :3] = Rotation.from_rotvec(0.02 * rng.standard_normal((60, 3))).as_matrix() @ turns
    shuffled = rng.permutation(240)
    told = decided(alone, near, corner[shuffled], xy[shuffled], image[shuffled])
    assert np.sum(angle(told, true) > 0.25) < 0.2 * np.sum(wrong)
    # an image that tells is not overruled
    sharp = at[:, :2] / at[:, 2:] + 0.001 / 900 * rng.standard_normal((240, 2))
    alone = board_poses(corner, sharp, image)
    np.testing.assert_allclose(decided(alone, inverse(near), corner, sharp, image), alone, atol=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.45])
def test_images_that_are_numbered_from_the_other_end(share):
    rng = np.random.default_rng(5)
    turned = rng.random(IMAGES) < share
    seen, noise = inverse(SEEN), Rotation.from_rotvec(0.01 * rng.standard_normal((IMAGES, 3))).as_matrix()
    other_end = np.where(turned[:, None, None], np.diag([-1.0, -1, 1]), np.eye(3))
    seen[:, :, :3] = noise @ seen[:, :, :3] @ other_end
    np.testing.assert_array_equal(half_turns(FLANGE, seen), turned)
    np.testing.assert_array_equal(half_turns(FLANGE, inverse(SEEN)), False)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_too_few_corners_have_no_pose(count):
    corner = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])[:count]
    poses = board_poses(corner, corner[:, :2], np.zeros(count, int))
    assert poses.shape == (1, 3, 4)
    assert np.isnan(poses).all()
