"""Seals: what was sealed is opened, anything else is refused; what was interrupted goes on."""

import json
import shutil
import sys
from pathlib import Path

import pytest
from sealed_worlds import here, made_up

from analysis.blind import seal
from analysis.blind.folder import FILES, PLAN, write
from analysis.blind.make import Drawn, make
from analysis.blind.run import run
from analysis.blind.unseal import opened
from bayescal.errors import BayescalError
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
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name != LIST
    }


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


def test_layout(answered):
    worlds = {f"worlds/{k:03d}/{name}" for k in range(WORLDS) for name in (*FILES, "seal.txt")}
    answers = {f"answers/{k:03d}.json" for k in range(WORLDS)}
    assert set(files(answered)) == worlds | answers | {"truth.json", "answers.json"}
    assert not (answered / ".making").exists()
    truth = (answered / "truth.json").read_text()
    assert {(answered / f"worlds/{k:03d}/seal.txt").read_text().strip() for k in range(WORLDS)} == {
        seal.of_text(truth)
    }
    assert json.loads(truth)["schema"] == "bayescal-blind-truth/1"
    assert len(bytes.fromhex(json.loads(truth)["salt"])) == 32


TAMPERED = {
    "truth": (lambda f: edit(f / "truth.json", '"step"', '"null"'), "not the truth that was sealed"),
    "salt": (lambda f: edit(f / "truth.json", '"salt": "', '"salt": "0'), "not the truth that was sealed"),
    "layout of the truth": (lambda f: edit(f / "truth.json", "{", "{ "), "not the truth that was sealed"),
    "no truth": (lambda f: (f / "truth.json").unlink(), "truth.json: No such file"),
    "seal of a world": (lambda f: edit(f / "worlds/001/seal.txt", "", "0"), "differs from that of world 000"),
    "no seal of a world": (lambda f: (f / "worlds/001/seal.txt").unlink(), "seal.txt: No such file"),
    "answer": (lambda f: edit(f / "answers/000.json", "named", "null"), "000.json: was changed after"),
    "a crash mended": (lambda f: edit(f / "answers/001.json", '"error"', '"gap"'), "001.json: was changed"),
    "an answer that is no answer": (
        lambda f: (f / "answers/000.json").write_text("{"),
        "000.json: invalid JSON",
    ),
    "answer missing": (lambda f: (f / "answers/002.json").unlink(), "002.json: an answer .* is missing"),
    "answer added": (
        lambda f: shutil.copy(f / "answers/002.json", f / "answers/003.json"),
        "003.json: an answer that was not sealed",
    ),
    "answers not sealed": (
        lambda f: (f / "answers.json").unlink(),
        "not sealed; run `python -m analysis.blind run",
    ),
    "no seal of `run`": (lambda f: (f / "answers.json").write_text("{}"), "answers.json: lacks 'answers'"),
    "answers to another truth": (
        lambda f: edit(f / "answers.json", '"truth_sha256": "', '"truth_sha256": "0'),
        "answers a truth of SHA-256 0",
    ),
    "dataset": (lambda f: edit(f / "worlds/001/measurements.csv", "world", "w"), "001: was changed since"),
    "model": (lambda f: edit(f / "worlds/002/baseline.txt", "world", "w"), "002: was changed since"),
    "no world": (lambda f: shutil.rmtree(f / "worlds/001"), "001/dataset.yaml: No such file"),
}


@pytest.mark.parametrize("what", TAMPERED)
def test_tampering_is_refused(answered, what):
    tamper, words = TAMPERED[what]
    tamper(answered)
    with pytest.raises(BayescalError, match=words) as told:
        opened(answered)
    assert "\n" not in str(told.value)


def test_both_hashes_of_a_changed_truth_are_told(answered):
    sealed = seal.of_text((answered / "truth.json").read_text())
    edit(answered / "truth.json", '"step"', '"null"')
    with pytest.raises(BayescalError) as told:
        opened(answered)
    assert sealed in str(told.value)
    assert seal.of_text((answered / "truth.json").read_text()) in str(told.value)


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
    with pytest.raises(BayescalError, match="001: was changed before it was answered"):
        opened(made)


def test_a_world_without_an_answer(made, tmp_path):
    shutil.move(made / "worlds/002", tmp_path / "aside")
    run(made)
    shutil.move(tmp_path / "aside", made / "worlds/002")
    with pytest.raises(BayescalError, match="002: has no answer"):
        opened(made)


def test_other_sources_are_told(answered, monkeypatch):
    monkeypatch.setattr(seal, "of_code", lambda: "other")
    assert not opened(answered)[2]["same_code"]


def test_sealed_answers_stay(answered):
    before = files(answered)
    with pytest.raises(BayescalError, match=r"sealed already; `python -m analysis.blind score`"):
        run(answered)
    assert files(answered) == before


def test_time_is_not_sealed(answered):
    edit(answered / "answers/000.json", "1.5", "2.5")
    assert opened(answered)[1]["000"]["seconds"] == 2.5


def test_what_was_interrupted_goes_on(tmp_path, made, monkeypatch):
    """Each world is answered once, and the seal is that of a run in one go."""
    again = shutil.copytree(made, tmp_path / "again")
    told = []
    done = here(monkeypatch, most=2)
    with pytest.raises(KeyboardInterrupt):
        run(again)
    with pytest.raises(BayescalError, match="not sealed"):
        opened(again)
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
    with pytest.raises(BayescalError, match=r"^tcp://there: a worker has a different version"):
        run(made, dask="tcp://there")
    assert not (made / "answers").exists()


