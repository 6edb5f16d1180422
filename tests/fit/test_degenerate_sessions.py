"""Degenerate sessions: what is not determined is named, with its cause and what to measure."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest
from rich.console import Console

from bayescal.arm.motion import NominalArm
from bayescal.assess.budget import budget
from bayescal.assess.identifiability import identifiability
from bayescal.assess.measurand import parameter
from bayescal.assess.undetermined import undetermined
from bayescal.calibration import fit
from bayescal.dataset import Target
from bayescal.estimate import calibrated
from bayescal.fitted.gate import _left_of_prior, of_fit
from bayescal.gap.diagnose import diagnose
from bayescal.model.scene import Scene
from bayescal.predict.forecast import SMALLEST, elsewhere, joint_range, point_slopes
from bayescal.reporting.fit.budget import budget_table, measurand_record
from bayescal.reporting.fit.record import fit_record
from bayescal.reporting.gap.phrases import headline
from bayescal.reporting.gap.record import write_gap
from bayescal.reporting.gap.summary import gap_summary

FULL = ("geometry", "compliance")
FULL_RANGE = "in poses over most of the range of"


def with_rows(session, rows):
    """The session with some of its rows."""
    m = session.measurements
    kept = {f.name: getattr(m, f.name) for f in fields(m) if getattr(m, f.name) is not None}
    kept["ids"] = tuple(f"c{k}" for k in range(len(rows)))
    kept |= {name: v[rows] for name, v in kept.items() if name not in ("ids", "line")}
    kept["line"] = np.arange(len(rows)) + 2
    return replace(session, measurements=type(m)(**kept))


def on_faces(session, *faces):
    names = np.array([t.name for t in session.targets])[session.measurements.target]
    used = with_rows(session, np.flatnonzero(np.isin(names, faces)))
    stated = tuple(c for c in session.certificates if set(c.targets) <= set(faces))
    return replace(used, certificates=stated)


def tracked(tracker, readings, centre=(0.06, 0.0, 0.12)):
    """An instrument's readings of a tool of the nominal arm at readings (N, 6), rad."""
    session = tracker(seed=2, count=90).dataset
    tool = replace(session.tools[0], centre=np.array(centre))
    session = replace(with_rows(session, np.arange(len(readings))), tools=(tool,))
    arm = NominalArm(session.robot, tool.centre)
    target = Target("tracker", "instrument", {"xyz": np.zeros(3), "rpy": np.zeros(3)})
    noise = 1e-5 * np.random.default_rng(1).standard_normal((len(readings), 3))
    table = replace(
        session.measurements, readings=readings, xyz=arm.ball(arm.frames(readings)) + noise, payload=None
    )
    return replace(session, targets=(target,), measurements=table)


def one_pose(cube):
    session = on_faces(cube(seed=3, count=150).dataset, "cube.+z")
    m = session.measurements
    same = np.repeat(m.readings[:1], len(m.ids), axis=0)
    return replace(session, measurements=replace(m, readings=same, payload=None))


def random_readings(lrmate, count=80):
    return 0.6 * joint_range(lrmate, count, np.random.default_rng(4))


def locked(lrmate):
    readings = random_readings(lrmate)
    readings[:, 3:] = np.radians([10.0, -40.0, 20.0])
    return readings


def clusters(lrmate):
    readings = random_readings(lrmate)
    rng = np.random.default_rng(5)
    return readings[np.arange(80) % 2] + np.radians(1.0) * rng.standard_normal((80, 6))


