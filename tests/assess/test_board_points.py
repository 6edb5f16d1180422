"""Points of a board that are off in all images, in fits of sessions whose other errors are noise."""

import re
from dataclasses import replace

import camera_sessions
import numpy as np
import pytest
from camera_sessions import BOARD, camera_session

from bayescal.assess.images import blurred, displaced, lost_images
from bayescal.effects import Circumstances
from bayescal.estimate import estimate
from bayescal.gap.search.cells import of_points
from bayescal.model import Scene, build


def fitted(monkeypatch, board, seed=5, spoilt=()):
    monkeypatch.setattr(camera_sessions, "BOARD", board)
    session = camera_session(images=16, seed=seed, velocity=False)
    session.measurements.pixel[list(spoilt), :2] += 32.0
    return estimate(build(Scene(session), ("geometry",)))


def test_a_misprinted_corner_is_named_with_its_size_although_all_of_it_is_rejected(monkeypatch):
    board = BOARD.copy()
    board[8] += [1e-3, -7e-4, 0.0]
    found = fitted(monkeypatch, board)
    (of,) = displaced(found)
    assert set(found.rejected % len(BOARD)) == {8}
    assert of.shift[8] * [1, 1, 0] == pytest.approx([1e-3, -7e-4, 0.0], abs=5e-5)
    assert "point 8 of the board of `cam` is 1.2 mm from its place in all images" in of.words
    assert f"{of.outliers[8]} of its 16 rows are outliers" in of.words


def test_a_wavy_board_is_not_flat(monkeypatch):
    board = BOARD.copy()
    board[:, 2] += 8e-4 * np.sin(2 * np.pi * board[:, 0] / 0.09) * np.cos(2 * np.pi * board[:, 1] / 0.13)
    (of,) = displaced(fitted(monkeypatch, board))
    assert "the board is not flat" in of.words
    assert np.corrcoef(of.shift[:, 2], board[:, 2])[0, 1] > 0.95


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_noise_and_a_corner_that_is_wrong_once_are_no_error_of_the_board(monkeypatch, seed):
    assert not displaced(fitted(monkeypatch, BOARD, seed, spoilt=(30,)))


def test_blurred_images_are_named():
    session = camera_session(images=16, seed=5, velocity=False)
    assert blurred(estimate(build(Scene(session), ("geometry",)))) == ""
    image = slice(4 * len(BOARD), 5 * len(BOARD))
    session.measurements.pixel[image, :2] += np.random.default_rng(3).normal(0.0, 2.0, (len(BOARD), 2))
    words = blurred(estimate(build(Scene(session), ("geometry",))))
    assert re.search(rf": {session.measurements.stop[image.start]} \d+(\.\d)? times; ", words)


def test_cells_of_a_board_are_random_errors_of_its_points():
    session = camera_session(images=16, seed=5, velocity=False)
    c: Circumstances = Scene(session).circumstances()
    made = list(of_points(c))
    assert [cell.driver.form for cell in made] == ["heights", "places", "places"]
    for cell in made:
        assert np.array_equal(cell.clusters, session.measurements.pixel[:, 2])
        assert cell.driver.text.endswith("of each of its points")


def test_an_image_of_which_most_corners_are_rejected_is_named():
    session = camera_session(images=16, seed=2)
    pixel = session.measurements.pixel.copy()
    rows = np.flatnonzero(session.measurements.stop == "i5")
    assert lost_images(estimate(build(Scene(session), ("geometry",)))) == ""
    pixel[rows, :2] += 15.0  # another part of the sensor
    spoilt = replace(session, measurements=replace(session.measurements, pixel=pixel))
    assert "i5 (24 of 24)" in lost_images(estimate(build(Scene(spoilt), ("geometry",))))
