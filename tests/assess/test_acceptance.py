"""Acceptance: what a sound fit survives, what a sick arm does not, and what rejected measurements share."""

from dataclasses import replace
from types import SimpleNamespace

import foreign
import numpy as np
import pytest
from cases import refused
from chances import least, most
from sessions import misread, with_columns

import bayescal as bc
import bayescal.assess.mistakes as mistakes_module
import bayescal.assess.shared_causes as shared_causes_module
from bayescal.assess.acceptance import (
    CONTRADICTED,
    DOUBTED,
    EXPLAINED,
    FALSE_REJECTIONS,
    LEVEL,
    UNVERIFIED,
    acceptance,
    discrepancy,
    widened,
)
from bayescal.assess.conformance import FAIL, OPEN, PASS, conformance
from bayescal.assess.mistakes import DIFFERENT, hidden, judged, mistaken
from bayescal.assess.shared_causes import LEVEL as LEVEL_SHARED
from bayescal.assess.shared_causes import Group, SharedCause, _windows, groups_of, shared, shared_causes
from bayescal.calibration import fit
from bayescal.dataset import Certificate, Dataset, read_dataset
from bayescal.estimate.unexplained import Unexplained
from bayescal.model import FitOptions, Scene
from bayescal.predict.validation import DistanceCheck, RowCheck, Validation

FULL = ("geometry", "compliance")
CAUSE = SharedCause("target", "cube.+y", np.arange(3), 10, 3, 60, 1.0)
SOUND = Unexplained("contact", 5e-6, 5e-6, 45, 5e-6, 0.0, 0.5, 200.0)


def checked(rng, shared_sd=3e-6, noise=5e-6, draws=2000, contacts=60, distances=12):
    """Validation data of a correct model: errors drawn as their predictions are, with a part in common."""

    def parts(count, scale=0.0):
        slopes = rng.standard_normal((4, count))
        slopes[0] += scale
        drawn = shared_sd * rng.standard_normal((draws + 1, 4)) @ slopes
        drawn = drawn + noise * rng.standard_normal((draws + 1, count))
        return drawn[0], drawn[1:]

    r, predicted = parts(contacts)
    error, lengths = parts(distances, 2.0)  # the arm is too long, or too short
    pairs = [DistanceCheck((f"a{k}", f"b{k}"), 0.2, 0.0, error[k], lengths[:, k]) for k in range(distances)]
    return Validation((), (RowCheck("face", r, predicted),), tuple(pairs), (), ())


def test_tests_of_a_correct_model_fail_as_often_as_stated():
    """Each figure has its probability, and all of them together the level."""
    sessions, p, failed, lost = 300, {}, 0, 0
    for k in range(sessions):
        rng = np.random.default_rng(k)
        v = checked(rng, draws=400)
        found = acceptance(replace(SOUND, p_value=rng.uniform()), v)
        failed += not found.explains
        lost += found.checks[1].value != acceptance(SOUND, v, (CAUSE,)).checks[1].value  # none is an outlier
        for c in found.checks:
            p.setdefault(c.test, []).append(c.p_value)
    assert len(p) == 4
    for name, own in p.items():
        for chance in (0.1, 0.5):
            count = int(np.sum(np.array(own) <= chance))
            assert least(sessions, 0.9 * chance) <= count <= most(sessions, 1.1 * chance), (name, chance)
    assert failed <= most(sessions, LEVEL)
    assert lost <= most(sessions, FALSE_REJECTIONS)


def test_an_unexplained_error_of_points_is_found_from_distances():
    """Each end of a distance has it, so that the mean square of the distances has it twice."""
    rng = np.random.default_rng(4)
    v, off = checked(rng, distances=300), 40e-6 * rng.standard_normal((300, 2))
    moved = [replace(d, error=d.error + a - b) for d, (a, b) in zip(v.distances, off, strict=True)]
    v = replace(v, distances=tuple(moved))
    assert widened(SOUND, v, acceptance(SOUND, v)).excess == pytest.approx(40e-6, rel=0.12)


