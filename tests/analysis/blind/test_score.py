"""The score of a blind check: perfect answers, known misses, calibrated and boastful probabilities."""

import csv
import json
from itertools import chain, combinations

import numpy as np
import pytest
from made_up_worlds import answer, at, many, null, one, pair, perfect, shrunk, silent, strange, tracked, truth

from analysis.blind.files import MISSES as files_MISSES
from analysis.blind.files import SCORE, write_score
from analysis.blind.pictures import PICTURES
from analysis.blind.score import figures
from analysis.blind.shrunk import worse_beyond_noise
from analysis.blind.skill import log_score, stated

NAMES = ("step", "lobing", "backlash", "bending")


def shares(found):
    """Every share of the figures with something to judge, by its key."""
    if isinstance(found, dict) and "hits" in found:
        return [found] if found["count"] else []
    inner = found.values() if isinstance(found, dict) else found if isinstance(found, list) else ()
    return list(chain.from_iterable(shares(value) for value in inner))


def test_perfect_answers_have_perfect_figures():
    found = figures(many(*perfect()))
    assert found["null"]["named"]["hits"] == 0
    assert found["outside"]["named_alone"]["hits"] == 0
    wrong = [
        found["null"].pop("named"),
        found["null"].pop("otherwise"),
        found.pop("worse_beyond_noise"),
        found["outside"].pop("named_alone"),
        *found["single"].pop("wrong_name"),
    ]
    assert all(s["hits"] == 0 for s in wrong)
    assert len(shares(found)) > 20
    assert all(s["hits"] == s["count"] for s in shares(found))
    assert found["misses"] == []
    assert found["reasons"] == {}
    assert found["worse"] == {}
    assert found["distances"]["closed"] == pytest.approx(1.0)
    assert found["distances"]["ratio"] == pytest.approx(1.0)
    assert found["planes"]["ratio"] == pytest.approx(1.0)
    assert found["log_score"]["mean"] == pytest.approx(0.0)
    assert found["log_score"]["base"] < -1
    for what in ("planes", "distances"):
        assert found["predicted"][what]["median"] == pytest.approx(1.0)
        assert found["predicted"][what]["near"] == 1.0
    assert all(b["held"] == pytest.approx(b["said"]) for b in found["reliability"])


def test_known_answers_have_known_figures():
    wrong, right = False, True
    known = [
        (null(), silent(), right),
        (null(), answer(), wrong),
        (null(), silent("unknown"), wrong),
        (truth(), answer(), right),
        (truth(), answer(named=("lobing",)), wrong),
        (truth(), answer(verdict="named+unexplained"), wrong),
        (truth(), silent(), wrong),
        (pair(), answer(named=("step", "lobing")), right),
        (pair(), answer(named=("step",)), wrong),
        (strange(), silent("unknown"), right),
        (strange(), answer(verdict="named+unexplained"), right),
        (strange(), answer(), wrong),
    ]
    rs = many(*(case[:2] for case in known))
    assert [r["right"] for r in rs] == [case[2] for case in known]
    found = figures(rs)

    def hits(s):
        return s["hits"], s["count"]

    assert hits(found["null"]["named"]) == (1, 3)
    assert hits(found["single"]["right"][-1]) == hits(found["single"]["strong"]) == (1, 4)
    assert hits(found["single"]["wrong_name"][-1]) == (1, 4)
    assert hits(found["pairs"]["all"]["recall"]) == hits(found["pairs"]["clear"]["recall"]) == (3, 4)
    assert hits(found["pairs"]["all"]["precision"]) == (3, 3)
    assert hits(found["each_of_two"][-1]) == (2, 2)  # step at 200
    assert hits(found["each_of_two"][-2]) == (1, 2)  # lobing at 50
    assert hits(found["outside"]["flagged"]) == (2, 3)
    assert hits(found["outside"]["named_alone"]) == (1, 3)
    assert hits(found["sure"]["right"]) == (2, 6)
    assert hits(found["sure"]["names_true"]) == (3, 6)
    assert hits(found["set"]["holds"]) == (3, 6)
    assert sum(found["reasons"].values()) == len(found["misses"]) == 7
    low, high = found["outside"]["flagged"]["interval95"]
    assert (low, high) == pytest.approx((0.2077, 0.9385), abs=1e-4)  # Wilson, of 2 in 3


