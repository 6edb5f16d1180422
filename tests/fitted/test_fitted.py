"""A fitted arm at any pose: equal to its model at the rows of the session, with every effect."""

import html
import json
import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from cases import refused, terminal_text, without_draws
from export_arms import fake, session_of
from rails import moving_session
from sessions import geared, with_columns

import bayescal as bc
from bayescal.effects import EFFECTS
from bayescal.errors import BayescalError
from bayescal.estimate.bounds import UNCHANGED
from bayescal.exporting import FORMATS
from bayescal.exporting.export import export
from bayescal.fitted import gate
from bayescal.fitted.arm import of_estimate, of_fit, of_gap
from bayescal.fitted.file import open_run, read_arm, write_arm
from bayescal.fitted.gate import Use
from bayescal.fitted.unmodelled import state_row
from bayescal.gap.diagnose import diagnose
from bayescal.gap.result import Named
from bayescal.model import Scene, build, standing
from bayescal.model.options import parts_of
from bayescal.public import FitResult
from bayescal.reporting.fit.record import fit_record, write_fit
from bayescal.reporting.fit.summary import fit_summary
from bayescal.reporting.gap.record import gap_record, write_gap
from bayescal.reporting.gap.summary import gap_summary
from bayescal.reporting.page import Run
from bayescal.reporting.page.build import run_page
from bayescal.simulation import Options, simulate

MOVING = tuple(
    e for e in ("compliance", "hardening", "bending", "base-compliance", "payload", "eccentricity",
                "second-harmonic", "gear-mesh@50", "backlash", "hysteresis", "encoder-scale",
                "coupling", "thermal-drift", "step")
)  # fmt: skip
ON_RAILS = ("straightness", "angular-motion", "positioning", "axis-bending")


@pytest.fixture(scope="module")
def session():
    return simulate(Options(contacts=60, later=6, repeats=2, spheres=0, seed=3, payload=1.0)).dataset


@pytest.mark.parametrize("effects", [MOVING, ("compliance", *ON_RAILS), ("compliance", "unsettled")])
def test_rows_of_the_session_are_where_the_model_has_them(session, effects):
    """Also as new poses: the drivers of a pose are those of the row that it repeats."""
    session = moving_session() if effects[-1] in ON_RAILS else session
    arm = fake(session, ("geometry", *effects))
    rows, m = np.arange(0, len(session.measurements.ids), 31), session.measurements
    expected = arm.model.motion(rows).points(arm.values).T
    np.testing.assert_allclose(arm.at_rows(rows).points, expected, rtol=0, atol=1e-12)
    if "unsettled" in effects:
        return  # the arm is at rest in a pose
    for row, own in zip(rows, expected, strict=True):
        pose = arm.at(m.readings[[row]], payload_kg=m.payload[row], direction=m.velocity[row], row=int(row))
        np.testing.assert_allclose(pose.points[0], own, rtol=0, atol=1e-12)


def test_the_model_is_in_equilibrium(session):
    arm = fake(session, ("geometry", "compliance", "bending", "base-compliance", "payload"))
    again = standing(arm.model, arm.values)
    np.testing.assert_allclose(again.stance.delta, arm.model.scene.stance.delta, rtol=0, atol=1e-12)


