"""Small tags far away: a second pose, mirrored about the line of sight, looks nearly the same."""

from dataclasses import replace

import camera_sessions
import numpy as np
import pytest

from bayescal.dataset.cameras import closed_form

HALF = 6e-3
TAG = HALF * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) + np.array([0.1, 0.06, 0.0])


@pytest.mark.parametrize("seed", [3, 5])
def test_flipped_images_do_not_matter(seed, monkeypatch):
    monkeypatch.setattr(camera_sessions, "BOARD", TAG)
    d = camera_sessions.camera_session(images=16, noise=0.5, seed=seed, velocity=False)
    t = d.targets[0]
    d = replace(d, targets=(replace(t, texts={"mount": "flange"}, values=dict(t.values) | {"points": TAG}),))
    _, _, found = closed_form(d, 0, np.arange(len(d.measurements.ids)), d.measurements.readings)
    assert np.linalg.norm(found.on_flange[:, 3] - camera_sessions.ON_FLANGE[:3, 3]) < 15e-3
    assert np.degrees(found.turned).max() < 10
