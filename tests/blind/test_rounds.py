"""A second round of a blind check: planned without the truth, probed by the simulator, compared by lambda."""

import csv
import json

import pytest

pytest.importorskip("pinocchio")

from made_up_worlds import answer, silent, truth

from analysis.blind import compared, further, rounds, seal
from analysis.blind.folder import SEALED, TRUTH, answer_path, record, texts, write
from analysis.blind.further import ERROR, Open, planned, probed
from analysis.blind.make import make
from analysis.blind.rounds import ARMS, ROUND, is_open, second_round
from bayescal.errors import BayescalError

SEED = 101
PAIR = {
    "a": [{"model": "bending at link 3", "values": []}],
    "b": [{"model": "coupling", "values": []}],
    "common": [],
}
GAP = {
    "schema": "bayescal-gap/1",
    "verdict": "ambiguous",
    "baseline": ["geometry", "compliance"],
    "without": [],
    "named": [],
    "probability": {"bending": 0.5, "coupling": 0.4},
    "undecided": [PAIR],
}


def sealed(folder, answers) -> None:
    for name, own in answers.items():
        write(answer_path(folder, name), own)
    sums = {name: seal.of_answer(own) for name, own in answers.items()}
    write(folder / SEALED, {"truth_sha256": seal.truth_seal(folder), "answers": sums})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A session whose answer, which is made up, leaves something open, and one whose answer does not."""
    out = tmp_path_factory.mktemp("rounds") / "blind"
    make(out, 2, SEED, generator=1)
    about = {"seconds": 1.0}
    sealed(
        out, {"000": about | {"gap": GAP}, "001": about | {"gap": GAP | {"verdict": "null", "undecided": []}}}
    )
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
    monkeypatch.setattr(further, "POOL", 250)
    second_round(folder)
    assert asked == list(ARMS)
    assert TRUTH in opened
    new = {}
    for arm in ARMS:
        assert [p.name for p in (folder / ROUND / arm / "worlds").iterdir()] == ["000"]
        before, after = texts(folder, "000"), texts(folder / ROUND / arm, "000")
        assert after["measurements.csv"].startswith(before.pop("measurements.csv"))
        assert after.items() >= before.items()
        every = rows(folder / ROUND / arm / "worlds/000/measurements.csv")
        new[arm] = every[-60:]
        assert {r["role"] for r in new[arm]} == {"calibrate"}
        assert seal.truth_seal(folder / ROUND / arm) == seal.truth_seal(folder)
    load = {arm: sum(float(r["payload_kg"]) > 0 for r in own) for arm, own in new.items()}
    assert load["random"] == 0 < load["chosen"]
    assert record(folder / ROUND / "left_out.json") == {}


def test_sessions_of_another_simulator_are_refused(folder) -> None:
    task = rounds.Continued(
        "000", {"seed": SEED + 1, "generator": 1}, {}, texts(folder, "000")["measurements.csv"]
    )
    with pytest.raises(BayescalError, match="makes another session now"):
        probed(task)


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
        write(
            tmp_path / ROUND / arm / SEALED, {"answers": {n: seal.of_answer(one) for n, one in own.items()}}
        )
    found = {row["group"]: row["right"] for row in compared.compared(tmp_path, truths, first)}
    weak = found["one effect, lambda 10 to 30"]
    assert [(s["hits"], s["count"]) for s in weak.values()] == [(0, 1), (1, 1), (0, 1)]
    clear = found["ambiguous at first, lambda from 30"]
    assert [(s["hits"], s["count"]) for s in clear.values()] == [(0, 1), (1, 1), (0, 1)]
    assert "1 of 1" in compared.page(compared.compared(tmp_path, truths, first))
    path = answer_path(tmp_path / ROUND / "chosen", "000")
    path.write_text(json.dumps(first["000"]))
    with pytest.raises(BayescalError, match="was changed after"):
        compared.compared(tmp_path, truths, first)
