"""Joint logs in the blind check: sealed as sessions are, diagnosed without their truth, and scored."""

import json
import re
import runpy

import numpy as np
import pytest
from cases import ROOT, refused
from typer.testing import CliRunner

import bayescal
from analysis.blind import make as maker
from analysis.blind import motions, seal
from analysis.blind import run as runner
from analysis.blind.__main__ import app
from analysis.blind.folder import LOG, texts
from analysis.blind.make import Drawn, built, make
from analysis.blind.run import Task, answered
from analysis.blind.unseal import opened
from bayescal.storage.folders import LIST

SCORE = ROOT.parent / "shared" / "data" / "motion-dev" / "score.py"
NAMES = ["delay", "ripple", "payload", "torque-drift"]
KINDS = ["null", "single", "pair", "outside"]
VERDICTS = ["null", "named", "named+unexplained", "class", "unknown", "ambiguous"]


def truth_of(number, rng):
    """A ground truth as the simulator writes it."""
    kind = KINDS[number % 4]
    names = list(rng.permutation(NAMES)[: {"single": 1, "pair": 2}.get(kind, 0)])
    outside = "hose" if kind == "outside" else None
    size = 0.0 if kind == "null" else float(np.exp(rng.uniform(np.log(10), np.log(800))))
    return {
        "world": f"{number:03d}",
        "kind": kind,
        "effects": ["unknown"] if outside else names,
        "outside": outside,
        "where": [] if kind == "null" else [{"site": f"joint {rng.integers(1, 3)}"}],
        "lambda": {"value": size},
        "torque_rms_Nm": {"oracle": [1.0, 2.0], "baseline": [1.1, 2.3]},
    }


