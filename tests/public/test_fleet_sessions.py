"""A fleet from end to end, on arms of the independent simulator: all is done, once; the table is right."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from cases import ROOT, refused

import bayescal as bc
from analysis.fleet_study import probed as probed_session
from analysis.fleet_study import put, shapes, subset
from bayescal.arm.chain import Prior
from bayescal.errors import BayescalError
from bayescal.exporting.robot import robot_text
from bayescal.fitted.arm import of_fit
from bayescal.public.fleet import Task, _arms, _entries, _members, computed, kept
from bayescal.public.fleet_results import robot_text as fleet_robot
from bayescal.robots import load_robot

ARMS, ODD, OFF = 4, 3, 0.02
"""Arms of the fleet, the one that differs, and by how much its third zero does, rad: 33 times the spread."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Small sessions, one of which cannot be read; without what would add candidates to their diagnoses."""
    top = tmp_path_factory.mktemp("fleet")
    for k, shape in enumerate(shapes(3, ARMS)):
        zero = shape.zero.copy()
        zero[2] += OFF * (k == ODD)
        name = f"arm-{k}"
        texts, _ = probed_session(k, replace(shape, zero=zero), name, serial=f"SN-{k}", date="2026-03-01")
        table = pd.read_csv(StringIO(texts["measurements.csv"]), dtype=str)
        few = table.drop(columns=table.filter(regex="degps$|^time|^temperature")).to_csv(index=False)
        texts |= {"measurements.csv": few}
        put(top / "sessions" / name, subset(texts, 60, k, 16))
    bad = texts | {"measurements.csv": texts["measurements.csv"].replace(",cube.+z,", ",cube.z,", 1)}
    put(top / "sessions" / "bad", bad)
    return top


def command(folder: Path, *more: str) -> list[str]:
    line = [sys.executable, "-m", "bayescal.cli", "fleet", str(folder / "sessions"), "--out"]
    return [*line, str(folder / "out"), "--workers", "2", *more]


def workers(process: int) -> list[int]:
    """The worker processes of a process."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return [int(p) for p in children if b"spawn_main" in Path(f"/proc/{p}/cmdline").read_bytes()]


def done(folder: Path) -> dict[str, int]:
    """When each run folder that is complete was written."""
    files = (folder / "out" / "sessions").glob("*/[fg]*/*.json")
    return {str(p): p.stat().st_mtime_ns for p in files if p.name in ("fit.json", "gap.json")}


@pytest.fixture(scope="module")
def ran(folder) -> tuple[Path, str, dict[str, int]]:
    """The fleet, one of whose two workers was killed; what was said; what was complete at that time."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        command(folder), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    end = time.monotonic() + 120
    while not (before := done(folder)) or len(workers(process.pid)) < 2:
        assert time.monotonic() < end
        time.sleep(0.02)
    os.kill(workers(process.pid)[0], signal.SIGKILL)
    out, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return folder / "out", out + errors, before


def test_nothing_is_lost_or_done_twice_though_a_worker_is_killed(ran):
    out, said, before = ran
    record = json.loads((out / "fleet.json").read_text())
    assert record["count"] == {"sessions": ARMS + 1, "fitted": ARMS, "kept": 0, "failed": 1}
    after = done(out.parent)
    assert len(after) == 2 * ARMS
    assert before.items() <= after.items()
    assert "5 sessions: 4 fitted, 0 kept, 1 failed" in said
    assert not list(out.rglob("*.part")) + list(out.rglob("*lock"))


def test_a_worker_killed_behind_its_last_file_leaves_no_lock(ran, folder):
    """Its results are there, its note and the lock are as it left them: nothing is computed."""
    out, _, _ = ran
    at = out / "sessions" / "arm-0"
    state = json.loads((at / "session.json").read_text())
    inputs = state["done"].pop("gap")
    state["begun"] = {"command": "gap", "inputs": inputs, "before": ""}
    (at / "session.json").write_text(json.dumps(state))
    (at / ".gap.bayescal-lock").write_text("4194304")
    options = {key: value for key, value in inputs.items() if key != "sha256"}
    times = done(folder)
    assert computed(Task(folder / "sessions" / "arm-0", at, options)) == ""
    assert done(folder) == times
    assert not list(at.rglob("*lock"))
    assert json.loads((at / "session.json").read_text())["done"]["gap"] == inputs


