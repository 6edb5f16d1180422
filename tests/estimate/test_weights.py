"""What each residual counts: the noise of the readings enters by the slopes of the residuals."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.estimate import unit_weights
from bayescal.model import ARM, build
from bayescal.model.scene import Scene


def residuals(session):
    """Residuals of every block at the nominal model, by name, m; and the model."""
    model = build(Scene(session), ())
    z = np.zeros(model.size)
    values = model.deviations(z[model.slices[ARM]])
    return {b.name: b.residual(values, z[model.slices[b.target]]).ravel() for b in model.blocks}, model


@pytest.mark.parametrize("maker", ["cube", "tracker"])
def test_noise_of_the_readings_adds_by_the_slopes(maker, request):
    session = request.getfixturevalue(maker)(seed=1, count=40).dataset
    m, joint, h = session.measurements, 20e-6, 1e-5
    plain, model = residuals(session)
    square = {name: np.zeros(len(r)) for name, r in plain.items()}
    for axis in np.eye(6):
        there, _ = residuals(replace(session, measurements=replace(m, readings=m.readings + h * axis)))
        for name, r in plain.items():
            square[name] += ((there[name] - r) / h) ** 2
    noisy = replace(session, noise=replace(session.noise, joint=joint))
    found = unit_weights(build(Scene(noisy), ()), np.zeros(model.size))
    for block in model.blocks:
        own = np.tile(block.sigma, block.kind.rows)
        expected = np.sqrt(own**2 + joint**2 * square[block.name])
        np.testing.assert_allclose(found.sigma[block.name], expected, rtol=1e-3)
        assert expected.max() > 1.2 * own.max()