def test_an_effect_that_cannot_be_seen_is_counted_apart():
    named = answer(named=("step",))
    both = answer(named=("step", "lobing"))
    weak, strong = (pair(strength=(200.0, size)) for size in (5.0, 10.0))
    found = figures(many((weak, named), (strong, named), (strong, both), (null(), answer())))["sure"]
    assert [(found[k]["hits"], found[k]["count"]) for k in ("right", "right_seen")] == [(1, 4), (1, 3)]


def calibrated(count, rng, honest=1.0):
    """Worlds whose truths are drawn from the probabilities that are stated; less honest ones sharpen them."""
    out = []
    for _ in range(count):
        p = rng.dirichlet(np.full(len(NAMES) + 2, 0.4))
        event = rng.choice(len(p), p=p)
        q = p ** (1.0 / honest)
        q /= q.sum()
        said = dict(zip(("null", "unknown", *NAMES), q.tolist(), strict=True))
        true = null() if event == 0 else strange() if event == 1 else truth(effects=(NAMES[event - 2],))
        sets = [((), q[0]), (("unknown",), q[1]), *(((name,), q[k + 2]) for k, name in enumerate(NAMES))]
        out.append((true, answer(verdict="ambiguous", named=(), p=said, sets=sets)))
    return many(*out)


def test_calibrated_probabilities_lie_in_their_bands_and_boasts_do_not():
    def outside(rs):
        return sum(not b["band95"][0] <= b["held"] <= b["band95"][1] for b in figures(rs)["reliability"])

    honest = calibrated(1500, np.random.default_rng(1))
    boasting = calibrated(1500, np.random.default_rng(1), honest=0.4)
    assert outside(honest) <= 1
    assert outside(boasting) >= 4
    score, boasts = log_score(honest), log_score(boasting)
    assert score["mean"] > boasts["mean"] + 0.1
    assert score["mean"] > score["base"]
    assert boasts["base"] == score["base"]
    entropy = [sum(p * np.log(max(p, 1e-4)) for p in r["probability"].values()) for r in honest]
    u = np.std(entropy) / np.sqrt(len(entropy))
    assert score["mean"] == pytest.approx(np.mean(entropy), abs=4 * u + 0.05)


@pytest.mark.parametrize("promoted", [False, True])
def test_stated_probabilities_of_all_that_may_be_true_add_up_to_one(promoted):
    """Sets that are listed as they are listed, the others by what is left over."""
    p = {"null": 0.1, "unknown": 0.15, "step": 0.5, "lobing": 0.4, "backlash": 0.1, "compliance": 0.05}
    sets = [((), 0.1), (("step",), 0.3), (("step", "lobing"), 0.2), (("lobing", "unknown"), 0.15)]
    said = answer(verdict="ambiguous", named=(), p=p, sets=sets)
    if promoted:  # compliance was missing from the model: all sets stand beside it
        p = p | {"null": 0.01, "compliance": 0.9}
        said = answer(named=("compliance",), p=p, sets=[(n, q) for n, q in sets], baseline=("geometry",))
    names = [name for name in p if name not in ("null", "unknown")]
    every = chain.from_iterable(combinations(names, k) for k in range(1, len(names) + 1))
    of = {names: stated(one(truth(effects=names), said)) for names in every}
    total = sum(of.values()) + stated(one(null(), said)) + stated(one(strange(), said))
    assert total == pytest.approx(1.0)
    if promoted:
        assert of["step", "compliance"] == pytest.approx(0.9 * 0.3)
        assert of[("compliance",)] == pytest.approx(0.9 * 0.1)
    else:
        assert of["step", "lobing"] == 0.2
        assert of["step", "backlash"] > of["backlash", "compliance"] > 0


