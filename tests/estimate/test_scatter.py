"""Errors that every image has anew are told by what its corners share."""

from dataclasses import replace

import numpy as np
import pytest
from camera_sessions import camera_session
from sessions import with_columns
from test_image_noise import STEP, misread

from bayescal.assess.acceptance import CONTRADICTED, DOUBTED, anew
from bayescal.calibration import fit
from bayescal.dataset import Noise
from bayescal.estimate.estimate import calibrated
from bayescal.estimate.scatter import scatter_of, with_scatter
from bayescal.fitted.arm import of_estimate
from bayescal.fitted.file import read_arm, write_arm
from bayescal.model.scene import Scene


def images(seed, **how):
    return camera_session(images=20, seed=seed, velocity=False, **how)


def unstated(session):
    return replace(session, noise=Noise(pixel=session.noise.pixel))


def told(session):
    return scatter_of(calibrated(Scene(session, oriented=True), ("geometry",)))


def test_errors_of_readings_that_are_not_stated_are_found_and_then_known():
    exact = images(1)
    session = misread(exact, 1)
    found = told(unstated(session))
    size = np.sqrt(np.mean((session.measurements.readings - exact.measurements.readings) ** 2))
    assert size == pytest.approx(STEP, rel=0.2)
    assert found.u == pytest.approx(size, rel=0.25)  # 20 images of 6 readings, less what the geometry takes
    assert found.beyond
    assert f"{np.degrees(found.u):.2g} deg (none known)" in found.words
    assert told(session) is None
    again = with_scatter(Scene(unstated(session), oriented=True), found)
    assert again.dataset.reading_noise[0] == found.u
    assert told(again.dataset) is None


def test_exact_readings_and_wrong_noise_of_corners_are_no_errors_of_images():
    session = images(3, noise=0.4)
    assert told(session) is None
    assert told(replace(session, noise=Noise(pixel=0.2))) is None


def test_steps_in_which_readings_are_written_are_known():
    session, step = images(4), np.radians(0.05)
    found = told(with_columns(session, readings=step * np.rint(session.measurements.readings / step)))
    assert found.u == found.prior_u == pytest.approx(step / np.sqrt(12.0))
    assert not found.beyond
    assert anew(found, None) is anew(None, None) is None


@pytest.mark.parametrize(("step", "verdict"), [(STEP / 4, DOUBTED), (STEP, CONTRADICTED)])
def test_a_fit_weighs_images_by_them_and_says_so(step, verdict):
    """The stated uncertainty holds the truth, which is the nominal arm."""
    session = unstated(misread(images(5, validate=4), 5, step))
    found = fit(session, ("geometry",), samples=0)
    tests = found.acceptance
    assert tests.verdict == verdict
    assert [check.test for check in (*tests.failed, *tests.doubts)] == ["images"]
    assert found.final.estimate.weights.scale["pixel"] == pytest.approx(1.0, abs=0.1)
    assert found.dataset is session
    arm = found.final.estimate.model.slices["arm"]
    off = found.final.estimate.z[arm] / np.sqrt(np.diag(found.stated.limited)[arm])
    assert np.mean(np.abs(off) < 1.96) > 0.85


def smoothly(size, power, session=None):
    """A session, and the same with an error of each image: polynomials of the place of a corner, px."""
    session = session or images(6)
    m, rng = session.measurements, np.random.default_rng(power)
    pixel = m.pixel.copy()
    for reading in np.unique(m.readings, axis=0):
        rows = (m.readings == reading).all(axis=1)
        place = pixel[rows, :2] - pixel[rows, :2].mean(axis=0)
        x, y = (place / place.std(axis=0)).T
        shapes = [np.ones_like(x), x, y, x**2 - 1.0, x * y, y**2 - 1.0][: (1, 3, 6)[power]]
        pixel[rows, :2] += size * (rng.normal(size=(2, len(shapes))) @ shapes).T
    return session, with_columns(session, pixel=pixel)


@pytest.mark.parametrize("power", [0, 1, 2])
def test_errors_of_images_themselves_are_not_those_of_readings(power):
    """Shifts, as of a stabiliser, and errors that vary smoothly over the corners, as of blur."""
    size, (session, wrong) = 0.3, smoothly(0.3, power)
    found = told(wrong)
    assert found.power == power
    assert found.field == pytest.approx(size / session.noise.pixel, rel=0.3)
    weighed = with_scatter(Scene(wrong, oriented=True), found)
    assert (weighed.dataset.noise.field, weighed.dataset.noise.joint) == (found.field, found.u)
    fitted = calibrated(weighed, ("geometry",))
    assert scatter_of(fitted) is None
    assert fitted.weights.scale["pixel"] == pytest.approx(1.0, abs=0.15)
    assert "every image has an error of its own" in found.words


@pytest.mark.parametrize("known", [True, False])
def test_errors_of_images_are_found_beside_those_of_readings(known):
    size, (session, wrong) = 0.1, smoothly(0.1, 1, misread(images(5), 5))
    found = told(wrong if known else unstated(wrong))
    assert (found.power, found.beyond) == (1, True)
    assert found.field == pytest.approx(size / session.noise.pixel, rel=0.4)
    assert found.u == pytest.approx(STEP, rel=0.35)
    assert ("readings" in found.words) is not known
    assert told(session) is None


def test_a_run_folder_keeps_errors_of_images(tmp_path):
    """No dataset file states them: a budget, which is computed again, would have another uncertainty."""
    _, wrong = smoothly(0.3, 2)
    weighed = with_scatter(Scene(wrong, oriented=True), told(wrong))
    found = calibrated(weighed, ("geometry",))
    write_arm(of_estimate(found, found.covariance), tmp_path)
    again = read_arm(tmp_path)
    assert again.dataset.noise.field == weighed.dataset.noise.field > 0.0
    assert again.dataset.noise.power == 2


def test_errors_of_readings_stand_where_those_of_images_have_no_size(monkeypatch):
    """Evidence that grows to the end of the sizes that are tried tells none."""
    monkeypatch.setattr("bayescal.estimate.scatter.FIELDS", np.array([1e-4, 2e-4, 3e-4]))
    found = told(unstated(misread(images(1), 1)))
    assert found.field == 0.0
    assert found.beyond