def gap_of(truth, rng):
    """An answer, right in half of all cases."""
    verdict = str(rng.choice(VERDICTS))
    right = {"null": "null", "outside": "unknown"}.get(truth["kind"], "named")
    verdict = right if rng.random() < 0.5 else verdict
    names = list(rng.permutation(NAMES)[: rng.integers(1, 3)]) if verdict.startswith("named") else []
    if verdict.startswith("named") and rng.random() < 0.5:
        names = [name for name in truth["effects"] if name != "unknown"]
    gap = {
        "verdict": verdict,
        "effects": names,
        "probability": {name: float(rng.uniform(0.8, 1.0)) for name in [*NAMES, "null", "unknown"]},
        "credible_set90": ["+".join(names) or verdict],
        "where": [{"site": f"joint {rng.integers(1, 3)}"}] if rng.random() < 0.8 else [],
        "torque_rms_Nm": {"before": [1.4, 2.6], "after": list(rng.uniform([1.0, 2.0], [1.3, 2.5]))},
    }
    if verdict == "class":
        members = rng.permutation([*NAMES, "other"])[: rng.integers(2, 6)]
        gap["class"] = {"members": {str(m): 0.3 for m in members}}
    return gap


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A blind folder of made-up logs whose answers are sealed."""

    def logs(_, tasks, workers, dask):
        for k, task in enumerate(tasks):
            assert task.kind == maker.MOTIONS
            truth = truth_of(task.number, np.random.default_rng(task.number))
            yield k, ({name: f"{name} of log {task.number}\n" for name in LOG}, truth)

    def answers(_, tasks, workers, dask):
        for k, task in enumerate(tasks):
            assert set(task.texts) == set(LOG)
            rng = np.random.default_rng(100 + k)
            about = {"world": task.name, "dataset_sha256": seal.of_world(task.texts), "seconds": 2.0}
            said = {"gap": gap_of(truth_of(k, np.random.default_rng(k)), rng)}
            yield k, about | {"code_sha256": seal.of_code()} | (said if k != 2 else {"error": "no arm"})

    monkeypatch.setattr(maker, "results", logs)
    monkeypatch.setattr(runner, "results", answers)
    make(tmp_path / "blind", 16, 5, kind=maker.MOTIONS)
    runner.run(tmp_path / "blind")
    return tmp_path / "blind"


def test_the_truth_of_logs_is_sealed(folder):
    truths, answers, about = opened(folder)
    assert about["kind"] == maker.MOTIONS
    assert about["generator"] == 1
    assert len(truths) == len(answers) == 16
    assert {p.name for p in (folder / "worlds" / "003").iterdir()} == {*LOG, "seal.txt", LIST}
    table = folder / "worlds" / "003" / "motion.csv"
    table.write_text(table.read_text() + "0\n")
    refused("was changed since", lambda: opened(folder))


def test_a_diagnosis_sees_nothing_but_its_log(folder, monkeypatch):
    seen = {}

    def diagnose(own):
        seen.update({p.name: p.read_text() for p in own.iterdir()})
        return type("Result", (), {"record": {"verdict": "null", "rows": [1]}})

    monkeypatch.setattr(bayescal, "diagnose", diagnose)
    given = texts(folder, "001")
    assert answered(Task("001", given))["gap"] == {"verdict": "null"}
    assert seen == given


def test_a_worker_makes_a_log_of_a_seed():
    files, truth = built(Drawn(3, 1, 1, False, maker.MOTIONS))
    assert set(files) == set(LOG)
    assert "truth" not in "".join(files).lower()
    assert truth["kind"] in KINDS
    json.dumps(truth, allow_nan=False)


def test_the_score_is_that_of_another_author(tmp_path):
    if not SCORE.exists():
        pytest.skip("needs the score of another author")
    rng = np.random.default_rng(1)
    truths = {f"{k:03d}": truth_of(k, rng) for k in range(200)}
    answers = {name: {"gap": gap_of(truth, rng)} for name, truth in truths.items()}
    (tmp_path / "truth").mkdir()
    for name, truth in truths.items():
        (tmp_path / "truth" / f"{name}.json").write_text(json.dumps(truth))
        (tmp_path / "gaps" / name).mkdir(parents=True)
        (tmp_path / "gaps" / name / "gap.json").write_text(json.dumps(answers[name]["gap"]))
    wanted = runpy.run_path(str(SCORE))["score"](tmp_path / "truth", tmp_path / "gaps")
    found = motions.figures([motions.record(truth, answers[name]) for name, truth in truths.items()])

    def rate(share):
        return None if not share["count"] else round(share["hits"] / share["count"], 3)

    assert rate(found["null_named"]) == wanted["null_named"]
    assert rate(found["null_otherwise"]) == wanted["null_false_positive"]
    assert rate(found["sure"]) == wanted["named_precision"]
    assert rate(found["named_alone"]) == wanted["outside_named_alone"]
    for kind in ("single", "pair", "outside"):
        bands = [wanted[f"{kind} {band}"] for band in ("0-30", "30-100", "100-1e+09")]
        assert [rate(s) for s in found["exact"][kind]] == [band[0] for band in bands]
        if kind != "outside":
            assert [rate(s) for s in found["partly"][kind]] == [band[1] for band in bands]
    for kind in ("single", "pair"):
        assert found["closed"][kind] == pytest.approx(wanted[f"gap closed, {kind}"], abs=1e-3)
    assert found["floor"]["after"] == pytest.approx(wanted["torque rms over oracle, null"]["after"], abs=1e-3)
    assert wanted["worlds"] == found["worlds"] == 200
    assert rate(found["set_holds"]) == wanted["coverage"]


def test_the_score_is_printed_and_written(folder, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"# Logs\n\n{motions.BEGIN}\nearlier\n{motions.END}\n\nend\n")
    done = CliRunner().invoke(app, ["score", str(folder), "--page", str(page)])
    assert done.exit_code == 0, done.output
    assert "outside: named alone" in done.output
    written = json.loads((folder / "score" / "score.json").read_text())
    assert written["crashed"] == {"002": "no arm"}
    assert len(written["records"]) == 16
    wrong = [r["world"] for r in written["records"] if not r["exact"]]
    lines = (folder / "score" / "misses.csv").read_text().splitlines()[1:]
    assert [line.split(",")[0] for line in lines] == wrong
    text = page.read_text()
    assert "earlier" not in text
    assert text.startswith("# Logs")
    assert text.endswith("end\n")
    assert re.findall(r"^\| (\d{3}) \|", text, re.M) == wrong
