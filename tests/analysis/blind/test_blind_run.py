"""The blind check from end to end: real worlds, real diagnoses, their truth out of reach."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from cases import ROOT, refused
from made_up_worlds import answer, silent, truth
from tiny_work import until
from typer.testing import CliRunner

from analysis.blind import compared, further, rounds, seal
from analysis.blind.__main__ import app
from analysis.blind.folder import SEALED, TRUTH, answer_path, record, texts, write
from analysis.blind.further import ERROR, Open, planned, probed
from analysis.blind.make import make
from analysis.blind.rounds import ARMS, ROUND, is_open, second_round
from analysis.blind.run import Task, answered, run

WORLDS, SEED = 2, 2444
"""Both sessions are of points of a tracker, with some 155 rows, of which few are kept."""
WATCH = """
import os, sys
def told(event, args):
    if event == "open" and isinstance(args[0], str) and args[1] is not None:
        path = os.path.abspath(args[0])
        if path.startswith({blind!r}):
            with os.fdopen(os.open({log!r}, os.O_APPEND | os.O_CREAT | os.O_WRONLY), "w") as log:
                log.write(f"{{os.getpid()}} {{path}}\\n")
sys.addaudithook(told)
"""
"""A start of Python that logs whatever is opened in the blind folder, in every process."""


def command(*words: object) -> str:
    done = CliRunner().invoke(app, [*map(str, words)])
    if done.exception:
        raise done.exception
    return done.output


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, str]:
    """Two worlds, and what the command said."""
    folder = tmp_path_factory.mktemp("made") / "blind"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("analysis.blind.make.results", few)
        return folder, command("make", "--worlds", WORLDS, "--seed", SEED, "--out", folder)


def few(work, tasks, workers, dask):
    """Sessions of a part of the rows and columns, simulated one by one."""
    for k, every in enumerate((3, 2)):
        files, true = work(next(tasks))
        head, *rows = csv.reader(files["measurements.csv"].splitlines())
        kept = [n for n, key in enumerate(head) if not re.match("time_s|temp|j._degps|repeat", key)]
        lines = [",".join(row[n] for n in kept) for row in (head, *rows[::every])]
        yield k, (files | {"measurements.csv": "\n".join(lines) + "\n"}, true)


@pytest.fixture(scope="module")
def ran(made, tmp_path_factory) -> tuple[Path, str, list[str]]:
    """Their answers, given while the truth was elsewhere; what the command said; what was opened."""
    top = tmp_path_factory.mktemp("ran")
    folder, log = Path(shutil.copytree(made[0], top / "blind")), top / "opened"
    truth = shutil.move(folder / "truth.json", top / "truth.json")
    (top / "sitecustomize.py").write_text(WATCH.format(blind=str(folder), log=str(log)))
    line = [sys.executable, "-m", "analysis.blind", "run", str(folder)]
    environment = os.environ | {"PYTHONPATH": f"{top}{os.pathsep}{ROOT}"}
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=True)
    shutil.move(truth, folder / "truth.json")
    return folder, done.stdout, log.read_text().splitlines()


def test_worlds_are_made_and_their_seal_is_told(made):
    folder, said = made
    assert seal.of_text((folder / "truth.json").read_text()) in said
    truth = json.loads((folder / "truth.json").read_text())
    assert list(truth["worlds"]) == ["000", "001"]
    assert {"effects", "where", "lambda"} <= set(truth["worlds"]["001"])
    assert "truth.json" not in " ".join(p.name for p in (folder / "worlds").rglob("*"))


def test_answers_are_given_and_their_seal_is_told(ran):
    folder, said, _ = ran
    assert seal.of_text((folder / "answers.json").read_text()) in said
    for name in ("000", "001"):
        answer = json.loads((folder / f"answers/{name}.json").read_text())
        assert answer["gap"]["verdict"]
        assert not {"curves", "residuals"} & set(answer["gap"])
        stated = (folder / f"worlds/{name}/baseline.txt").read_text()
        assert answer["gap"]["baseline"] == stated.strip().split(",")
        assert answer["seconds"] > 0


def test_the_truth_is_not_opened_and_workers_open_nothing(ran):
    folder, _, log = ran
    opened = [line.split(maxsplit=1) for line in log]
    assert len({process for process, _ in opened}) == 1, "workers get texts, and no place"
    paths = {Path(path).relative_to(folder).as_posix() for _, path in opened}
    assert "worlds/001/measurements.csv" in paths, "the log sees what is opened"
    assert not any("truth" in path for path in paths)


def hears_ctrl_c():
    """A shell's background jobs, and all that they start, are deaf to it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_interrupted_and_resumed_on_dask_the_seal_is_the_same(made, ran, thread_of_dask, tmp_path):
    folder = Path(shutil.copytree(made[0], tmp_path / "blind"))
    line = [sys.executable, "-m", "analysis.blind", "run", str(folder)]
    process = subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=hears_ctrl_c
    )
    until(lambda: any((folder / "answers").glob("0*.json")), 300)
    process.send_signal(signal.SIGINT)
    out, said = process.communicate(timeout=300)
    assert process.returncode == 130
    assert not out
    assert "completed sessions are kept; the same command continues" in said
    assert "Traceback" not in said
    first = sorted((folder / "answers").glob("*"))
    assert len(first) == 1
    before = first[0].stat().st_mtime_ns
    found = run(folder, dask=thread_of_dask.scheduler_address)
    assert found.sha256 == seal.of_text((ran[0] / "answers.json").read_text())
    assert first[0].stat().st_mtime_ns == before