CASES = {
    "one plane": (lambda cube, *_: on_faces(cube(seed=3, count=400).dataset, "cube.+z"), "a1", "directions",
                  "all measurements look along z of the base"),
    "one pose": (lambda cube, *_: one_pose(cube), "theta3", "poses", "all measurements have one pose"),
    "no certificate": (lambda cube, *_: replace(cube(seed=3, count=150).dataset, certificates=()), "a2",
                       "length", "state a certified distance"),
    "few contacts": (lambda cube, *_: with_rows(cube(seed=3, count=150).dataset, np.arange(20)), "a2",
                     "poses", "20 different poses cannot determine 39 unknowns"),
    "ball on J6": (lambda cube, tracker, robot: tracked(tracker, random_readings(robot), (0, 0, 0.12)),
                   "alpha5", "tool", "measure also with a second tool"),
    "tool at the flange": (lambda cube, tracker, robot: tracked(tracker, random_readings(robot), (0, 0, 0)),
                           "alpha5", "tool", "measure also with a second tool"),
    "locked wrist": (lambda cube, tracker, robot: tracked(tracker, locked(robot)), "theta4", "poses",
                     f"{FULL_RANGE} J4, J5, J6"),
    "two clusters": (lambda cube, tracker, robot: tracked(tracker, clusters(robot)), "a1", "poses",
                     FULL_RANGE),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_is_not_determined_is_named_with_its_cause(case, cube, tracker, lrmate):
    make, parameter, change, words = CASES[case]
    fitted = calibrated(Scene(make(cube, tracker, lrmate)), FULL)
    found = undetermined(fitted, identifiability(fitted))
    own = [u for u in found if change in u.changes and parameter in u.parameters]
    assert own, [u.words for u in found]
    assert words in own[0].words
    assert own[0].matters == (change != "tool")
    assert own[0].matters or own[0].hidden


def test_a_good_session_leaves_nothing_but_redundant_parameters(cube):
    fitted = calibrated(Scene(cube(seed=3, count=150).dataset), FULL)
    found = undetermined(fitted, identifiability(fitted))
    assert [(u.state, u.parameters) for u in found] == [("redundant", ("d2", "d3"))]
    assert not any(u.matters or u.hidden for u in found)


def test_the_stated_change_is_enough(cube, tracker, lrmate):
    """A session with the change determines what the one without it does not."""
    poor = calibrated(Scene(tracked(tracker, locked(lrmate))), FULL)
    rich = calibrated(Scene(tracked(tracker, random_readings(lrmate))), FULL)
    lacking = {n for u in undetermined(poor, identifiability(poor)) if u.matters for n in u.parameters}
    still = {n for u in undetermined(rich, identifiability(rich)) if u.matters for n in u.parameters}
    assert len(lacking) > 10
    assert not still


def test_what_is_left_is_what_the_parameters_displace(cube):
    """The RMS left over the range of all joints, against points of arms that are drawn from the posterior."""
    fitted = calibrated(Scene(replace(cube(seed=3, count=150).dataset, certificates=())), FULL)
    known = identifiability(fitted)
    scale = next(u for u in undetermined(fitted, known) if u.changes == ("length",))
    v = next(d.vector for d in known.weak if {n for n, _ in d.loadings} == {"a2", "d4"})
    model, rng = fitted.model, np.random.default_rng(3)
    readings = joint_range(model.scene.dataset.robot, 300, rng)
    motion = elsewhere(model, np.zeros(300, int), readings)
    z = np.zeros(len(model.parameters))
    z[known.index] = v / np.sqrt(1 + v @ known.information @ v)
    before = motion.points(fitted.arm)
    moved = motion.points(fitted.arm + z * model.sd) - before
    np.testing.assert_allclose(point_slopes(model, motion, fitted.arm) @ z, moved.T, atol=1e-6)
    at = before - before.mean(axis=1, keepdims=True)
    turns = [np.cross(axis, at.T).T for axis in np.eye(3)]
    design = np.stack([t.ravel() for t in turns], axis=1)
    rest = (moved - moved.mean(axis=1, keepdims=True)).ravel()
    rest = rest - design @ np.linalg.lstsq(design, rest, rcond=None)[0]
    assert scale.left == pytest.approx(np.sqrt(np.mean(rest**2) * 3), rel=0.15)


def test_elsewhere_at_the_rows_of_the_session_is_the_session(cube):
    model = calibrated(Scene(cube(seed=3, count=150).dataset), FULL).model
    rows = np.arange(40)
    there = elsewhere(model, rows, model.scene.dataset.measurements.readings[rows])
    values = 1e-3 * model.sd
    np.testing.assert_allclose(there.points(values), model.motion(rows).points(values), atol=1e-7)


def test_rows_of_one_pose_predict_nothing(cube):
    """0.0 µm was predicted between points that are 0 mm apart, as a calibrated arm."""
    found = fit(one_pose(cube), FULL, samples=0)
    assert not found.acceptance.determined
    assert found.forecast.workspace.longest > SMALLEST
    assert found.forecast.workspace.over == "points over the range of all joints"
    assert {"not_identifiable", "prior"} <= {f.code for f in found.findings}
    assert fit_record(found)["identifiability"]["undetermined"][0]["lacks"] == ["poses"]


def test_an_estimate_within_its_uncertainty_of_zero_is_called_so(tracker, lrmate):
    """Such a compliance was called not identifiable, beside a table that said the opposite."""
    found = fit(tracked(tracker, random_readings(lrmate)), FULL, samples=0)
    said = [f.text for f in found.findings if f.code == "rigid"]
    assert said
    assert all(text.startswith("set to rigid, because not distinguishable from 0") for text in said)


@pytest.fixture(scope="module")
def diagnosed(cube):
    return diagnose(with_rows(one_pose(cube), np.arange(14)), ("geometry",))


def test_no_effect_in_rows_of_one_pose_is_no_success(diagnosed):
    """The headline was 'No effect above noise: the model explains these data'."""
    assert re.search(r"2\d of 2\d combinations of parameters are not identifiable", headline(diagnosed)[0])
    assert any("all measurements have one pose" in text for text in diagnosed.warnings)


def test_a_diagnosis_of_one_pose_has_a_page_and_no_nan(diagnosed, tmp_path):
    """A page of one block of rows ended with a traceback, and the terminal printed nan."""
    write_gap(diagnosed, tmp_path / "run", pictures=False)
    console = Console(width=150)
    with console.capture() as said:
        console.print(gap_summary(diagnosed))
    assert "nan" not in said.get()
    assert "no interval: the validation measurements have one pose" in said.get()


def test_an_arm_of_one_pose_is_not_exported(cube):
    """Its distances kept 'nan %' of the uncertainty of the priors."""
    found = calibrated(Scene(one_pose(cube)), FULL)
    left = _left_of_prior(found, found.covariance)
    assert left == 1.0


@pytest.fixture(scope="module")
def twelve(cube):
    return fit(with_rows(cube(seed=3, count=150).dataset, np.arange(20)), FULL, samples=0)


def test_an_arm_that_priors_decide_is_not_exported(twelve):
    """20 contacts left half of the prior's uncertainty, and robot.yaml was written without a word."""
    assert not twelve.acceptance.determined
    (reason,) = of_fit(twelve).against
    assert re.search(r"\d+ % of the variance of a predicted distance is that of priors", reason)


def test_a_budget_that_priors_decide_says_so(twelve, cube):
    told = {}
    for name, found in {"few": twelve, "many": fit(cube(seed=3, count=150).dataset, FULL, samples=0)}.items():
        of = budget(found.basis, parameter(found.basis, "a2"))
        console = Console(width=150)
        with console.capture() as said:
            console.print(budget_table(of))
        told[name] = of.prior_share, "not determined" in said.get()
        assert measurand_record(of)["prior_share"] == of.prior_share
    assert told["few"][0] > 0.5 > told["many"][0]
    assert (told["few"][1], told["many"][1]) == (True, False)


@pytest.mark.parametrize(("noise", "wild"), [(1e-6, False), (2e-3, True)])
def test_a_tiny_stated_noise_is_no_sign_of_a_wrong_file(cube, noise, wild):
    """'residuals of 0.0 mm, far more than any small error of an arm', of 1 µm at a stated noise of 1 nm."""
    session = cube(seed=3, count=120, noise=noise, stated=1e-9 if not wild else 5e-6).dataset
    found = fit(session, FULL, samples=0)
    assert ("wrong_files" in {f.code for f in found.findings}) == wild
