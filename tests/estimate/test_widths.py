"""Prior widths by evidence: arms three times as far from nominal as stated, and arms as stated."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal
from sessions import plain

from bayescal.calibration import fit
from bayescal.effects import parameters_of
from bayescal.errors import BayescalError
from bayescal.estimate import fitted_level, widths
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.widths import LEAST, SPREAD, TOLD, Spread, Width, with_widths
from bayescal.fitted.arm import of_fit, refitted
from bayescal.fitted.file import read_arm, write_arm
from bayescal.gap.diagnose import diagnose
from bayescal.model.options import FitOptions, family
from bayescal.model.scene import Scene
from bayescal.reporting.fit.record import fit_record
from bayescal.reporting.gap.record import gap_record

MODEL = ("geometry", "compliance")
USUAL = FitOptions()
FAMILIES = {
    "geometry angles of joints", "geometry lengths of joints", "geometry angles of links",
    "geometry lengths of links", "compliance of joints",
}  # fmt: skip


@cache
def usual(tracker, seed=0):
    """What is told of an arm as far from nominal as stated."""
    return told(tracker(seed=seed, count=40, noise=1e-4))


def told(session):
    """The fit of a session with the stated priors, the fit with the widths that it tells, and these."""
    scene = Scene(session.dataset, oriented=True)
    plain = fitted_level(scene, MODEL, USUAL)
    return plain, *with_widths(plain, scene, MODEL, USUAL)


def pulls(found, session):
    """Errors of the arm's parameters over their stated uncertainty."""
    model, arm = found.model, found.model.slices["arm"]
    true = np.array([session.arm.values[p.name] for p in model.parameters])
    return (model.physical(found.z)[arm] - true) / (stated(found).sd[arm] * model.sd)


def test_an_arm_three_times_as_far_from_nominal(tracker):
    """Its widths are found, and its intervals are true; with the stated priors they are not."""
    before, after, factors = [], [], []
    for seed in range(5):
        session = tracker(seed=seed, count=40, noise=1e-4, spread=3.0)
        plain, wide, options, found = told(session)
        assert found
        assert {w.family for w in found} <= FAMILIES
        assert options.widths == {w.family: w.factor for w in found}
        assert min(w.nats for w in found) >= LEAST
        factors += [w.factor for w in found]
        before.append(pulls(plain, session))
        after.append(pulls(wide, session))
    inside = [np.mean(np.abs(np.concatenate(every)) < 1.96) for every in (before, after)]
    assert inside[0] < 0.88
    assert inside[1] == pytest.approx(0.95, abs=3 * np.sqrt(0.95 * 0.05 / 135))
    assert np.exp(np.mean(np.log(factors))) == pytest.approx(3.0, rel=0.25)


def test_stated_priors_stay_where_they_are_right(tracker):
    for seed in range(4):
        plain, same, options, found = usual(tracker, seed)
        assert same is plain
        assert (options, found) == (USUAL, ())


def test_priors_that_are_too_wide_stay(tracker):
    plain, same, _, found = told(tracker(seed=2, count=40, noise=1e-4, spread=0.2))
    assert same is plain
    assert not found


def test_widths_that_larger_noise_hides(tracker):
    """An arm twelve times as far from nominal as stated is fitted by larger noise, which hides the widths."""
    session = tracker(seed=0, count=40, noise=1e-4, spread=12.0)
    plain, wide, options, found = told(session)
    assert plain.weights.scale["point"] > 10
    assert np.max(np.abs(pulls(plain, session))) > 10
    assert wide.weights.scale["point"] == pytest.approx(1.0, abs=0.2)
    assert np.max(np.abs(pulls(wide, session))) < 4
    assert options.widths == {w.family: w.factor for w in found}
    assert {round(w.factor) for w in found} != {10}  # the families have factors of their own


def test_one_joint_that_larger_noise_hides(tracker):
    """A zero that is 2.5 deg off: 22 times its prior."""
    session = tracker(seed=1, count=40, noise=5e-4)
    table = session.dataset.measurements
    off = np.radians(2.5) * (np.arange(6) == 3)
    session.dataset = replace(session.dataset, measurements=replace(table, readings=table.readings - off))
    scene = Scene(session.dataset, oriented=True)
    plain = fitted_level(scene, MODEL, USUAL)
    wide, _, (only,) = with_widths(plain, scene, MODEL, USUAL)
    assert only.family == "geometry angles of joints"
    k = wide.model.names.index("theta4")
    true = abs(session.arm.values["theta4"] - off[3])
    errors = [abs(abs(f.arm[k]) - true) / (stated(f).sd[k] * f.model.sd[k]) for f in (plain, wide)]
    assert errors[0] > 10
    assert errors[1] < 3