def test_the_score_is_of_what_was_sealed(ran, tmp_path):
    folder, _, _ = ran
    said = command("score", folder, "--out", tmp_path / "score", "--no-pictures", "--note", "frozen at noon")
    about = json.loads((tmp_path / "score/score.json").read_text())["about"]
    assert about["note"] == "frozen at noon"
    assert about["answers_sha256"] in said
    assert about["truth_sha256"] in said
    assert not (folder / "score").exists()


def test_a_crash_is_an_answer_in_one_line(made, tmp_path):
    own = texts(made[0], "000")
    answer = answered(Task("000", own | {"dataset.yaml": own["dataset.yaml"] + "surprise: 1\n"}))
    assert "gap" not in answer
    assert answer["error"].startswith("dataset.yaml:")
    assert "\n" not in answer["error"]
    assert answer["dataset_sha256"] != seal.of_world(own)


def test_a_defect_is_an_answer_too(made, monkeypatch):
    def defect(*_):
        raise IndexError("off by one")

    monkeypatch.setattr("bayescal.gap.diagnose.diagnose", defect)
    assert answered(Task("000", texts(made[0], "000")))["error"] == "IndexError: off by one"


@pytest.mark.parametrize(("words", "told"), [
    (("score", "{made}"), "its answers are not sealed"),
    (("score", "{made}", "--out", "{made}"), "bayescal did not write: "),
    (("make", "--out", "{made}", "--worlds", "3"), "was started with 2 sessions"),
    (("run", "{made}", "--dask", "tcp://127.0.0.1:9"), "no Dask scheduler there"),
])  # fmt: skip
def test_refusals(made, words, told):
    refused(told, lambda: command(*(word.format(made=made[0]) for word in words)))
    assert not (made[0] / "answers").exists()