def test_the_table_is_right_and_a_bad_session_stands_in_it(ran):
    out, said, _ = ran
    record = json.loads((out / "fleet.json").read_text())
    first, *others = record["arms"]
    assert first["arm"] == f"SN-{ODD}"
    (d,) = (d for d in first["differs"] if d["stated"])
    assert d["parameter"] == "theta3"
    assert d["value"] == pytest.approx(np.degrees(OFF), abs=3 * d["u"])
    assert not [d for arm in others for d in arm["differs"] if d["stated"]]
    (bad,) = (s for s in record["sessions"] if s["error"])
    assert bad["session"] == "bad"
    assert "measurements.csv:" in bad["error"]
    assert f"bad: {bad['error']}" in said
    # the prior of the others is wrong for the one that differs
    assert record["models"][0]["better"] == ARMS - 1
    page = (out / "fleet.html").read_text()
    for session in record["sessions"]:
        assert bool(session["fit"]) == (f"sessions/{session['session']}/fit/report.html" in page)
    assert (out / "sessions" / "arm-0" / "fit" / "report.html").is_file()


def test_a_second_call_computes_what_is_missing_or_changed_on_dask(ran, folder, thread_of_dask):
    out, _, _ = ran
    before = done(folder)
    settings = folder / "sessions" / "arm-1" / "dataset.yaml"
    settings.write_text(settings.read_text() + "# a comment\n")
    shutil.rmtree(out / "sessions" / "arm-2" / "gap")
    lines = []
    result = bc.fleet([folder / "sessions"], out, dask=thread_of_dask.scheduler_address, say=lines.append)
    assert result.record["count"] == {"sessions": 5, "fitted": 2, "kept": 2, "failed": 1}
    assert lines[0] == f"2 of 5 sessions are kept from an earlier run in {out}"
    changed = {path.split("/sessions/")[1] for path, time in done(folder).items() if before.get(path) != time}
    assert changed == {"arm-1/fit/fit.json", "arm-1/gap/gap.json", "arm-2/gap/gap.json"}
    assert result.arms.index[0] == f"SN-{ODD}"
    assert list(result.sessions.loc["arm-2"][["arm", "status"]]) == ["SN-2", "fitted"]
    assert set(result.prior.name) == set(bc.load(out / "sessions" / "arm-0" / "fit").parameters.index[:24])


def test_other_options_are_another_computation(ran, folder):
    out, _, _ = ran
    options = {"model": ["geometry", "compliance"], "without": [], "seed": 0, "robust": True}
    for width, error in ((1.0, ""), (2.0, None)):
        folders = (path / "sessions" / "arm-0" for path in (folder, out))
        assert kept(Task(*folders, options | {"prior_width": width})) == error


def test_the_learnt_prior_is_used_by_the_next_fit(ran, folder, tmp_path):
    out, _, _ = ran
    source = folder / "sessions" / "arm-0"
    texts = {p.name: p.read_text() for p in source.iterdir()}
    few = subset(texts, 40, 1)
    plain = bc.fit(put(tmp_path / "plain", few), samples=0)
    texts = few | {"robot.yaml": (out / "fleet-robot.yaml").read_text()}
    learnt = bc.fit(put(tmp_path / "learnt", texts), samples=0)
    prior = bc.load(out / "sessions" / "arm-0" / "fit").parameters  # stated
    assert (learnt.parameters.prior_sd[:24] < prior.prior_sd[:24]).mean() > 0.8
    key = lambda result: result.record["predicted_distance"]["expanded_U_um"]  # noqa: E731
    assert key(learnt) < 0.9 * key(plain)
    assert not [w for w in learnt.warnings if "contrary to the prior" in w]


def test_an_arm_unlike_the_fleet_is_told_by_its_fit(ran, folder, tmp_path, usual_draws):
    """A prior that is wrong in one parameter, by many of its standard deviations."""
    texts = {p.name: p.read_text() for p in (folder / "sessions" / "arm-0").iterdir()}
    prior = "priors:\n  - {name: theta3, deviation_deg: 0.8, sd_deg: 0.02}\n  - {name: theta9, sd_deg: 1}\n"
    found = bc.fit(put(tmp_path / "far", texts | {"robot.yaml": texts["robot.yaml"] + prior}), samples=0)
    plain = bc.load(ran[0] / "sessions" / "arm-0" / "fit")
    codes = {f["code"]: f["text"] for f in found.record["findings"]}
    assert codes["far_from_prior"].startswith("theta3:")
    assert "theta9" in codes["prior_unused"]
    assert codes["far_from_prior"] in bc.diagnose(tmp_path / "far").record["warnings"]
    assert "priors" not in robot_text(of_fit(found.data), "")  # of a calibrated arm
    for name in ("theta2", "theta3", "d4"):  # the usual prior holds
        usual, now = plain.parameters.loc[name], found.parameters.loc[name]
        columns = ["estimate", "u", "prior_sd"]
        assert list(now[columns]) == pytest.approx(list(usual[columns]), rel=1e-3)