def test_large_residuals_alone_widen_nothing(tracker):
    """Noise ten times as large as stated has no width."""
    session = tracker(seed=0, count=40, noise=1e-4)
    scene = Scene(replace(session.dataset, noise=replace(session.dataset.noise, point=1e-5)), oriented=True)
    plain = fitted_level(scene, MODEL, USUAL)
    assert plain.weights.scale["point"] > widths.LARGE
    same, options, found = with_widths(plain, scene, MODEL, USUAL)
    assert same is plain
    assert (options, found) == (USUAL, ())


def test_a_common_factor_is_one_sentence():
    told_widths = [Width(name, 10.0, 42.0, ("a2",)) for name in ("lengths of links", "angles of links")]
    (sentence,) = widths.sentences(told_widths)
    assert sentence.startswith("the lengths of links, angles of links are larger")
    assert len(widths.sentences([told_widths[0], replace(told_widths[1], factor=3.0)])) == 2
    assert widths.sentences(()) == ()


def test_the_evidence_is_the_density_of_the_estimate():
    # of an estimate of six parameters in two families, one of which has two members
    rng = np.random.default_rng(1)
    root = rng.standard_normal((6, 9))
    by = [rng.standard_normal((6, k)) for k in (2, 4)]
    spread = Spread(4.0 * rng.standard_normal(6), root @ root.T / 9, tuple(b @ b.T for b in by))
    at = np.array([0.4, 1.1])
    own = np.exp(2 * at)
    total = spread.noise + own[0] * spread.by_family[0] + own[1] * spread.by_family[1]
    density = multivariate_normal.logpdf(spread.z, np.zeros(6), total) - 0.5 * np.sum((at / SPREAD) ** 2)
    loss, slopes = spread.loss(at)
    assert loss == pytest.approx(-density - 3 * np.log(2 * np.pi), rel=1e-12)
    np.testing.assert_allclose(slopes, approx_fprime(at, lambda x: spread.loss(x)[0], 1e-7), rtol=1e-4)
    best, least = spread.best((0, 1))
    assert least == spread.loss(best)[0]
    assert np.all(np.abs(spread.loss(best)[1])[best > 0] < 1e-3)


def test_uncertainty_of_a_factor_of_direct_readings():
    """With negligible noise the logarithm of a factor of n values has the variance 1 / (2 n)."""
    many = Spread(np.ones(50), 1e-12 * np.eye(50), (np.eye(50),))
    expected = 1.0 / (100 + SPREAD**-2)
    assert many.uncertainty(np.array([0.7]), (0,)) == pytest.approx([expected], rel=1e-6)


def test_a_spread_is_that_of_the_estimator(tracker):
    """Under the stated priors the estimate's covariance is that of the prior minus the posterior."""
    found = usual(tracker)[0]
    own = [np.flatnonzero([bool(family(p)) for p in found.model.parameters])]
    free = Spread.of(found, found.covariance, own)
    total = free.noise + free.by_family[0]
    np.testing.assert_allclose(total, np.eye(len(total)), atol=1e-9)  # white under these
    arm = found.model.slices["arm"]
    prior = np.eye(arm.stop) - found.covariance[arm, arm]
    assert free.z @ free.z == pytest.approx(found.z[arm] @ np.linalg.pinv(prior) @ found.z[arm], rel=1e-3)


def test_families_are_of_joints_and_links(tracker):
    every = parameters_of((*MODEL, "base-compliance", "step"), Scene(tracker(seed=0).dataset).circumstances())
    assert {family(p) for p in every} - {""} == FAMILIES
    assert {p.site.kind for p in every if not family(p)} >= {"base", "tool"}


@pytest.fixture(scope="module")
def far(tracker):
    return fit(tracker(seed=8, count=40, spread=3.0).dataset, MODEL, samples=0)


def test_widths_are_stated(far):
    record = fit_record(far)
    stated_widths = {entry["family"]: entry for entry in record["prior_widths"]}
    assert stated_widths
    assert record["prior_width"] == 1.0
    sd = {p["name"]: p["prior_sd"] for p in record["parameters"]}
    for name, entry in stated_widths.items():
        words = f"the {name} are larger than their prior makes likely: fitted with {entry['factor']:.2g}"
        assert any(f["code"] == "prior_width" and f["text"].startswith(words) for f in record["findings"])
        if name == "geometry angles of joints":
            assert [sd[p] for p in entry["parameters"]] == pytest.approx([0.1145916 * entry["factor"]] * 4)
    assert far.options.widths == {name: entry["factor"] for name, entry in stated_widths.items()}


