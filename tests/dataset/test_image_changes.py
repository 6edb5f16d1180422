"""What is wrong with all images of a session, or with a joint, is said by the one change that explains it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import camera_session
from sessions import misread, with_columns

from bayescal.dataset.cameras import carried, closed_form, flange_poses, projected
from bayescal.dataset.plausibility import explanation
from bayescal.errors import BayescalError

DOCUMENT = SimpleNamespace(where="dataset.yaml: {}".format)
CORNERS = 24


@pytest.fixture(scope="module")
def fixed():
    return camera_session("fixed", images=10, seed=3, placed=False)


@pytest.fixture(autouse=True)
def few_teeth(monkeypatch):
    """Of the horns on other teeth one way only: each is a hand-eye anew."""
    monkeypatch.setattr("bayescal.dataset.plausibility.TEETH", (-15.0, -10.0, -5.0))


def said(session) -> BayescalError:
    found = explanation(session, DOCUMENT)
    assert found is not None
    return found


def with_lens(session, factor):
    (t,) = session.targets
    values = t.values | {key: factor * t.values[key] for key in ("fx", "fy", "cx", "cy")}
    return replace(session, targets=(replace(t, values=values),))


def test_a_calibration_of_another_resolution(fixed):
    problem = said(with_lens(fixed, 0.5))
    assert "the calibration of `cam` is of images 0.5 times as large as these" in problem.what
    assert problem.remedy.startswith("divide fx_px, fy_px, cx_px and cy_px by 0.5")


def test_readings_of_the_image_before():
    fixed = camera_session("fixed", images=16, seed=3, placed=False)
    readings = fixed.measurements.readings.copy()
    half = 9 * CORNERS
    readings[half:] = np.roll(readings[half:], CORNERS, axis=0)
    problem = said(with_columns(fixed, readings=readings))
    assert "images of `cam` fit the joint readings of the image after" in problem.what


def test_lines_that_are_exposed_one_after_another():
    session = camera_session("flange", images=10, seed=3, placed=False)
    session = with_columns(session, velocity=2 * session.measurements.velocity)
    m, rows = session.measurements, np.arange(len(session.measurements.readings))
    found = closed_form(session, 0, rows, m.readings)[2]
    at = m.readings + 3e-5 * m.pixel[:, 1:2] * m.velocity
    pixel = m.pixel.copy()
    t, flanges = session.targets[0], (flange_poses(session, q) for q in (m.readings, at))
    poses = (found.predicted(flange, carried(t)) for flange in flanges)
    before, after = (projected(t, pose, m.pixel[:, 2]) for pose in poses)
    pixel[:, :2] += after - before
    problem = said(with_columns(session, pixel=pixel))
    assert "exposed line by line while the arm moved (rolling shutter, about 30 µs a line)" in problem.what
    assert "with the arm at rest" in problem.remedy
    assert explanation(with_columns(session, pixel=pixel, velocity=None), DOCUMENT) is None


def test_a_horn_on_another_tooth(fixed):
    problem = said(misread(fixed, 5, np.radians(14.4)))
    assert problem.where == "measurements.csv: `j5_deg`"
    assert "the zero of J5 differs by about -14 deg" in problem.what


def test_a_session_without_mistakes_has_no_explanation(fixed):
    assert explanation(fixed, DOCUMENT) is None