@pytest.mark.parametrize(("arm", "message"), [
    ("(", "no regular expression"), ("x", "not in the name of"), ("none.csv", "none.csv"),
])  # fmt: skip
def test_arms_that_cannot_be_told(folder, tmp_path, arm, message):
    refused(message, lambda: bc.fleet([folder / "sessions"], tmp_path / "out", arm=arm))
    assert not (tmp_path / "out").exists()


def test_arms_are_told_alike_by_an_expression_and_by_a_table(tmp_path):
    """The first group of the expression, or all of it; whatever surrounds it in the name."""
    arm_of = {f"{day}-r{k}_a": f"r{k}" for day in ("mo", "tu") for k in (1, 2, 12)}
    (tmp_path / "arms.csv").write_text("session,arm\n" + "".join(f"{s},{a}\n" for s, a in arm_of.items()))
    for arm in (str(tmp_path / "arms.csv"), "-(r[0-9]+)_", "r[0-9]+", "-(?:r|R)(?=.)"):
        told = _arms(arm, list(arm_of))
        found = {name: told({"session": name}) for name in arm_of}
        wanted = arm_of if "?" not in arm else dict.fromkeys(arm_of, "-r")
        assert found == wanted, arm


def test_a_folder_of_others_is_refused(folder, tmp_path, thread_of_dask):
    (tmp_path / "mine").write_text("notes")
    refused("not of a fleet", lambda: bc.fleet([folder / "sessions"], tmp_path))
    (tmp_path / "mine").unlink()
    shutil.copytree(folder / "sessions" / "arm-0", tmp_path / "sessions" / "arm-0")  # one's own datasets
    refused("not of a fleet", lambda: bc.fleet([tmp_path / "sessions"], tmp_path))
    (tmp_path / "fleet.json").write_text('{"schema": "of another program"}')
    refused("not of a fleet", lambda: bc.fleet([tmp_path / "sessions"], tmp_path))
    assert not (tmp_path / "sessions" / "arm-0" / "session.json").exists()
    for none in ([], [tmp_path / "nope"]):
        with pytest.raises(BayescalError, match="no session;"):
            bc.fleet(none, tmp_path / "out")
    with pytest.raises(BayescalError, match="no session could be read"):
        bc.fleet([folder / "sessions/bad"], tmp_path / "out", dask=thread_of_dask.scheduler_address)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("dated", [True, False])
def test_sessions_are_in_the_order_of_their_dates(monkeypatch, tmp_path, dated):
    """Whatever they are called; as they were given where one states no date."""
    dates = {"b": "2025-03-01", "a": "2025-07-01", "c": "2024-11-30", "d": "2025-05-05" if dated else None}

    def with_fit(entry, folder):
        name = entry["session"]
        return {**entry, "sha256": name, "date": dates[name], "serial": "7", "fit": {"words": "made up"}}

    monkeypatch.setattr("bayescal.reporting.fleet.with_fit", with_fit)
    state = {"failed": None, "done": {"fit": {}}}
    tasks = {n: SimpleNamespace(dataset=n, folder=tmp_path / n, state=lambda: state) for n in dates}
    done = dict.fromkeys(dates, "fitted")
    entries = _entries(tasks, dict.fromkeys(dates, ""), done, lambda e: e["serial"])
    assert [e["session"] for e in entries] == (["c", "b", "d", "a"] if dated else list(dates))


def test_an_arm_is_that_of_its_diagnosis_where_there_is_one(monkeypatch, tmp_path):
    entry = {"session": "s", "arm": "a", "robot": "r", "folder": "sessions/s"}
    monkeypatch.setattr("bayescal.public.fleet.read_likelihood", lambda run, model: run.name)
    entries = [{**entry, "gap": {"verdict": "null"}}, {**entry, "gap": None}]
    assert [m.likelihood for m in _members(entries, tmp_path, ("geometry",))] == ["gap", "fit"]


def test_priors_that_a_fleet_does_not_learn_stay_in_its_robot(monkeypatch, tmp_path):
    robot, _ = load_robot("fanuc-lrmate200ic")
    own, other = (Prior(name, "rad", 1e-3, 2e-3) for name in ("theta2", "theta3"))
    learnt = SimpleNamespace(parameter=SimpleNamespace(name="theta2", unit="rad"), mean=4e-3, sd=1e-3)
    monkeypatch.setattr("bayescal.public.fleet_results.priors", lambda model: [learnt])
    text = fleet_robot(SimpleNamespace(arms=("a", "b")), replace(robot, priors=(own, other)))
    (tmp_path / "robot.yaml").write_text(text)
    found = {p.name: p.deviation for p in load_robot("robot.yaml", tmp_path)[0].priors}
    assert found == pytest.approx({"theta2": 4e-3, "theta3": 1e-3})
