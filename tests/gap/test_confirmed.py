"""Which named effects the validation data admit, and which are withheld."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from made_up_errors import NOISE, held
from scipy.stats import chi2, multivariate_normal
from sessions import misread, with_columns

from bayescal.errors import BayescalError
from bayescal.estimate import estimate
from bayescal.gap.outcome.magnitude import log_predictive
from bayescal.gap.search.gate import confirmed, contradiction, gain, share
from bayescal.gap.settings import GATE
from bayescal.model import build
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import BLOCKED, BY_REGION, LEFT_OUT, REGIONS, regions, validation_errors
from bayescal.predict.errors import ValidationErrors, without_rows

COUNT = 60
SCATTER = np.random.default_rng(4).standard_normal(COUNT)


def errors(excess: float) -> ValidationErrors:
    """Validation data with an error beside the noise, and two distances."""
    residual = NOISE * SCATTER + excess * np.where(np.arange(COUNT) % 2, 1.0, -1.0)
    made = held(residual, distances=np.zeros(2))
    by_parameters = NOISE * np.array([[1.0, 0.0], [1.0, 0.0]])
    apart = replace(made.distances, by_parameters=by_parameters, by_noise=NOISE * np.eye(2))
    return replace(made, distances=apart)


BASE = (errors(20e-6),)


def judged(spoils: dict[str, float], helps: dict[str, float], base: float = 20e-6):
    """Refits of sets of names, each of which takes an error away or adds one."""

    def refit(members):
        size = base - sum(helps.get(m, 0.0) for m in members) + sum(spoils.get(m, 0.0) for m in members)
        return "+".join(members), (errors(size),)

    return refit


def test_effects_that_help_are_kept():
    refit = judged({}, {"play": 8e-6, "scale": 7e-6})
    found = confirmed(("play", "scale"), refit, BASE)
    assert (found.members, found.fitted, found.withheld) == (("play", "scale"), "play+scale", ())
    # Even a certain one: there is no refit that has it
    broken = unfitted(refit, lambda m: "scale" in m)
    found = confirmed(("play", "scale"), broken, BASE, lambda member: True)
    assert (found.members, found.fitted, found.unclaimed) == (("play",), "play", ())
    (aside,) = found.withheld
    assert aside.words == "explains the calibration rows but cannot be fitted (gravity moves the arm)"


@pytest.mark.parametrize("order", [("drift", "play", "scale"), ("play", "scale", "drift")])
def test_the_effect_that_spoils_the_validation_is_withheld_whatever_its_size(order):
    """The last of the effects is the smallest: it must not be withheld for what another one does."""
    refit = judged({"drift": 60e-6}, {"play": 8e-6, "scale": 7e-6})
    found = confirmed(order, refit, BASE)
    assert found.members == tuple(m for m in order if m != "drift")
    assert [a.member for a in found.withheld] == ["drift"]
    assert found.withheld[0].cost == pytest.approx(-gain(BASE[0], found.errors, refit(order)[1][0]))
    assert found.fitted == "play+scale"


def test_a_name_that_costs_beside_another_that_helps_is_withheld():
    """Together they help. Alone, each removal is tried, and one of them is worth more without the other."""
    refit = judged({"drift": 8e-6}, {"play": 18e-6})
    assert gain(BASE[0], BASE[0], refit(("play", "drift"))[1][0]) > 3
    assert confirmed(("play", "drift"), refit, BASE).members == ("play",)


@pytest.mark.parametrize(
    ("warm", "count", "kept"), [(-7e-6, 1, "warm"), (1e-6, 1, None), (-5e-8, 1, "warm"), (-5e-8, 9, None)]
)
def test_an_effect_that_spoils_the_validation_is_named_in_a_form_that_does_not(warm, count, kept):
    """One that costs is not enough, if less than an effect may that is no second choice.

    Nor is one that gains as much as the best of several does by chance.
    """
    refit = judged({"drift": 60e-6, "slow": 30e-6, "warm": warm}, {"play": 8e-6})
    forms = (*["slow"] * count, "warm")
    found = confirmed(("drift", "play"), refit, BASE, instead=lambda members, m: forms)
    assert found.members == ((kept, "play") if kept else ("play",))
    assert [(a.member, new) for a, new in found.replaced] == ([("drift", kept)] if kept else [])
    assert [a.member for a in found.withheld] == ([] if kept else ["drift"])


def unfitted(refit, refused):
    """The refits, except of sets that cannot be fitted."""

    def some(members):
        if refused(members):
            raise BayescalError("gravity moves the arm", "compliance", "check masses")
        return refit(members)

    return some


def test_an_effect_without_which_the_others_cannot_be_fitted_is_kept():
    refit = unfitted(judged({"drift": 60e-6}, {"play": 8e-6, "scale": 7e-6}), lambda m: "play" not in m)
    assert confirmed(("play", "scale", "drift"), refit, BASE).members == ("play", "scale")


def test_two_that_spoil_are_both_withheld():
    refit = judged({"drift": 60e-6, "bending": 50e-6}, {"play": 8e-6})
    found = confirmed(("bending", "play", "drift"), refit, BASE)
    assert found.members == ("play",)
    assert {a.member for a in found.withheld} == {"drift", "bending"}
    # The others are tested as if it were not there, and the refit contains it
    found = confirmed(("drift", "bending", "play"), refit, BASE, lambda m: m == "drift")
    assert (found.members, found.fitted) == (("drift", "play"), "drift+play")
    assert [a.member for a in found.withheld] == ["bending"]
    assert [a.member for a in found.unclaimed] == ["drift"]
    assert found.unclaimed[0].cost > 3


def test_of_two_that_spoil_only_together_one_goes():
    """Either does what both do, so that no removal alone helps; less than both is needed all the same."""

    def refit(members):
        return "+".join(members), (errors(40e-6 if members else 0.0),)

    found = confirmed(("bending", "coupling"), refit, (errors(0.0),))
    assert found.members == ()
    assert len(found.withheld) == 2


def test_without_any_effect_the_baseline_stands():
    found = confirmed(("drift",), judged({"drift": 60e-6}, {}), BASE)
    assert (found.members, found.fitted) == ((), "")


@pytest.mark.parametrize("noise", [1.0, 0.2])
def test_share_of_a_predicted_change_is_one_if_true_and_none_if_spurious(noise):
    """Whatever noise is stated: its uncertainty is that of the scatter of the other errors."""
    rng = np.random.default_rng(3)
    values, withheld = [], []
    for _ in range(200):
        change, other = 10e-6 * rng.standard_normal(COUNT), 20e-6 * rng.standard_normal(COUNT)
        more = replace(errors(0.0), residual=other, noise=np.full(COUNT, noise * NOISE))
        true = share(replace(more, residual=other + change), more)
        none = share(replace(more, residual=other), replace(more, residual=other - change))
        values.append([(true.value - 1.0) / true.u, none.value / none.u])
        withheld.append([true.missing, none.missing])
    assert np.std(values, axis=0) == pytest.approx([1.0, 1.0], abs=0.2)
    assert np.mean(values, axis=0) == pytest.approx([0.0, 0.0], abs=0.25)
    wrongly, rightly = np.mean(withheld, axis=0)
    assert wrongly < 0.02
    assert rightly > 0.7


@pytest.mark.parametrize("blocks", [GATE.blocks, COUNT])
def test_uncertainty_of_a_share_is_that_of_a_mean_over_blocks(blocks):
    """Where the change is the same in every block, the share is the mean of those of the blocks."""
    rng = np.random.default_rng(8)
    block = np.repeat(np.arange(blocks), COUNT // blocks)
    change = 50e-6 * np.where(np.arange(COUNT) % 2, 1.0, -1.0)
    less = replace(errors(0.0), residual=change + 20e-6 * rng.standard_normal(COUNT), block=block)
    each = np.bincount(block, less.residual * change) / np.bincount(block, change**2)
    found = share(less, replace(less, residual=less.residual - change))
    assert not less.gross.any()
    assert found.value == pytest.approx(np.mean(each))
    assert found.u == pytest.approx(np.std(each, ddof=1) / np.sqrt(blocks))


def test_a_share_of_rows_of_few_poses_has_a_wide_uncertainty():
    """Ten rows of each of six poses with the same error are six observations: too few to withhold a name."""
    block = np.repeat(np.arange(6), COUNT // 6)
    less, more = (replace(errors(excess), block=block) for excess in (10e-6, 20e-6))
    assert share(less, more).u == np.inf
    assert not share(less, more).missing


def apart(seed, *sizes):
    """A change of a name, and other errors that are uncorrelated with it."""
    rng = np.random.default_rng(seed)
    change, other = (size * rng.standard_normal(COUNT) for size in sizes)
    return change, other - change * (other @ change) / (change @ change)


def test_a_name_whose_predicted_change_is_missing_is_withheld():
    """The log density does not show it where the stated noise is too large."""
    change, other = apart(5, 18e-6, 30e-6)

    def refit(members):
        residual = other - change * len(members)
        return "", (replace(errors(0.0), residual=residual, noise=np.full(COUNT, 60e-6)),)

    found = confirmed(("hysteresis",), refit, refit(())[1])
    assert found.members == ()
    assert found.withheld[0].cost < 3
    assert "of the change" in found.withheld[0].words


def test_a_name_must_pass_with_regions_left_out_as_with_blocks():
    """What it predicts is there in the blocks of time, and not in the regions: it is withheld."""
    change, other = apart(6, 20e-6, 20e-6)
    fold = np.arange(COUNT) % 5

    def refit(members):
        there = [other + change * (not members), other - change * len(members)]
        return "", tuple(
            replace(errors(0.0), residual=r, noise=np.full(COUNT, 60e-6), how=how, fold=fold)
            for r, how in zip(there, (BLOCKED, BY_REGION), strict=True)
        )

    found = confirmed(("eccentricity",), refit, refit(())[1])
    (aside,) = found.withheld
    assert "contacts in joint regions that are left out show" in aside.words
    (blocks, _), (base, _) = refit(("eccentricity",))[1], refit(())[1]
    assert share(base, blocks).value == pytest.approx(1.0)
    assert aside.share.value == pytest.approx(0.0, abs=1e-9)


def test_what_a_name_costs_is_of_the_blocks_whatever_it_lacks_in_regions():
    rng = np.random.default_rng(6)
    change, other = (20e-6 * rng.standard_normal(COUNT) for _ in range(2))
    less, more = (replace(errors(0.0), residual=other - k * change, how=BLOCKED) for k in (0, 3))
    one_block = [replace(e, block=np.zeros(COUNT, int)) for e in (less, more)]  # of which there is no share
    by_region = [replace(e, how=BY_REGION) for e in (less, more)]

    def refit(members):
        return "", (one_block[len(members)], by_region[len(members)])

    (aside,) = confirmed(("eccentricity",), refit, refit(())[1]).withheld
    assert share(*by_region).missing
    assert "makes blocks of poses and time that are left out less probable" in aside.words


# --- What a refit gains by the validation data, and whether they contradict it.

RNG = np.random.default_rng(0)
RESIDUAL = NOISE * RNG.choice([-1.3, -1.0, -0.6, 0.6, 1.0, 1.3], COUNT)
DISTANCES = 2 * NOISE * np.array([1.0, -1.0, 0.9, -1.1, 1.1, -0.9])


def correlated(residual, distances=None, seed=1):
    """Errors whose parameters make them dependent."""
    out = held(residual, distances=distances)
    by = NOISE * np.random.default_rng(seed).standard_normal((COUNT, 3))
    d = replace(out.distances, by_parameters=NOISE * np.ones((len(out.distances.error), 1)))
    return replace(out, by_parameters=by, distances=d)


def with_distances(residual, noise, **fields):
    """Errors of contacts and of distances, which have the noise of each alone."""
    out = held(residual, distances=DISTANCES)
    return replace(out, distances=replace(out.distances, by_noise=noise * np.eye(6)), **fields)


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
    before = with_distances(RESIDUAL, 2 * NOISE, how=LEFT_OUT)
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
    before = with_distances(RESIDUAL, NOISE, how=LEFT_OUT)
    chance = chi2.sf(np.sum(DISTANCES**2) / NOISE**2, 6)
    assert contradiction(before, before) == pytest.approx(chance, rel=1e-6)


def test_of_two_tests_the_smaller_probability_counts_twice():
    """Contacts as expected beside distances that are not: two tests, and so twice the chance."""
    quiet = with_distances(0.8 * RESIDUAL, NOISE)
    alone = replace(quiet, how=LEFT_OUT)
    assert 0.0 < contradiction(alone, alone) < 0.4
    assert contradiction(quiet, quiet) == pytest.approx(2.0 * contradiction(alone, alone), rel=1e-12)


def test_few_degrees_of_freedom_of_the_noise_contradict_less():
    """Errors twice as large as predicted: nothing if the noise is known from five residuals."""
    known = held(2.2 * RESIDUAL)
    few = replace(known, dof={"contact": 5.0})
    assert contradiction(known, known) < GATE.contradicted < contradiction(few, few)


# --- Names without validation measurements: blocks of rows and regions that are left out judge them.

FULL = ("geometry", "compliance")


def judged_in_blocks(dataset, name, how=BLOCKED):
    """Nats of a name by rows left out one by one and by blocks, and the share of its change in blocks."""
    fits = [estimate(build(Scene(dataset), own)) for own in (FULL, (*FULL, name))]
    less, more = (validation_errors(fit) for fit in fits)
    single = float(np.sum(log_predictive(more)[0] - log_predictive(less)[0]))
    less, more = (validation_errors(fit, without=how) for fit in fits)
    return single, gain(less, less, more), share(less, more)


@pytest.fixture(scope="module")
def dataset(cube):
    return cube(seed=1, count=150).dataset


def test_an_error_of_a_joint_is_confirmed(dataset):
    wave = misread(dataset, 4, 1e-3 * np.sin(dataset.measurements.readings[:, 3]))
    _, nats, shown = judged_in_blocks(wave, "eccentricity at joint 4 x8")
    assert nats > 100
    assert shown.value == pytest.approx(1.0, abs=4 * shown.u)
    assert shown.u < 0.05


def test_errors_that_neighbours_share_do_not_confirm_a_name(dataset):
    """Joints that change their zeros every 25 rows: left out one by one, rows do not contradict a step."""
    rng = np.random.default_rng(1)
    for joint in range(1, 7):
        dataset = misread(dataset, joint, np.repeat(3e-4 * rng.standard_normal(6), 25))
    single, nats, shown = judged_in_blocks(dataset, "step@80 x8")
    assert single > -0.5
    assert nats < -GATE.loss
    assert shown.missing


def test_a_region_has_the_rows_of_its_poses_in_any_order(cube):
    m = cube(seed=1, count=40).dataset.measurements
    rows = np.concatenate([np.arange(40), np.arange(40)])  # two residuals of each row
    label = regions(m, rows)
    assert np.array_equal(label[:40], label[40:])
    assert len(np.unique(label)) == REGIONS
    inside, own = m.readings / np.std(m.readings, axis=0), label[:40]
    centres = np.array([inside[own == k].mean(axis=0) for k in range(REGIONS)])
    near = np.argmin(np.linalg.norm(inside[:, None] - centres, axis=2), axis=1)
    assert np.mean(near == own) > 0.9
    first, *others = regions(m, np.repeat([3, 8], 5))
    assert others == [first] * 4 + [1 - first] * 5


def test_a_joint_that_stands_still_has_no_part_in_a_region(dataset):
    """Its readings differ by a resolution of the encoder, which is no other pose."""
    m, rng = dataset.measurements, np.random.default_rng(3)
    readings = m.readings.copy()
    readings[:, 5] = 0.3
    still = replace(m, readings=readings.copy())
    readings[:, 5] += 2e-6 * rng.integers(-1, 2, len(readings))
    same, jittered = (regions(of, np.arange(len(readings))) for of in (still, replace(m, readings=readings)))
    assert len({*zip(same.tolist(), jittered.tolist(), strict=True)}) == REGIONS


def test_an_error_of_regions_does_not_confirm_a_name_that_fits_it(dataset):
    """Zeros of joints that differ by region: blocks of time visit all regions and do not show it."""
    rng, label = np.random.default_rng(1), regions(dataset.measurements, np.arange(150))
    for joint in range(1, 7):
        dataset = misread(dataset, joint, 3e-4 * rng.standard_normal(REGIONS)[label])
    for how, lacks in ((BLOCKED, False), (BY_REGION, True)):
        assert judged_in_blocks(dataset, "eccentricity x8", how)[2].missing is lacks


def test_residuals_of_one_fold_are_those_that_were_left_out_together(dataset):
    """Beside rows of a face that is not fitted, which the fit to all others predicts."""
    m = dataset.measurements
    beside = m.target == 0
    d = with_columns(dataset, role=np.where(beside, "validate", m.role))
    h = validation_errors(estimate(build(Scene(d), FULL)), without=BY_REGION)
    assert np.array_equal(h.fold == -1, beside[h.rows])
    label = regions(m, np.flatnonzero(~beside))
    own = dict(zip(np.flatnonzero(~beside).tolist(), label.tolist(), strict=True))
    pairs = {(fold, own.get(row, -1)) for fold, row in zip(h.fold, h.rows.tolist(), strict=True)}
    assert len(pairs) == 1 + REGIONS


def test_rows_that_are_not_scored_leave_the_others_as_they_are(dataset):
    every = validation_errors(estimate(build(Scene(dataset), ("geometry",))), without=LEFT_OUT)
    some = without_rows(every, [int(every.rows[0]), 10**6])
    assert len(some.residual) == len(every.residual) - np.sum(every.rows == every.rows[0])
    assert np.array_equal(some.residual, every.residual[every.rows != every.rows[0]])
    assert len(some.by_parameters) == len(some.noise) == len(some.block) == len(some.rows)
    assert without_rows(every, []) is every
