"""The stated uncertainty of simulated sessions: near the plain one without an effect, true with one."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from bayescal.dataset.join import joined
from bayescal.estimate import calibrated
from bayescal.estimate.discrepancy import LEAST_WHITE, families, stated
from bayescal.estimate.families import COURSES, EFFECT
from bayescal.estimate.moments import UNSEEN
from bayescal.estimate.solver import linearise
from bayescal.model.scene import Scene
from bayescal.posterior import gaussian

FULL = ("geometry", "compliance")


@pytest.fixture(scope="module")
def clean(cube):
    return stated(calibrated(Scene(cube(seed=4).dataset), FULL))


def bent(cube, seed=4):
    """A session whose first link turns by a function of the two next readings that no model has."""
    made = cube(seed=seed).dataset
    m = made.measurements
    readings = m.readings.copy()
    readings[:, 0] += 1e-3 * np.sin(readings[:, 1] + readings[:, 2])
    return replace(made, measurements=replace(m, readings=readings))


@pytest.fixture(scope="module")
def sick(cube):
    return stated(calibrated(Scene(bent(cube)), FULL))


def test_without_a_discrepancy_the_uncertainty_is_the_plain_one(clean):
    """Except for the errors of masses, of which most unknowns have little."""
    without = np.diag(clean.covariance) - clean.inputs.variances
    ratio = np.sqrt(without) / clean.plain.sd
    assert clean.families == ()
    assert clean.white == 1.0
    assert np.min(ratio) > 1.0 - 1e-9
    assert np.max(ratio) < 1.1


def test_no_stated_uncertainty_is_smaller_than_the_plain_one(sick):
    """Also where the discrepancy explains most of the residual variance, of any combination of unknowns."""
    more = sick.covariance - sick.plain.covariance
    assert np.min(np.linalg.eigvalsh(more)) > -1e-9 * np.max(np.linalg.eigvalsh(sick.covariance))


def test_an_effect_that_no_model_has_widens_the_parameters_that_it_biases(clean, sick):
    assert sick.families
    assert sick.white < 0.9
    moved = np.abs(sick.plain.z - clean.plain.z)[: len(sick.plain.model.parameters)]
    plain, wide = (np.mean((moved / sd[: len(moved)]) ** 2) for sd in (sick.plain.sd, sick.sd))
    assert plain > 4.0
    assert wide < 2.0


def test_residuals_above_the_noise_lower_the_gate(cube):
    """A family is then found that the gate alone would miss, in a session of 150 rows."""
    made = cube(seed=4).dataset
    m = made.measurements
    readings = m.readings.copy()
    readings[:, 1] += 1e-3 * np.cos(1.5 * readings[:, 1])
    scene = Scene(replace(made, measurements=replace(m, readings=readings)))
    found = stated(calibrated(scene, FULL))
    assert found.families
    loud = replace(scene.dataset, noise=replace(scene.dataset.noise, contact=1e-4))
    assert not stated(calibrated(Scene(loud), FULL)).families


def test_draws_have_the_covariance_that_is_stated(sick):
    z = gaussian(sick.plain, 0, 4000).flat
    drawn = sick.draws(z, np.random.default_rng(0))
    got = np.cov(drawn.T) / np.sqrt(np.outer(*2 * (np.diag(sick.wide.covariance),)))
    want = sick.wide.covariance / np.sqrt(np.outer(*2 * (np.diag(sick.wide.covariance),)))
    assert np.max(np.abs(got - want)) < 0.12
    np.testing.assert_allclose(np.std(sick.reported(drawn), axis=0), sick.sd, rtol=0.1)


def test_no_parameter_is_less_certain_than_its_prior(sick):
    assert np.all(sick.sd <= 1.0 + 1e-9)


def test_functions_of_the_whole_session_serve_its_parts(cube):
    scene = Scene(cube(seed=4).dataset)
    own = families(scene.circumstances(scene.rows("calibrate")))
    assert [f.name for f in own][:3] == ["angle of joints", "angle of other joints", "torque of joints"]
    found = stated(calibrated(scene, ("geometry",)), own)
    assert found.families  # compliance is missing
    assert found.parameter_shares.keys() == set(found.families)  # nor masses


@pytest.mark.parametrize("seed", [0, 1])
def test_a_family_explains_what_the_residual_variance_loses(tracker, seed):
    """The share that is no noise: of the functions by their variance, over all residuals, three a pose."""
    made = tracker(seed, 60).dataset
    readings = made.measurements.readings.copy()
    readings[:, 1] += 1e-4 * np.cos(3 * readings[:, 1])
    scene = Scene(replace(made, measurements=replace(made.measurements, readings=readings)))
    found = stated(calibrated(scene, FULL))
    j, (block,) = (
        linearise(found.wide.model, found.wide.z, found.wide.weights).jacobian,
        found.plain.model.blocks,
    )
    j = j[np.tile(found.plain.weights.row[block.name], 3) > 0]
    g = j[:, [k for k, p in enumerate(found.wide.model.parameters) if p.effect == EFFECT]]
    j = j[:, found.own]
    h = g - j @ (found.plain.covariance @ (j.T @ g))
    assert 1.0 - found.white == pytest.approx(np.sum(h**2) / UNSEEN / len(h), rel=0.12)  # without masses
    assert LEAST_WHITE < found.white < 0.95
    assert 0.0 < sum(found.parameter_shares.values()) < 1.0


def test_without_functions_the_uncertainty_is_that_of_the_poses(clean):
    found = stated(clean.plain, [])
    assert found.families == ()
    np.testing.assert_allclose(found.sd, clean.sd, rtol=1e-9)


def test_functions_of_time_end_with_their_session(cube):
    """The second of two joined sessions is not the later part of the first."""
    made = [replace(cube(seed=seed).dataset, name=name) for seed, name in ((4, "A"), (5, "B"))]
    scene = Scene(joined(made))
    found = {f.name: f.parameters for f in families(scene.circumstances(scene.rows("calibrate")))}
    first = np.arange(len(scene.q)) < len(made[0].measurements.ids)
    drivers = [np.asarray(p.terms[0].driver) for p in found["time of joints"]]
    assert len(drivers) == 2 * COURSES * scene.chain.n
    for d in drivers:
        assert not (np.any(d[first]) and np.any(d[~first]))
        own = d[first] if np.any(d[first]) else d[~first]
        assert np.max(own) > 0.3 * np.max(np.abs(own)) > 0
        assert np.min(own) < 0


def test_functions_of_a_large_session_are_linearised_in_parts(clean, monkeypatch):
    """The model of all functions at once took most of the memory of a session of 100,000 rows."""
    module, size = import_module("bayescal.estimate.discrepancy"), []

    def watched(model, z, weights):
        size.append(model.size)
        return linearise(model, z, weights)

    monkeypatch.setattr(module, "linearise", watched)
    monkeypatch.setattr(module, "MOST_VALUES", 10 * len(clean.plain.model.scene.dataset.measurements.ids))
    again = stated(clean.plain)
    assert len(size) > 1
    assert max(size) <= len(clean.plain.z) + 20
    np.testing.assert_allclose(again.covariance, clean.covariance, rtol=1e-9, atol=1e-12)
    assert again.variances == pytest.approx(clean.variances)
