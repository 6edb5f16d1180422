"""Pairs of sessions in the blind check: what is made, what an answer holds, and its score by hand."""

import numpy as np
import pytest
from cases import refused

import bayescal.changes
import bayescal.reporting.changed
from analysis.blind import changes
from analysis.blind.folder import DATASET, PAIR
from analysis.blind.make import CHANGES, Drawn, built, make
from analysis.blind.run import Task, answered
from analysis.world.changes import KINDS, _left


def truth(number, *made):
    least = min((c["lambda"] for c in made), default=0.0)
    about = {"world": f"{number:03d}", "kind": made[0]["name"] if made else "null", "stage": "cube"}
    return about | {"lambda": least, "changes": list(made), "nuisance": {}}


def change(name, site, size, unit="rad", value=(1e-4,)):
    return {"name": name, "site": site, "lambda": size, "unit": unit, "value": list(value)}


def item(name, effect, site, group=(), difference=0.0, u=1.0, stated=True):
    return {"item": name, "effect": effect, "site": site, "class": list(group), "stated": stated,
            "difference": difference, "u": u}  # fmt: skip


def answer(verdict, *items):
    return {"gap": {"verdict": verdict, "items": list(items), "probability": {"same": 0.5}}, "seconds": 3.0}


ZERO = change("zero", "joint 3", 90.0)
CASES = [
    (truth(0), answer("same", item("theta3", "geometry", "joint 3", stated=False))),
    (truth(1), answer("changed", item("base", "placement", "base"))),
    (truth(2, ZERO), answer("changed", item("theta3", "geometry", "joint 3", (), np.degrees(1e-4), 1e-3))),
    (truth(3, ZERO), answer("changed", item("theta3", "geometry", "joint 3", ("theta3", "a3")),
                            item("a3", "geometry", "link 3", ("theta3", "a3")))),
    (truth(4, change("backlash", "joint 2", 40.0)), answer("changed", item("d2", "geometry", "joint 2"))),
    (truth(5, change("tool", "tool", 20.0, "m", (1e-4, 0, 0))),
     answer("changed", *(item("tool", "tool", "tool", (), x, 0.01) for x in (0.1, 0.0, 0.05)))),
    (truth(6, change("base", "base", 60.0, "m", (1, 2, 3, 4, 5, 6))), {"error": "no fit"}),
]  # fmt: skip


def test_the_score_by_hand():
    records = [changes.record(t, a) for t, a in CASES]
    found = changes.figures(records)
    hits = {k: (v["hits"], v["count"]) for k, v in found.items() if isinstance(v, dict) and "hits" in v}
    assert hits == {
        "false": (1, 2), "null_ambiguous": (0, 2), "named": (2, 3), "alone": (1, 3), "extra": (1, 4),
        "within": (3, 4),
    }  # fmt: skip
    assert records[4]["extra"] == ["d2"]
    assert records[3]["extra"] == []
    assert found["crashed"] == {"006": "no fit"}
    assert [m["world"] for m in found["misses"]] == ["001", "004", "006"]
    met = {row.label: row.met for row in changes.rows(found)}
    assert met["nothing changed: called changed"] is False
    assert met["right item named, alone or in a class, lambda from 30"] is False


def test_the_page_holds_the_score(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"# Changes\n\n{changes.BEGIN}\nearlier\n{changes.END}\n\nend\n")
    truths = {t["world"]: t for t, _ in CASES}
    changes.CARD.scored(truths, {t["world"]: a for t, a in CASES}, {"seed": 7}, tmp_path / "score", page)
    text = page.read_text()
    assert "earlier" not in text
    assert "| 004 | backlash joint 2 | 40 | changed | d2 |" in text


def test_a_pair_has_two_datasets_and_a_change_of_the_drawn_size(monkeypatch):
    texts, true = built(Drawn(3, 0, 1, False, CHANGES))
    assert list(texts) == [f"{part}/{file}" for part in PAIR for file in DATASET]
    assert true["kind"] in KINDS
    for made in true["changes"]:
        assert 9.0 < made["lambda"] < 1100.0
    seen = {}

    def compared(sessions, effects):
        seen["rows"] = [len(s.measurements.ids) for s in sessions]
        return "found"

    monkeypatch.setattr(bayescal.changes, "changed", compared)
    monkeypatch.setattr("bayescal.reporting.changed.changed_record", lambda of: {"verdict": of, "rows": [1]})
    assert answered(Task("000", texts))["gap"] == {"verdict": "found"}
    assert min(seen["rows"]) > 150


def test_what_columns_leave_of_a_shift():
    rng = np.random.default_rng(0)
    matrix, shift = rng.standard_normal((20, 3)), rng.standard_normal(20)
    rest = shift - matrix @ np.linalg.lstsq(matrix, shift, rcond=None)[0]
    assert _left(matrix, shift) == pytest.approx(rest @ rest)
    assert _left(matrix, matrix @ np.ones(3)) == pytest.approx(0.0, abs=1e-18)


def test_pairs_have_no_reserved_causes(tmp_path):
    refused("no reserved causes", lambda: make(tmp_path / "blind", 1, kind=CHANGES, reserved=True))