def test_a_world_that_kills_its_workers_is_a_crash(made, monkeypatch):
    monkeypatch.setattr(
        "analysis.blind.run.results",
        lambda _, tasks, *how: ((k, Lost("killed")) for k, _ in enumerate(tasks)),
    )
    assert run(made).crashed == WORLDS
    assert opened(made)[1]["000"]["error"] == "killed"


def test_making_goes_on(tmp_path, monkeypatch):
    """The same worlds and the same truth as in one go, and none made twice."""
    monkeypatch.setattr("analysis.blind.make.secrets.token_hex", lambda count: count * "ab")
    done = here(monkeypatch, most=2)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "parts", WORLDS, SEED)
    assert not (tmp_path / "parts/truth.json").exists()
    for command in (run, opened):
        with pytest.raises(BayescalError, match=r"not all made.*`python -m analysis.blind make`"):
            command(tmp_path / "parts")
    (tmp_path / "parts/worlds/.002.1.part").mkdir()  # as a killed process leaves it
    last = here(monkeypatch)
    sealed = make(tmp_path / "parts", WORLDS, SEED)
    assert [(task.seed, task.number) for task in (*done, *last)] == [(SEED, 0), (SEED, 1), (SEED, 2)]
    assert make(tmp_path / "whole", WORLDS, SEED) == sealed
    assert files(tmp_path / "parts") == files(tmp_path / "whole")
    assert not list((tmp_path / "parts/worlds").glob(".*"))


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
    with pytest.raises(BayescalError, match="not all made"):
        run(folder)
    last = here(monkeypatch)
    assert make(folder, WORLDS, SEED) == seal.truth_seal(folder)
    assert not last
    run(folder)
    assert len(opened(folder)[0]) == WORLDS


def test_nothing_of_the_making_stays(made):
    """Not even where a maker is killed while it tidies up."""
    (made / ".making").mkdir()
    (made / ".making/001.json").write_text("{}")
    make(made, WORLDS, SEED)
    assert not (made / ".making").exists()


def test_made_once(made):
    before = files(made)
    sealed = seal.of_text((made / "truth.json").read_text())
    assert make(made, WORLDS, SEED) == make(made, WORLDS) == sealed
    for worlds, seed, words in (
        (WORLDS, 6, "another seed"),
        (4, SEED, "3 sessions"),
        (4, 6, "3 sessions and another"),
    ):
        with pytest.raises(BayescalError, match=f"started with {words}"):
            make(made, worlds, seed)
    assert files(made) == before


def test_a_drawn_seed_is_told_by_the_truth_alone(tmp_path, monkeypatch):
    here(monkeypatch)
    monkeypatch.setattr("analysis.blind.make.secrets.randbelow", lambda below: 1234567)
    make(tmp_path / "blind", 1)
    assert json.loads((tmp_path / "blind/truth.json").read_text())["seed"] == 1234567


def test_the_same_seed_has_another_seal(tmp_path, made):
    """Or it could be found by making worlds of all seeds."""
    assert make(tmp_path / "other", WORLDS, SEED) != seal.truth_seal(made)


def test_a_folder_with_something_else_is_refused(tmp_path, monkeypatch):
    done = here(monkeypatch)
    (tmp_path / "letter.txt").write_text("keep me")
    with pytest.raises(BayescalError, match=r"did not write: letter\.txt"):
        make(tmp_path, WORLDS, SEED)
    assert files(tmp_path) == {"letter.txt": b"keep me"}
    assert not done


@pytest.mark.parametrize("command", [run, opened])
def test_no_blind_folder(tmp_path, command):
    with pytest.raises(
        BayescalError, match=r"no blind worlds here; make some: python -m analysis.blind make"
    ):
        command(tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()


def test_without_pinocchio(tmp_path, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(BayescalError, match=r"needs Pinocchio; pip install 'bayescal\[blind\]'"):
        make(tmp_path / "blind", WORLDS, SEED)
    assert not (tmp_path / "blind").exists()


def test_sessions_of_one_generator_stay_so(tmp_path, monkeypatch):
    """An interrupted simulation that states no generator continues with the first; others are refused."""
    done = here(monkeypatch, most=1)
    folder = tmp_path / "blind"
    with pytest.raises(KeyboardInterrupt):
        make(folder, 2, SEED, generator=1)
    plan = json.loads((folder / PLAN).read_text())
    (folder / PLAN).write_text(json.dumps({k: plan[k] for k in ("seed", "worlds", "salt")}))
    here(monkeypatch)
    for more, words in (({"generator": 2}, "generator 1"), ({"reserved": True}, "no reserved causes")):
        with pytest.raises(BayescalError, match=f"started with {words}"):
            make(folder, 2, SEED, **more)
    sealed = make(folder, 2, SEED)
    assert [t.generator for t in done] == [1]
    assert json.loads((folder / "truth.json").read_text())["generator"] == 1
    assert make(folder, 2, SEED) == make(folder, 2, generator=1) == sealed
    with pytest.raises(BayescalError, match="started with generator 1"):
        make(folder, 2, SEED, generator=2)
    with pytest.raises(BayescalError, match="no generator 9"):
        make(tmp_path / "other", 1, generator=9)