@pytest.mark.parametrize(("spoil", "test"), [
    (lambda v: replace(v, planes=(replace(v.planes[0], residuals=2.5 * v.planes[0].residuals),)),
     "validation_contacts"),
    (lambda v: replace(v, distances=tuple(replace(d, error=5 * d.error) for d in v.distances)),
     "validation_distances"),
    (lambda v: replace(v, distances=tuple(replace(d, error=d.error + 30e-6) for d in v.distances)),
     "mean_distance_error"),
])  # fmt: skip
def test_what_was_not_predicted_fails_its_test_and_widens(spoil, test):
    v = checked(np.random.default_rng(1))
    assert acceptance(SOUND, v).explains
    assert widened(SOUND, v, acceptance(SOUND, v)).excess == 0.0
    v = spoil(v)
    tests = acceptance(SOUND, v)
    assert test in {c.test for c in tests.failed}
    assert all(c.value > c.limit for c in tests.failed)
    assert tests.verdict == CONTRADICTED
    assert widened(SOUND, v, tests).excess > 5e-6


def test_the_limit_is_where_the_chance_is_the_level():
    tests = acceptance(SOUND, checked(np.random.default_rng(2)))
    assert all((c.value < c.limit) == c.passed for c in tests.checks)
    repeats = replace(SOUND, fitted=1.3 * SOUND.floor)
    again = acceptance(repeats, checked(np.random.default_rng(2))).checks
    ours = next(c for c in again if c.test == "residuals")
    assert ours.limit == pytest.approx(repeats.limit(ours.level))


def test_one_slipped_contact_is_no_sick_arm():
    v = checked(np.random.default_rng(3))
    r = v.planes[0].residuals.copy()
    r[7] += 1e-3
    assert acceptance(SOUND, replace(v, planes=(replace(v.planes[0], residuals=r),))).explains
    r[:12] += 1e-3
    assert not acceptance(SOUND, replace(v, planes=(replace(v.planes[0], residuals=r),))).explains


def test_nothing_to_verify_with_is_said():
    assert acceptance(SOUND, Validation((), (), (), (), ())).verdict == UNVERIFIED
    drawn = 1e-4 * np.random.default_rng(0).standard_normal((501, 3, 20))
    turns = (RowCheck("tracker", drawn[0], drawn[1:]),)  # orientations alone verify too
    assert acceptance(SOUND, Validation((), (), (), (), (), turns)).validated


@pytest.fixture(scope="module")
def session(cube):
    session = cube(seed=6, count=300).dataset
    return with_columns(session, role=np.where(np.arange(300) % 5 == 4, "validate", "calibrate"))


@pytest.fixture(scope="module")
def clean(session):
    return fit(session, FULL, FitOptions(tolerance=1e-3), samples=0)


@pytest.fixture(scope="module")
def groups(session):
    rows = np.arange(300)
    return groups_of(Scene(session), rows), rows


def some_groups(count=60):
    """Four kinds of groups of a third of the rows, that overlap within a kind."""
    rng = np.random.default_rng(0)
    orders = [rng.permutation(count) for _ in range(4)]
    twice = [np.resize(order, 2 * count) for order in orders]
    return [
        Group(f"kind {k}", f"group {i}", np.sort(rows[10 * i : 10 * i + 20]))
        for k, rows in enumerate(twice)
        for i in range(6)
    ]


def test_rejections_at_random_share_nothing():
    every, rows, found = some_groups(), np.arange(60), 0
    for seed in range(120):
        rejected = np.isin(rows, np.random.default_rng(seed).choice(rows, 4 + seed % 20, replace=False))
        found += bool(shared(every, rows, rejected, seed))
    assert found <= most(120, LEVEL_SHARED)


