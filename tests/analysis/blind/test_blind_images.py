"""Sessions of a camera in the blind check: what an answer holds, and its score by hand."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from cases import refused

import bayescal.gap.diagnose
import bayescal.reporting.gap.record
from analysis.blind import images
from analysis.blind.folder import DATASET
from analysis.blind.make import IMAGES, Drawn, built, make
from analysis.blind.run import Task, answered
from bayescal.estimate import estimate
from bayescal.model import Scene, build


def truth(number, side, effects, size):
    place = [0.0, 0.0, 0.0, 0.01, 0.02, 0.03]
    return {"world": f"{number:03d}", "side": side, "effects": effects, "lambda": size, "on_flange": place,
            "arm": {"a2": 0.3, "theta3": 0.002}}  # fmt: skip


def answer(verdict, named=(), sites=(), off=0.0, arm=0.0, solver=1e-3):
    gap = {"verdict": verdict, "named": [{"effect": e, "model": e} for e in named], "class": None,
           "where": [{"site": s} for s in sites]}  # fmt: skip
    estimates = {f"on-flange {a}": [x + off, 1e-4] for a, x in zip("xyz", (0.01, 0.02, 0.03), strict=True)}
    estimates |= {"a2": [0.3 + arm, 1e-5], "theta3": [0.002, 1e-4], "a9": [1.0, 1.0]}
    solvers = {"tsai": [0.01 + solver, 0.02, 0.03], "park": [0.01, 0.02, 0.03 + 2 * solver]}
    return {"gap": gap, "estimates": estimates, "solvers": solvers, "seconds": 4.0}


CASES = [
    (truth(0, "null", [], 0.0), answer("null")),
    (truth(1, "arm", ["backlash"], 90.0), answer("named", ["backlash"], off=4e-4, arm=3e-5)),
    (truth(2, "arm", ["gravity"], 40.0), answer("unknown", sites=["joint 2", "camera"])),
    (truth(3, "mount", ["step"], 200.0), answer("named", ["board-scale"], sites=["tool"], off=1e-2)),
    (truth(4, "board", ["board-bow"], 20.0), answer("named+unexplained", ["board-bow"], sites=["board"])),
    (truth(5, "clock", ["latency"], 300.0), {"error": "no arm"}),
]


def test_the_score_by_hand():
    found = images.figures([images.record(t, a) for t, a in CASES])
    hits = {k: (v["hits"], v["count"]) for k, v in found.items() if isinstance(v, dict) and "hits" in v}
    assert hits == {
        "side": (2, 4), "complete": (1, 4), "null_otherwise": (0, 1), "hand_within": (9, 12),
        "arm_within": (7, 8), "better": (4, 5), "half": (1, 2),
    }  # fmt: skip
    assert found["of_side"]["mount"]["hits"] == 0
    assert found["crashed"] == {"005": "no arm"}
    assert [m["world"] for m in found["misses"]] == ["003", "005"]
    assert found["ratio"] == pytest.approx(0.0)
    met = {row.label: row.met for row in images.rows(found)}
    assert met["right side, lambda from 30"] is False
    assert met["noise only: called otherwise"] is True


def test_the_sides_of_a_class_without_a_name_are_those_of_its_sites():
    record = answer("class")["gap"] | {"class": {"site": "tool and joint 2", "members": {"backlash": 0.3}}}
    assert images.sides(record) == ["arm", "mount"]


def test_the_page_holds_the_score(tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text(f"# Images\n\n{images.BEGIN}\nearlier\n{images.END}\n\nend\n")
    truths = {t["world"]: t for t, _ in CASES}
    images.CARD.scored(truths, {t["world"]: a for t, a in CASES}, {"seed": 7}, tmp_path / "score", page)
    text = page.read_text()
    assert "earlier" not in text
    assert "seed 7: 1 null, 2 arm, 1 board, 1 mount, 1 clock" in text
    assert "| 003 | mount+step | 200 | named | board-scale | board |" in text
    assert "right side" in capsys.readouterr().out
    assert (tmp_path / "score" / "misses.csv").read_text().startswith("world,truth,lambda")


def test_reserved_causes_are_refused(tmp_path):
    refused("no reserved causes", lambda: make(tmp_path / "blind", 1, 5, kind=IMAGES, reserved=True))
    refused("there is no kind pictures", lambda: make(tmp_path / "blind", 1, 5, kind="pictures"))


def test_an_answer_holds_estimates_and_solvers(monkeypatch):
    files, true = built(Drawn(5, 2, 1, False, IMAGES))
    assert set(files) == set(DATASET)
    json.dumps(true, allow_nan=False)

    def quick(dataset):
        found = estimate(build(Scene(dataset), ("geometry", "compliance")))
        return SimpleNamespace(arm=found, calibrated=None, covariance=None)

    monkeypatch.setattr(bayescal.gap.diagnose, "diagnose", quick)
    said = {"verdict": "null", "named": [], "curves": 1}
    monkeypatch.setattr(bayescal.reporting.gap.record, "gap_record", lambda _: said)
    head, *lines = files["measurements.csv"].splitlines()
    given = answered(Task("002", files | {"measurements.csv": "\n".join([head, *lines[::4]]) + "\n"}))
    assert "error" not in given
    assert given["gap"] == {"verdict": "null", "named": []}
    scored = images.record(true, given)
    assert scored["side_right"]
    assert scored["hand_mm"] < scored["best_mm"]
    assert len(scored["arm_off"]) == len(true["arm"])
    assert np.max(np.abs([*scored["hand_off"], *scored["arm_off"]])) < 4
