"""A blurred image has the noise of its own scatter; others, and a single wild corner, do not."""

from dataclasses import replace

import numpy as np
from camera_sessions import BOARD, camera_session

from bayescal.dataset.cameras import blur


def test_a_blurred_image():
    session = camera_session(images=15)
    m, count = session.measurements, len(BOARD)
    pixel = m.pixel.copy()
    noise = np.random.default_rng(3).standard_normal((count, 2))
    pixel[4 * count : 5 * count, :2] += 2.0 * noise
    pixel[9 * count, :2] += 8.0
    factor = blur(replace(session, measurements=replace(m, pixel=pixel)), 0, np.arange(len(pixel)))
    of_image = factor.reshape(15, count)
    assert np.all(of_image == of_image[:, :1])
    assert 5 < of_image[4, 0] < 16  # 10 times the noise of 0.2 px
    assert np.all(np.delete(of_image[:, 0], 4) == 1.0)
