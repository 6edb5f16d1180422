"""A blurred image has the noise of its own scatter; others, and a single wild corner, do not."""

from dataclasses import replace

import numpy as np
import pytest
from camera_sessions import BOARD, camera_session

from bayescal.dataset.cameras import blur, images, stated


def test_a_blurred_image():
    session = camera_session(images=15)
    m, count = session.measurements, len(BOARD)
    pixel = m.pixel.copy()
    pixel[4 * count : 5 * count, :2] += 2.0 * np.random.default_rng(3).standard_normal((count, 2))
    pixel[9 * count, :2] += 8.0
    factor = blur(replace(session, measurements=replace(m, pixel=pixel)), 0, np.arange(len(pixel)))
    of_image = factor.reshape(15, count)
    assert np.all(of_image == of_image[:, :1])
    assert 5 < of_image[4, 0] < 16  # 10 times the noise of 0.2 px
    assert np.all(np.delete(of_image[:, 0], 4) == 1.0)


@pytest.mark.parametrize("noise", [0.1, 0.4])
def test_the_scatter_of_images_is_their_noise(noise):
    """In px, whatever the board: the pose of an image takes up a part of it."""
    session = camera_session(images=40, noise=noise)
    rows = np.arange(len(session.measurements.ids))
    assert np.mean(images(session, 0, rows).scatter) == pytest.approx(noise, rel=0.1)
    some = rows[np.isin(rows % len(BOARD), (0, 2, 5, 9, 13, 18, 20, 23))]  # a third of the corners
    assert np.mean(images(session, 0, some).scatter) == pytest.approx(noise, rel=0.15)


def test_usual_uncertainties_of_a_lens_are_those_of_an_image_of_any_resolution():
    """Of focal lengths, in proportion to them; a stated one is kept, for both axes or for each."""
    (target,) = camera_session(images=3).targets

    def of(**values):
        return stated(replace(target, values=dict(target.values) | values)).focal

    fx, fy = target.values["fx"], target.values["fy"]
    assert of(fx=3.0 * fx, fy=2.0 * fy) == pytest.approx([3.0, 2.0] * of())
    assert of() / [fx, fy] == pytest.approx([1e-2, 1e-2], rel=0.99)  # between a ten-thousandth and 2 %
    assert of(u_focal=1.5) == pytest.approx([1.5, 1.5])
