"""False alarms of a diagnosis: on sessions of noise at most the stated share has anything significant."""

from dataclasses import replace

import numpy as np
import pytest
from chances import least, most
from gap_problems import BASELINE, Bench, pool_of, unsolved
from sessions import with_columns

from bayescal.estimate import STATED_WORTH
from bayescal.gap.linear.state import fit_state
from bayescal.gap.outcome import margins as margins_module
from bayescal.gap.outcome.statements import amplitudes
from bayescal.gap.outcome.where import Scale, f_test, places, places_named
from bayescal.gap.result import Named
from bayescal.gap.search.beam import Hypothesis, Member
from bayescal.gap.settings import OUTCOME
from bayescal.predict.crossvalidation import validation_errors

SESSIONS, DRAWS = 25, 200
"""Of noise: with a search, and with single tests only."""


@pytest.fixture(scope="module")
def bench(cube):
    """A small session with one in twelve of the generic cells, so that a search is fast."""
    own = Bench.of(cube(seed=7, count=60).dataset)
    of = [k for k, cell in enumerate(own.pool.cells) if cell.clusters is None][::12]
    columns = np.concatenate([own.pool.sets[s] for k in of for s in np.flatnonzero(own.pool.owner == k)])
    few = pool_of([own.pool.cells[k] for k in of], own.pool.columns[:, columns], own.pool.count)
    return replace(own, pool=few)


def noise_of(bench, seed):
    """Noise as uncertain as the stated one, and a drawn arm."""
    p = bench.made_up(seed)
    rng = np.random.default_rng([seed, 1])
    drawn = p.jacobian @ rng.standard_normal(p.jacobian.shape[1])
    noise = rng.standard_normal(len(drawn))
    noise[: p.count] *= np.sqrt(STATED_WORTH / rng.chisquare(STATED_WORTH))
    return replace(p, residual=drawn + noise)


def scale_of(bench):
    return Scale(bench.circumstances, 1e-10, bench.problem.jacobian.shape[1], bench.slopes)


def placed(bench, state, pool):
    return places(Hypothesis((), state, 0.0, 0.0), pool, bench.known.pool, scale_of(bench))


def test_locations_of_noise_are_significant_as_rarely_as_stated(bench):
    """Each test has its chance, and the smallest probability of all of them that of the family."""
    found, p = 0, []
    for seed in range(DRAWS):
        state = fit_state(noise_of(bench, seed), (), ())
        if seed < SESSIONS:
            found += placed(bench, state, bench.pool)[0].family_p_value <= OUTCOME.significant
        p.append(f_test(state, bench.pool.columns[:, bench.pool.sets[0]]))
        p.append(f_test(state, bench.pool.columns[:, bench.pool.sets[-1]]))
    assert found <= most(SESSIONS, OUTCOME.significant)
    for chance in (0.1, 0.5):
        assert least(len(p), chance) <= np.sum(np.array(p) <= chance) <= most(len(p), chance)


def test_every_test_takes_its_share_of_the_margin(bench):
    """Of the generic sets and of the sites of a name: with all twice, a probability is twice as large."""
    pool = bench.pool
    there = bench.visible(pool.columns[:, pool.sets[0]], 50.0, seed=1)
    state = fit_state(bench.made_up(3, there), (), ())
    twice = pool_of((*pool.cells, *pool.cells), np.tile(pool.columns, 2), pool.count)
    one, two = (placed(bench, state, of)[0] for of in (pool, twice))
    assert one.driver == two.driver
    assert 0.0 < one.p_value < 0.5 / len(twice.sets)
    assert one.family_p_value == pytest.approx(len(pool.sets) * one.p_value)
    assert two.family_p_value == pytest.approx(2.0 * one.family_p_value, rel=1e-6)
    variant = max(bench.known.variants["backlash"], key=lambda v: len(v.columns))
    state = fit_state(bench.made_up(3, bench.of_effect("backlash", 60.0)), variant.columns, np.ones(6))
    named = Hypothesis((Member(variant, 1.0, 0.0),), state, 0.0, 0.0)
    sites = places_named(named, bench.known.pool, scale_of(bench))
    count = len(variant.columns)
    assert any(place.family_p_value < 1.0 for place in sites)
    for place in sites:
        assert place.family_p_value == pytest.approx(min(1.0, count * place.p_value))


def test_amplitudes_of_noise_are_significant_as_rarely_as_stated(cube):
    fitted = unsolved(cube(seed=1).dataset, (*BASELINE, "backlash"), off=0.0)
    own = [k for k, p in enumerate(fitted.model.parameters) if p.effect == "backlash"]
    covariance, found, together = 0.05**2 * np.eye(fitted.model.size), np.zeros(1000, int), 0
    for seed in range(len(found)):
        z = np.zeros(fitted.model.size)
        z[own] = 0.05 * np.random.default_rng(seed).standard_normal(len(own))
        each = amplitudes(replace(fitted, z=z), covariance, [Named("backlash", "backlash", (), "", 1.0, 0.0)])
        found[seed] = sum(a.significant for a in each[: len(own)])
        together += len(each) > len(own)  # their sum, where none is significant alone
    alarms = int(np.sum(found > 0))
    assert least(len(found), OUTCOME.significant) <= alarms <= most(len(found), OUTCOME.significant)
    assert 0 < together <= most(len(found), OUTCOME.significant)


def test_bins_of_noise_deviate_as_rarely_as_stated(cube, monkeypatch):
    """Residuals drawn with the covariance that a fit and its predictions leave; the noise is uncertain."""
    session = cube(seed=20, count=100).dataset
    role = np.where(np.arange(100) % 5 == 4, "validate", "calibrate")
    fitted = unsolved(with_columns(session, role=role), off=0.0)
    j = fitted.linear.jacobian
    fitted = replace(fitted, covariance=np.linalg.inv(np.eye(j.shape[1]) + j.T @ j))
    held = validation_errors(fitted)
    shape = margins_module.residuals(fitted, held)
    count = len(shape.rows)
    both = shape.spread @ shape.spread.T * np.equal.outer(shape.fitted, shape.fitted)
    values, vectors = np.linalg.eigh(np.eye(count) + np.where(shape.fitted, -1.0, 1.0)[:, None] * both)
    found, single, dof = 0, [], 15.0
    for seed in range(4 * DRAWS):
        rng = np.random.default_rng(seed)
        white = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(count))
        white *= np.sqrt(dof / rng.chisquare(dof))
        drawn = replace(shape, white=white, suspect=np.zeros(count, bool), dof=dof)
        single.append(margins_module.margin_of(drawn, "", "", np.arange(count) % 3 == 0).p_value)
        if seed < SESSIONS:
            monkeypatch.setattr(margins_module, "residuals", lambda *_, drawn=drawn: drawn)
            bins = [m for own in margins_module.margins(fitted, held).values() for m in own]
            found += min(m.p_value for m in bins) <= 0.05
    assert found <= most(SESSIONS, 0.05)
    low = np.array(single) <= 0.05  # the smaller of two tests that are not independent
    assert 0.033 * len(low) < np.sum(low) <= most(len(low), 0.05)
