"""Noise of images: what corners of one image share, and what each has of its own."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import BOARD, camera_session
from sessions import with_columns

from bayescal.assess.shared_causes import _validation_rows
from bayescal.calibration import fit
from bayescal.dataset import Noise
from bayescal.estimate import calibrated, estimate, fitted_level
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.unexplained import noise_again, unexplained
from bayescal.estimate.widths import with_widths
from bayescal.gap.examine import examine
from bayescal.model import USUAL, Scene, build
from bayescal.predict.crossvalidation import IMAGES_LEFT_OUT, validation_errors
from bayescal.predict.validation import validate

module = import_module("bayescal.estimate.widths")
STEP = np.radians(0.03)
"""Standard error of the readings of an image, rad: 0.2 mm at the board, 0.3 px."""


def misread(session, seed, step=STEP):
    """The session with an error of each reading, the same for all corners of an image, as it is stated."""
    m, n = session.measurements, session.robot.n
    error = step * np.random.default_rng(seed).standard_normal((len(m.ids) // len(BOARD), n))
    noise = Noise(pixel=session.noise.pixel, joint=float(step))
    readings = m.readings + np.repeat(error, len(BOARD), axis=0)
    return replace(with_columns(session, readings=readings), noise=noise)


def images_of(seed, images=20, **how):
    return camera_session(images=images, seed=seed, velocity=False, **how)


def test_corners_within_images_tell_the_noise_whatever_the_arm_does():
    spoilt = replace(images_of(1, noise=0.3, arm=[0.0, 2e-3, -2e-3, 1e-3, 3e-3, 0.0]), noise=Noise(pixel=0.2))
    nominal = estimate(build(Scene(spoilt), ()))
    (block,) = nominal.model.blocks
    scatter, dof = noise_again(nominal, "pixel")
    assert scatter / np.mean(block.kind.scale) == pytest.approx(0.3, rel=0.08)
    assert dof == 2 * len(block.rows) - 6 * 20
    left = unexplained(nominal)
    assert left.excess > 3 * scatter
    assert "corners within images" in left.words


def test_the_noise_within_images_has_the_stated_errors_of_readings_and_no_blurred_image():
    session = misread(images_of(2), 2)
    blurred = slice(0, len(BOARD))
    session.measurements.pixel[blurred, :2] += np.random.default_rng(1).normal(0.0, 2.0, (len(BOARD), 2))
    found = calibrated(Scene(session), ("geometry",))
    (block,) = found.model.blocks
    stated = np.sqrt(np.mean(found.weights.sigma[block.name].reshape(2, -1)[:, len(BOARD) :] ** 2))
    assert stated > 1.5 * np.mean(block.sigma[len(BOARD) :])
    assert noise_again(found, "pixel")[0] == pytest.approx(stated, rel=0.08)
    assert unexplained(found).stated == pytest.approx(stated)


def test_errors_that_images_share_take_as_many_degrees_of_freedom_as_they_have():
    """Seven unknowns and more follow the errors of twelve images: the noise seemed a fifth smaller."""
    sessions = (misread(images_of(seed, images=12), seed) for seed in range(3))
    scale = [calibrated(Scene(session), ("geometry",)).weights.scale["pixel"] for session in sessions]
    assert np.mean(scale) == pytest.approx(1.0, abs=0.1)


def test_readings_with_errors_are_no_effect_and_validation_images_are_as_expected():
    session = misread(images_of(4, images=20, validate=5), 4)
    found = examine(Scene(session, oriented=True), ("geometry", "compliance"), USUAL)
    assert found.decision.kind == "null"
    assert found.problem.images is not None  # the readings of each are in the covariance of its corners
    (points,) = validate(found.fitted, np.tile(found.fitted.z, (400, 1)), np.full((400, 1), 1.0)).points
    one = points.predicted[:, 0, : len(BOARD)]
    assert np.mean(np.corrcoef(one.T)) > 0.4  # of the corners of an image
    assert abs(np.mean(np.corrcoef(one[:, 0], points.predicted[:, 0, -1])[0, 1])) < 0.2
    told = fit(misread(images_of(12, 18, validate=5), 12), ("geometry",), samples=0)
    assert told.acceptance.failed == ()


def test_validation_images_with_errors_of_readings_are_no_outliers():
    session = misread(images_of(13, images=26, validate=6), 13)
    rows, off = _validation_rows(calibrated(Scene(session, oriented=True), ("geometry",)))
    assert (len(rows), np.sum(off)) == (6 * len(BOARD), 0)


def test_an_image_is_left_out_as_a_whole():
    session = misread(images_of(5), 5)
    held = validation_errors(calibrated(Scene(session, oriented=True), ("geometry",)))
    assert held.how == IMAGES_LEFT_OUT
    assert len(np.unique(held.fold)) == 20
    first = np.arange(len(session.measurements.ids)) < len(BOARD)
    without = with_columns(session, role=np.where(first, "validate", "calibrate"))
    there = calibrated(Scene(without, oriented=True), ("geometry",))
    rows = np.arange(len(BOARD))
    (block,) = there.model.blocks
    wanted = there.residuals(there.model.block(there.model.scene.index[block.target], rows)).ravel()
    own = np.concatenate([held.residual[(held.rows == k)] for k in rows]).reshape(-1, 2).T.ravel()
    assert np.sqrt(np.mean((own - wanted) ** 2)) < 0.1 * np.sqrt(np.mean(wanted**2))


def wrong_lens(off):
    """A session whose focal lengths are off by so many px, stated with u 1 px."""
    session = images_of(6, images=14)
    (target,) = session.targets
    wrong = {key: target.values[key] + off for key in ("fx", "fy")}
    values = dict(target.values) | wrong | {"u_focal": 1.0}
    return Scene(replace(session, targets=(replace(target, values=values),)), oriented=True)


def test_a_wrong_lens_is_told_by_its_family_and_not_by_the_arm(monkeypatch):
    """A focal length 6 u off; and where its own errors hide it, by the fit that has its width."""
    scene = wrong_lens(6.0)

    def told():
        found, _, widths = with_widths(fitted_level(scene, ("geometry",), USUAL), scene, ("geometry",), USUAL)
        (fx,) = (v for v, p in zip(found.arm, found.model.parameters, strict=True) if p.name == "cam fx")
        return [w.family for w in widths], fx

    for hidden in (False, True):
        if hidden:
            monkeypatch.setattr(module, "stated", lambda found: SimpleNamespace(covariance=spoilt(found)))
        families, fx = told()
        assert families == ["errors of focal lengths and optical axis"]
        assert fx == pytest.approx(-6.0, abs=1.5)


def spoilt(found):
    """The stated covariance, much wider where the lens has its stated width."""
    (sd,) = (p.sd for p in found.model.parameters if p.name == "cam fx")
    return (1.0 if sd > 1.0 else 400.0) * stated(found).covariance
