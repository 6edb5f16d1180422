"""Names without validation measurements: blocks of poses and time that are left out judge them."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.estimate import estimate
from bayescal.gap.outcome.magnitude import log_predictive
from bayescal.gap.search.gate import gain, share
from bayescal.gap.settings import GATE
from bayescal.model import build
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import BLOCKED, validation_errors

FULL = ("geometry", "compliance")


def judged(dataset, name):
    """Nats of a name by rows left out one by one and by blocks, and the share of its change in blocks."""
    fits = [estimate(build(Scene(dataset), own)) for own in (FULL, (*FULL, name))]
    less, more = (validation_errors(fit) for fit in fits)
    single = float(np.sum(log_predictive(more)[0] - log_predictive(less)[0]))
    less, more = (validation_errors(fit, without=BLOCKED) for fit in fits)
    return single, gain(less, less, more), share(less, more)


def off(dataset, joint, error):
    """The session with an error (N,), rad, of a joint (from 1)."""
    m = dataset.measurements
    readings = m.readings.copy()
    readings[:, joint - 1] += error
    return replace(dataset, measurements=replace(m, readings=readings))


def test_an_error_of_a_joint_is_confirmed(cube):
    d = cube(seed=1, count=150).dataset
    wave = off(d, 4, 1e-3 * np.sin(d.measurements.readings[:, 3]))
    _, nats, shown = judged(wave, "eccentricity at joint 4 x8")
    assert nats > 100
    assert shown.value == pytest.approx(1.0, abs=4 * shown.u)
    assert shown.u < 0.05


def test_errors_that_neighbours_share_do_not_confirm_a_name(cube):
    """Joints that change their zeros every 25 rows: left out one by one, rows do not contradict a step."""
    d, rng = cube(seed=1, count=150).dataset, np.random.default_rng(1)
    for joint in range(1, 7):
        d = off(d, joint, np.repeat(3e-4 * rng.standard_normal(6), 25))
    single, nats, shown = judged(d, "step@80 x8")
    assert single > -0.5
    assert nats < -GATE.loss
    assert shown.missing
