"""Every command and report says the same of what may be used of a run."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from rich.console import Console

import bayescal as bc
from bayescal.errors import BayescalError
from bayescal.fitted import gate
from bayescal.fitted.arm import of_fit, of_gap
from bayescal.fitted.file import read_arm
from bayescal.gap.diagnose import diagnose
from bayescal.gap.result import Named
from bayescal.public.results import FitResult
from bayescal.reporting.fit.files import write_fit
from bayescal.reporting.fit.summary import fit_summary
from bayescal.reporting.gap.record import write_gap
from bayescal.reporting.gap.summary import gap_summary

SMALL = {"contacts": 60, "later": 10, "repeats": 0, "spheres": 0, "seed": 1}
TARGETS = "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n450,0,200,180,0,0\n"
CASES = {
    "good": (True, "use"),
    "barely negative": (True, ""),
    "significantly negative": (False, "gap"),
    "not identified": (False, "measure"),
    "not converged": (False, "samples"),
}
"""Whether the arm may be used, and the next step, "" for any."""


def fit_of(case):
    """A fit of each case."""
    rigid = case in ("barely negative",)
    session = bc.simulate(effects="geometry" if rigid else "geometry, compliance", **SMALL).dataset
    if case == "significantly negative":  # gravity upside down
        session = replace(session, gravity=-session.gravity)
    if case == "not identified":  # no length is certified
        session = replace(
            session, certificates=(), targets=tuple(replace(t, u=None) for t in session.targets)
        )
    found = bc.fit(session, samples=0).data
    if case == "not converged":
        found = replace(found, draws=replace(found.draws, converged=False, complaint="R-hat 1.2"))
    return found


@pytest.fixture(scope="module", params=CASES)
def run(request, tmp_path_factory):
    """A fit, its run folder, and what is expected of it."""
    found, folder = fit_of(request.param), tmp_path_factory.mktemp("run") / "fit"
    names = write_fit(found, folder, pictures=False)
    allowed, step = CASES[request.param]
    return SimpleNamespace(
        case=request.param, fit=found, folder=folder, names=names, allowed=allowed, step=step
    )


def text_of(report):
    console = Console(width=10_000, record=True)
    console.print(report)
    return console.export_text()


def done(work):
    """Whether it is allowed, and with which reasons it is refused."""
    try:
        work()
    except BayescalError as error:
        return False, error.what
    return True, ""


def test_the_rule(run):
    use = of_fit(run.fit).use
    assert use.allowed == run.allowed
    assert use.next == run.step or not run.step
    assert (
        run.fit.acceptance.usable <= use.allowed or run.case == "not converged"
    )  # no good verdict is refused
    assert bool(use.rigid.parameters) == (run.case == "barely negative")


def test_files_and_reports_say_the_same(run):
    use = of_fit(run.fit).use
    head = (run.folder / "robot.yaml").read_text(encoding="utf-8").splitlines()[: len(use.against) + 1]
    refused = [line for line in head if line.startswith("# NOT TO BE USED: ")]
    assert refused == [f"# NOT TO BE USED: {reason}." for reason in use.against]
    assert bool(refused) == (not run.allowed)
    contents = json.loads((run.folder / "fit.json").read_text(encoding="utf-8"))
    assert contents["use"] == use.record() == json.loads((run.folder / "arm.json").read_text())["use"]
    assert read_arm(run.folder).use == use
    page = (run.folder / "report.html").read_text(encoding="utf-8")
    assert ("not to be used" in page) == (not run.allowed)
    told = text_of(fit_summary(run.fit))
    assert ("not to be used" in told) == (not run.allowed)
    assert ("use robot.yaml" in told) == (use.next == "use") == ("Use robot.yaml" in page)
    assert ("set to rigid" in told) == bool(use.rigid.words)
    for reason in use.against:
        assert reason in told


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


def test_verify_states_the_reasons(run, tmp_path):
    pytest.importorskip("mujoco")
    bc.export(run.folder, "mjcf", force=True).save(tmp_path / "arm.xml")
    sidecar = json.loads((tmp_path / "arm.xml.bayescal.json").read_text(encoding="utf-8"))
    verified = bc.verify(run.folder, tmp_path / "arm.xml")
    assert verified.passed
    assert verified.record["use"] == sidecar["use"] == of_fit(run.fit).use.record()
    for remark in of_fit(run.fit).use.remarks:
        assert remark in text_of(verified.report())


def test_an_effect_that_is_left_out_is_said_everywhere(tmp_path):
    """Of a diagnosis with a named effect that the validation data do not confirm."""
    gap = diagnose(bc.simulate(**SMALL).dataset)
    named = Named("backlash", "backlash at joint 3", (), "", 0.99, 20.0, confirmed=False)
    gap = replace(gap, verdict=replace(gap.verdict, kind="named", named=(named,)), levels=gap.levels[-1:])
    words = "backlash at joint 3 is named, but the validation data do not confirm it: the arm is without it"
    assert gate.of_gap(gap).left_out == (words,)
    names = write_gap(gap, tmp_path / "gap", pictures=False)
    assert of_gap(gap).use == read_arm(tmp_path / "gap").use
    assert {"gap.json", "arm.json", "gap.html"} <= set(names)
    assert words in text_of(gap_summary(gap))
    for name in ("gap.json", "arm.json"):
        assert json.loads((tmp_path / "gap" / name).read_text(encoding="utf-8"))["use"]["left_out"] == [words]
    assert words in (tmp_path / "gap" / "gap.html").read_text(encoding="utf-8")
    assert words in bc.export(tmp_path / "gap", "robot.yaml").record["notes"]
