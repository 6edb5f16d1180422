"""The gap study in small: worlds are diagnosed and scored, and a wrong answer would be seen as one."""

import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("pinocchio")
sys.path.insert(0, str(Path(__file__).parents[2]))

from analysis import gap_score, gap_study

WORLDS = 4


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Four worlds through the command, and the page that it writes."""
    runs = tmp_path_factory.mktemp("runs")
    page = runs / "page.md"
    page.write_text(f"before\n{gap_study.BEGIN}\nold\n{gap_study.END}\nafter\n", encoding="utf-8")
    options = ["--worlds", str(WORLDS), "--seed", "101", "--own", "0", "--workers", "2"]
    gap_study.main([*options, "--runs", str(runs), "--out", str(page)])
    return runs


@pytest.fixture(scope="module")
def records(run):
    return json.loads((run / "records.json").read_text())["worlds"]


def test_every_world_is_scored(run, records):
    assert [r["world"] for r in records] == ["000", "001", "002", "003"]
    assert all(r["named"] == [] for r in records if r["kind"] == "null")
    for r in records:
        assert r["kind"] in ("null", "single", "pair", "outside")
        assert {"null", "unknown"} < set(r["probability"])
        assert r["distance_um"]["after"] < 100
    found = json.loads((run / "gap_study.json").read_text())["worlds"]
    assert found["worlds"] == WORLDS
    assert sum(b["count"] for b in found["reliability"]) > 0
    assert len(found["misses"]) == sum(not gap_score.right(r) for r in records)


def test_page_keeps_what_is_around(run):
    text = (run / "page.md").read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "\nold\n" not in text
    for words in ("null worlds that carry a name", "by lambda", "stated probability", "recall"):
        assert words in text


def world(kind, effects, verdict, named, strength=200.0, **more):
    """A record of a world, made up."""
    return {
        "world": "000", "kind": kind, "effects": effects, "outside": None, "lambda": strength,
        "each": dict.fromkeys(effects, strength), "true_places": ["joint 4, angle 4"], "verdict": verdict,
        "named": named, "probability": {"null": 0.0, "unknown": 0.0} | dict.fromkeys(named, 0.95),
        "set": named, "places": ["joint 4, angle 4"], "at_right_site": True, "named_at_right_site": {},
        "distance_um": {"before": 30.0, "after": 11.0, "floor": 10.0}, "plane_um": None, "seconds": 1.0,
    } | more  # fmt: skip


def test_a_wrong_answer_is_one():
    right = [
        world("null", [], "null", [], 0.0),
        world("single", ["step"], "named", ["step"]),
        world("pair", ["step", "lobing"], "named", ["lobing", "step"]),
        world("outside", ["unknown"], "unknown", []),
        world("outside", ["unknown"], "named+unexplained", ["step"]),
    ]
    wrong = [
        world("null", [], "named", ["step"], 0.0),
        world("null", [], "unknown", [], 0.0),
        world("single", ["step"], "named", ["lobing"]),
        world("single", ["step"], "named+unexplained", ["step"]),
        world("single", ["step"], "null", []),
        world("pair", ["step", "lobing"], "named", ["lobing"]),
        world("outside", ["unknown"], "named", ["step"]),
    ]
    assert all(map(gap_score.right, right))
    assert not any(map(gap_score.right, wrong))
    found = gap_score.figures([*right, *wrong])
    assert found["null"]["named"] == {"count": 3, "hits": 1}
    assert found["single"][-1]["right"] == {"count": 4, "hits": 1}
    assert found["single"][-1]["wrong_name"] == {"count": 4, "hits": 1}
    assert found["pairs"]["all"]["recall"] == {"count": 4, "hits": 3}
    assert found["pairs"]["all"]["precision"] == {"count": 3, "hits": 3}
    assert found["outside"]["flagged"] == {"count": 3, "hits": 2}
    assert found["sure"]["right"] == {"count": 6, "hits": 2}
    assert len(found["misses"]) == len(wrong)
    assert gap_score.table(found)


def test_shrinkage_is_of_the_excess():
    one = world("single", ["step"], "named", ["step"])
    worse = world(
        "single", ["step"], "named", ["lobing"], distance_um={"before": 20.0, "after": 30.0, "floor": 10.0}
    )
    found = gap_score.figures([one, worse])
    assert gap_score.figures([one])["distances"]["closed"] == pytest.approx((900 - 121) / 800)
    assert found["distances"]["closed"] == pytest.approx((900 - 121 + 400 - 900) / (800 + 300))
    assert found["worse"] == {"000": [20.0, 30.0]}
    assert found["distances"]["ratio_right"] == pytest.approx(1.1)


def test_nothing_hidden_is_found_where_nothing_is():
    """A session of our own with another noise than it states, and other masses than the robot file."""
    seed = 1010000
    case = "masses +-15 %, 2 kg on half the contacts"
    dataset = gap_study.simulate(gap_study.Options(seed=seed, contacts=60, repeats=0, placements=0)).dataset
    changed = gap_study.wrongly_stated(dataset, seed, stated=0.75, masses=0.15)
    assert changed.noise.contact == pytest.approx(0.75 * dataset.noise.contact)
    off = changed.robot.masses / dataset.robot.masses - 1
    assert 0.02 < abs(off).max() <= 0.15
    assert gap_study.wrongly_stated(dataset, seed) == dataset
    false = gap_score.own_figures(
        [{"case": case, "seed": k, "verdict": "named", "named": ["step"] * (k == 3)} for k in range(40)]
    )
    assert false[case]["named"] == 1
    assert "3: step" in gap_score.own_table(false)
