"""The page of real sessions in small: sockets at three places, each of them kept back in turn."""

import json
from dataclasses import replace

import foreign
import numpy as np
import pytest

from analysis import real_sessions, real_sessions_page
from bayescal.dataset import Certificate, Noise, Target, read_dataset, write_dataset

PLACES = {"left": (0.40, 0.25, 0.20), "right": (0.40, -0.25, 0.20), "far": (0.52, 0.0, 0.25)}
APART = 0.05
NOISE = 20e-6


def solved(arm, robot, goal, start):
    """Readings, of many starts (N, 6), at which the true arm's ball is at a goal: damped least squares."""
    towards = np.broadcast_to(np.eye(3), (len(start), 3, 3))
    q, met = arm.driven(
        start, np.zeros(len(start)), lambda p, which: (p - goal[which], towards[which]), joints=6, to=1e-8
    )
    angle = q @ robot.link_from_reading.T * np.sign(np.diag(robot.link_from_reading))
    within = np.all((angle > robot.limits[:, 0]) & (angle < robot.limits[:, 1]), axis=1)
    return q[within & met]


@pytest.fixture(scope="module")
def sockets(tracker):
    """Two sockets at three places, certified, each visited in 16 poses by an arm with errors of its own."""
    made = tracker(seed=3, count=60)
    session, arm, rng = made.dataset, made.arm, np.random.default_rng(3)
    targets, goals = [], []
    for name, place in PLACES.items():
        for k in range(2):
            goals.append(np.array([place[0], place[1] + k * APART, place[2]]))
            targets.append(Target(f"{name}.{k}", "fixed-point", {"centre": goals[-1] + 1e-3}))
    readings, target = [], []
    near = session.measurements.readings
    for t, goal in enumerate(goals):
        start = near + 0.2 * rng.standard_normal(near.shape)
        mine = solved(arm, session.robot, goal + NOISE * rng.standard_normal((len(near), 3)), start)[:16]
        assert len(mine) == 16
        readings += list(mine)
        target += [t] * 16
    count = len(target)
    m = session.measurements
    table = replace(
        m,
        ids=tuple(f"s{k}" for k in range(count)),
        role=np.where(np.arange(count) % 4 == 0, "validate", "calibrate"),
        target=np.array(target),
        tool=np.zeros(count, int),
        readings=np.array(readings),
        line=np.arange(2, count + 2),
        time=10.0 * np.arange(count),
        payload=np.zeros(count),
        xyz=None,
        repeat=None,
        **dict.fromkeys(("velocity", "command", "torque", "temperature")),
    )
    papers = tuple(
        Certificate("distance", (f"{name}.0", f"{name}.1"), APART, u_distance=1e-5) for name in PLACES
    )
    return replace(
        session, name="sockets", noise=Noise(contact=NOISE), targets=tuple(targets), certificates=papers,
        measurements=table,
    )  # fmt: skip


@pytest.fixture(scope="module")
def run(sockets, tmp_path_factory):
    folder = tmp_path_factory.mktemp("real")
    write_dataset(sockets, folder / "real" / "sockets")
    (folder / "page.md").write_text(
        "before\n{}\nold\n{}\nafter\n".format(*real_sessions_page.MARKS), encoding="utf-8"
    )
    real_sessions.main(arguments(folder))
    return folder


def arguments(folder):
    return [
        *("--real", str(folder / "real"), "--runs", str(folder / "runs"), "--out", str(folder / "page.md"))
    ]


def records(folder):
    return json.loads((folder / "runs" / "records.json").read_text(encoding="utf-8"))


def test_each_level_leaves_less(run):
    whole = records(run)["sockets"]
    assert whole["places"] == list(PLACES)
    mean = {step["model"]: step["points"]["mean_mm"] for step in whole["levels"]}
    assert mean["nominal"] > 1.0
    assert mean["nominal"] > mean["geometry"] > mean["compliance"]
    assert mean["compliance"] < 3e3 * NOISE


def test_a_place_apart_is_predicted_by_the_others(run):
    found = records(run)
    for place in PLACES:
        steps = {step["model"]: step for step in found[f"sockets | {place}"]["levels"]}
        assert steps["nominal"]["count"] == 32
        assert steps["compliance"]["mean_mm"] < 0.3 * steps["nominal"]["mean_mm"]


def test_a_place_apart_is_not_fitted(sockets):
    """With the place's readings spoilt, the other places' model stays: what is spoilt shows in full."""
    m = sockets.measurements
    there = m.target >= 4
    readings = m.readings.copy()
    readings[there, 0] += np.radians(1.0) * np.random.default_rng(0).choice([-1, 1], there.sum())
    spoilt = replace(sockets, measurements=replace(m, readings=readings))
    clean, bad = (real_sessions.unseen(d, "far", ())["levels"][-1] for d in (sockets, spoilt))
    assert bad["mean_mm"] > 5.0
    assert clean["mean_mm"] < 0.2


def test_the_page_is_renewed_and_a_run_goes_on(run, monkeypatch):
    before = (run / "page.md").read_text(encoding="utf-8")
    assert before.startswith("before\n")
    assert before.endswith("after\n")
    assert "\nold\n" not in before
    assert "| sockets, 24 points | nominal |" in before
    assert "| sockets, 3 locations | nominal |" in before
    path = run / "runs" / "records.json"
    kept = records(run)
    last = kept.pop("sockets | far")
    path.write_text(json.dumps(kept), encoding="utf-8")
    made = []
    monkeypatch.setattr(real_sessions, "made", lambda task: made.append(task.key) or last)
    real_sessions.main(arguments(run))
    assert made == ["sockets | far"]
    assert (run / "page.md").read_text(encoding="utf-8") == before


def test_the_figures_of_others_are_numbers_of_known_levels():
    figures = real_sessions_page.quoted()
    assert len({session for session, _, _ in figures}) == 6
    for (_, _, level), row in figures.items():
        assert level in real_sessions_page.LEVELS
        assert float(row["mean_mm"]) > 0
        assert row["source"]
        if row["rms_mm"]:
            assert float(row["mean_mm"]) <= float(row["rms_mm"]) <= float(row["max_mm"])


@foreign.needs()
def test_the_ur5_as_its_readme_says():
    """Nothing fitted at all: the figure that the session's README quotes."""
    step = real_sessions.as_in_the_files(real_sessions.Scene(read_dataset(foreign.REAL / "ur5-lasertracker")))
    other = real_sessions_page.quoted()["ur5-lasertracker", "points", "nominal"]
    for what in ("mean_mm", "rms_mm", "max_mm"):
        assert step["points"][what] == pytest.approx(float(other[what]), abs=2e-3)