def test_flange_and_slopes(session):
    arm = fake(session, ("geometry", "compliance", "backlash"))
    poses = arm.at(session.measurements.readings[:5], direction=np.ones(6))
    tool = session.tools[0].centre + [arm.values[arm.model.names.index(f"ball {a}")] for a in "xyz"]
    reached = np.einsum("cij,j->ci", poses.flange, np.append(tool, 1.0))[:, :3]
    np.testing.assert_allclose(poses.points, reached, rtol=0, atol=1e-12)
    k = arm.model.names.index("backlash J3")
    step = replace(arm, values=arm.values + 1e-6 * np.eye(len(arm.values))[k])
    moved = step.at(session.measurements.readings[:5], direction=np.ones(6)).points - poses.points
    np.testing.assert_allclose(1e6 * moved, poses.by_parameters[:, :, k], atol=2e-3)
    assert poses.covariance.shape == (5, 3, 3)
    # levels add one effect each
    assert arm.levels == ("nominal", "geometry", "+ compliance", "+ backlash")
    q = session.measurements.readings[:3]
    last = arm.level("+ backlash").at(q, direction=np.ones(6)).points
    np.testing.assert_allclose(last, arm.at(q, direction=np.ones(6)).points, rtol=0, atol=1e-12)
    nominal = arm.level("nominal").at(q).points
    np.testing.assert_allclose(nominal, arm.model.scene.points[:3], rtol=0, atol=1e-12)
    model = build(Scene(session), ("geometry",))
    own = [arm.values[arm.model.names.index(p.name)] for p in model.parameters]
    rigid = model.motion(np.arange(3)).points(np.array(own)).T
    np.testing.assert_allclose(arm.level("geometry").at(q).points, rigid, rtol=0, atol=1e-12)


def test_play_follows_the_direction(session):
    arm = fake(session, ("geometry", "backlash"))
    q = session.measurements.readings[:4]
    up, down = (arm.at(q, direction=s * np.ones(6)).points for s in (1, -1))
    np.testing.assert_allclose(0.5 * (up + down), arm.at(q).points, rtol=0, atol=1e-8)
    assert np.all(np.linalg.norm(up - down, axis=1) > 1e-6)


def test_state_of_a_time_and_of_a_row(session):
    arm = fake(session, ("geometry", "step@30", "thermal-drift"))
    m, q = session.measurements, session.measurements.readings[[0]]
    early, late = arm.at(q, row=0).points, arm.at(q).points
    np.testing.assert_allclose(arm.at(q, time=m.time[0]).points, early, rtol=0, atol=1e-12)
    for beyond in (-1.0, m.time[-1] + 1.0):  # neither an extrapolation nor the nearest row
        with pytest.raises(BayescalError, match="--at-time-s: is no time of the session"):
            arm.at(q, time=beyond)
    for time in np.linspace(0.0, m.time.max(), 40):  # of rows in any order
        mixed = with_columns(session, time=np.random.default_rng(0).permutation(m.time))
        times, row = mixed.measurements.time, state_row(mixed, time=time)
        assert times[row] == max(times[times <= time], default=times.min())
    np.testing.assert_allclose(arm.at(q, row=m.ids[0]).points, early, rtol=0, atol=1e-15)
    assert np.linalg.norm(early - late) > 1e-6
    refused("there is no row `x`", lambda: arm.at(q, row="x"))


def test_every_moving_effect_is_tested():
    """A new effect joins the list, or moves no frame of the arm."""
    resting = {"lobing", "latency", "plane-form", "artefact", "ball-radius"}
    resting |= {"focal-length", "image-centre", "lens-distortion", "board-scale", "board-bow"}
    moving = {e.partition("@")[0] for e in (*MOVING, *ON_RAILS, "unsettled")}
    assert moving | resting | {"geometry"} == set(EFFECTS)


def test_round_trip_of_the_run_folder(session, tmp_path):
    session = replace(session, sha256="5" * 64)  # of files that the copy is written otherwise than
    arm = fake(session, ("geometry", "compliance", "payload", "hysteresis@0.02", "step@30"))
    assert write_arm(arm, tmp_path) == ("arm.json", "dataset")
    again = open_run(tmp_path)
    assert again.dataset.sha256 == session.sha256
    q = session.measurements.readings[::9]
    np.testing.assert_allclose(again.at(q, row=3).points, arm.at(q, row=3).points, rtol=0, atol=2e-9)
    np.testing.assert_array_equal(again.covariance, arm.covariance)
    assert [p.name for p in again.model.parameters] == [p.name for p in arm.model.parameters]
    assert json.loads((tmp_path / "arm.json").read_text())["schema"] == "bayescal-arm/1"