def test_who_hands_out_the_work_needs_none_of_it():
    """Nor does the command line: neither solver nor cluster is loaded, and help is quick."""
    program = (
        "import sys, analysis.blind.__main__, analysis.blind.run, analysis.blind.make\n"
        "print([m for m in ('numpy', 'gtsam', 'distributed', 'pinocchio') if m in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"


# --- A second round of a blind check: planned without the truth, probed by the simulator, compared by lambda.

ROUNDS_SEED = 101
MODELS = {"a": "bending at link 3", "b": "coupling"}
PAIR = {"common": []} | {key: [{"model": model, "values": []}] for key, model in MODELS.items()}
GAP = {"schema": "bayescal-gap/1", "verdict": "ambiguous", "baseline": ["geometry", "compliance"]}
GAP |= {"named": [], "probability": {"bending": 0.5, "coupling": 0.4}, "noise_scale": {"contact": 1.0}}
GAP |= {"without": [], "undecided": [PAIR]}


def sealed(folder, answers) -> None:
    for name, own in answers.items():
        write(answer_path(folder, name), own)
    sums = {name: seal.of_answer(own) for name, own in answers.items()}
    write(folder / SEALED, {"truth_sha256": seal.truth_seal(folder), "answers": sums})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A session whose answer, which is made up, leaves something open, and one whose answer does not."""
    out = tmp_path_factory.mktemp("rounds") / "blind"
    make(out, 2, ROUNDS_SEED, generator=1)
    about = {"seconds": 1.0}
    null = GAP | {"verdict": "null", "undecided": []}
    sealed(out, {"000": about | {"gap": GAP}, "001": about | {"gap": null}})
    return out


def rows(path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_open_answers() -> None:
    assert is_open({"verdict": "named", "undecided": [PAIR]})
    assert is_open({"verdict": "unknown", "undecided": []})
    assert not is_open({"verdict": "named", "undecided": []})


def test_a_round_appends_measured_rows_and_nothing_else(folder, monkeypatch) -> None:
    opened, asked = [], []
    read = rounds.read

    def watched(path):
        opened.append(path.name)
        return read(path)

    def one_by_one(work, tasks, workers, dask):
        for k, task in enumerate(tasks):
            if work is planned:
                assert TRUTH not in opened, "the plan is made before the truth is opened"
                assert set(vars(task)) == {"name", "texts", "gap"}
            yield k, work(task)

    def run(own, workers, dask, notify):
        asked.append(own.name)
        return rounds.Answered("sum", 1, 0, 0)

    monkeypatch.setattr(rounds, "read", watched)
    monkeypatch.setattr(rounds, "results", one_by_one)
    monkeypatch.setattr(rounds, "run", run)
    monkeypatch.setattr(further, "POOL", 130)
    second_round(folder)
    assert asked == list(ARMS)
    assert TRUTH in opened
    new = {}
    for arm in ARMS:
        assert [p.name for p in (folder / ROUND / arm / "worlds").iterdir()] == ["000"]
        before, after = texts(folder, "000"), texts(folder / ROUND / arm, "000")
        assert after["measurements.csv"].startswith(before.pop("measurements.csv"))
        assert after.items() >= before.items()
        new[arm] = rows(folder / ROUND / arm / "worlds/000/measurements.csv")[-60:]
        assert {r["role"] for r in new[arm]} == {"calibrate"}
        assert seal.truth_seal(folder / ROUND / arm) == seal.truth_seal(folder)
    load = {arm: sum(float(r["payload_kg"]) > 0 for r in own) for arm, own in new.items()}
    assert load["random"] == 0 < load["chosen"]
    assert record(folder / ROUND / "left_out.json") == {}


def test_sessions_of_another_simulator_are_refused(folder) -> None:
    table = texts(folder, "000")["measurements.csv"]
    task = rounds.Continued("000", {"seed": ROUNDS_SEED + 1, "generator": 1}, {}, table)
    refused("makes another session now", lambda: probed(task))


def test_what_cannot_be_planned_is_left_out(folder, monkeypatch) -> None:
    monkeypatch.setattr(further, "POOL", 50)
    pair = PAIR | {"a": [{"model": "backlash at joint 9", "values": []}]}
    found = planned(Open("000", texts(folder, "000"), GAP | {"undecided": [pair]}))
    assert "joint 9" in found[ERROR]


def test_rounds_are_compared_by_the_lambda_of_the_first(tmp_path) -> None:
    truths = {name: truth() | {"world": name} for name in ("000", "001")}
    for name, size in (("000", 15.0), ("001", 80.0)):
        effect = truths[name]["effects"][0]
        truths[name] |= {"lambda": {"value": size, "each": {effect: size}}}
    first = {name: silent("ambiguous") | {"world": name} for name in truths}
    right = {name: answer() | {"world": name} for name in truths}
    for arm, own in (("chosen", right), ("random", {"001": first["001"]})):
        for name, one in own.items():
            write(answer_path(tmp_path / ROUND / arm, name), one)
        write(tmp_path / ROUND / arm / SEALED, {"answers": {n: seal.of_answer(a) for n, a in own.items()}})
    found = {row["group"]: row["right"] for row in compared.compared(tmp_path, truths, first)}
    weak = found["one effect, lambda 10 to 30"]
    assert [(s["hits"], s["count"]) for s in weak.values()] == [(0, 1), (1, 1), (0, 1)]
    clear = found["ambiguous at first, lambda from 30"]
    assert [(s["hits"], s["count"]) for s in clear.values()] == [(0, 1), (1, 1), (0, 1)]
    assert "1 of 1" in compared.page(compared.compared(tmp_path, truths, first))
    answer_path(tmp_path / ROUND / "chosen", "000").write_text(json.dumps(first["000"]))
    refused("was changed after", lambda: compared.compared(tmp_path, truths, first))
