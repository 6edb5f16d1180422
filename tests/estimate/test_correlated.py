"""Errors that the corners of an image share, against dense covariances."""

from dataclasses import replace

import numpy as np
import pytest
from camera_sessions import camera_session
from scipy.sparse import csr_array
from test_image_noise import misread

from bayescal.assess.images import images
from bayescal.estimate import STATED_WORTH, calibrated, linearise
from bayescal.estimate.correlated import Shared
from bayescal.estimate.widths import log_evidence
from bayescal.model.scene import Scene
from bayescal.posterior.density import Density


def dense(shared, row=1.0):
    """Covariance (R, R) of residuals of unit noise, row by row, times the roots of the weights."""
    by = shared.by * np.sqrt(np.broadcast_to(row, len(shared.by)))[:, None]
    same = shared.image[:, None] == shared.image
    return np.diag(1.0 - np.sum(shared.by**2, axis=1)) + same * (by @ by.T)


@pytest.fixture(scope="module")
def shared():
    rng = np.random.default_rng(1)
    by = rng.normal(size=(31, 3)) * [0.4, 0.2, 0.0]
    return Shared(by / np.maximum(1.2 * np.linalg.norm(by, axis=1), 1.0)[:, None], rng.integers(0, 4, 31))


def test_residuals_become_independent_and_back(shared):
    weight = np.where(np.arange(31) % 5, 1.0, 0.3)
    apart, covariance = shared.decorrelated(weight), dense(shared, weight)
    turned = apart.white(np.eye(31))
    assert turned @ covariance @ turned.T == pytest.approx(np.eye(31), abs=1e-12)
    assert apart.coloured(turned) == pytest.approx(np.eye(31), abs=1e-12)
    assert apart.log_det == pytest.approx(-0.5 * np.linalg.slogdet(covariance)[1])
    assert apart.white(np.arange(31.0)) == pytest.approx(turned @ np.arange(31.0))
    assert apart.turned(np.eye(31)) == pytest.approx(turned.T)
    assert apart.each(csr_array(np.eye(31))).toarray() == pytest.approx(turned)


def test_blocks_in_order_share_what_each_has(shared):
    some = Shared.joined([shared, 4, replace(shared, by=shared.by[:, :1])]).decorrelated().white(np.eye(66))
    assert some[:31, :31] == pytest.approx(shared.decorrelated().white(np.eye(31)))
    assert some[31:35] == pytest.approx(np.eye(66)[31:35])
    one = replace(shared, by=shared.by[:, :1])
    assert some[35:, 35:] == pytest.approx(one.decorrelated().white(np.eye(31)))
    assert np.all(some[:31, 31:] == 0)


def test_rows_without_shared_errors_are_as_they_were(shared):
    out = np.arange(31) > 20
    turned = shared.without(out).decorrelated().white(np.eye(31))
    assert turned[out] == pytest.approx(np.eye(31)[out])
    assert shared[~out].decorrelated().white(np.eye(21)) == pytest.approx(turned[:21, :21])


@pytest.fixture(scope="module")
def found():
    return calibrated(Scene(misread(camera_session(images=12, seed=3, velocity=False), 3)), ("geometry",))


def test_a_fit_is_generalised_least_squares_and_the_posterior_has_its_density(found):
    """The most probable parameters, their covariance, chi-square and evidence, by a dense covariance."""
    ((name, shared),) = found.weights.shared.items()
    (block,) = found.model.blocks
    row = np.tile(found.weights.row[name], block.kind.rows)
    apart = linearise(found.model, found.z, found.weights.apart)
    weight = np.linalg.inv(dense(shared, row)) * (row[:, None] * row > 0)
    gradient = apart.jacobian.T @ weight @ apart.residual + found.z
    assert gradient @ found.covariance @ gradient < 1e-4
    information = apart.jacobian.T @ weight @ apart.jacobian + np.eye(found.model.size)
    assert found.covariance @ information == pytest.approx(np.eye(found.model.size), abs=1e-6)
    whole = (apart.residual @ weight @ apart.residual) * found.weights.scale[block.group] ** 2
    assert Density(found).misfit(found.z[None])[0][0, 0] == pytest.approx(whole, rel=1e-9)
    kept, scale = row > 0, found.weights.scale[block.group]
    log_det = np.linalg.slogdet(dense(shared)[np.ix_(kept, kept)])[1] + 2 * np.sum(kept) * np.log(scale)
    expected = 0.5 * np.linalg.slogdet(found.covariance)[1] - 0.5 * (found.z @ found.z + log_det)
    expected -= 0.5 * whole / scale**2 + STATED_WORTH * (np.log(scale) + 0.5 / scale**2)
    assert log_evidence(found, found.rejected) == pytest.approx(expected)


def test_what_a_side_changes_in_the_images_is_of_the_corners_themselves(found):
    apart = found.weights.apart
    alone = replace(found, weights=apart, linear=linearise(found.model, found.z, apart))
    (one,), (other,) = images(found), images(alone)
    assert one == other
