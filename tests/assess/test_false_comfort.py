"""Small residuals that prove nothing are called so: one defect, its words and no others."""

import json
from dataclasses import replace

import foreign
import numpy as np
import pytest
from cases import terminal_text
from scipy.integrate import quad
from scipy.stats import invgamma, norm
from sessions import bulging, rough, validating, with_columns

from bayescal.assess.acceptance import EXPLAINED, not_physical
from bayescal.assess.findings import Assessed, differing, findings
from bayescal.assess.identifiability import BARELY, directions, in_words
from bayescal.calibration import fit
from bayescal.dataset import read_dataset
from bayescal.fitted.gate import of_fit
from bayescal.model import FitOptions, Scene, build
from bayescal.reporting.fit.record import fit_record
from bayescal.reporting.fit.summary import fit_summary

FULL = ("geometry", "compliance")
WORDS = {
    "form": "planes that are not flat",
    "directions": "too few directions are probed",
    "prior": "the prediction rests on tolerances",
    "contrast": "small residuals do not prove",
    "scale": "the lengths of the links are 1.01",
}


def said(found) -> set[str]:
    return {what for what, words in WORDS.items() if any(words in w for w in found.warnings)}


def on_faces(session, *names):
    """The session with only the contacts on some faces fitted."""
    m = session.measurements
    touched = np.array([t.name for t in session.targets])[m.target]
    return with_columns(session, role=np.where(np.isin(touched, names), "calibrate", "validate"))


def scaled(session, factor):
    """The session with a wrong certified distance: every length of the arm follows it."""
    first, *others = session.certificates
    return replace(session, certificates=(replace(first, distance=factor * first.distance), *others))


def test_residuals_that_differ_between_targets_are_said_by_name(fits, cube):
    """Noise of +y four times that of the other faces; and no such words of even noise."""
    found = fit(rough(cube(seed=6, count=200).dataset, 20e-6), FULL, samples=0)
    (said_,) = (f.text for f in found.findings if f.code == "noise_differs")
    assert said_.startswith("residuals differ between targets (cube.+y 1.")
    assert not [f for f in fits["good"].findings if f.code == "noise_differs"]


def test_evidence_of_differing_noise_is_the_integral_over_the_noise_of_each_target():
    count, chi2, prior = np.array([40.0, 60.0]), np.array([20.0, 80.0]), invgamma(2.0, scale=2.0)
    each = [
        quad(lambda v, n=n, s=s: v ** (-n / 2) * np.exp(0.5 * s * (1 - 1 / v)) * prior.pdf(v), 0.01, 30.0)[0]
        for n, s in zip(count, chi2, strict=True)
    ]
    assert differing(count, chi2) == pytest.approx(np.sum(np.log(each)), abs=1e-6)


CASES = {
    "good": (lambda cube: cube(seed=6, count=90).dataset, set()),
    "bulging": (lambda cube: bulging(cube(seed=6, count=90).dataset, 60e-6), {"form"}),
    "scaled": (lambda cube: scaled(cube(seed=6, count=90).dataset, 1.011), {"scale"}),
    "along y": (lambda cube: on_faces(cube(seed=6, count=90).dataset, "cube.+y", "cube.-y"), {"directions"}),
    "too few": (lambda cube: cube(seed=6, count=24).dataset, {"prior", "contrast"}),
}


@pytest.fixture(scope="module")
def fits(cube):
    return {name: fit(make(cube), FULL, samples=0) for name, (make, _) in CASES.items()}


@pytest.mark.parametrize("case", CASES)
def test_a_defect_has_its_words_and_no_others(fits, case):
    assert said(fits[case]) == CASES[case][1]


def test_no_verdict_is_favourable_where_priors_decide(fits):
    assert fits["too few"].acceptance.explains
    assert fits["too few"].acceptance.verdict != EXPLAINED
    assert fits["good"].acceptance.determined


def test_a_good_session_is_silent(fits):
    assert fits["good"].warnings == ()


@pytest.mark.parametrize(("faces", "missing", "words"), [
    (("cube.+y", "cube.-y", "cube.+z"), "x", "hardly a row looks along x of the base"),
    (("cube.+y", "cube.-y", "cube.-x"), "z", "hardly a row looks along z of the base"),
    (("cube.+y", "cube.-y"), "xz", "all measurements look along y of the base"),
])  # fmt: skip
def test_the_missing_direction_is_named(cube, faces, missing, words):
    seen = directions(build(Scene(on_faces(cube(seed=6, count=120).dataset, *faces)), ()))
    assert in_words(seen) == words
    assert np.all(seen.share[-len(missing) :] < BARELY)
    across = [k for k, axis in enumerate("xyz") if axis not in missing]
    np.testing.assert_allclose(seen.missing[:, across], 0.0, atol=0.02)


