"""Outliers: clean measurements are lost at the promised rate, whatever their rows and their number."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2 as chi2_distribution

from bayescal.estimate import estimate
from bayescal.estimate.outliers import FALSE_REJECTIONS, Judged, freed, rejected, scale, student_weights
from bayescal.model import build
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate


def session(rng, count, rows, unknowns, off=0.0):
    """Slopes (C, k, D) and residuals (C, k) of a linear session; measurement 5 is `off` by so many sigma."""
    slopes = rng.standard_normal((count, rows, unknowns))
    y = slopes @ rng.standard_normal(unknowns) * 10 + rng.standard_normal((count, rows))
    way = rng.standard_normal(rows)
    y[5] += off * way / np.linalg.norm(way)
    return slopes, y


def solved(slopes, y, weight, size=1.0):
    """Covariance of weighted least squares, and its residuals; a prior ten times as wide as the truth."""
    gram = np.einsum("cki,c,ckj->ij", slopes, weight, slopes) / size**2
    covariance = np.linalg.inv(gram + np.eye(len(gram)) / 1e4)
    z = covariance @ np.einsum("cki,c,ck->i", slopes, weight, y) / size**2
    return covariance, y - slopes @ z


def left_out(slopes, y):
    """Measurements that are left out in the end: the rounds of an estimate, on a linear model."""
    weight, size = np.ones(len(y)), 1.0
    for k in range(20):
        covariance, r = solved(slopes, y, weight, size)
        leverage = slopes @ covariance @ np.swapaxes(slopes, 1, 2) / size**2
        found = Judged.of([(r, leverage, weight)])
        size, before = found.robust, weight
        weight = found.student_weights() if k < 8 else 1.0 - found.outliers()
        if np.array_equal(weight, before):
            break
    return np.flatnonzero(weight == 0)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_false_rejections_of_known_noise_are_as_promised(rows):
    """One hundredth of a measurement a session, of any number of rows."""
    rng = np.random.default_rng(rows)
    lost = [
        np.sum(rejected(np.sum(rng.standard_normal((20, rows)) ** 2, axis=1), rows)) for _ in range(20000)
    ]
    assert np.mean(lost) == pytest.approx(FALSE_REJECTIONS, rel=0.35)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_robust_scale_is_that_of_the_noise(rows):
    rng = np.random.default_rng(rows)
    r = 3.0 * rng.standard_normal((20000, rows))
    r[:1000] *= 50.0
    assert scale(np.sum(r**2, axis=1), rows) == pytest.approx(3.0, rel=0.06)
    assert scale(np.sum(r**2, axis=1) / 2, rows, taken=rows * 10000) == pytest.approx(3.0, rel=0.06)


@pytest.mark.parametrize(("count", "rows", "unknowns"), [(60, 1, 12), (30, 2, 12), (20, 3, 12), (44, 1, 30)])
def test_clean_sessions_keep_what_they_have(count, rows, unknowns):
    """With few contacts over the unknowns too: a residual counts by its own variance, a scale by its dof."""
    rng = np.random.default_rng(count + rows)
    lost = [len(left_out(*session(rng, count, rows, unknowns))) for _ in range(150)]
    assert sum(lost) <= 150 * FALSE_REJECTIONS + 4  # 1.5 are expected
    assert max(lost) <= 2


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_ten_sigma_are_always_rejected(rows):
    rng = np.random.default_rng(rows)
    for _ in range(40):
        assert 5 in left_out(*session(rng, 60, rows, 10, off=10.0))


def test_a_scale_of_few_degrees_of_freedom_rejects_less():
    chi2 = np.array([20.0, 1.0, 1.0, 1.0])
    assert rejected(chi2, 1).tolist() == [True, False, False, False]
    assert not np.any(rejected(chi2, 1, dof=4.0))
    assert rejected(100 * chi2, 1, dof=4.0)[0]
    assert rejected(100 * chi2, 1, 10.0)[0]
    # nor is anything rejected by a scale that rests on it alone
    assert not np.any(rejected(np.array([1e6, 1.0]), 1, 1e3, 0.5, True))


def test_a_residual_counts_by_the_variance_that_the_fit_predicts_of_it():
    """Of normal data all are chi-square, kept, half-weighted or left out, whatever their leverage."""
    rng = np.random.default_rng(0)
    slopes = rng.standard_normal((12, 2, 8))
    slopes[0] *= 6.0  # of high leverage
    for own in (0.0, 0.4, 1.0):
        weight = np.ones(12)
        weight[:2] = own
        out = []
        for _ in range(1500):
            y = slopes @ rng.standard_normal(8) + rng.standard_normal((12, 2))
            covariance, r = solved(slopes, y, weight)
            out.append(freed(r, slopes @ covariance @ np.swapaxes(slopes, 1, 2), weight))
        mean = np.mean(out, axis=0)
        # a half-weighted contact has the weight of half a contact in the fit of the others
        np.testing.assert_allclose(mean[:2] if own == 0.4 else mean, 2.0, rtol=0.15 if own == 0.4 else 0.1)
        assert np.quantile(np.array(out)[:, 0], 0.9) == pytest.approx(chi2_distribution.ppf(0.9, 2), rel=0.12)


def test_student_weights_are_those_of_its_likelihood():
    """Of Student t noise, whose likelihood they maximise at its own scale: E w chi2 = rows."""
    rng = np.random.default_rng(1)
    for rows in (1, 2, 3):
        t = rng.standard_normal((100000, rows)) / np.sqrt(rng.chisquare(4.0, (100000, 1)) / 4.0)
        chi2 = np.sum(t**2, axis=1)
        assert np.mean(chi2 * student_weights(chi2, rows, 1.0)) == pytest.approx(rows, rel=0.02)


def test_few_contacts_are_not_fitted_beyond_their_noise():
    """Hardly more rows than unknowns: the median of what is left is no measure of the noise."""
    session = simulate(Options(seed=3, contacts=80, repeats=5, later=0, placements=0)).dataset
    m = session.measurements
    few = replace(session, measurements=replace(m, role=np.where(np.arange(80) < 14, m.role, "validate")))
    found = estimate(build(Scene(few), ("geometry", "compliance")))
    assert not len(found.rejected)
    assert 0.6 < found.weights.scale["contact"] < 1.5
    assert found.iterations < 60


def test_stated_noise_that_the_scale_contradicts_does_not_count():
    """An error that the model lacks makes all residuals larger: the largest of twenty is no outlier then."""
    chi2 = 4.0**2 * np.array([8.5, *np.ones(19)])
    assert not np.any(rejected(chi2, 1, 4.0, 20.0, True, worth=8.0))
    chi2[0] = 4.0**2 * 14.0
    assert rejected(chi2, 1, 4.0, 20.0, True, worth=8.0)[0]