def test_far_from_nominal_is_by_the_stated_priors(far):
    """A wider prior does not excuse a value that the robot file may have wrong."""
    model, z = far.final.estimate.model, far.final.estimate.z
    factors = [far.options.widths.get(family(p), 1.0) for p in model.parameters]
    far_off = zip(model.parameters, z, factors, strict=False)
    beyond = [p.name for p, at, factor in far_off if abs(at) * factor > 4]
    assert beyond
    assert not np.any(np.abs(z[: len(model.parameters)]) > 4)
    (finding,) = [f for f in far.findings if f.code == "far_from_nominal"]
    words = "more than 4 prior standard deviations (before widening) from nominal"
    assert finding.text.startswith(f"{', '.join(beyond)}: {words}")


def test_levels_have_the_same_widths(far, monkeypatch):
    """Errors of levels differ by their parameters, not by their priors."""
    final = dict(zip(far.final.estimate.model.names, far.final.estimate.model.sd, strict=False))
    for level in far.levels[1:]:
        model = level.estimate.model
        own = dict(zip(model.names, model.sd, strict=False))
        assert own == pytest.approx(own | {name: final[name] for name in own if name in final})
    scene, usable = Scene(far.dataset, oriented=True), fitted_level

    def narrow(scene, effects, options):
        if options.widths:
            raise BayescalError("no length is known", "dataset.yaml", "certify a distance")
        return usable(scene, effects, options)

    monkeypatch.setattr(widths, "fitted_level", narrow)
    assert np.max(widths.simpler_level(scene, ("geometry",), far.options).model.sd) < max(final.values())
    monkeypatch.setattr(widths, "fitted_level", lambda *_: narrow(scene, (), far.options))
    with pytest.raises(BayescalError, match="no length"):
        widths.simpler_level(scene, ("geometry",), USUAL)


def test_an_arm_keeps_its_widths(far, tmp_path):
    arm = of_fit(far)
    write_arm(arm, tmp_path)
    again = read_arm(tmp_path)
    assert again.origin.options.widths == far.options.widths
    np.testing.assert_allclose(again.model.sd, arm.model.sd, rtol=1e-12)
    assert refitted(again, (), ("compliance J6",)).origin.options.widths.keys() == far.options.widths.keys()


def test_a_fit_that_wider_priors_do_not_permit_has_the_stated_ones(tracker, monkeypatch):
    session = tracker(seed=0, count=40, noise=1e-4, spread=3.0)

    def refused(*_):
        raise BayescalError("no length is known", "dataset.yaml", "certify a distance")

    monkeypatch.setattr(widths, "fitted_level", refused)
    plain, same, options, found = told(session)
    assert same is plain
    assert (options, found) == (USUAL, ())


def test_nothing_is_told_by_few_nats(tracker):
    """The gain of all factors together decides."""
    plain = usual(tracker)[0]
    pushed = replace(plain, z=2.0 * plain.z)
    assert not widths.widths(plain, plain.covariance)
    more = widths.widths(replace(plain, z=6.0 * plain.z), plain.covariance)
    assert sum(w.nats for w in more) > TOLD
    assert isinstance(more[0], Width)
    # each factor is the root mean square of what it may be
    places = {}
    for k, p in enumerate(plain.model.parameters):
        places.setdefault(family(p), []).append(k)
    places.pop("", None)
    free = [list(places).index(w.family) for w in more]
    members = [np.array(o) for o in places.values()]
    spread = Spread.of(replace(plain, z=6.0 * plain.z), plain.covariance, members)
    middle, sd = spread.best(free)[0][free], np.sqrt(spread.uncertainty(spread.best(free)[0], free))
    drawn = np.exp(middle + sd * np.random.default_rng(0).standard_normal((40_000, len(free))))
    np.testing.assert_allclose([w.factor for w in more], np.sqrt(np.mean(drawn**2, axis=0)), rtol=0.03)
    assert np.max(sd) > 0.1
    assert len(widths.widths(pushed, plain.covariance)) <= len(more)


def test_a_diagnosis_has_the_widths_of_a_fit(far, tracker):
    """Its baseline is the fit of the same model; the note and gap.json state them."""
    gap = diagnose(plain(tracker(seed=8, count=40, spread=3.0).dataset), MODEL)
    assert gap.options.widths == pytest.approx(dict(far.options.widths))
    np.testing.assert_allclose(gap.calibrated.model.sd, far.final.estimate.model.sd)
    record = gap_record(gap)
    assert record["prior_widths"] == gap.options.widths
    for name in far.options.widths:
        words = f"the {name} are larger than their prior makes likely"
        assert any(note.startswith(words) for note in record["notes"])
