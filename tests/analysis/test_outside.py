"""Made-up causes, and the card of their diagnoses."""

import json

import pytest

from analysis.outside import Task, answer, card, diagnosed, tasks, truths
from bayescal.motion.effects import EFFECTS as OF_MOTIONS

NAMED = {"baseline": ["geometry"], "verdict": "named", "effects": ["step"], "probability": {"step": 0.97}}
CLASS = NAMED | {"verdict": "class", "effects": [], "probability": {"step": 0.6}}
CLASS |= {"class": {"members": {"step": 0.6, "other": 0.3}}}


def truth(kind, *effects, detectability=50.0):
    return {"kind": kind, "effects": list(effects), "lambda": {"value": detectability}}


@pytest.mark.parametrize(("of", "record", "held_out", "right", "partly", "false"), [
    (truth("single", "step"), NAMED, False, True, True, 0),
    (truth("single", "step"), NAMED, True, False, False, 1),
    (truth("pair", "step", "lobing"), NAMED, False, False, True, 0),
    (truth("single", "lobing"), NAMED, False, False, False, 1),
    (truth("outside", "unknown"), NAMED, False, False, False, 1),
    (truth("outside", "unknown"), CLASS, False, True, True, 0),
    (truth("single", "step"), CLASS, False, False, True, 0),
    (truth("null", "null"), NAMED, False, False, False, 1),
    (truth("null"), NAMED | {"verdict": "null", "effects": [], "probability": {}}, False, True, True, 0),
])  # fmt: skip
def test_an_answer_is_right_if_it_names_what_is_there(of, record, held_out, right, partly, false):
    found = answer(of, record, held_out)
    assert (found.right, found.partly, found.false) == (right, partly, false)


def test_an_error_of_what_the_baseline_of_a_log_has_is_a_name():
    log = NAMED | {"baseline": ["armature"], "effects": ["armature"], "probability": {"armature": 0.97}}
    assert answer(truth("single", "armature"), log, False).right
    assert answer(truth("single", "ripple"), log, False).false == 1


def test_the_list_of_logs_lacks_the_effect_too(tmp_path, monkeypatch):
    monkeypatch.setattr("analysis.outside.is_log", lambda folder: True)
    monkeypatch.setattr("analysis.outside.recorded", lambda folder: {"listed": list(OF_MOTIONS)})
    before, out = list(OF_MOTIONS), tmp_path / "gap.json"
    diagnosed(Task(tmp_path, out, "ripple"))
    assert list(OF_MOTIONS) == before
    assert json.loads(out.read_text())["listed"] == [name for name in before if name != "ripple"]


@pytest.mark.parametrize("blind", [False, True])
def test_sessions_of_one_effect_are_held_out(tmp_path, blind):
    """Of both layouts; not of effects that fits have in any case."""
    every = {f"{k:03d}": truth("single", name) for k, name in enumerate(("lobing", "plane-form", "step"))}
    every["003"] = truth("pair", "lobing", "step")
    if blind:
        (tmp_path / "truth.json").write_text(json.dumps({"worlds": every}))
    else:
        (tmp_path / "truth").mkdir()
        for number, of in every.items():
            (tmp_path / "truth" / f"{number}.json").write_text(json.dumps(of))
    at = tmp_path / "worlds" if blind else tmp_path
    found = truths(tmp_path)
    assert found == {at / number: of for number, of in every.items()}
    held_out = [(t.folder, t.without) for t in tasks(found, tmp_path, True)]
    assert held_out == [(at / "000", "lobing"), (at / "002", "step")]
    assert [t.without for t in tasks(found, tmp_path, False)] == [""] * 4


@pytest.mark.parametrize(("site", "located"), [
    ("joint 1", True),
    ("joint 10", False),
    ("cube.+x", True),
    ("cube", True),
    ("cubes", False),
    ("", False),
])  # fmt: skip
def test_the_first_location_is_one_of_the_truth(site, located):
    of = truth("single", "step") | {"where": [{"site": "joint 1"}, {"site": "face", "also": ["cube."]}]}
    record = NAMED | {"where": [{"site": site}, {"site": "joint 1"}] if site else []}
    assert answer(of, record, False).located is located
    assert answer(truth("null"), record, False).located is None


def test_the_card_counts_by_kind_and_detectability():
    every = [answer(truth("single", "step", detectability=x), NAMED, False) for x in (31.0, 99.0, 101.0)]
    every.append(answer(truth("single", "lobing"), NAMED, False))
    rows = [line.split() for line in list(card(every))[1:]]
    assert [" ".join(row) for row in rows] == [
        "single 30-100 3 0.67 0.67 - 1",
        "single 100-inf 1 1.00 1.00 - 0",
    ]
