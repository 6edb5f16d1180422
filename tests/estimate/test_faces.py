"""Form errors of faces: how often noise is taken for one, and the size of one."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.effects.probe import shapes
from bayescal.estimate import estimate
from bayescal.estimate.unexplained import check_faces
from bayescal.model import Scene, build

DRAWS = 200


@pytest.fixture(scope="module")
def fitted(cube):
    return estimate(build(Scene(cube(seed=3, count=160).dataset), ("geometry",)))


def checked(fitted, errors):
    """The check of residuals that errors (R,), in units of the noise, leave behind a fit."""
    jacobian = fitted.linear.jacobian
    left = errors - jacobian @ (fitted.covariance @ (jacobian.T @ errors))
    return check_faces(replace(fitted, linear=replace(fitted.linear, residual=left)))


def test_noise_makes_any_face_of_a_session_uneven_as_often_as_its_p_says(fitted):
    """P of the least of all faces is that of a session; without the number of faces it would be 1 in 4."""
    rng, count = np.random.default_rng(0), len(fitted.linear.residual)
    draws = [checked(fitted, rng.standard_normal(count)) for _ in range(DRAWS)]
    assert len(draws[0]) > 3
    least = np.array([min(face.p_value for face in faces) for faces in draws])
    for p in (0.05, 0.2):
        often = p + 3.0 * np.sqrt(p * (1.0 - p) / DRAWS)
        assert 0.1 * p < np.mean(least < p) < often


def test_the_form_of_a_face_is_found_there_with_its_size(fitted):
    face = fitted.model.scene.circumstances().faces[1]
    block = fitted.model.block_of[face.name]
    noise = 1.0 / fitted.weights.whitening(block)
    form = 5.0 * float(np.median(noise)) * shapes(face)[1][2][block.rows]
    errors = np.random.default_rng(1).standard_normal(len(fitted.linear.residual))
    errors[fitted.linear.of_block[face.name]] += form / noise
    found = {check.target: check for check in checked(fitted, errors)}
    assert [name for name, check in found.items() if check.uneven] == [face.name]
    assert found[face.name].form == pytest.approx(np.sqrt(np.mean(form**2)), rel=0.25)