def test_an_arm_without_equilibrium_is_refused(session):
    arm = fake(session, ("geometry", "compliance"))
    soft = [1.0 if p.name == "compliance J2" else 0.0 for p in arm.model.parameters]
    refused("does not come to rest under gravity", lambda: arm.valued(np.array(soft)))


@pytest.mark.parametrize("folder", ["../run/dataset", "/elsewhere", "dataset/../..", "dataset/x"])
def test_only_copies_in_the_run_folder_are_read(session, tmp_path, folder):
    (tmp_path / "run").mkdir()
    path = tmp_path / "run" / "arm.json"
    write_arm(fake(session, ("geometry",)), path.parent)
    record = json.loads(path.read_text())
    record["dataset"]["folders"] = [folder]
    path.write_text(json.dumps(record))
    refused(r"arm\.json: `.*` is not a copy of the dataset", lambda: open_run(path.parent))


def test_a_folder_without_arm_is_refused(tmp_path):
    refused(r"there is no arm\.json", lambda: open_run(tmp_path))


def test_a_torque_that_only_the_fitted_arm_has(tmp_path):
    """The last joint of a UR that points straight down carries no torque, unless the arm leans."""
    session = session_of("universal-robots-ur5e", payload=0.0)
    readings = np.tile(np.radians([0.0, -90.0, 90.0, -90.0, -90.0, 0.0]), (len(session.measurements.ids), 1))
    readings[:, 0] = session.measurements.readings[:, 0]
    tools = tuple(replace(t, centre_of_mass=np.array([0.0, 0.0, 0.06])) for t in session.tools)
    session = with_columns(replace(session, tools=tools), readings=readings, payload=None)
    leaning = fake(session, ("geometry",))
    nominal = {p.name for p in build(leaning.model.scene, ("compliance",)).parameters}
    assert "compliance J6" in nominal
    assert "compliance J6" not in {p.name for p in build(Scene(session), ("compliance",)).parameters}
    model = build(leaning.model.scene, ("geometry", "compliance"))
    values = dict(zip((p.name for p in leaning.model.parameters), leaning.values, strict=True))
    arm = replace(leaning, model=model, effects=("geometry", "compliance"))
    arm = replace(arm, covariance=np.eye(len(model.parameters)), states={})
    arm = arm.valued(np.array([values.get(p.name, 1e-3) for p in model.parameters]))
    write_arm(arm, tmp_path)
    again = open_run(tmp_path)
    assert [p.name for p in again.model.parameters] == [p.name for p in arm.model.parameters]
    q = readings[:3]
    np.testing.assert_allclose(again.at(q).points, arm.at(q).points, rtol=0, atol=2e-9)
    nominal = arm.level("nominal")
    np.testing.assert_allclose(nominal.at(q).points, nominal.at(q, row=0).points, atol=1e-12)


# --- Every command and report says the same of what may be used of a run.

SMALL = {"contacts": 50, "later": 10, "repeats": 0, "spheres": 0, "seed": 1}
TARGETS = "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n450,0,200,180,0,0\n"
CASES = {
    "good": (True, "use"),
    "barely negative": (True, ""),
    "significantly negative": (False, "gap"),
    "not identified": (False, "measure"),
    "not converged": (False, "samples"),
}
"""Whether the arm may be used, and the next step, "" for any."""


@cache
def good_fit():
    return bc.fit(bc.simulate(effects="geometry, compliance", **SMALL).dataset, samples=0).data


