"""Degenerate sessions: what is not determined is named, with its cause and what to measure."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from camera_sessions import camera_session
from cases import refused, terminal_text
from sessions import plain, with_columns, with_rows
from typer.testing import CliRunner

import bayescal as bc
from bayescal import calibration
from bayescal.arm.motion import NominalArm
from bayescal.assess.budget import budget
from bayescal.assess.identifiability import _words, identifiability
from bayescal.assess.measurand import parameter
from bayescal.assess.undetermined import undetermined
from bayescal.calibration import fit
from bayescal.cli import app
from bayescal.dataset import Target, read_dataset, write_dataset
from bayescal.effects import Parameter
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated, check_enough
from bayescal.estimate.unexplained import repeat_scatter
from bayescal.fitted.gate import _left_of_prior, of_fit
from bayescal.gap.diagnose import diagnose
from bayescal.methods import compare
from bayescal.model import FitOptions, Scene
from bayescal.predict.forecast import SMALLEST, elsewhere, joint_range, point_slopes
from bayescal.reporting.comparison import _held
from bayescal.reporting.fit.files import budget_table, measurand_record
from bayescal.reporting.fit.record import fit_record
from bayescal.reporting.gap.phrases import headline
from bayescal.reporting.gap.record import gap_record, write_gap
from bayescal.reporting.gap.summary import gap_summary
from bayescal.simulation import Options, simulate
from bayescal.statistics import spawned

FULL = ("geometry", "compliance")
LEVELS_OF = calibration.levels_of
FULL_RANGE = "in poses over most of the range of"


@pytest.fixture(autouse=True, scope="module")
def _one_level():
    """Fits without simpler levels, which are tested in `test_fit`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "levels_of", lambda effects: (effects,))
        yield


def on_faces(session, *faces):
    names = np.array([t.name for t in session.targets])[session.measurements.target]
    used = with_rows(session, np.flatnonzero(np.isin(names, faces)))
    return replace(used, certificates=tuple(c for c in session.certificates if set(c.targets) <= set(faces)))


def tracked(tracker, readings, centre=(0.06, 0.0, 0.12)):
    """An instrument's readings of a tool of the nominal arm at readings (N, 6), rad."""
    session = tracker(seed=2, count=90).dataset
    tool = replace(session.tools[0], centre=np.array(centre))
    session = replace(with_rows(session, np.arange(len(readings))), tools=(tool,))
    arm = NominalArm(session.robot, tool.centre)
    target = Target("tracker", "instrument", {"xyz": np.zeros(3), "rpy": np.zeros(3)})
    noise = 1e-5 * np.random.default_rng(1).standard_normal((len(readings), 3))
    xyz = arm.ball(arm.frames(readings)) + noise
    table = replace(session.measurements, readings=readings, xyz=xyz, payload=None)
    return replace(session, targets=(target,), measurements=table)


