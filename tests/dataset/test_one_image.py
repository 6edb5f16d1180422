"""Mistakes of single images, and lenses that are stated roughly or are of another camera."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import SIZE, camera_session
from sessions import misread, with_columns, with_rows

from bayescal.dataset import read_dataset, write_dataset
from bayescal.dataset.image_changes import by_corners, impossible, odd_images
from bayescal.dataset.image_checks import misfit
from bayescal.dataset.plausibility import explanation
from bayescal.errors import BayescalError

DOCUMENT = SimpleNamespace(where="dataset.yaml: {}".format)
CORNERS = 24


@pytest.fixture(scope="module")
def session():
    return camera_session(images=8, seed=3, placed=False)


def refused(session, folder) -> str:
    write_dataset(session, folder / "cell")
    with pytest.raises(BayescalError) as caught:
        read_dataset(folder / "cell")
    return str(caught.value)


def with_pixel(session, spoil, rows=slice(None)):
    pixel = session.measurements.pixel.copy()
    spoil(pixel[rows])
    return with_columns(session, pixel=pixel)


def reverse(pixel):
    pixel[:, 2] = CORNERS - 1 - pixel[:, 2]


def halve(pixel):
    pixel[:, :2] *= 0.5


def test_a_point_that_is_twice_in_an_image(session, tmp_path):
    def double(pixel):
        pixel[77, 2] = pixel[76, 2]

    text = refused(with_pixel(session, double), tmp_path)
    assert "measurements.csv:79: point 4 is twice in image `i3` (as row `i3c4`)" in text


def test_an_image_that_is_numbered_from_the_other_end(session, tmp_path):
    text = refused(with_pixel(session, reverse, slice(120, 144)), tmp_path)
    assert "impossible image" in text
    assert "(image `i5`, 24 rows: its corners are numbered from the other end)" in text
    assert "number the corners of this image as those of the others" in text


def test_an_image_that_nothing_explains(session):
    spoilt = misread(session, 2, 0.5, slice(120, 144))
    said, explained, remedy = impossible(spoilt, np.array([120]), np.array([0.1]))
    assert said == " (image `i5`, 24 rows)"
    assert not explained
    assert "calibration of the camera and its u" in remedy


def test_an_image_of_another_size():
    lens = {"distortion": np.array([-0.2, 0.05, 0.0, 0.0, 0.0])}
    plain = camera_session(images=8, seed=3, placed=False)
    target = replace(plain.targets[0], values=plain.targets[0].values | lens)
    distorted = replace(plain, targets=(target,))
    from bayescal.dataset.cameras import lens_of

    def distort(pixel):
        xy = (pixel[:, :2] - lens_of(target).centre) / lens_of(target).focal
        pixel[:, :2] = lens_of(target).pixels(xy.T).T

    whole = with_pixel(distorted, distort)
    assert not list(odd_images(whole, 0))
    (odd,) = odd_images(with_pixel(whole, halve, slice(120, 144)), 0)
    assert odd.name == "`i5`"
    assert "multiplied by 2" in odd.what


def test_columns_of_pixels_that_are_interchanged(session, tmp_path):
    text = refused(with_columns(session, pixel=session.measurements.pixel[:, [1, 0, 2]]), tmp_path)
    assert "with both columns interchanged all corners are inside" in text
    assert "exchange the headings `u_px`" in text


def test_the_board_with_columns_and_rows_interchanged(session, tmp_path):
    (t,) = session.targets
    turned = replace(t, texts=dict(t.texts) | {"board": "charuco:5x7:30mm:22mm"})
    text = refused(replace(session, targets=(turned,)), tmp_path)
    assert "write `board: charuco:7x5:30mm:22mm`" in text
    assert "%" not in text


def test_joints_that_hardly_move(session, tmp_path):
    text = refused(with_columns(session, readings=1e-3 * session.measurements.readings), tmp_path)
    assert "no joint reading varies by more than" in text
    assert "are the readings deg" in text


def rough(session, by, **u):
    (t,) = session.targets
    values = t.values | {key: t.values[key] + by.get(key, 0.0) for key in ("fx", "fy", "cx", "cy")} | u
    return replace(session, targets=(replace(t, values=values),))


def test_a_lens_within_its_stated_uncertainty_makes_no_image_impossible(session):
    other, rows = {"fx": 50.0, "fy": -20.0, "cx": 40.0, "cy": -30.0}, np.arange(len(session.measurements.ids))
    readings = session.measurements.readings
    stated = rough(session, other, u_focal=20.0, u_centre=15.0)
    assert misfit(rough(session, other, u_focal=1.0, u_centre=1.0), 0, rows, readings).max() > 0.05
    assert misfit(stated, 0, rows, readings).max() < 0.02


def test_a_lens_of_cropped_images_is_named(session):
    problem = explanation(rough(session, {"cy": 120.0}), DOCUMENT)
    assert problem is not None
    assert "another lens or part of the sensor: cy 3" in problem.what
    assert f"stated {SIZE[1] / 2 + 120:.0f} (u 3)" in problem.what


def test_a_lens_of_cropped_images_is_no_board_of_another_size(session, tmp_path):
    write_dataset(rough(session, {"cx": 100.0}), tmp_path / "cell")
    read_dataset(tmp_path / "cell")


def test_an_image_of_a_small_tag_is_where_its_corners_are():
    """Its own pose is the mirrored one; its corners are as near to those that the arm predicts as others."""
    some = camera_session(images=25, seed=12, arm=[0, 2e-3, -2e-3, 2e-3, -2e-3, 0], noise=0.5, placed=False)
    tag = with_rows(some, np.flatnonzero(np.isin(some.measurements.pixel[:, 2], [0, 1, 6, 7])))
    m = tag.measurements
    rows = np.arange(len(m.ids))
    assert by_corners(tag, 0, rows, misfit(tag, 0, rows, m.readings)).max() < 0.02
