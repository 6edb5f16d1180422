"""Springs of MuJoCo against the characteristics that they stand for."""

import numpy as np
import pytest

from bayescal.exporting.mjcf.elastic import CLOSE, linear, spring_of

TORQUE = 40.0 * np.linspace(0.0, 1.0, 1501)[1:] ** 2
FINE = np.linspace(-40.0, 40.0, 4001)
CHARACTERISTICS = {
    "softer under load": lambda t: 3e-5 * t + 3e-7 * t * np.abs(t),
    "stiffer under load": lambda t: 6e-5 * t - 3e-7 * t * np.abs(t),
    "knee": lambda t: 3e-5 * t + 1e-4 * np.tanh(t / 9.0),
    "hysteresis": lambda t: 3e-5 * t + 5e-5 * np.tanh(t / 0.6),
}


@pytest.mark.parametrize("name", CHARACTERISTICS)
def test_spring_has_the_characteristic(name):
    deflection = CHARACTERISTICS[name]
    spring = spring_of(TORQUE, deflection(TORQUE))
    off = (spring.torque(deflection(FINE)) - FINE) * np.gradient(deflection(FINE), FINE)
    assert np.max(np.abs(off)) < 1.5 * CLOSE
    assert all(b.stiffness > 0 for b in spring.bands)  # else the integrator leaves a part of it explicit
    assert spring.stiffness >= 0
    assert spring.slope == pytest.approx(1.0 / (deflection(1e-3) / 1e-3), rel=0.05)


def test_compliance_is_one_linear_spring():
    spring = spring_of(TORQUE, 2e-4 * TORQUE)
    assert spring.stiffness == pytest.approx(linear(2e-4).stiffness, rel=1e-12)
    assert not spring.bands