def fit_of(case):
    """A fit of each case."""
    if case == "good":
        return good_fit()
    if case == "not converged":
        return replace(good_fit(), draws=replace(good_fit().draws, converged=False, complaint="R-hat 1.2"))
    rigid = case in ("barely negative",)
    session = bc.simulate(effects="geometry" if rigid else "geometry, compliance", **SMALL).dataset
    if case == "significantly negative":  # gravity upside down
        session = replace(session, gravity=-session.gravity)
    if case == "not identified":  # no length is certified
        targets = tuple(replace(t, u=None) for t in session.targets)
        session = replace(session, certificates=(), targets=targets)
    return bc.fit(session, samples=0).data


@pytest.fixture(scope="module", params=CASES)
def run(request, tmp_path_factory):
    """A fit, its run folder, and what is expected of it."""
    found, folder = fit_of(request.param), tmp_path_factory.mktemp("run") / "fit"
    with without_draws():
        write_fit(found, folder, fit_record(found), pictures=False)
    allowed, step = CASES[request.param]
    return SimpleNamespace(case=request.param, fit=found, folder=folder, allowed=allowed, step=step)


def text_of(report):
    return terminal_text(report, 10000)


def done(work):
    """Whether it is allowed, and with which reasons it is refused."""
    try:
        work()
    except BayescalError as error:
        return False, error.what
    return True, ""


def test_the_rule_and_what_files_and_reports_say(run):
    use = of_fit(run.fit).use
    assert use.allowed == run.allowed
    assert use.next == run.step or not run.step
    # no good verdict is refused
    assert run.fit.acceptance.usable <= use.allowed or run.case == "not converged"
    assert bool(use.rigid.parameters) == (run.case == "barely negative")
    # files and reports say the same
    head = (run.folder / "robot.yaml").read_text(encoding="utf-8").splitlines()[: len(use.against) + 1]
    refused = [line for line in head if line.startswith("# NOT TO BE USED: ")]
    assert refused == [f"# NOT TO BE USED: {reason}." for reason in use.against]
    assert bool(refused) == (not run.allowed)
    contents = json.loads((run.folder / "fit.json").read_text(encoding="utf-8"))
    assert contents["use"] == use.record() == json.loads((run.folder / "arm.json").read_text())["use"]
    assert read_arm(run.folder).use == use
    page = (run.folder / "report.html").read_text(encoding="utf-8")
    assert ("not to be used" in page) == (not run.allowed)
    told = text_of(fit_summary(run.fit, fit_record(run.fit)))
    assert ("not to be used" in told) == (not run.allowed)
    assert ("use robot.yaml" in told) == (use.next == "use") == ("Use robot.yaml" in page)
    assert ("set to rigid" in told) == bool(use.rigid.words)
    for reason in use.against:
        assert reason in told


@pytest.mark.parametrize("run", ["good", "significantly negative"], indirect=True)
def test_commands_do_the_same(run, tmp_path):
    use = of_fit(run.fit).use
    targets = tmp_path / "targets.csv"
    targets.write_text(TARGETS, encoding="utf-8")
    for work in (
        lambda **force: bc.export(run.folder, "mjcf", **force),
        lambda **force: bc.export(FitResult(run.fit), "robot.yaml", **force),
        lambda **force: bc.compensate(run.folder, targets, **force),
    ):
        allowed, why = done(work)
        assert allowed == run.allowed
        assert [reason for reason in use.against if reason not in why] == []
        assert done(lambda work=work: work(force=True))[0]


@pytest.mark.parametrize("run", ["barely negative", "not identified"], indirect=True)
def test_verify_states_the_reasons(run, tmp_path):
    bc.export(run.folder, "mjcf", force=True).save(tmp_path / "arm.xml")
    sidecar = json.loads((tmp_path / "arm.xml.bayescal.json").read_text(encoding="utf-8"))
    verified = bc.verify(run.folder, tmp_path / "arm.xml")
    assert verified.passed
    assert verified.record["use"] == sidecar["use"] == of_fit(run.fit).use.record()
    for remark in of_fit(run.fit).use.remarks:
        assert remark in text_of(verified.report())


