"""What a fit states covers the truth as often as it says, in a small problem of an instrument.

Noise is drawn as uncertain as the stated one: of so many sessions 95.45 % of the intervals hold the truth.
"""

from dataclasses import replace

import numpy as np
import pytest
from chances import least, most
from scipy.stats import chi2

from bayescal.assess.budget import budget
from bayescal.assess.inputs import Basis
from bayescal.assess.measurand import parameter
from bayescal.estimate import STATED_WORTH, calibrated, estimate
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.outliers import FALSE_REJECTIONS, Judged
from bayescal.model import Scene, with_parameters

SESSIONS, U = 120, 10e-6
NAMES = ("theta2", "theta3", "theta5")


@pytest.fixture(scope="module")
def sessions(tracker):
    """Fits to six points each: values and intervals of three joint offsets, noise over the stated one."""
    dataset = tracker(0, 6).dataset
    some = [p for p in calibrated(Scene(dataset), ("geometry",)).model.parameters if p.name in NAMES]
    model = with_parameters(Scene(dataset), ("geometry",), some)
    block, at = model.blocks[0], model.slices[model.blocks[0].target]
    empty = replace(block.kind, xyz=0.0 * block.kind.xyz)
    inside, noise = [], []
    for seed in range(SESSIONS):
        rng = np.random.default_rng(seed)
        z = rng.standard_normal(model.size) * np.where(np.arange(model.size) < len(some), 1.0, 0.2)
        seen = empty.residual(block.state(z[at]), block.seen(model.deviations(z[: len(some)]))).T
        size = np.sqrt(STATED_WORTH / rng.chisquare(STATED_WORTH))
        xyz = seen + size * U * rng.standard_normal(seen.shape)
        again = replace(dataset, measurements=replace(dataset.measurements, xyz=xyz))
        basis = Basis(stated(estimate(with_parameters(Scene(again), ("geometry",), some)), []))
        found = basis.stated.plain
        noise.append((found.dof["point"], found.weights.scale["point"] / size))
        for name, true in zip(NAMES, model.physical(z), strict=False):
            m = parameter(basis, name)
            inside.append(abs(m.value - true) <= budget(basis, m).expanded)
    return np.array(inside).reshape(SESSIONS, len(NAMES)), *np.array(noise).T


def test_parameters_lie_within_their_u_as_often_as_stated(sessions):
    assert 0.93 < np.mean(sessions[0]) < 0.97


def test_noise_has_the_degrees_of_freedom_that_are_stated(sessions):
    """With the weight of the stated noise: (8 + dof) times its square over the true one is chi-square."""
    _, dof, ratio = sessions
    p = chi2.cdf((STATED_WORTH + dof) * ratio**2, STATED_WORTH + dof)
    for chance in (0.1, 0.5, 0.9):
        assert least(SESSIONS, chance) <= np.sum(p <= chance) <= most(SESSIONS, chance)
    assert np.mean(dof) == pytest.approx(18 - 9, abs=0.6)


@pytest.mark.parametrize(("count", "rows"), [(40, 1), (12, 3)])
def test_clean_measurements_are_lost_as_rarely_as_promised(count, rows):
    """At the first iteration, by the median, at most so; later, by the scale of those kept, exactly."""
    draws, rng = 1500, np.random.default_rng(count)
    none, lost, p = np.zeros((count, rows, rows)), np.zeros(2), []
    for _ in range(draws):
        size = np.sqrt(STATED_WORTH / rng.chisquare(STATED_WORTH))
        r = size * rng.standard_normal((count, rows))
        hard, soft = (Judged.of([(r, none, np.full(count, w))]) for w in (1.0, 0.999))
        lost += np.sum(hard.outliers()), np.sum(soft.outliers())
        p.append(chi2.cdf((STATED_WORTH + hard.dof) * (hard.scale / size) ** 2, STATED_WORTH + hard.dof))
    assert lost[0] / draws == pytest.approx(FALSE_REJECTIONS, abs=0.006)
    assert 0.0 < lost[1] / draws < 0.009
    assert least(draws, 0.1) <= np.sum(np.array(p) <= 0.1) <= most(draws, 0.1)


def test_weights_do_not_depend_on_the_unit_of_the_noise():
    """Of noise well above the stated one, whatever its size: by its own scale, at every iteration."""
    r = np.random.default_rng(2).standard_normal((60, 2))
    r[5] *= 8.0
    for weight in (1.0, 0.999):
        found = [Judged.of([(size * r, np.zeros((60, 2, 2)), np.full(60, weight))]) for size in (50.0, 5e3)]
        np.testing.assert_allclose(found[0].student_weights(), found[1].student_weights(), rtol=1e-3)
        assert [np.flatnonzero(own.outliers()).tolist() for own in found] == [[5], [5]]
        assert found[0].student_weights()[5] < 0.2 < 0.9 < np.median(found[0].student_weights())