def test_one_answer_changed_changes_what_it_should():
    right = perfect()
    spoilt = list(right)
    spoilt[3] = (spoilt[3][0], silent(distances=None))
    before, after = many(*right), many(*spoilt)
    assert [k for k, (a, b) in enumerate(zip(before, after, strict=True)) if a != b] == [3]
    old, new = figures(before), figures(after)
    assert [m["world"] for m in new["misses"]] == ["003"]
    changed = {key for key in old if old[key] != new[key]}
    assert changed == {
        "single", "set", "distances", "planes", "predicted", "reliability", "log_score", "reasons", "misses",
        "named_place", "unnamed_place", "sure", "certain", "worse_beyond_noise",
    }  # fmt: skip
    assert [s["hits"] for s in new["single"]["right"]] == [1, 1, 0, 1, 1, 1]
    assert new["distances"]["count"] == old["distances"]["count"] - 1


def test_a_crash_and_a_lost_answer_are_not_right():
    crash = {"world": "000", "error": "LinAlgError: singular"}
    rs = many((truth(), crash), (null(), None), (strange(), None))
    found = figures(rs)
    assert not any(r["right"] for r in rs)
    assert found["crashed"] == {"000": "LinAlgError: singular", "001": "no answer", "002": "no answer"}
    assert found["single"]["strong"]["hits"] == found["null"]["right"]["hits"] == 0
    assert found["log_score"]["mean"] == pytest.approx(np.log(1e-4))
    assert found["seconds"] == {"median": None, "most": None}


def test_shrinkage_is_of_the_excess_and_beside_what_was_predicted():
    good = (truth(), answer(distances=shrunk(30.0, 11.0, said=30.0, expects=11.0)))
    worse = (truth(), answer(named=("lobing",), distances=shrunk(20.0, 30.0, said=20.0, expects=10.0)))
    found = figures(many(good, worse))
    assert figures(many(good))["distances"]["closed"] == pytest.approx((900 - 121) / 800)
    assert found["distances"]["closed"] == pytest.approx((900 - 121 + 400 - 900) / (800 + 300))
    assert found["distances"]["ratio_right"] == pytest.approx(1.1)
    assert found["worse"] == {"001": [20.0, 30.0]}
    said = found["predicted"]["distances"]
    assert (said["count"], said["near"]) == (2, 0.5)
    assert said["median"] == pytest.approx(np.sqrt(1.0 * 3.0))
    assert found["predicted"]["planes"]["count"] == 0


def test_floor_of_planes_has_the_true_noise():
    noisier = truth() | {"noise_um": 6.0}  # estimated: 8 um, and 6 um by parameters
    r = one(noisier, answer(planes=shrunk(20.0, 11.0, floor=10.0)))
    assert r["plane_um"]["floor"] == pytest.approx(np.hypot(6.0, 6.0))


def test_points_of_a_tracker_are_compared_with_those_of_the_true_model():
    said = answer(points=shrunk(30.0, 11.0, floor=8.0))
    found = figures(many((tracked(), said), (truth(), said)))["points"]
    assert (found["count"], found["floor_um"]) == (1, 10.0)
    assert found["closed"] == pytest.approx((900 - 121) / 800)
    assert one(tracked(), answer())["point_um"] is None, "no refit"


@pytest.mark.parametrize(("place", "where", "hit"), [
    ({"site": "joint 4", "driver": "joint angle"}, at("joint 4", "approach 4"), True),
    ({"site": "joint 4", "driver": "joint angle"}, at("joint 5", "angle 4"), False),
    ({"site": "time", "driver": "temperature", "also": ["temperature"]}, at("base", "temperature"), True),
    ({"site": "probe", "driver": "speed", "also": ["stylus"]}, at("stylus", "direction"), True),
    ({"site": "link 4", "driver": "bending moment"}, at("arm", "bending moment"), False),
])  # fmt: skip
def test_places_are_met_in_the_words_of_the_truth(place, where, hit):
    true = truth(place=place)
    named = one(true, answer(where=[where | {"explained_by": "step"}]))
    assert named["named_at_right_site"] == {"step": hit}
    unnamed = one(true, silent(where=[where]))
    assert unnamed["first_place_right"] == unnamed["at_right_site"] == hit
    assert one(true, silent(where=[at("joint 6"), where]))["first_place_right"] is False


