"""The blind check from end to end: real worlds, real diagnoses, their truth out of reach."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tiny_work import until
from typer.testing import CliRunner

pytest.importorskip("pinocchio")

from analysis.blind import seal
from analysis.blind.folder import texts
from analysis.blind.run import Task, answered, run
from bayescal.cli import app
from bayescal.errors import BayescalError

WORLDS, SEED = 2, 101
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
    import analysis.blind.__main__  # noqa: F401  (registers itself)

    done = CliRunner().invoke(app, ["blind", *map(str, words)])
    if done.exception:
        raise done.exception
    return done.output


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, str]:
    """Two worlds, and what the command said."""
    folder = tmp_path_factory.mktemp("made") / "blind"
    return folder, command("make", "--worlds", WORLDS, "--seed", SEED, "--workers", 2, "--out", folder)


@pytest.fixture(scope="module")
def ran(made, tmp_path_factory) -> tuple[Path, str, list[str]]:
    """Their answers, given while the truth was elsewhere; what the command said; what was opened."""
    top = tmp_path_factory.mktemp("ran")
    folder, log = Path(shutil.copytree(made[0], top / "blind")), top / "opened"
    truth = shutil.move(folder / "truth.json", top / "truth.json")
    (top / "sitecustomize.py").write_text(WATCH.format(blind=str(folder), log=str(log)))
    line = [sys.executable, "-m", "bayescal.cli", "blind", "run", str(folder), "--workers", "2"]
    environment = os.environ | {"PYTHONPATH": str(top)}
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
        assert answer["gap"]["baseline"] == (
            folder / f"worlds/{name}/baseline.txt"
        ).read_text().strip().split(",")
        assert answer["seconds"] > 0


def test_the_truth_is_not_opened_and_workers_open_nothing(ran):
    folder, _, log = ran
    opened = [line.split(maxsplit=1) for line in log]
    processes = {process for process, _ in opened}
    assert len(processes) == 1, "workers get texts, and no place"
    paths = {Path(path).relative_to(folder).as_posix() for _, path in opened}
    assert "worlds/001/measurements.csv" in paths, "the log sees what is opened"
    assert not any("truth" in path for path in paths)


def hears_ctrl_c():
    """A shell's background jobs, and all that they start, are deaf to it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_interrupted_and_resumed_on_dask_the_seal_is_the_same(made, ran, cluster, tmp_path):
    folder = Path(shutil.copytree(made[0], tmp_path / "blind"))
    line = [sys.executable, "-m", "bayescal.cli", "blind", "run", str(folder)]
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
    found = run(folder, dask=cluster.scheduler_address)
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


def test_a_changed_truth_is_no_score(ran, tmp_path):
    folder = Path(shutil.copytree(ran[0], tmp_path / "blind"))
    (folder / "truth.json").write_text((folder / "truth.json").read_text() + "\n")
    with pytest.raises(BayescalError, match="not the truth that was sealed"):
        command("score", folder)
    assert not (folder / "score").exists()


def test_a_crash_is_an_answer_in_one_line(made, tmp_path):
    own = texts(made[0], "000")
    broken = own | {"dataset.yaml": own["dataset.yaml"] + "surprise: 1\n"}
    answer = answered(Task("000", broken))
    assert "gap" not in answer
    assert answer["error"].startswith("dataset.yaml:")
    assert "\n" not in answer["error"]
    assert answer["dataset_sha256"] != seal.of_world(own)


def test_a_defect_is_an_answer_too(made, monkeypatch):
    def defect(*_):
        raise IndexError("off by one")

    monkeypatch.setattr("bayescal.gap.diagnose.diagnose", defect)
    assert answered(Task("000", texts(made[0], "000")))["error"] == "IndexError: off by one"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("run", "{none}"), "no blind worlds here"),
        (("score", "{none}"), "no blind worlds here"),
        (("score", "{made}"), "its answers are not sealed"),
        (("score", "{made}", "--out", "{made}"), "bayescal did not write: "),
        (("make", "--out", "{made}", "--worlds", "3"), "was started with 2 sessions"),
        (("run", "{made}", "--dask", "tcp://127.0.0.1:9"), "no Dask scheduler there"),
    ],
)
def test_refusals(made, tmp_path, words, told):
    places = {"none": tmp_path / "none", "made": made[0]}
    with pytest.raises(BayescalError, match=told) as error:
        command(*(word.format(**places) for word in words))
    assert "\n" not in str(error.value)
    assert not (made[0] / "answers").exists()


def test_help_is_quick():
    """The command line alone loads neither solver nor cluster."""
    program = (
        "import sys, analysis.blind.__main__\n"
        "print([m for m in ('numpy', 'gtsam', 'distributed', 'pinocchio') if m in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"


def test_who_hands_out_the_work_needs_none_of_it():
    program = (
        "import sys, analysis.blind.run, analysis.blind.make\n"
        "print([m for m in ('numpy', 'gtsam', 'distributed', 'pinocchio') if m in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"
