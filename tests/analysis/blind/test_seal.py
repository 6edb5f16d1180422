"""Seals: what was sealed is opened, anything else is refused; what was interrupted goes on."""

import json
import shutil
from pathlib import Path

import pytest
from cases import refused
from sealed_worlds import here, made_up

from analysis.blind import seal
from analysis.blind.folder import write
from analysis.blind.make import Drawn, make
from analysis.blind.run import run
from analysis.blind.unseal import opened
from bayescal.storage.folders import LIST
from bayescal.storage.workers import Lost

WORLDS, SEED = 3, 5
pytestmark = pytest.mark.usefixtures("_no_pinocchio_needed")


@pytest.fixture
def _no_pinocchio_needed(monkeypatch):
    monkeypatch.setattr("analysis.blind.make.find_spec", lambda name: name)


@pytest.fixture
def made(tmp_path, monkeypatch) -> Path:
    """Worlds that nobody answered yet."""
    here(monkeypatch)
    make(tmp_path / "blind", WORLDS, SEED)
    return tmp_path / "blind"


@pytest.fixture
def answered(made) -> Path:
    """Worlds whose answers are sealed."""
    run(made)
    return made


def files(folder: Path) -> dict[str, bytes]:
    files = (p for p in sorted(folder.rglob("*")) if p.is_file() and p.name != LIST)
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_what_was_sealed_is_opened(answered):
    truths, answers, about = opened(answered)
    assert list(truths) == list(answers) == ["000", "001", "002"]
    assert truths["002"] == made_up(Drawn(SEED, 2, 2, False))[1]
    assert answers["000"]["gap"]["verdict"] == "named"
    assert answers["000"]["seconds"] == 1.5
    assert answers["001"]["error"] == "no arm"
    assert about["seed"] == SEED
    assert about["same_code"]
    assert about["truth_sha256"] == seal.of_text((answered / "truth.json").read_text())
    assert about["answers_sha256"] == seal.of_text((answered / "answers.json").read_text())
    assert {"bayescal", "python", "gtsam"} <= set(about["software"])


TAMPERED = {
    "truth": (lambda f: edit(f / "truth.json", '"step"', '"null"'), "not the truth that was sealed"),
    "salt": (lambda f: edit(f / "truth.json", '"salt": "', '"salt": "0'), "not the truth that was sealed"),
    "no seal of a world": (lambda f: (f / "worlds/001/seal.txt").unlink(), "seal.txt: No such file"),
    "answer": (lambda f: edit(f / "answers/000.json", "named", "null"), "000.json: was changed after"),
    "answer missing": (lambda f: (f / "answers/002.json").unlink(), "002.json: an answer .* is missing"),
    "answers not sealed": (lambda f: (f / "answers.json").unlink(),
                           "not sealed; run `python -m analysis.blind run"),
    "answers to another truth": (
        lambda f: edit(f / "answers.json", '"truth_sha256": "', '"truth_sha256": "0'),
        "answers a truth of SHA-256 0"),
    "dataset": (lambda f: edit(f / "worlds/001/measurements.csv", "world", "w"), "001: was changed since"),
    "model": (lambda f: edit(f / "worlds/002/baseline.txt", "world", "w"), "002: was changed since"),
}  # fmt: skip


@pytest.mark.parametrize("what", TAMPERED)
def test_tampering_is_refused(answered, what):
    tamper, words = TAMPERED[what]
    tamper(answered)
    refused(words, lambda: opened(answered))


def test_an_answer_sealed_anew_is_another_seal(answered):
    """Whoever forges the seal too must change the hash that was printed."""
    before = opened(answered)[2]["answers_sha256"]
    path = answered / "answers/000.json"
    old = seal.of_answer(json.loads(path.read_text()))
    edit(path, "named", "null")
    edit(answered / "answers.json", old, seal.of_answer(json.loads(path.read_text())))
    assert opened(answered)[2]["answers_sha256"] != before


def test_a_world_changed_before_it_was_answered(made):
    edit(made / "worlds/001/dataset.yaml", "world", "w")
    run(made)
    refused("001: was changed before it was answered", lambda: opened(made))


def test_what_was_interrupted_goes_on(tmp_path, made, monkeypatch):
    """Each world is answered once, and the seal is that of a run in one go."""
    again = shutil.copytree(made, tmp_path / "again")
    told = []
    done = here(monkeypatch, most=2)
    with pytest.raises(KeyboardInterrupt):
        run(again)
    refused("not sealed", lambda: opened(again))
    last = here(monkeypatch)
    found = run(again, notify=lambda words, fraction: told.append((words, fraction)))
    assert [t.name for t in (*done, *last)] == ["000", "001", "002"]
    assert told == [("2 of 3", 2 / 3), ("3 of 3", 1.0)]
    assert (found.worlds, found.crashed, found.again) == (3, 1, 0)
    assert run(made).sha256 == found.sha256


@pytest.mark.parametrize("what", ["world", "sources"])
def test_answers_to_what_was_are_given_again(made, monkeypatch, what):
    here(monkeypatch, most=2)
    with pytest.raises(KeyboardInterrupt):
        run(made)
    if what == "world":
        edit(made / "worlds/001/measurements.csv", "world", "w")
    else:
        monkeypatch.setattr(seal, "of_code", lambda: "other")
    last = here(monkeypatch)
    found = run(made)
    assert [t.name for t in last] == (["001", "002"] if what == "world" else ["000", "001", "002"])
    assert found.again == len(last) - 1


def test_a_worker_with_other_sources_is_refused(made, monkeypatch):
    def results(work, tasks, workers, dask):
        yield 0, {"world": "000", "code_sha256": "other"}

    monkeypatch.setattr("analysis.blind.run.results", results)
    refused(r"^tcp://there: a worker has a different version", lambda: run(made, dask="tcp://there"))
    assert not (made / "answers").exists()


def test_a_world_that_kills_its_workers_is_a_crash(made, monkeypatch):
    monkeypatch.setattr(
        "analysis.blind.run.results",
        lambda _, tasks, *how: ((k, Lost("killed")) for k, _ in enumerate(tasks)),
    )
    assert run(made).crashed == WORLDS
    assert opened(made)[1]["000"]["error"] == "killed"


@pytest.mark.parametrize("after", ["truth.json", "seal.txt"])
def test_sealing_goes_on(tmp_path, monkeypatch, after):
    """A maker that is killed while it seals leaves worlds that are not sealed, and seals them next time."""
    here(monkeypatch)
    folder = tmp_path / "blind"

    def killed(path, content):
        write(path, content)
        if path.name == after:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("analysis.blind.make.write", killed)
        with pytest.raises(KeyboardInterrupt):
            make(folder, WORLDS, SEED)
    refused("not all made", lambda: run(folder))
    last = here(monkeypatch)
    assert make(folder, WORLDS, SEED) == seal.truth_seal(folder)
    assert not last
    run(folder)
    assert len(opened(folder)[0]) == WORLDS


def test_the_same_seed_has_another_seal(tmp_path, made):
    """Or it could be found by making worlds of all seeds."""
    assert make(tmp_path / "other", WORLDS, SEED) != seal.truth_seal(made)
