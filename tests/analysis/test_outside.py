"""Made-up causes, and the card of their diagnoses."""

import json

import pytest
from sessions import geared

from analysis.made_up import CAUSES, LAMBDAS, made
from analysis.outside import Task, answer, card, diagnosed, main
from bayescal.dataset import read_dataset
from bayescal.effects import EFFECTS

NAMED = {"baseline": ["geometry"], "verdict": "named", "effects": ["step"], "probability": {"step": 0.97}}
CLASS = NAMED | {
    "verdict": "class",
    "effects": [],
    "probability": {"step": 0.6},
    "class": {"members": {"step": 0.6, "other": 0.3}},
}


def truth(kind, *effects, detectability=50.0):
    return {"kind": kind, "effects": list(effects), "lambda": {"value": detectability}}


@pytest.mark.parametrize(
    ("of", "record", "held_out", "right", "partly", "false"),
    [
        (truth("single", "step"), NAMED, False, True, True, 0),
        (truth("single", "step"), NAMED, True, False, False, 1),
        (truth("pair", "step", "lobing"), NAMED, False, False, True, 0),
        (truth("single", "lobing"), NAMED, False, False, False, 1),
        (truth("outside", "unknown"), NAMED, False, False, False, 1),
        (truth("outside", "unknown"), CLASS, False, True, True, 0),
        (truth("single", "step"), CLASS, False, False, True, 0),
        (truth("null", "null"), NAMED, False, False, False, 1),
        (truth("null"), NAMED | {"verdict": "null", "effects": [], "probability": {}}, False, True, True, 0),
    ],
)  # fmt: skip
def test_an_answer_is_right_if_it_names_what_is_there(of, record, held_out, right, partly, false):
    found = answer(of, record, held_out)
    assert (found.right, found.partly, found.false) == (right, partly, false)


def test_the_card_counts_by_kind_and_detectability():
    every = [answer(truth("single", "step", detectability=x), NAMED, False) for x in (31.0, 99.0, 101.0)]
    every.append(answer(truth("single", "lobing"), NAMED, False))
    rows = [line.split() for line in list(card(every))[1:]]
    assert rows == [
        ["single", "30-100", "3", "0.67", "0.67", "1"],
        ["single", "100-inf", "1", "1.00", "1.00", "0"],
    ]


def test_a_made_up_cause_is_visible_and_in_no_list(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("analysis.outside.read_dataset", lambda folder: geared(read_dataset(folder)))
    (tmp_path / "truth").mkdir()
    number = list(CAUSES).index("sagging-flange") * len(LAMBDAS) + 1
    made(tmp_path, 3, number)
    true = json.loads((tmp_path / "truth" / f"{number:03d}.json").read_text())
    assert 0.6 * LAMBDAS[1] < true["lambda"]["value"] < 1.6 * LAMBDAS[1]
    assert "made-up" not in EFFECTS
    before = list(EFFECTS)
    session = tmp_path / f"{number:03d}"
    assert len(read_dataset(session).measurements.ids) > 300
    diagnosed(Task(session, tmp_path / "runs" / session.name / "gap.json", "bending"))
    assert list(EFFECTS) == before
    main([str(tmp_path), "--out", str(tmp_path / "runs"), "--workers", "1"])
    assert capsys.readouterr().out.splitlines()[1].split()[:4] == ["outside", "100-inf", "1", "1.00"]
    record = json.loads((tmp_path / "runs" / session.name / "gap.json").read_text())
    assert "bending" not in record["probability"]