def one_pose(cube):
    session = on_faces(cube(seed=3, count=150).dataset, "cube.+z")
    m = session.measurements
    return with_columns(session, readings=np.repeat(m.readings[:1], len(m.ids), axis=0), payload=None)


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
    "one plane": (lambda cube, *_: on_faces(cube(seed=3, count=150).dataset, "cube.+z"), "a1", "directions",
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
    words = "only the combination d2 + d3 is identifiable (no effect with this tool)"
    assert found[0].cause == f"{words}, because no measurement depends on each by itself"


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
    assert scale.displacement == pytest.approx(np.sqrt(np.mean(rest**2) * 3), rel=0.15)


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
    write_gap(diagnosed, tmp_path / "run", gap_record(diagnosed), pictures=False)
    text = terminal_text(gap_summary(diagnosed, gap_record(diagnosed)), 150)
    assert "nan" not in text
    assert "no interval: the validation measurements have one pose" in text


def test_an_arm_of_one_pose_is_not_exported(cube):
    """Its distances kept 'nan %' of the uncertainty of the priors."""
    found = calibrated(Scene(one_pose(cube)), FULL)
    assert _left_of_prior(found, found.covariance) == 1.0


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
        told[name] = of.prior_share, "not determined" in terminal_text(budget_table(of), 150)
        assert measurand_record(of)["prior_share"] == of.prior_share
    assert told["few"][0] > 0.5 > told["many"][0]
    assert (told["few"][1], told["many"][1]) == (True, False)


@pytest.mark.parametrize(("noise", "wild"), [(1e-6, False), (2e-3, True)])
def test_a_tiny_stated_noise_is_no_sign_of_a_wrong_file(cube, noise, wild):
    """'residuals of 0.0 mm, far more than any small error of an arm', of 1 µm at a stated noise of 1 nm."""
    session = cube(seed=3, count=70, noise=noise, stated=1e-9 if not wild else 5e-6).dataset
    assert ("wrong_files" in {f.code for f in fit(session, FULL, samples=0).findings}) == wild


# --- Sessions with little in them: known targets, repeats without scatter, few contacts or none.


def with_targets(session, **known):
    """The session with all planes known as well as stated."""
    change = [replace(t, **known) if t.kind == "plane" else t for t in session.targets]
    return replace(session, targets=tuple(change))


def first(session, count):
    """The session with only its first rows to calibrate."""
    m = session.measurements
    role = np.where((m.role == "calibrate") & (np.cumsum(m.role == "calibrate") > count), "validate", m.role)
    return with_columns(session, role=role)


def test_targets_may_be_known(cube, monkeypatch):
    """`u_mm: 0` of the contract; with all planes known the nominal model has no unknown at all."""
    monkeypatch.setattr(calibration, "levels_of", LEVELS_OF)
    found = fit(with_targets(cube(seed=2, count=80).dataset, u=0.0, u_angle=0.0), ("geometry",), samples=0)
    assert np.all(np.isfinite(found.final.estimate.sd))
    nominal, last = (level.unexplained.fitted for level in (found.levels[0], found.levels[-1]))
    assert last < nominal


def test_repeats_that_read_identically_are_no_noise(cube):
    """An encoder coarser than the noise: the stated noise stands in its place."""
    session = cube(seed=2, count=120).dataset
    m = session.measurements
    readings, repeat = m.readings.copy(), np.full(len(m.ids), "", object)
    for target in range(4):
        rows = np.flatnonzero((m.role == "calibrate") & (m.target == target))[:4]
        readings[rows] = readings[rows[0]]
        repeat[rows] = f"r{target}"
    same = with_columns(session, readings=readings, repeat=repeat.astype(str))
    found = fit(same, ("geometry",), samples=0)
    scatter, dof = repeat_scatter(Scene(same), found.final.estimate)
    assert (scatter, dof > 5) == (None, True)
    assert found.final.unexplained.floor == pytest.approx(5e-6)


@pytest.mark.parametrize("count", [0, 8])
@pytest.mark.parametrize("command", [fit, diagnose, compare])
def test_too_few_rows_are_refused_in_one_line(cube, count, command):
    few = first(cube(seed=2, count=80).dataset, count)
    assert refused("role calibrate", lambda: command(few, ("geometry",))).where == "measurements.csv"


@pytest.mark.parametrize("known", [None, {"u": 0.0, "u_angle": 0.0}])
def test_the_number_that_is_asked_for_is_enough(cube, known):
    """Loose targets take up rows to be located; known ones take none: one row a joint is left to be asked."""
    session = cube(seed=2, count=80).dataset
    session = session if known is None else with_targets(session, **known)
    with pytest.raises(BayescalError) as caught:
        check_enough(Scene(first(session, 4)))
    needed = int(re.search(r"measure (\d+) or more", caught.value.remedy)[1])
    unknowns = 0 if known else 12
    assert 6 <= needed <= 6 + unknowns
    check_enough(Scene(first(session, 6 + unknowns)))
    with pytest.raises(BayescalError):
        check_enough(Scene(first(session, 5)))


def test_streams_are_independent(cube, monkeypatch):
    """Draws of the posterior, the noise added to them and the forecast once shared one stream."""
    used = {}
    for name in ("gaussian", "validate", "forecast"):
        plain = getattr(calibration, name)

        def told(*given, plain=plain, name=name, **named):
            used[name] = next(v for v in reversed(given) if isinstance(v, int) and v != 2000)
            return plain(*given, **named)

        monkeypatch.setattr(calibration, name, told)
    fit(cube(seed=2, count=80).dataset, ("geometry",), FitOptions(seed=3), samples=0)
    assert len({3, *used.values()}) == 4
    draws = [np.random.default_rng(s).standard_normal(10_000) for s in spawned(3, 6)]
    assert np.abs(np.corrcoef(draws) - np.eye(6)).max() < 0.05
    assert spawned(3, 6) == spawned(3, 6) != spawned(4, 6)


def parameter_of(name, unit, sd):
    return Parameter(name, unit, (), sd)


D2, D3 = (parameter_of(name, "m", 1e-4) for name in ("d2", "d3"))
THETA4, A4 = parameter_of("theta4", "rad", 1e-3), parameter_of("a4", "m", 2e-4)


@pytest.mark.parametrize(("parameters", "free", "size", "words"), [
    ((D2, D3), (1, -1), 0.0, "only the combination d2 + d3 is identifiable"),
    ((D2, D3), (1, 1), 0.0, "only the combination d2 - d3 is identifiable"),
    # equal loadings, but of unequal priors: no sum of the two is identifiable
    ((D2, replace(D3, sd=2e-4)), (1, -1), 0.0, "only the combination d2 + 0.5 d3 is identifiable"),
    ((THETA4, A4), (1, 1), 0.0, "only the combination a4 - 3.5 mm/deg theta4 is identifiable"),
    ((D2, D3), (1, -1), 0.7, "the combination d2 + d3 is identifiable, d2 and d3 singly weakly"),
    ((D2, D3), (1, 0), 0.0, "d2 is not identifiable"),
    ((D2, D3), (0, 1), 0.9, "d3 is weakly identifiable"),
    ((D2, D3, A4), (1, -1, 1), 0.0,
     "a common change of d2 by +0.058 mm, d3 by -0.058 mm and a4 by +0.12 mm is not identifiable"),
])  # fmt: skip
def test_a_weak_direction_in_its_units(parameters, free, size, words):
    v = np.array(free) / np.linalg.norm(free)
    assert _words(parameters, v, size, v[:, None]) == words
    if words.startswith("only"):  # the combination does not change along the free direction
        change = {p.name: x * p.sd for p, x in zip(parameters, v, strict=True)}
        if "theta4" not in change:
            factor = float(re.search(r"[+-] ([\d.]*)", words)[1] or 1) * (-1 if " - " in words else 1)
            assert change["d2"] + factor * change["d3"] == pytest.approx(0.0, abs=1e-12)


def test_two_weak_directions_through_one_parameter_promise_no_pair():
    """d2 - d3 and d3 - a4 both free: neither d2 + d3 nor d3 + a4 is identifiable, only their common sum."""
    v = np.array([1, -1, 0]) / np.sqrt(2)
    weak = np.linalg.qr(np.array([[1, -1, 0], [0, 1, -1]], float).T)[0]
    assert "common change of d2" in _words((D2, D3, A4), v, 0.0, weak)


def test_a_direction_of_many_parameters_alike_names_the_first():
    """No loading of twenty equal ones is large."""
    many = [Parameter(f"curve {k}", "m", (), 1e-4) for k in range(20)]
    v = np.ones(20) / np.sqrt(20)
    assert "and curve" in _words(many, v, 0.0, v[:, None])


# --- Several sessions on the command line: one fit, one diagnosis, and whether they agree.

LITTLE = {"contacts": 54, "later": 8, "repeats": 3, "spheres": 0}
QUICK = ("--samples", "0", "--no-pictures")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two sessions of one arm, and one of another."""
    top = tmp_path_factory.mktemp("sessions")
    for name, seed, arm in (("may", 1, 1), ("june", 2, 1), ("twin", 3, 7)):
        made = simulate(Options(name=name, seed=seed, arm_seed=arm, **LITTLE)).dataset
        write_dataset(plain(made), top / name)
    return top


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)), env={"COLUMNS": "120"}, catch_exceptions=False)


@pytest.fixture(scope="module")
def together(folders):
    out = folders / "run"
    done = run("fit", folders / "may", folders / "june", *QUICK, "--out", out)
    assert done.exit_code == 0, done.output
    return done.output, json.loads((out / "fit.json").read_text()), out


def test_record_names_every_session(folders, together):
    _, record, out = together
    assert record["dataset"]["name"] == "may + june"
    sessions = record["dataset"]["sessions"]
    expected = [(name, read_dataset(folders / name).sha256) for name in ("may", "june")]
    assert [(s["name"], s["sha256"]) for s in sessions] == expected
    assert len({record["dataset"]["sha256"], *(s["sha256"] for s in sessions)}) == 3
    assert {p.name for p in out.iterdir()} >= {"fit.json", "posterior.nc", "robot.yaml"}
    assert {p["target"].partition(":")[0] for p in record["validation"]["planes"]} == {"may", "june"}


def test_record_and_table_tell_how_the_sessions_agree(together):
    printed, record, _ = together
    found = record["agreement"]
    (pair,) = found["pairs"]
    assert pair["sessions"] == ["may", "june"]
    assert not pair["disagree"]
    assert set(pair["apart_sd"]) == {p["name"] for p in found["parameters"]}
    for p in found["parameters"]:
        assert p["together"]["sd"] <= 1.15 * min(s["sd"] for s in p["alone"].values())
    assert "difference" in printed
    assert "may and june: chi-squared" in printed


def test_sessions_of_two_arms_are_flagged(folders):
    """`joint` is a level and no cause, and still a model whose sessions are compared."""
    result = bc.fit([folders / "may", folders / "twin"], "joint", samples=0)
    assert result.record["agreement"]["pairs"][0]["disagree"]
    assert "may and twin disagree" in " ".join(str(result).split())
    assert any("may and twin disagree" in warning for warning in result.record["warnings"])


def test_another_drawing_is_refused_and_nothing_written(folders, tmp_path):
    june = read_dataset(folders / "june")
    write_dataset(replace(june, robot=replace(june.robot, d=june.robot.d + 1e-3)), tmp_path / "longer")
    with pytest.raises(BayescalError, match=r"not the robot of may: d of J1 0\.001, not 0"):
        run("fit", folders / "may", tmp_path / "longer", *QUICK, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_gap_takes_several_sessions(folders):
    out = folders / "gap"
    done = run("gap", folders / "may", folders / "june", "--no-pictures", "--out", out)
    assert done.exit_code == 0, done.output
    record = json.loads((out / "gap.json").read_text())
    assert [s["name"] for s in record["dataset"]["sessions"]] == ["may", "june"]
    assert record["gap"]["heldout_rms_um"] < 12
    assert "may and june: chi-squared" in done.output


def test_what_is_stated_of_a_camera_is_not_to_be_left_out():
    """The size of a board, of which images tell no more than its u: leave it out of the model, it said."""
    fitted = calibrated(Scene(camera_session(images=8, seed=3)), ("geometry",))
    found = undetermined(fitted, identifiability(fitted))
    (lens,) = (u for u in found if set(u.parameters) == {"cam k2", "cam k3"})
    assert lens.state == "noise"
    assert lens.remedy.startswith("calibrate the camera")


def test_a_method_that_moves_little_says_what_it_moves():
    """Five solvers of hand-eye listed 40 parameters each that they keep."""
    model = SimpleNamespace(names=("a1", "a2", "a3", "x", "y"))
    solution = SimpleNamespace(model=model, held=model.names[:3], free=2)
    row = SimpleNamespace(result=SimpleNamespace(solution=solution))
    assert _held(row) == "kept nominal: all but x, y"
    solution.held = ("a1",)
    assert _held(row) == "kept nominal: a1"
