"""The gate of the validation data: what a refit gains, and whether they contradict it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from made_up_errors import NOISE, held
from scipy.stats import chi2, multivariate_normal

from bayescal.gap.search.gate import contradiction, gain, share
from bayescal.gap.settings import GATE
from bayescal.predict.crossvalidation import BLOCKED, LEFT_OUT

COUNT = 60
RNG = np.random.default_rng(0)
RESIDUAL = NOISE * RNG.choice([-1.3, -1.0, -0.6, 0.6, 1.0, 1.3], COUNT)
DISTANCES = 2 * NOISE * np.array([1.0, -1.0, 0.9, -1.1, 1.1, -0.9])


def correlated(residual, distances=None, seed=1):
    """Errors whose parameters make them dependent."""
    out = held(residual, distances=distances)
    by = NOISE * np.random.default_rng(seed).standard_normal((COUNT, 3))
    d = replace(out.distances, by_parameters=NOISE * np.ones((len(out.distances.error), 1)))
    return replace(out, by_parameters=by, distances=d)


def test_gain_is_that_of_the_full_normal_densities():
    """Noise, parameters and a fifth of each change, which distances also share."""
    before = correlated(2 * RESIDUAL, 3 * DISTANCES, seed=2)
    less, more = correlated(1.5 * RESIDUAL, 2 * DISTANCES), correlated(RESIDUAL, DISTANCES, seed=3)

    def density(*way):
        h = way[-1]
        contacts = np.diag(h.noise**2) + h.by_parameters @ h.by_parameters.T
        shared = 2 * NOISE**2 + np.zeros((6, 6))  # parameters and noise
        for a, b in pairwise(way):
            contacts = contacts + np.diag((0.2 * (a.residual - b.residual)) ** 2)
            off = 0.2 * (a.distances.error - b.distances.error)
            shared = shared + np.diag(off**2) + np.outer(off, off)
        shared = shared + GATE.rounding**2 * np.eye(6)
        pairs = (contacts, h.residual), (shared, h.distances.error)
        return sum(multivariate_normal(cov=c, allow_singular=True).logpdf(r) for c, r in pairs)

    assert gain(before, less, more) == pytest.approx(density(before, less, more) - density(before, less))
    assert gain(before, before, more) == pytest.approx(density(before, more) - density(before))


def test_a_refit_that_is_too_sure_of_itself_loses():
    """Errors equal, but the refit states a fifth of their size."""
    sure = held(5 * RESIDUAL)
    before = replace(sure, noise=5 * sure.noise)
    assert gain(before, before, sure) < -100
    assert gain(before, before, replace(before, residual=0.9 * before.residual)) > 0


def test_a_change_that_is_large_is_no_excuse():
    """Two effects that spoil: without one of them errors are smaller, and so is the form error they claim."""
    sign = np.where(np.arange(COUNT) % 2, 1.0, -1.0)
    before, less, more = (held(RESIDUAL + k * NOISE * sign) for k in (4, 14, 26))
    assert gain(before, less, more) < -3
    assert gain(before, before, less) < -3
    # An effect that takes 60 noise away and leaves 10 is a right name; without the tolerance it loses
    before, after = held(60 * NOISE * sign), held(10 * NOISE * sign)
    assert contradiction(before, after) > 0.1
    assert contradiction(after, after) < 1e-100  # the same errors, not of a change


def test_one_slip_neither_condemns_nor_saves():
    """A contact that is gross counts by itself, in a mixture: a metre off costs no more than a millimetre."""
    before = held(RESIDUAL)
    slipped = [RESIDUAL + np.where(np.arange(COUNT) == 3, off, 0.0) for off in (1e-3, 1.0)]
    costs = [-gain(before, before, held(r)) for r in slipped]
    assert costs[0] == pytest.approx(costs[1], abs=1e-6)
    assert 3 < costs[0] < 15
    both = [held(r) for r in slipped]
    assert gain(both[0], both[0], both[1]) == pytest.approx(0.0, abs=1e-6)
    assert contradiction(before, both[0]) == pytest.approx(contradiction(before, before), rel=0.01)


def test_fitted_contacts_do_not_judge_a_refit():
    """Left out one by one they are calibration rows, which the search has judged; distances still judge."""
    before, after = (replace(held(k * RESIDUAL), how=LEFT_OUT) for k in (1, 3))
    assert gain(before, before, after) == 0.0
    assert contradiction(before, after) == 1.0
    before = replace(held(RESIDUAL, distances=DISTANCES), how=LEFT_OUT)
    before = replace(before, distances=replace(before.distances, by_noise=2 * NOISE * np.eye(6)))
    spoilt = replace(before, distances=replace(before.distances, error=8 * DISTANCES))
    assert gain(before, before, spoilt) < -3


def blocked(residual, by, fold):
    return replace(held(residual), how=BLOCKED, by_parameters=by, fold=fold)


def test_blocks_that_are_left_out_judge_a_refit():
    """Each block has a fit of its own, so that blocks are independent; fitted contacts contradict nothing."""
    fold = np.repeat(np.arange(4), COUNT // 4)
    by = NOISE * np.random.default_rng(3).standard_normal((COUNT, 3))
    before, after = (blocked(k * RESIDUAL, by, fold) for k in (1, 3))
    each = [
        gain(*(replace(held(h.residual[own]), by_parameters=by[own]) for h in (before, before, after)))
        for own in (fold == k for k in range(4))
    ]
    assert gain(before, before, after) == pytest.approx(sum(each))
    assert gain(before, before, after) < -3
    assert contradiction(before, after) == 1.0


def test_a_share_is_a_regression_with_the_covariance_of_each_block():
    rng = np.random.default_rng(5)
    fold = np.arange(COUNT) % 3
    by = 3 * NOISE * rng.standard_normal((COUNT, 4))
    change = 2 * NOISE * rng.standard_normal(COUNT)
    less, more = blocked(RESIDUAL + change, by, fold), blocked(RESIDUAL, by, fold)
    covariance = NOISE**2 * np.eye(COUNT) + np.where(fold == fold[:, None], by @ by.T, 0.0)
    weighted = np.linalg.solve(covariance, change)
    expected = weighted @ (RESIDUAL + change) / (weighted @ change)
    assert share(less, more).value == pytest.approx(expected, rel=1e-9)


def test_a_direction_that_the_other_blocks_do_not_determine_is_no_evidence():
    """Large residuals along it do not decide whether the change of a name is there."""
    rng = np.random.default_rng(4)
    fold = np.repeat(np.arange(4), COUNT // 4)
    change = 2 * NOISE * np.sign(rng.standard_normal(COUNT))
    loose = rng.standard_normal(COUNT)
    by = 1e-2 * loose[:, None]
    lost = 200 * NOISE * loose * np.array([1, -1, 1, -1])[fold]
    less, more = (blocked(lost + r, by, fold) for r in (RESIDUAL / 3 + change, RESIDUAL / 3))
    found = share(less, more)
    assert found.value == pytest.approx(1.0, abs=0.1)
    assert found.u < 0.1


def test_distances_contradict_as_their_chi_square_says():
    """With independent errors, no change and no contacts that judge."""
    before = replace(held(RESIDUAL, distances=DISTANCES), how=LEFT_OUT)
    d = replace(before.distances, by_noise=NOISE * np.eye(6))
    before = replace(before, distances=d)
    assert contradiction(before, before) == pytest.approx(
        chi2.sf(np.sum(DISTANCES**2) / NOISE**2, 6), rel=1e-6
    )


def test_of_two_tests_the_smaller_probability_counts_twice():
    """Contacts as expected beside distances that are not: two tests, and so twice the chance."""
    quiet = held(0.8 * RESIDUAL, distances=DISTANCES)
    quiet = replace(quiet, distances=replace(quiet.distances, by_noise=NOISE * np.eye(6)))
    alone = replace(quiet, how=LEFT_OUT)
    assert 0.0 < contradiction(alone, alone) < 0.4
    assert contradiction(quiet, quiet) == pytest.approx(2.0 * contradiction(alone, alone), rel=1e-12)


def test_few_degrees_of_freedom_of_the_noise_contradict_less():
    """Errors twice as large as predicted: nothing if the noise is known from five residuals."""
    known = held(2.2 * RESIDUAL)
    few = replace(known, dof={"contact": 5.0})
    assert contradiction(known, known) < GATE.contradicted < contradiction(few, few)
