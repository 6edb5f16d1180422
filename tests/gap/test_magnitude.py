"""The size of a gap and what a model expects: of errors that were drawn, part by part."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_up_errors import NOISE, held

from bayescal.gap.outcome import magnitude as module
from bayescal.gap.outcome.magnitude import NoiseFloor, magnitude
from bayescal.predict.crossvalidation import LEFT_OUT, VALIDATED

COUNT, KNOWN = 1000, 1e6
"""Validation measurements, and degrees of freedom of a noise that is known."""
PARTS = {"noise": NOISE, "parameters": 4e-6, "error": 8e-6}
"""m, of contacts."""
FACTORS = {"by_parameters": 3e-6, "by_noise": 5e-6, "by_certificates": 6e-6}
"""m, of what moves a certified distance."""


def drawn(parts, distances=None, seed=0):
    """Contacts and distances that leave errors of some parts; the model has the noise and the parameters."""
    rng = np.random.default_rng(seed)
    errors = sum(size * rng.standard_normal(COUNT) for size in parts.values())
    sizes = dict.fromkeys(FACTORS, 0.0) | (distances or {})
    count = 30 if distances is not None else 0
    made = held(errors, np.hypot(NOISE, parts.get("parameters", 0.0)), np.zeros(count))
    each = {key: size * np.eye(count) for key, size in sizes.items()}
    return replace(made, distances=replace(made.distances, **each))


@pytest.fixture
def measured(monkeypatch):
    """The size of a gap by errors, with a noise that is known."""
    monkeypatch.setattr(module, "noise_floor", lambda final, group: NoiseFloor(NOISE, KNOWN, "stated"))
    monkeypatch.setattr(module, "stated_noise", lambda fitted, group: NOISE)
    estimate = SimpleNamespace(weights=SimpleNamespace(scale={"contact": 1.0}))
    return lambda errors: magnitude(estimate, estimate, errors)


@pytest.mark.parametrize("how", [VALIDATED, LEFT_OUT])
@pytest.mark.parametrize("error", [0.0, 8e-6, 20e-6])
def test_the_excess_is_what_neither_noise_nor_parameters_explain(measured, error, how):
    errors = drawn(PARTS | {"error": error})
    if how == LEFT_OUT:  # the noise of a contact that was left out has that of the parameters
        wide = np.full(COUNT, np.hypot(NOISE, PARTS["parameters"]))
        errors = replace(errors, how=how, noise=wide, by_parameters=0.0 * errors.by_parameters)
    found = measured(errors)
    low, high = found.excess_interval95
    assert low <= error <= high
    assert found.excess == pytest.approx(error, rel=0.1, abs=2e-6)
    every = np.linalg.norm([NOISE, PARTS["parameters"], error])
    assert found.validation_rms == pytest.approx(every, rel=0.05)


def test_blurred_measurements_are_no_excess(measured):
    errors = drawn({"noise": NOISE})
    blur = np.where(np.arange(COUNT) % 5 == 0, 4.0, 1.0)
    blurred = replace(errors, residual=blur * errors.residual, noise=blur * errors.noise)
    assert measured(blurred).excess_interval95[0] == 0.0


def test_the_expected_errors_of_contacts_are_those_of_noise_and_parameters(measured):
    (contacts,) = measured(drawn(PARTS)).measured
    assert contacts.count == COUNT
    low, high = contacts.predicted_interval95
    assert low < contacts.predicted_rms < high
    expected = np.hypot(NOISE, PARTS["parameters"])
    assert contacts.predicted_rms == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("without", ["", *FACTORS])
def test_the_expected_errors_of_distances_have_every_part(measured, without):
    parts = {key: size for key, size in FACTORS.items() if key != without}
    found = measured(drawn(PARTS, parts)).measured[-1]
    assert (found.what, found.count) == ("sphere distances", 30)
    assert found.predicted_rms == pytest.approx(np.linalg.norm([*parts.values()]), rel=0.05)
