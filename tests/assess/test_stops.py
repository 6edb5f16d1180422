"""The measurements of one stop of the arm (corners of an image) are one piece of evidence."""

import numpy as np
import pytest
from camera_sessions import camera_session
from sessions import with_columns

from bayescal.assess.shared_causes import Group, shared, shared_causes
from bayescal.estimate import estimate
from bayescal.model import Scene, build

IMAGES, CORNERS = 40, 24


@pytest.fixture(scope="module")
def session():
    return camera_session(images=IMAGES, seed=3, velocity=False)


def blurred(session, images):
    """The fit of a session with blurred images: corners displaced in one direction, by different amounts."""
    pixel = session.measurements.pixel.copy()
    for i in images:
        size = 3.0 + 2.0 * np.random.default_rng(i).standard_normal((CORNERS, 1))
        pixel[CORNERS * i :][:CORNERS, :2] += size * np.array([0.6, 0.8])
    return estimate(build(Scene(with_columns(session, pixel=pixel)), ("geometry",)))


def test_corners_of_one_image_share_no_cause(session):
    found = blurred(session, [11])
    assert len(found.rejected) > 6
    assert set(found.rejected // CORNERS) == {11}
    assert not shared_causes(found)


def test_corners_of_many_images_share_one_and_a_slip_is_before_an_image(session):
    causes = {c.kind: c for c in shared_causes(blurred(session, range(34, IMAGES)))}
    for cause in causes.values():
        assert len(np.unique(cause.rows // CORNERS)) >= 3
    assert "from row i34c0 on" in causes["slip"].label


def test_stops_and_not_rows_are_dealt():
    """Six of 14 rejected rows are of one stop: by rows the stretch of time would be a cause."""
    rows = np.arange(480)
    rejected = np.isin(rows, [*range(240, 246), 20, 70, 120, 170, 290, 340, 390, 440])
    stretches = [Group("stretch of time", f"{a}", rows[a : a + 24]) for a in range(0, 480, 24)]
    stops = rows // 24
    assert shared(stretches, rows, rejected)
    assert not shared(stretches, rows, rejected, stops=stops)
    # a group of one row of each stop is tested as it was
    (own,) = shared([Group("target", "third", rows[2::24]), *stretches], rows, rows % 24 == 2, stops=stops)
    assert own.label == "third"


def test_stops_at_random_share_nothing():
    rows, found = np.arange(480), 0
    groups = [Group("stretch of time", f"{a}", rows[a : a + 96]) for a in range(0, 480, 48)]
    for seed in range(150):
        rng = np.random.default_rng(seed)
        wrong = rng.choice(20, 4 + seed % 8, replace=False)
        rejected = np.isin(rows // 24, wrong) & (
            rng.random(480) < rng.choice([0.05, 0.5, 1.0], 20)[rows // 24]
        )
        found += bool(shared(groups, rows, rejected, seed, rows // 24))
    assert found <= 4
