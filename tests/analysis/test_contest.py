"""The benchmark that other tools enter: its score against closed forms, refusals, and one small run."""

import json
from math import log
from pathlib import Path

import numpy as np
import pytest
from cases import refused
from scipy.spatial.transform import Rotation

import bayescal as bc
from analysis.contest import run, session, tasks
from analysis.contest.entry import Entry, of_sets, read_entry, record_of
from analysis.contest.ours import TOOLS, Answer
from analysis.contest.score import FLOOR, Z95, figures, of_names

RNG = np.random.default_rng(3)
TRACKER = {"tracker": {"kind": "instrument", "xyz_mm": [0, 0, 0], "rpy_deg": [0, 0, 0]}}
NOISE = {"contact_mm": 0.01, "point_mm": 0.01}


def made(targets, rows, certificates=()):
    """A session of rows (role, target, xyz or None) with a ball of radius 3 mm."""
    said = {"tools": {"ball": {"ball_radius_mm": 3.0}}, "noise": NOISE}
    said |= {"targets": targets, "certificates": list(certificates)}
    cells = [
        {"id": f"r{k}", "role": role, "target": target}
        | ({} if xyz is None else dict(zip(tasks.XYZ, map(str, xyz), strict=True)))
        for k, (role, target, xyz) in enumerate(rows)
    ]
    return session.of(said, cells, "task")


def entry(points, u=None, names=None):
    return Entry("tool", 1.0, np.asarray(points), np.full(len(points), np.nan) if u is None else u, names)


def on_plane(heights):
    """Contacts on z = 0: 20 that calibrate, then some that lie above the plane by the arm."""
    flat = np.column_stack([RNG.uniform(-100, 100, (20, 2)), np.full(20, 3.0)])
    late = np.column_stack([RNG.uniform(-100, 100, (len(heights), 2)), 3.0 + np.array(heights)])
    rows = [("calibrate", "top", None)] * 20 + [("validate", "top", None)] * len(heights)
    target = {"top": {"kind": "plane", "normal": [0.02, 0, 1], "offset_mm": 1.0}}
    return made(target, rows), np.concatenate([flat, late])


def test_known_heights_give_their_rms():
    s, points = on_plane([0.03, -0.04])
    found = figures(s, entry(points))
    assert found.rows == 2
    assert found.rms == pytest.approx(np.sqrt(0.5 * (0.03**2 + 0.04**2)))
    assert (found.mean, found.maximum) == (pytest.approx(0.035), pytest.approx(0.04))
    assert np.isnan(found.distance_rms)
    assert np.isnan(found.inside95)


def test_intervals_are_counted_by_component():
    s, points = on_plane([0.03, -0.04, 0.01])
    u = np.full(len(points), np.nan)
    u[-3:-1] = 0.018  # 0.03 is within 1.96 u, 0.04 is not; the last row states none
    found = figures(s, entry(points, u))
    assert found.inside95 == 0.5
    width = 2 * Z95 * 0.018
    assert found.interval_score == pytest.approx(width + 0.5 * 40 * (0.04 - Z95 * 0.018))


def test_gross_errors_of_calibration_rows_do_not_move_a_target():
    s, points = on_plane([0.0, 0.0])
    points[:20, 2] += RNG.normal(0, 1e-3, 20)
    points[4, 2] += 1.0
    assert figures(s, entry(points)).rms < 2e-3


def test_the_frame_of_an_instrument_does_not_count():
    points = RNG.uniform(-500, 500, (12, 3))
    xyz = (points - [1000.0, -200.0, 50.0]) @ Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    rows = [("calibrate" if k < 8 else "validate", "tracker", x) for k, x in enumerate(xyz)]
    assert figures(made(TRACKER, rows), entry(points)).maximum < 1e-9
    off = points.copy()
    off[8:, 1] += 0.2
    assert figures(made(TRACKER, rows), entry(off)).mean == pytest.approx(0.2)