def test_faces_alike_see_every_direction(cube):
    seen = directions(build(Scene(cube(seed=6, count=120).dataset), ()))
    np.testing.assert_allclose(seen.share, [1.0, 0.5**0.5, 0.5**0.5], atol=0.03)
    np.testing.assert_allclose(seen.axes @ seen.axes.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("faces", [("cube.+y", "cube.-y"), ("cube.+y", "cube.-y", "cube.-x", "cube.+z")])
def test_the_forecast_holds_the_truth(cube, faces):
    """True distances of the true arm: as far off as predicted, with faces all round and with two alone."""
    ratios = []
    for seed in range(1, 4):
        session = cube(seed=seed, count=80)
        found = fit(on_faces(session.dataset, *faces), FULL, samples=0)
        scene, m = found.final.estimate.model.scene, session.dataset.measurements
        rows = np.arange(0, 80, 2)
        model = found.final.estimate.model
        values = model.deviations(found.final.estimate.z[model.slices["arm"]])
        told = model.motion(rows).points(values).T
        true = session.arm.points(m.readings[rows], m.payload[rows])
        i, j = np.triu_indices(len(rows), 1)
        length = np.linalg.norm(true[i] - true[j], axis=1)
        far = length > 0.2 * length.max()
        error = (np.linalg.norm(told[i] - told[j], axis=1) - length)[far]
        assert scene.dataset is found.dataset
        ratios.append(np.sqrt(np.mean(error**2)) / found.forecast.workspace.rms)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4
    assert max(ratios) < 2.5


def test_more_contacts_leave_less_to_the_prior(fits, cube):
    assert fits["too few"].forecast.prior_share > 0.9
    assert 0.02 < fit(cube(seed=6, count=40).dataset, FULL, samples=0).forecast.prior_share < 0.5
    assert fits["good"].forecast.prior_share < 0.01


def test_the_summary_leads_with_the_distance_error(fits, tmp_path):
    lines = terminal_text(fit_summary(fits["too few"], fit_record(fits["too few"])), 200).splitlines()
    assert lines[1].startswith("verdict")
    assert any(line.startswith("distance error") and "predicted" in line for line in lines[:8])
    assert any(line.startswith("validation") and "none" in line for line in lines[:12])
    space = fits["too few"].forecast.workspace
    ends = [f"{1e3 * end:.0f}" for end in (space.shortest, space.longest)]
    assert 0 < float(ends[0]) < float(ends[1])
    assert any(f"{space.count} distances, {ends[0]} to {ends[1]} mm" in line for line in lines)


def test_the_record_has_the_figures(fits):
    record = json.loads(json.dumps(fit_record(fits["too few"]), allow_nan=False))
    told = record["predicted_distance"]
    low, high = told["predicted_interval95_um"]
    assert low < told["predicted_rms_um"] < high
    assert told["measured_rms_um"] is None
    assert told["prior_share"] > 0.5
    assert record["directions"]["missing"] == []
    assert told["all"][-1]["over"] == "points of the workspace"


def test_an_instrument_kept_back_measures_the_distances(tracker):
    lead = fit(validating(tracker(seed=2, count=90).dataset, 3), FULL, samples=0).forecast.lead
    assert lead.over == "readings of the instrument"
    assert lead.interval[0] < lead.measured < lead.interval[1]
    assert 10e-6 < lead.rms < 20e-6  # the noise of two readings along the line between them


@pytest.mark.parametrize(("times", "lacks"), [(0.9, False), (1.1, True)])
def test_more_than_was_predicted_is_said(fits, times, lacks):
    found, space = fits["good"], fits["good"].forecast.workspace
    measured = replace(space, over="sphere centres", measured=times * space.interval[1])
    expected = replace(found.forecast, checked=(measured,))
    last = found.final
    said = findings(
        Assessed(
            last.estimate, last.unexplained, last.validation, expected, found.undetermined,
            found.directions, found.faces, found.acceptance,
        )
    )  # fmt: skip
    assert [f.code for f in said] == ["distances"] * lacks


def test_a_negative_value_is_judged_by_the_stated_uncertainty(fits):
    found = fits["good"].final.estimate
    k, p = next((k, p) for k, p in enumerate(found.model.parameters) if p.positive)
    z = found.z.copy()
    z[k] = (-3.0 * found.sd[k] * p.sd - p.centre) / p.sd
    below = replace(found, z=z)
    (fault,) = not_physical(below, found.covariance)
    assert fault.words.startswith(f"negative by more than 2.6 u, which is not physical: {p.name}")
    assert fault.p_value == pytest.approx(norm.cdf(-3.0))
    assert not_physical(below, 4.0 * found.covariance) == ()
    assert not_physical(found, found.covariance) == ()


def test_a_factor_on_lengths_needs_lengths_that_are_determined(fits):
    """By the stated uncertainty: the solver's alone is too small where the model lacks an effect."""
    found = fits["scaled"]
    last = found.final
    parts = (last.estimate, last.unexplained, last.validation, found.forecast, found.undetermined,
             found.directions, found.faces, found.acceptance)  # fmt: skip
    stated = (last.estimate.sd, np.full_like(last.estimate.sd, 0.6))  # of those of the prior
    told = [findings(Assessed(*parts, widths=found.widths, sd=sd)) for sd in stated]
    assert ["one_scale" in {f.code for f in each} for each in told] == [True, False]


@foreign.needs()
def test_loose_tolerances_on_three_planes_are_seen_through():
    """MA1400: planes are met to a quarter of a millimetre; the tracker's distances say what that is worth."""
    session = read_dataset(foreign.REAL / "motoman-planes")
    found = fit(session, ("geometry",), FitOptions(prior_width=15.0), samples=0)
    planes = np.concatenate([p.residuals for p in found.final.validation.planes])
    assert np.sqrt(np.mean(planes**2)) < 0.3e-3
    assert said(found) == set(WORDS) - {"scale"}
    lead = found.forecast.lead
    assert lead.over == "readings of the instrument"
    assert lead.measured > 0.6e-3
    assert lead.interval[0] < lead.measured < lead.interval[1]
    assert found.forecast.workspace.rms > 10e-3


def test_a_factor_of_all_lengths_is_checked_first_and_goes_with_the_arm(fits):
    use = of_fit(fits["scaled"])
    assert use.next == "scale"
    assert any(WORDS["scale"] in words for words in use.warnings)
    assert of_fit(fits["good"]).next == "validate"