@pytest.mark.parametrize(("shift", "count", "beyond"), [(0.0, 12, 0), (6.0, 12, 0), (40.0, 12, 1)])
def test_distances_get_worse_beyond_noise(shift, count, beyond):
    """Errors of the true model of 10 um; a refit that moves distances at random, or by a bias besides."""
    rng = np.random.default_rng(4)
    noise, move = 10.0 * rng.standard_normal(count), 5.0 * rng.standard_normal(count)
    rms = [float(np.sqrt(np.mean(e**2))) for e in (noise - move / 2, noise + move / 2 + shift)]
    moved = float(np.mean((move + shift) ** 2))
    d = shrunk(*rms, said=float(np.sqrt(moved + 100.0)), expects=10.0) | {"count": count}
    found = figures([one(truth(), answer(distances=d))])["worse_beyond_noise"]
    assert (found["hits"], found["count"]) == (beyond, 1)


def test_the_band_of_worse_distances_holds_95_percent():
    """Where neither model is better, no more than 2.5 % of sessions are called worse."""
    rng, hits, many_ = np.random.default_rng(5), 0, 400
    for _ in range(many_):
        noise, move = 10.0 * rng.standard_normal(8), 5.0 * rng.standard_normal(8)
        a, b = (float(np.sqrt(np.mean((noise + s * move / 2) ** 2))) for s in (-1, 1))
        d = shrunk(a, b, said=float(np.sqrt(np.mean(move**2) + 100.0)), expects=10.0) | {"count": 12}
        hits += worse_beyond_noise(one(truth(), answer(distances=d)))
    assert hits / many_ < 0.04


# --- The score card: a screen, a page, a folder that is whole, and pictures whatever was judged.

ABOUT = {
    "truth_sha256": "a1" * 32, "answers_sha256": "b2" * 32, "code_sha256": "c3" * 32,
    "software": {"bayescal": "0.1.0"}, "worlds": 12, "seed": 2026, "note": "at commit 0123abc",
}  # fmt: skip
SOME = [
    *perfect(),
    (truth(), answer(named=("lobing",), distances=shrunk(20.0, 30.0))),
    (null(), answer()),
    (strange("dent"), silent()),
]
CASES = {
    "all kinds": SOME,
    "noise only": [(null(), silent())],
    "with a tracker": [
        (tracked(), answer(points=shrunk(30.0, 11.0))),
        (tracked(strength=50.0), answer(named=("lobing",))),
        (tracked(strength=20.0), silent()),
    ],
    "crashed": [(truth(), None)],
}


@pytest.mark.parametrize("case", ["all kinds"])
def test_folder_is_whole_and_its_pictures_drawn(case, tmp_path):
    rs = many(*CASES[case])
    found = figures(rs)
    names = write_score(rs, found, ABOUT, tmp_path / "score")
    there = {p.name for p in (tmp_path / "score").glob("[!.]*")}
    assert there == set(names) == {SCORE, files_MISSES, *PICTURES}
    for name in PICTURES:
        picture = (tmp_path / "score" / name).read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) > 10_000
    kept = json.loads((tmp_path / "score" / SCORE).read_text(), parse_constant=pytest.fail)
    assert kept["about"] == ABOUT
    assert len(kept["records"]) == kept["worlds"] == len(rs)
    with (tmp_path / "score" / files_MISSES).open() as stream:
        assert [line["world"] for line in csv.DictReader(stream)] == [m["world"] for m in found["misses"]]