def test_spheres_of_validation_rows_are_scored_by_their_distance():
    ways = RNG.normal(size=(24, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    centre = np.where(np.arange(24)[:, None] < 12, [0.0, 0, 0], [100.0, 0, 0])
    ball = {"kind": "sphere", "diameter_mm": 20.0}
    targets = {"a": ball | {"centre_mm": [1, 0, 0]}, "b": ball | {"centre_mm": [99, 1, 0]}}
    stated = {"kind": "distance", "between": ["a", "b"], "distance_mm": 99.95, "u_distance_mm": 0.001}
    rows = [("validate", "a" if k < 12 else "b", None) for k in range(24)]
    found = figures(made(targets, rows, [stated]), entry(centre + 13.0 * ways))
    assert (found.rows, found.distances) == (0, 1)
    assert found.distance_rms == pytest.approx(0.05)


@pytest.mark.parametrize(("said", "effects", "p", "right"), [
    ([(["backlash"], 0.7), ([], 0.3)], ["backlash"], 0.7, 1),
    ([(["backlash"], 0.7), ([], 0.3)], [], 0.3, 0),
    ([(["backlash", "step"], 1.0)], ["backlash"], FLOOR, 0),
    ([(["step", "unknown"], 0.4), (["unknown"], 0.3)], ["unknown"], 0.7, 1),
    ([], ["step"], FLOOR, 0),
])  # fmt: skip
def test_names_are_scored_by_the_probability_of_the_true_set(said, effects, p, right):
    names = of_sets([{"effects": e, "probability": q} for e, q in said])
    assert of_names(names, {"effects": effects}) == (pytest.approx(log(p)), right)


def test_a_class_is_divided_among_its_members():
    names = of_sets([{"effects": ["bending", "unknown"], "probability": 0.8, "any": True}])
    assert of_names(names, {"effects": ["bending"]})[0] == pytest.approx(log(0.4))


def good():
    return record_of("tool", "task", ("a", "b"), np.zeros((2, 3)), 1.0, np.ones(2), {frozenset(): 1.0})


@pytest.mark.parametrize(("change", "words"), [
    ({"colour": "red"}, "colour"),
    ({"task": "other"}, "of the task other"),
    ({"rows": good()["rows"][:1]}, "lacks 1 of 2 rows, the first is b"),
    ({"rows": [*good()["rows"], good()["rows"][0]]}, "a row twice"),
    ({"rows": [*good()["rows"], {"id": "c", "tcp_mm": [0, 0, 0]}]}, "row c"),
    ({"rows": [{"id": "a", "tcp_mm": [0, 0, float("nan")]}]}, "NaN"),
    ({"rows": [{"id": "a", "tcp_mm": [0, 0, 0], "u_mm": 0}]}, "u_mm"),
    ({"names": [{"effects": ["rust"], "probability": 1}]}, "rust"),
    ({"names": [{"effects": e, "probability": 0.6} for e in ([], ["step"])]}, "more than 1"),
])  # fmt: skip
def test_a_bad_entry_is_refused_in_one_line(tmp_path, change, words):
    path = tmp_path / "tool.json"
    path.write_text(json.dumps(good()))
    assert read_entry(path, "task", ("a", "b")).points.shape == (2, 3)
    path.write_text(json.dumps(good() | change))
    refused(words, lambda: read_entry(path, "task", ("a", "b")))


def test_halves_divide_rows_and_leave_what_only_validates():
    role = np.array(["calibrate"] * 8 + ["validate"] * 4 + ["locate", "validate"])
    late = tasks.halves(role, np.array(["a"] * 12 + ["b"] * 2))
    assert [k for k, r in late.items() if r == "validate"] == list(range(6, 12))
    assert set(late) == set(range(12))


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    """A task with contacts of a small session, and the answers."""
    out = tmp_path_factory.mktemp("contest")
    bc.simulate(contacts=60, later=12, repeats=0, spheres=0, seed=4).save(out / "made")
    texts = {name: (out / "made" / name).read_text() for name in ("dataset.yaml", "measurements.csv")}
    texts["task.json"] = json.dumps({"name": "small", "group": "simulated", "baseline": ["geometry"]})
    truth = {"kind": "null", "effects": []}
    tasks.keep(out / "run", tasks.Task("small", texts, {"readings": {}, "truth": truth}))
    return out / "run"


def test_a_run_enters_scores_and_continues(small, capsys):
    chosen = {name: TOOLS[name] for name in ("nominal arm", "bayescal fit", "survey, open loop")}
    run.entered(small, chosen)
    assert "instrument" in (small / "entries" / "small" / "survey--open-loop.txt").read_text()

    def never(given: object) -> Answer:
        raise AssertionError

    run.entered(small, dict.fromkeys(chosen, never))  # what is there is kept
    run.main(["score", "--out", str(small)])
    scores = {r["tool"]: r for r in json.loads((small / "scores.json").read_text())}
    nominal, ours = (scores[name] for name in ("nominal arm", "bayescal fit"))
    assert 0 < ours["rms"] < 0.2 * nominal["rms"]
    assert ours["inside95"] > 0.8
    assert "survey, open loop, 1 task: no calibration row" in capsys.readouterr().out
    assert "<table>" in (small / "index.html").read_text()


def test_hidden_readings_are_in_no_file_of_a_task(tmp_path):
    rows = [{"id": "a", "role": "validate", "x_mm": "1", "y_mm": "2", "z_mm": "3"}]
    rows.append({"id": "b", "role": "calibrate", "x_mm": "4", "y_mm": "5", "z_mm": "6"})
    text, hidden = tasks.hide(rows)
    assert text.splitlines()[1:] == ["a,validate,,,", "b,calibrate,4,5,6"]
    assert hidden == {"a": [1.0, 2.0, 3.0]}