def test_an_effect_that_is_left_out_is_said_everywhere(tmp_path):
    """Of a diagnosis with a named effect that the validation data do not confirm."""
    session = bc.simulate(effects="geometry, compliance", **SMALL).dataset
    gap = diagnose(geared(with_columns(session, time=None, temperature=None, velocity=None)))
    named = Named("backlash", "backlash at joint 3", (), "", 0.99, 20.0, confirmed=False)
    gap = replace(gap, verdict=replace(gap.verdict, kind="named", named=(named,)), levels=gap.levels[-1:])
    words = "backlash at joint 3 is named, but the validation data do not confirm it: the arm is without it"
    assert gate.of_gap(gap).left_out == (words,)
    names = write_gap(gap, tmp_path / "gap", gap_record(gap), pictures=False)
    assert of_gap(gap).use == read_arm(tmp_path / "gap").use
    assert {"gap.json", "arm.json", "gap.html"} <= set(names)
    assert words in text_of(gap_summary(gap, gap_record(gap)))
    for name in ("gap.json", "arm.json"):
        assert json.loads((tmp_path / "gap" / name).read_text(encoding="utf-8"))["use"]["left_out"] == [words]
    assert words in (tmp_path / "gap" / "gap.html").read_text(encoding="utf-8")
    assert words in bc.export(tmp_path / "gap", "robot.yaml").record["notes"]
    moved = replace(gap, displaced=("a2 by 7 mm, 148 standard uncertainties",))
    reason = "backlash at joint 3 would change a2 by 7 mm, 148 standard uncertainties; the arm is without it"
    assert gate.of_gap(moved).against == (*gate.of_gap(gap).against, reason)


# --- What is not exported without --force, and why.


@pytest.mark.parametrize("step", ["use", "gap"])
def test_the_next_diagnosis_is_of_the_model_that_was_fitted(step):
    effects, parts = ("geometry", "backlash at joint 3"), ("geometry at joint 4",)
    found, record = good_fit(), fit_record(good_fit())
    assert "--model" not in text_of(fit_summary(found, record))
    options = replace(found.options, without=parts_of(parts, effects))
    doubts = found.acceptance.checks[:1] if step == "gap" else ()
    tests = replace(found.acceptance, doubts=doubts)
    other = (*found.levels[:-1], replace(found.final, effects=effects))
    found = replace(found, options=options, levels=other, acceptance=tests)
    record |= {"model": [*effects], "without": [*fit_record(found)["without"]]}
    record["use"] |= {"next": step}
    asked = "--model 'geometry,backlash at joint 3' --without 'geometry at joint 4'"
    assert f"bayescal gap {found.dataset.folder} {asked}" in text_of(fit_summary(found, record))
    assert f"bayescal gap x/dataset {asked}" in html.unescape(run_page(Run("fit", record, "x")))


@pytest.fixture(scope="module")
def result():
    return FitResult(good_fit())


def test_a_good_fit_passes(result):
    assert of_fit(result.data).use.against == ()
    assert bc.export(result, "urdf").record["notes"][-1].startswith("joint values of the file")


def test_a_fit_and_its_export_count_the_same_parameters_of_the_arm(result):
    fitted = re.search(r"(\d+) parameters of the arm and 3 of tool", text_of(result.report()))
    exported = re.search(r"of (\d+) parameters of the arm", text_of(bc.export(result, "mjcf").report()))
    assert int(fitted[1]) == int(exported[1]) == len(result.data.final.estimate.model.parameters) - 3


def test_doubts_of_the_verdict_are_said_where_the_arm_is_used(result):
    tests = replace(result.data.acceptance, checks=(), doubts=result.data.acceptance.checks[:1])
    use = of_fit(replace(result.data, acceptance=tests)).use
    assert use.allowed
    assert any("errors are larger than noise and model predict" in note for note in use.notes)


