"""Lenses against OpenCV, and the inverse of a distortion."""

from dataclasses import replace

import numpy as np
import pytest
from camera_sessions import pose

from factors.camera import FISHEYE, PINHOLE, Camera, Lens

FOCAL, CENTRE = np.array([910.0, 905.0]), np.array([645.0, 355.0])
LENSES = [
    Lens(PINHOLE, FOCAL, CENTRE, np.array([-0.2, 0.05, 1e-3, -5e-4, 0.01])),
    Lens(FISHEYE, 0.5 * FOCAL, CENTRE, np.array([0.03, -0.01, 4e-3, -1e-3])),
]


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_a_distortion_is_undone(lens):
    pixel = np.random.default_rng(0).uniform([100, 50], [1180, 670], (50, 2)).T
    np.testing.assert_allclose(lens.pixels(lens.directions(pixel)), pixel, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_derivatives_by_coefficients(lens):
    xy = np.random.default_rng(1).uniform(-0.4, 0.4, (2, 30))
    by = lens.by_coefficients(xy)
    for k, step in enumerate(1e-6 * np.eye(len(lens.coefficients))):
        up, down = (replace(lens, coefficients=lens.coefficients + way * step) for way in (1, -1))
        np.testing.assert_allclose(by[k], (up.distorted(xy) - down.distorted(xy)) / 2e-6, atol=1e-9)


@pytest.mark.parametrize("carried", [False, True])
@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_pixels_are_those_of_opencv(lens, carried):
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(2)
    corner = np.column_stack([rng.uniform(-0.1, 0.1, (20, 2)), 0.01 * rng.standard_normal(20)])
    fixed, tool = pose([170, 5, 20], [0.5, 0.1, 0.6]), pose([3, -4, 30], [0.5, 0.12, 0.1])
    if carried:
        fixed, tool = tool, fixed
    camera, board = (tool, fixed) if carried else (fixed, tool)
    seen = np.linalg.inv(camera) @ board
    kind = Camera(fixed, np.zeros(3), corner, np.zeros((20, 2)), lens, np.ones(20), np.ones(6), carried)
    own = kind.pixels(np.zeros(6), np.repeat(tool[:3, :, None], 20, axis=2))
    matrix = np.array([[lens.focal[0], 0, lens.centre[0]], [0, lens.focal[1], lens.centre[1]], [0, 0, 1]])
    project = cv2.fisheye.projectPoints if lens.model == FISHEYE else cv2.projectPoints
    turn, shift = cv2.Rodrigues(seen[:3, :3])[0], seen[:3, 3].reshape(3, 1).copy()
    points = project(corner.reshape(-1, 1, 3), turn, shift, matrix, lens.coefficients)[0]
    np.testing.assert_allclose(own.T, points.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("carried", [False, True])
def test_corners_of_one_image_share_its_pose(carried):
    rng, image = np.random.default_rng(3), np.array([0, 0, 1, 1, 1, 2])
    corner = np.append(rng.uniform(-0.1, 0.1, (5, 2)), np.zeros((5, 1)), axis=1)[[0, 1, 0, 4, 3, 2]]
    fixed, ones = pose([170, 5, 20], [0.5, 0.1, 0.6]), np.ones(6)
    each = Camera(fixed, np.zeros(3), corner, rng.normal(size=(6, 2)), LENSES[0], ones, ones, carried)
    x = 0.01 * rng.normal(size=(2, 6))
    poses = np.array([pose([3, -4, k], [0.5, 0.1, 0.1])[:3] for k in range(3)])
    of_images, of_corners = np.moveaxis(poses, 0, -1), np.moveaxis(poses[image], 0, -1)
    of = replace(each, image=image)
    np.testing.assert_allclose(of.residual(x, of_images), each.residual(x, of_corners), atol=1e-9)
