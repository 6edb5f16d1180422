"""The fraction of the gap that went: known cases, coverage of its interval, and what is not claimed."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.gap.outcome.shrinkage import compare, expects, shrinkage
from bayescal.predict.bootstrap import resampled
from bayescal.predict.crossvalidation import VALIDATED, HeldOut
from bayescal.predict.distances import CentreDistances
from bayescal.predict.intervals import bootstrap_interval95

NOISE = 5e-6
INFINITE = float("inf")


def held(residual, sd=NOISE, distances=None, distance_sd=NOISE, block=None):
    """Contacts that leave these residuals, under a model that expects `sd`."""
    count = len(residual)
    distances = np.zeros(0) if distances is None else distances
    names = tuple((f"a@{k // 3}", f"b@{k // 3}") for k in range(len(distances)))
    return HeldOut(
        VALIDATED,
        "contact",
        residual,
        np.full(count, NOISE),
        np.full((count, 1), np.sqrt(max(sd**2 - NOISE**2, 0.0))),
        np.arange(count),
        np.full(count, "planes"),
        np.full(count, "contact"),
        np.full(count, "cube.+x"),
        np.arange(count) if block is None else block,
        CentreDistances(
            names, distances, np.zeros((len(names), 1)), np.full((len(names), 1), distance_sd),
            np.zeros(len(names)),
        ),
    )  # fmt: skip


def test_a_gap_that_is_taken_away_and_half_of_one():
    rng = np.random.default_rng(0)
    noise, effect = NOISE * rng.standard_normal(4000), 20e-6 * rng.standard_normal(4000)
    (whole,) = shrinkage(held(noise + effect), held(noise), NOISE)
    assert (whole.what, whole.count) == ("planes", 4000)
    assert whole.removed == pytest.approx(1.0, abs=0.02)
    assert whole.before == pytest.approx(np.hypot(20e-6, 5e-6), rel=0.05)
    assert whole.floor == pytest.approx(NOISE)
    assert whole.claimed
    (half,) = shrinkage(held(noise + effect), held(noise + np.sqrt(0.5) * effect), NOISE)
    assert half.removed == pytest.approx(0.5, abs=0.05)
    assert half.removed_interval95[0] < 0.5 < half.removed_interval95[1]


@pytest.mark.parametrize(("blocks", "per_block"), [(40, 1), (20, 3), (5, 3)])
def test_interval_covers_the_truth(blocks, per_block):
    """Half of a gap whose size differs from block to block goes; the interval holds that share."""
    rng = np.random.default_rng(blocks)
    count, inside, finite = blocks * per_block, 0, 0
    block = np.repeat(np.arange(blocks), per_block)
    for _ in range(200):
        effect = 20e-6 * np.repeat(rng.standard_normal(blocks), per_block) * rng.choice([-1, 1], count)
        noise = NOISE * rng.standard_normal(count)
        squares = np.stack(
            [
                (noise + effect) ** 2,
                (noise + np.sqrt(0.5) * effect) ** 2,
                np.full(count, NOISE**2),
                np.zeros(count),
            ]
        )
        found = compare("planes", count, squares, block, (NOISE, NOISE), INFINITE, rng)
        finite += np.isfinite(found.removed)
        inside += found.removed_interval95[0] <= 0.5 <= found.removed_interval95[1]
    assert finite > 180
    assert inside / finite > 0.9


def test_without_a_gap_there_is_no_ratio_and_no_claim():
    rng = np.random.default_rng(1)
    ratios, claims = 0, 0
    for _ in range(200):
        noise = NOISE * rng.standard_normal(60)
        other = noise + 0.5e-6 * rng.standard_normal(60)
        (found,) = shrinkage(held(noise), held(other), NOISE, noise_dof=45)
        ratios += np.isfinite(found.removed)
        claims += found.claimed
    assert ratios <= 20
    assert claims <= 20


def test_worse_distances_are_not_claimed():
    rng = np.random.default_rng(2)
    noise = NOISE * rng.standard_normal(60)
    big = 34e-6 * rng.choice([-1, 1], 12)
    before = held(noise + 20e-6, distances=big)
    planes, distances = shrinkage(before, held(noise, distances=3 * big), NOISE)
    assert planes.claimed
    assert (distances.what, distances.count, distances.claimed) == ("distances", 12, False)
    assert distances.removed < 0
    unsure = shrinkage(before, held(noise, distances=big / 10, distance_sd=100e-6), NOISE)[1]
    assert not unsure.claimed
    assert unsure.predicted == pytest.approx(100e-6)
    good = shrinkage(before, held(noise, distances=big / 10), NOISE)[1]
    assert good.claimed
    assert good.removed > 0.95


def test_predicted_shrinkage_rests_on_fitted_rows_alone():
    """It is right where the refitted model is, and held-out noise of another draw does not move it."""
    rng = np.random.default_rng(6)
    effect, off = 20e-6 * rng.standard_normal(2000), 3e-6 * rng.standard_normal(2000)
    told = []
    for _ in range(2):
        noise = NOISE * rng.standard_normal(2000)
        (found,) = shrinkage(held(noise + off + effect), held(noise + off, sd=np.hypot(NOISE, 3e-6)), NOISE)
        assert found.predicted_before == pytest.approx(found.before, rel=0.05)
        assert found.predicted == pytest.approx(found.after, rel=0.05)
        told.append((found.predicted_before, found.predicted))
    assert told[0] == pytest.approx(told[1], rel=1e-9)
    assert expects(np.array([7.0, -1.0]), np.array([3.0, -1.0]), np.array([1.0, 1.0])) == pytest.approx(
        (3.0, 1.0)
    )


def test_a_slip_does_not_count():
    rng = np.random.default_rng(3)
    noise = NOISE * rng.standard_normal(60)
    slipped = noise.copy()
    slipped[7] = 300e-6
    (clean,) = shrinkage(held(noise + 15e-6), held(noise), NOISE)
    (spoilt,) = shrinkage(held(slipped + 15e-6), held(slipped), NOISE)
    assert spoilt.count == clean.count - 1
    assert spoilt.after == pytest.approx(clean.after, rel=0.1)


def test_one_seed_one_result():
    rng = np.random.default_rng(4)
    noise = NOISE * rng.standard_normal(60)
    first, again = (shrinkage(held(3 * noise), held(noise), NOISE, seed=5) for _ in range(2))
    assert first == again
    three = replace(held(noise), block=np.arange(60) // 20)
    (wide,) = shrinkage(replace(held(3 * noise), block=np.arange(60) // 20), three, NOISE)
    assert wide.removed == pytest.approx(first[0].removed)


def test_bootstrap_moves_blocks_as_one():
    rng = np.random.default_rng(5)
    block = np.repeat(np.arange(30), 10)
    shared = rng.standard_normal(30)[block]
    means = resampled(block, np.stack([shared, shared + 1.0]), rng)
    np.testing.assert_allclose(means[:, 1] - means[:, 0], 1.0)
    assert means[:, 0].std() == pytest.approx(shared.std() / np.sqrt(30), rel=0.1)
    wide, narrow = (np.ptp(bootstrap_interval95(0.0, means[:, 0], number)) for number in (4, 1000))
    assert wide > 1.7 * narrow
