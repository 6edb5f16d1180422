"""Sessions with cameras: read and written, placed by their rows, and what is refused."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import BOARD, FIXED, ON_FLANGE, SIZE, camera_session
from cases import cases, refused

from bayescal.dataset import read_dataset, write_dataset
from bayescal.dataset.cameras import board, board_of, closed_form, lens_of
from bayescal.dataset.image_checks import LARGEST, SMALLEST, misfit, region


def written(dataset, folder):
    write_dataset(dataset, folder / "cell")
    return folder / "cell"


@pytest.mark.parametrize("mount", FIXED)
def test_camera_and_board_are_placed_by_the_rows(mount, tmp_path):
    read = read_dataset(written(camera_session(mount, placed=False), tmp_path))
    np.testing.assert_allclose(read.tools[0].centre, ON_FLANGE[:3, 3], atol=3e-3)
    np.testing.assert_allclose(read.targets[0].values["xyz"], FIXED[mount][:3, 3], atol=3e-3)
    again = read_dataset(written(read, tmp_path / "again"))
    np.testing.assert_allclose(again.measurements.pixel, read.measurements.pixel)
    np.testing.assert_allclose(again.tools[0].rpy, read.tools[0].rpy, atol=1e-6)
    assert again.targets[0].texts == read.targets[0].texts


def test_a_stated_place_is_kept(tmp_path):
    stated = camera_session()
    stated = replace(stated, targets=(replace(stated.targets[0], u=5e-3),))
    read = read_dataset(written(stated, tmp_path))
    np.testing.assert_allclose(read.targets[0].values["xyz"], stated.targets[0].values["xyz"], atol=1e-9)


def of_target(dataset, **values):
    return replace(dataset, targets=(replace(dataset.targets[0], values=dataset.targets[0].values | values),))


def with_text(dataset, **texts):
    t = dataset.targets[0]
    return replace(dataset, targets=(replace(t, texts=dict(t.texts) | texts),))


def with_pixel(dataset, pixel):
    return replace(dataset, measurements=replace(dataset.measurements, pixel=pixel))


def mirrored(d):
    return with_pixel(d, d.measurements.pixel * [-1, 1, 1] + [SIZE[0], 0, 0])


def renumbered(d):
    pixel = d.measurements.pixel.copy()
    pixel[:, 2] = (pixel[:, 2] % 6) * 4 + pixel[:, 2] // 6
    return with_pixel(d, pixel)


def half_size(d):
    return of_target(d, size=0.5 * SIZE, fx=455.0, fy=452.5, cx=320.0, cy=180.0)


def flat_turns(d):
    return with_pixel(d, np.tile(d.measurements.pixel[: len(BOARD)], (20, 1)))


REFUSED = {
    "numbers of another board": (lambda d: with_text(d, board="charuco:5x4:30mm:22mm"), "points 0 to 11"),
    "a board of another size": (lambda d: with_text(d, board="charuco:7x5:25mm:18mm"), "squares of 30 mm"),
    "the other mount": (lambda d: with_text(d, mount="fixed"), "mount: flange"),
    "another resolution": (half_size, "of another resolution"),
    "a mirrored board": (mirrored, "mirrored"),
    "another order": (renumbered, "order of the corners"),
    "a turn of one image": (flat_turns, "hand-eye|do not|mm"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case, tmp_path):
    spoil, words = REFUSED[case]
    folder = written(spoil(camera_session(placed=False)), tmp_path)
    caught = refused(words, lambda: read_dataset(folder))
    assert caught.where
    assert caught.remedy


@pytest.mark.parametrize(("old", "new", "words"), cases("camera_refusals"))
def test_settings_refused(old, new, words, tmp_path):
    folder = written(camera_session(), tmp_path)
    path = folder / "dataset.yaml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    refused(words, lambda: read_dataset(folder))


def test_an_empty_cell(tmp_path):
    folder = written(camera_session(), tmp_path)
    path = folder / "measurements.csv"
    lines = path.read_text().splitlines()
    cells = lines[5].split(",")
    cells[lines[0].split(",").index("u_px")] = ""
    lines[5] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    refused("u_px", lambda: read_dataset(folder))


def test_a_blurred_image_agrees_with_the_arm_where_its_own_pose_is_poor():
    """The pose of the board by such an image alone is mm off the arm's, while no corner is."""
    sharp = camera_session("fixed", noise=0.1)
    m = sharp.measurements
    rows = np.arange(len(m.readings))
    of = closed_form(sharp, 0, rows, m.readings)[0].image
    pixel, readings = m.pixel.copy(), m.readings.copy()
    pixel[of == 18, :2] += 2.0 * np.random.default_rng(0).standard_normal((np.sum(of == 18), 2))
    readings[of == 7, 2] += 0.1
    off = replace(sharp, measurements=replace(m, pixel=pixel, readings=readings))
    assert closed_form(off, 0, rows, readings)[2].away[18] > 0.01
    distance = misfit(off, 0, rows, readings)
    assert distance[of == 18].max() == 0.0
    assert distance[of == 7].min() > 0.05


@pytest.mark.parametrize("size", [(1280.0, 720.0), (720.0, 1280.0), (900.0, 900.0)])
def test_a_planned_board_fills_a_share_of_the_shorter_edge_of_the_image(size):
    """Seen frontally: nearer it would be cut off, farther away its corners tell little."""
    t = camera_session(images=1).targets[0]
    t = replace(t, values=dict(t.values) | {"size": np.array(size), "xyz": np.full(3, 0.1)})
    board_length, lens = np.max(np.ptp(board(t).points, axis=0)), lens_of(t)
    place = region(t, SimpleNamespace(probed=lambda: np.zeros((0, 3))))
    for distance, share in zip(place.span, (LARGEST, SMALLEST), strict=True):
        ends = np.array([[-0.5, 0.5], [-0.5, 0.5]]) * board_length / distance
        long = np.abs(np.diff(lens.pixels(ends), axis=1)).ravel()
        assert np.mean(long) == pytest.approx(share * min(size), rel=1e-6)


@pytest.mark.parametrize("text", ["charuco:7x5:30mm:22mm", "checkerboard:9x6:25mm", "apriltag:36h11:40mm"])
def test_points_of_a_board_go_clockwise_as_they_are_seen(text):
    """Seen along +z they turn from x to y, seen against it the other way."""
    one = board_of(text)
    across, around = one.points[1] - one.points[0], one.points[-1] - one.points[0]
    assert across[0] > 0
    assert across[1] == 0
    assert np.sign(np.cross(across, around)[2]) == one.front
