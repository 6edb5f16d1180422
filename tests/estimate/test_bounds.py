"""Positive parameters at their bound: against an independent solver, and what is left as it is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.stats import chi2, truncnorm

import bayescal as bc
from bayescal.estimate import calibrated
from bayescal.estimate.bounds import UNCHANGED, bounded, negative, not_physical
from bayescal.estimate.discrepancy import stated
from bayescal.model.scene import Scene
from bayescal.posterior import approximate

MODEL = ("geometry", "compliance")


@pytest.fixture(scope="module")
def free():
    """The fit without bounds of a rigid arm: some of its compliances are negative."""
    session = bc.simulate(effects="geometry", contacts=60, later=0, repeats=0, spheres=0, seed=1, noise=2e-5)
    return calibrated(Scene(session.dataset, oriented=True), MODEL)


@pytest.fixture(scope="module")
def held(free):
    """With bounds."""
    return bounded(free)


def physical(found):
    return dict(zip(found.model.names, found.model.physical(found.z), strict=True))


def test_nothing_is_negative_and_what_was_is_zero(free, held):
    out, rigid = held
    before, after = physical(free), physical(out)
    names = [p.name for p in free.model.parameters if p.positive]
    assert min(before[n] for n in names) < 0
    assert min(after[n] for n in names) >= -1e-12
    assert out.held == tuple(n.parameter for n in rigid.parameters) != ()
    assert all(abs(after[n.parameter]) < 1e-12 and n.value == before[n.parameter] for n in rigid.parameters)
    assert 0 < rigid.distance_rms < rigid.distance_max < 1e-3
    assert rigid.words.startswith(f"set to rigid, because not distinguishable from 0: {out.held[0]} -")


def test_the_optimum_is_that_of_an_independent_solver(free, held):
    """Bounded least squares of the linearised problem, with the prior as rows (scipy's trust region)."""
    model, size = free.model, free.model.size
    rows = np.vstack([free.linear.jacobian, np.eye(size)])
    right = np.concatenate([free.linear.jacobian @ free.z - free.linear.residual, np.zeros(size)])
    low = np.full(size, -np.inf)
    for k, p in enumerate(model.parameters):
        if p.positive:
            low[k] = -p.centre / p.sd
    best = lsq_linear(rows, right, (low, np.full(size, np.inf)), tol=1e-12).x
    off = np.abs(held[0].z - best) / free.sd
    assert np.max(off) < 0.05
    assert np.max(np.abs(best - free.z) / free.sd) > 0.3  # the bound matters here


def test_the_uncertainty_stays(free, held):
    """About the bound, u is that of the fit without it: no less than the moment of what is possible."""
    ratio = held[0].sd / free.sd
    assert np.all((ratio > 0.9) & (ratio < 1.1))
    for below in (0.0, 0.5, 1.0, 2.0):
        possible = truncnorm(below, np.inf, loc=-below)  # N(-below, 1), given that it is not negative
        assert possible.moment(2) <= 1.0 + 1e-12


def test_draws_are_about_the_bounded_estimate(free, held):
    z, _ = approximate(held[0], 1, 4000)
    assert np.max(np.abs(np.mean(z, axis=0) - held[0].z) / held[0].sd) < 0.1
    z, _ = approximate(free, 1, 4000)
    assert np.max(np.abs(np.mean(z, axis=0) - free.z) / free.sd) < 0.1


def test_significant_values_are_left():
    """Of an arm whose gravity is stated upside down: its joints seem to turn against their torques."""
    session = bc.simulate(contacts=60, later=0, repeats=0, spheres=0, seed=1).dataset
    found = calibrated(Scene(replace(session, gravity=-session.gravity), oriented=True), MODEL)
    out, rigid = bounded(found)
    u = np.sqrt(np.diag(stated(out).limited)[: len(out.arm)]) * out.model.sd
    below = negative(out.model.parameters, out.arm, u)
    assert {"compliance J2", "compliance J3"} <= {n.parameter for n in below if n.significant}
    assert {n.parameter for n in below}.isdisjoint({n.parameter for n in rigid.parameters})
    assert below[0].limit == pytest.approx(2.61, abs=0.01)  # of five compliances
    (fault,) = not_physical(out, stated(out).limited)
    assert fault.words.count("compliance J") == 2
    assert fault.words.endswith("the model lacks an effect, or masses are wrong: run bayescal gap")


def test_a_fit_without_negative_values_is_unchanged(free):
    z = free.z.copy()
    for k, p in enumerate(free.model.parameters):
        if p.positive:
            z[k] = 0.0
    good = replace(free, z=z)
    assert bounded(good) == (good, UNCHANGED)


def test_values_that_are_negative_together_are_left(free, held):
    """Each within its u, but all of them at 1.9 u below zero by chance are less probable than one at 2 u."""
    out, names = held[0], [p.name for p in free.model.parameters if p.positive]
    z = out.z.copy()
    for k, p in enumerate(out.model.parameters):
        if p.positive:
            z[k] = (-1.9 * out.sd[k] * p.sd - p.centre) / p.sd
    apart = np.diag(np.diag(out.covariance))
    (fault,) = not_physical(replace(out, z=z), apart)
    assert fault.words.startswith("negative together beyond their u")
    assert fault.p_value == pytest.approx(chi2.sf(len(names) * 1.9**2, len(names)), rel=1e-6)
    assert fault.p_value < fault.level
    assert fault.value > fault.limit
    assert not_physical(out, out.covariance) == ()