def negative(found, name, times):
    """An estimate with a parameter at some u below zero."""
    k = found.model.names.index(name)
    p = found.model.parameters[k]
    z = found.z.copy()
    z[k] = -(times * found.sd[k] * p.sd + p.centre) / p.sd
    return replace(found, z=z)


@pytest.fixture(scope="module")
def soft(result):
    """The arm of a fit with a compliance that is significantly negative."""
    found = negative(result.data.final.estimate, "compliance J3", 5.0)
    return replace(of_estimate(found, found.covariance), use=Use(gate.of_estimate(found, found.covariance)))


def test_a_negative_compliance(soft):
    words = r"not exported: negative by more than \S+ u, which is not physical: compliance J3 -\S+ µrad/.N m"
    refused(words, lambda: export(soft, "robot.yaml"))
    out = export(soft, "robot.yaml", force=True)
    assert [m.parameters for m in out.missing] == [("compliance J3",)]
    assert "compliance J3" not in [i.parameter for i in out.written.items]


OF_THEIR_OWN = {"ur-yaml", "hand-eye", "lerobot", "lerobot-dynamixel", "pal"}
"""Formats of another robot or session, or of a file of their own."""


@pytest.mark.parametrize("to", sorted(set(FORMATS) - OF_THEIR_OWN))
def test_every_format_can_be_forced(soft, to):
    """What a format cannot hold, as a spring that pushes, is left out and said."""
    refused("not exported", lambda: export(soft, to))
    out = export(soft, to, force=True)
    why = next((m.why for m in out.missing if m.parameters == ("compliance J3",)), "")
    assert ("no spring turns against its torque" in why) == (to in ("mjcf", "sdf", "robot.yaml", "dh-csv"))
    lost = {name for m in out.missing for name in m.parameters}
    assert "compliance J3" in lost or any(i.parameter == "compliance J3" for i in out.written.items)
    assert any("exported with --force: negative by more than " in note for note in out.notes)
    assert out.record("x")["use"]["allowed"] is False


def test_priors_that_decide(result):
    """The same fit with the covariance of the prior."""
    found = result.data.final.estimate
    assert gate.of_estimate(found, found.covariance) == ()
    prior = np.eye(found.model.size)
    (reason,) = gate.of_estimate(found, prior)
    assert reason.startswith("the fit is not identified: distances between TCP positions keep 100 %")
    for share, words in ((0.99 * gate.REDUCED, 0), (1.01 * gate.REDUCED, 1)):  # of every prior sd
        assert len(gate.of_estimate(found, share**2 * prior)) == words
    bare = replace(found.model, constraints=())
    assert gate.of_estimate(replace(found, model=bare), prior)[0].startswith("no certified length was fitted")
    # As a fit is: not by the narrower one of the solver
    verdict = SimpleNamespace(named=(), kind="null")
    wide = np.eye(found.model.size)
    gap = SimpleNamespace(arm=found, covariance=wide, verdict=verdict, rigid=UNCHANGED, displaced=())
    assert len(gate.of_gap(gap).against) == 1
    gap.covariance = found.covariance
    assert gate.of_gap(gap) == gate.NOTHING


def test_names_without_gain():
    assert gate.not_gained([("backlash", 4.0), ("bending", -0.5), ("step@3", float("nan"))]) == (
        "bending does not make the validation data more probable (-0.5 nats)",
        "step@3 does not make the validation data more probable (+nan nats)",
    )


def test_an_effect_that_the_machine_does_not_have_is_refused(result, tmp_path):
    """Added by the user: fitted again, and its gain on the validation measurements is not positive."""
    with pytest.raises(BayescalError, match="coupling does not make the validation data more probable"):
        bc.export(result, "urdf", with_="coupling")
    without = bc.export(result, "urdf", without="compliance")
    assert without.record["model"] == ["geometry"]
    assert not without.data.missing
    refused("the model has compliance already", lambda: bc.export(result, "urdf", with_="compliance"))