def test_kinds_share_the_margin_and_groups_of_a_kind_do_not_lose_it():
    """A kind that is there twice halves it; a group that is there twice is still one test."""
    rows, kind = np.arange(60), some_groups()[:6]
    rejected = np.isin(rows, kind[2].rows[:14]) | (rows == 3)
    (one,) = shared(kind, rows, rejected)
    (again,) = shared([*kind, *kind], rows, rejected)
    twice = shared([*kind, *(replace(g, kind="copy") for g in kind)], rows, rejected)
    assert again.p_value == one.p_value < LEVEL_SHARED / 2
    assert [c.p_value for c in twice] == pytest.approx([2 * one.p_value] * 2)


@pytest.mark.parametrize("kind", ["target", "direction of motion", "stretch of time", "joint range", "pose"])
def test_rejections_in_a_group_name_it(groups, kind):
    every, rows = groups
    rng = np.random.default_rng(1)
    own = [g for g in every if g.kind == kind and 20 <= len(g.rows) <= 160]
    group = own[len(own) // 2]
    rejected = np.zeros(300, bool)
    rejected[rng.permutation(group.rows)[:20]] = True
    rejected[rng.choice(300)] = True
    causes = shared(every, rows, rejected)
    assert causes
    assert kind in {c.kind for c in causes}
    assert all(np.all(rejected[c.rows]) for c in causes)


def test_a_true_outlier_in_a_wider_group_of_the_same_rows_stays_one():
    """Fifteen late rows of a face are off; two outliers on it and three elsewhere have no part in it."""
    rows = np.arange(600)
    late, face = Group("slip", "from row 585 on", rows[585:]), Group("target", "face", rows[450:])
    other = Group("target", "other face", rows[:450])
    outliers = [20, 180, 400, 460, 500]
    rejected = np.isin(rows, [*rows[585:], *outliers])
    causes = shared([late, face, other], rows, rejected)
    assert [c.label for c in causes] == [late.label]
    assert not np.intersect1d(causes[0].rows, outliers).size
    # more of that face than by chance: a second cause, and in other words the first
    many = rejected | np.isin(rows, rows[460:520:4])
    assert [c.label for c in shared([late, face, other], rows, many)] == [late.label, face.label]
    again = shared([late, replace(late, kind="role"), other], rows, rejected)
    assert {c.kind for c in again} == {"slip", "role"}


def test_permutations_in_parts_give_the_same_probabilities(groups, monkeypatch):
    some, rows = groups
    rejected = np.isin(rows, np.arange(40, 300, 13))
    whole = shared(some, rows, rejected)
    monkeypatch.setattr(shared_causes_module, "LEVEL", 1.0)
    every = shared(some, rows, rejected)
    monkeypatch.setattr(shared_causes_module, "MOST_VALUES", 7 * len(some))
    assert every
    assert [c.p_value for c in shared(some, rows, rejected)] == [c.p_value for c in every]
    monkeypatch.undo()
    assert shared(some, rows, rejected) == whole


def test_groups_of_a_large_session_stay_affordable(session, monkeypatch):
    """Rows of all groups grow in proportion to the session, beyond `MOST_ENTRIES` too."""
    rows = np.arange(300)
    before = sum(len(g.rows) for g in groups_of(Scene(session), rows))
    monkeypatch.setattr(shared_causes_module, "MOST_ENTRIES", 10 * len(rows))
    few = groups_of(Scene(session), rows)
    assert sum(len(g.rows) for g in few) < before / 2
    assert {g.kind for g in few} == {g.kind for g in groups_of(Scene(session), rows)}


def test_a_slip_is_a_stretch_of_time():
    rows = np.arange(1000)
    windows = [Group("stretch of time", f"{a}", rows[a : a + 64]) for a in range(0, 960, 32)]
    rejected = (rows >= 411) & (rows < 470)  # 59 rows at once
    (cause,) = shared(windows, rows, rejected)
    assert len(cause.rows) >= 30
    assert cause.p_value < 1e-3


def test_rows_that_share_a_cause_stay_in_the_fit_and_outliers_do_not(session, clean):
    calibrate = np.flatnonzero(session.measurements.role == "calibrate")
    stretch, alone = np.arange(125, 145), calibrate[[5, 60, 180, 220]]
    outliers = fit(misread(session, 3, 1e-3, alone), FULL, samples=0)
    event = fit(misread(session, 3, 1e-3, stretch), FULL, samples=0)
    assert clean.acceptance.verdict == EXPLAINED
    assert len(set(alone) & set(outliers.final.estimate.rejected)) >= 3  # one touches across its slip
    assert outliers.acceptance.explains
    assert not outliers.acceptance.causes
    assert event.acceptance.verdict == CONTRADICTED
    assert len(set(stretch) & set(event.final.estimate.rejected)) <= 3
    assert "stretch of time" in {c.kind for c in event.acceptance.causes}
    assert event.final.unexplained.excess > 2 * clean.final.unexplained.excess
    assert event.forecast.workspace.rms > 2 * clean.forecast.workspace.rms
    assert any(f.code == "shared_cause" and f.severity == "error" for f in event.findings)


def checked_targets(*sizes):
    """Validation of targets with eight contacts each, whose errors are these sizes of the predicted ones."""
    rng = np.random.default_rng(0)
    signs = np.resize([1.0, -1.0], 8)
    drawn = [1e-5 * rng.standard_normal((2000, 8)) for _ in sizes]
    rows = (RowCheck(f"face {k}", 1e-5 * sizes[k] * signs, d) for k, d in enumerate(drawn))
    return Validation(FULL, tuple(rows), (), (), ())


def test_a_noise_above_the_stated_and_a_target_outside_are_doubts():
    """The tests allow for 1.4 times the stated noise, and for one target among many."""
    few = replace(SOUND, repeats=None, repeats_dof=0)
    even = checked_targets(*[0.7] * 10)
    assert acceptance(few, even).verdict == EXPLAINED
    assert acceptance(replace(few, fitted=1.08 * few.stated), even).verdict == EXPLAINED
    noisy = acceptance(replace(few, fitted=1.3 * few.stated), even)
    assert (noisy.verdict, noisy.explains, noisy.usable) == (DOUBTED, True, False)
    assert [d.words for d in noisy.doubts] == ["residuals of 6.5 µm against the stated noise, 5.0 µm"]
    odd = acceptance(few, checked_targets(*[0.6] * 9, 1.9))
    assert odd.verdict == DOUBTED
    (target,) = odd.doubts
    assert target.words.startswith("contacts on face 9 of validation measurements: RMS error 19.0 µm")


def test_most_of_a_target_are_no_outliers():
    """A socket of two contacts, both far outside: none is left if they count as outliers."""
    few = replace(SOUND, repeats=None, repeats_dof=0)
    even = checked_targets(*[0.7] * 9)
    of_two = RowCheck("socket", np.array([1e-4, -1e-4]), even.planes[0].predicted[:, :2])
    with np.errstate(all="raise"):
        found = acceptance(few, replace(even, planes=(*even.planes, of_two)))
    assert [d.words.partition(" of ")[0] for d in found.doubts] == ["contacts on socket"]


def test_residuals_that_vary_with_a_quantity_are_a_doubt_and_noise_is_none(clean):
    (found,) = discrepancy(SimpleNamespace(chance={"time of the tool": 4e-4, "torque of joints": 1e-9}))
    assert (found.passed, found.p_value) == (False, 1e-9)
    assert "torque of joints" in found.words
    assert discrepancy(SimpleNamespace(chance={"time of the tool": 6e-4, "torque of joints": 0.5})) == ()
    assert discrepancy(SimpleNamespace(chance={})) == ()
    assert not clean.acceptance.doubts


def test_shared_causes_need_rejected_rows(clean):
    assert not shared_causes(replace(clean.final.estimate, rejected=np.empty(0, int)))


def test_a_tolerance_is_decided(session, clean):
    found = clean
    assert found.tolerance.decision == OPEN  # the session has no certified distance
    assert found.tolerance.probability == 1.0
    expected, pair = found.forecast, ("a", "b")
    v = SimpleNamespace(distances=(SimpleNamespace(between=pair, error=5e-5),))
    own = SimpleNamespace(u=1e-5, k=2.0, expanded=2e-5, dof=np.inf)

    def at(x, tests=found.acceptance):
        return conformance(x, expected, v, tests, {pair: own})

    assert at(1e-3).decision == PASS
    assert at(1e-6).decision == FAIL
    assert at(6e-5).decision == OPEN
    assert at(0.5 * expected.workspace.rms).probability < 0.6
    for lacking in ("validated", "determined"):
        assert at(1e-3, replace(found.acceptance, **{lacking: False})).decision == OPEN
    sick = replace(found.acceptance, checks=(replace(found.acceptance.checks[0], p_value=0.0),))
    assert at(1e-3, sick).decision == OPEN
    refused("tolerance", lambda: fit(session, FULL, FitOptions(tolerance=-1.0), samples=0))


@pytest.mark.parametrize("dof", [5.0, np.inf])
@pytest.mark.parametrize("error", [-3e-5, 0.0, 1.5e-5])
def test_the_probability_of_conformance_is_that_of_drawn_errors(error, dof):
    """Of a distance: its error is normal about the measured one with u of its budget, or Student's t."""
    u, rng = 1e-5, np.random.default_rng(0)
    drawn = error + u * (rng.standard_normal(40_000) if np.isinf(dof) else rng.standard_t(dof, 40_000))
    pair, good = ("a", "b"), SimpleNamespace(explains=True, validated=True, determined=True, doubts=())
    volume = SimpleNamespace(workspace=SimpleNamespace(expanded=u, k=2.0, within=lambda tolerance: 1.0))
    own = SimpleNamespace(u=u, k=2.3, expanded=2.3 * u, dof=dof)
    checked = SimpleNamespace(distances=(SimpleNamespace(between=pair, error=error),))
    for tolerance in (1e-5, 2e-5, 4e-5):
        (found,) = conformance(tolerance, volume, checked, good, {pair: own}).distances
        assert found.probability == pytest.approx(np.mean(np.abs(drawn) <= tolerance), abs=0.01)
        assert (found.expanded, found.k, found.error) == (own.expanded, own.k, error)


# --- Gross mistakes of stated values are named, good sessions have none, and what cannot be seen is said.


@pytest.fixture(scope="module")
def good() -> Dataset:
    return bc.simulate(contacts=70, later=8, repeats=5, spheres=2, placements=1, seed=1).dataset


def of_tools(dataset: Dataset, field: str, factor: float) -> Dataset:
    tools = (replace(t, **{field: factor * getattr(t, field)}) for t in dataset.tools)
    return replace(dataset, tools=tuple(tools))


def of_diameters(dataset: Dataset, factor: float, name: str = "") -> Dataset:
    targets = (
        replace(t, values=t.values | {"diameter": factor * t.values["diameter"]})
        if "diameter" in t.values and t.name.startswith(name)
        else t
        for t in dataset.targets
    )
    return replace(dataset, targets=tuple(targets))


def of_lengths(dataset: Dataset, factor: float) -> Dataset:
    longer = (replace(c, distance=c.distance and factor * c.distance) for c in dataset.certificates)
    return replace(dataset, certificates=tuple(longer))


LOOKS = "looks like it is"
MISTAKES = {
    "ball diameter": (of_tools, ("ball_radius", 2.0), f"`ball_radius_mm` of `ball` {LOOKS} a diameter"),
    "ball in m": (of_tools, ("ball_radius", 1e-3), f"`ball_radius_mm` of `ball` {LOOKS} in m"),
    "sphere radius": (of_diameters, (0.5,), f"all spheres and cylinders {LOOKS} a radius"),
    "one sphere": (of_diameters, (0.5, "ball.B"), f"`diameter_mm` of `ball.B` {LOOKS} a radius"),
    "twice the diameter": (of_diameters, (2.0,), f"{LOOKS} twice the diameter"),
    "sphere in m": (of_diameters, (1e-3,), f"spheres and cylinders {LOOKS} in m"),
    "mass centre": (of_tools, ("centre_of_mass", 25.4), f"`ball` {LOOKS} multiplied by 25.4 once too often"),
    "mass centre in inches": (of_tools, ("centre_of_mass", 1 / 25.4), f"`ball` {LOOKS} in inches"),
    "certificates": (of_lengths, (1.01,), "the certified lengths together look too long by a factor of 1.0"),
    "short certificates": (of_lengths, (0.99,),
                           "the certified lengths together look too short by a factor of 1.0"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named(good, name):
    change, arguments, words = MISTAKES[name]
    (found,) = mistaken(judged(change(good, *arguments)))
    assert words in found.what
    assert found.remedy


def test_a_good_session_has_none_and_says_what_it_cannot_show(good):
    found = judged(good)
    assert not list(mistaken(found))
    assert abs(found.scale[0]) < 4 * found.scale[1]
    assert list(hidden(found)) == [f"a common error of all certified lengths below {100 * DIFFERENT:.1g} %"]


def test_without_gravity_a_mass_centre_is_not_shown(good):
    found = judged(replace(good, gravity=np.zeros(3)))
    assert found.unknown == ("`centre_of_mass_mm` of `ball`",)
    assert "`centre_of_mass_mm` of `ball`" in next(hidden(found))


def test_a_fit_that_has_not_converged_is_no_mistake(good, monkeypatch):
    """A hypothesis continues from where the session as stated ended: it may gain by its steps alone."""
    monkeypatch.setattr(mistakes_module, "STEPS", 3)
    robot = good.robot
    far = replace(good, robot=replace(robot, a=robot.a + 3e-3, offset=robot.offset + 0.01))
    assert judged(far).better == ()


def test_without_certified_lengths_there_is_no_factor(good):
    bare = tuple(c for c in good.certificates if c.distance is None)
    assert judged(replace(good, certificates=bare)).scale is None
    apart = (*bare, Certificate("distance", ("ball.A@1", "ball.B@1"), distance=0.3, u_distance=1e-6))
    assert judged(replace(good, certificates=apart)).scale is not None


@foreign.needs()
@pytest.mark.parametrize("name", ["real/motoman-planes", "real/panda-ball-socket-4"])
def test_no_false_alarm(name):
    found = judged(read_dataset(foreign.DATA / name))
    assert found is not None
    assert not list(mistaken(found))


def test_a_fit_that_fails_names_it(good, monkeypatch):
    monkeypatch.setattr("bayescal.calibration.judged", judged)
    wrong = of_tools(good, "ball_radius", 2.0)
    assert fit(wrong, ("geometry",), samples=0).findings[0].code == "gross_mistake"


@pytest.mark.parametrize(("count", "shortest"), [(96, 6), (100, 7), (40, 20)])
def test_any_stretch_is_nearly_a_window(count, shortest):
    """Windows of each size are half over the one before: one of them has three quarters of any stretch."""
    windows = list(_windows(count, shortest))
    assert all(0 <= start < stop <= count for start, stop in windows)
    sizes = [shortest * 2**k for k in range(8) if shortest * 2**k <= count // 2]
    assert {stop - start for start, stop in windows} >= set(sizes)
    for size in sizes:
        own = [(start, stop) for start, stop in windows if stop - start == size]
        for first in range(count - size + 1 - size // 2):
            assert max(min(stop, first + size) - max(start, first) for start, stop in own) >= 0.75 * size - 1
