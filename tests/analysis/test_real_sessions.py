"""The page of real sessions in small: sockets at three places, each of them kept back in turn."""

import json
from dataclasses import replace

import foreign
import numpy as np
import pytest
from kind_sessions import CONTACT, cone, of_pieces
from sessions import misread, plain, wavy, with_columns, with_rows

from analysis import knock_out, knock_out_page, real_halves, real_sessions, real_sessions_page, real_steps
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import Certificate, read_dataset, write_dataset
from bayescal.estimate import calibrated
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate

PLACES = {"left": (0.40, 0.25, 0.20), "right": (0.40, -0.25, 0.20), "far": (0.52, 0.0, 0.25)}
APART = 0.05


@pytest.fixture(scope="module")
def sockets(tracker):
    """Two sockets at three places, certified, each visited in 16 poses by an arm with errors of its own."""
    beside = np.array([0.0, APART, 0.0])
    goals = {f"{name}.{k}": place + k * beside for name, place in PLACES.items() for k in (0, 1)}
    pieces = [cone(name, goal + 1e-3, [-1e-3] * 3, count=16, held=4) for name, goal in goals.items()]
    pairs = [(f"{name}.0", f"{name}.1") for name in PLACES]
    papers = tuple(Certificate("distance", pair, APART, u_distance=1e-5) for pair in pairs)
    session = of_pieces(tracker(seed=3, count=60), pieces, papers, seed=3, planes=False).dataset
    session = with_rows(session, np.argsort(session.measurements.target, kind="stable"))
    return replace(with_columns(session, time=10.0 * np.arange(96)), name="sockets")


@pytest.fixture(scope="module")
def run(sockets, tmp_path_factory, renewed):
    folder = tmp_path_factory.mktemp("real")
    write_dataset(sockets, folder / "real" / "sockets")
    renewed(real_sessions_page.MARKS, lambda _: real_sessions.main(arguments(folder)), folder)
    return folder


def arguments(folder):
    return [*map(str, ["--real", folder / "real", "--runs", folder / "runs", "--out", folder / "page.md"])]


def records(folder):
    return json.loads((folder / "runs" / "records.json").read_text(encoding="utf-8"))


def check_continued(folder, module, given, key, monkeypatch):
    """A record that is lost is made again, no other, and the page is the same."""
    before, kept, made = (folder / "page.md").read_text(encoding="utf-8"), records(folder), []
    last = kept.pop(key)
    (folder / "runs" / "records.json").write_text(json.dumps(kept), encoding="utf-8")
    monkeypatch.setattr(module, "made", lambda task: made.append(task.key) or last)
    module.main(given)
    assert made == [key]
    assert (folder / "page.md").read_text(encoding="utf-8") == before


def test_each_level_leaves_less(run):
    whole = records(run)["sockets"]
    assert whole["places"] == list(PLACES)
    mean = {step["model"]: step["points"]["mean_mm"] for step in whole["levels"]}
    assert mean["nominal"] > 1.0
    assert mean["nominal"] > mean["geometry"] > mean["compliance"]
    assert mean["compliance"] < 12e3 * CONTACT


def test_a_place_apart_is_predicted_by_the_others(run):
    found = records(run)
    for place in PLACES:
        steps = {step["model"]: step for step in found[f"sockets | {place}"]["levels"]}
        assert steps["nominal"]["count"] == 32
        assert steps["compliance"]["mean_mm"] < 0.3 * steps["nominal"]["mean_mm"]


def test_a_place_apart_is_not_fitted(sockets):
    """With the place's readings spoilt, the other places' model stays: what is spoilt shows in full."""
    there = sockets.measurements.target >= 4
    signs = np.random.default_rng(0).choice([-1, 1], there.sum())
    spoilt = misread(sockets, 1, np.radians(1.0) * signs, there)
    clean, bad = (real_sessions.unseen(d, "far", ())["levels"][-1] for d in (sockets, spoilt))
    assert bad["mean_mm"] > 5.0
    assert clean["mean_mm"] < 0.2


def test_the_page_is_renewed_and_a_run_goes_on(run, monkeypatch):
    before = (run / "page.md").read_text(encoding="utf-8")
    assert "| sockets, 24 points | nominal |" in before
    assert "| sockets, 3 locations | nominal |" in before
    check_continued(run, real_sessions, arguments(run), "sockets | far", monkeypatch)


@foreign.needs()
def test_the_ur5_as_its_readme_says():
    """Nothing fitted at all: the figure that the session's README quotes."""
    step = real_sessions.as_in_the_files(real_sessions.Scene(read_dataset(foreign.REAL / "ur5-lasertracker")))
    other = real_sessions_page.quoted()["ur5-lasertracker", "points", "nominal"]
    for what in ("mean_mm", "rms_mm", "max_mm"):
        assert step["points"][what] == pytest.approx(float(other[what]), abs=2e-3)


# --- The knock-outs in small: what is taken out of a simulated session is found.


def test_what_is_taken_out_is_found():
    options = Options(contacts=64, later=20, repeats=0, spheres=2, placements=1, seed=4)
    without = "geometry at joint 4"
    r = knock_out.knocked(plain(simulate(options).dataset), without) | {"without": without}
    assert knock_out_page.right(r)
    assert r["probability"] > 0.99
    held = r["validation"]["planes"]
    assert held["after_um"] < 1.1 * held["whole_um"] < 0.2 * held["before_um"]
    assert held["before_um"] == pytest.approx(held["predicted_before_um"], rel=0.15)
    assert r["lambda"] > 1000


# --- A half of a session that is diagnosed.


@pytest.fixture(scope="module")
def waved(tracker):
    return wavy(tracker(seed=3, count=80).dataset)


def test_the_stated_uncertainty_of_a_half_holds_for_the_other(waved):
    (one, other) = next(real_halves.splits(waved)).halves
    functions = real_halves.families(Scene(waved).circumstances(np.concatenate([one, other])))
    assert 0.9 <= real_halves.half(waved, one, other, functions).inside[1] <= 1.0


# --- Steps added to sessions.


def test_a_shifted_base_is_seen_by_an_instrument_and_in_the_readings(waved, sockets):
    """Both are the same displacement of the arm's points in its frame."""
    by = np.array([3e-4, -2e-4, 5e-4])
    (t,), row = waved.targets, 40
    moved = real_steps.shifted(waved, row, by).measurements.xyz - waved.measurements.xyz
    np.testing.assert_allclose(moved[:row], 0.0)
    turn = rpy_matrix(t.values["rpy"])
    np.testing.assert_allclose(moved[row:] @ turn.T, by + np.zeros((40, 3)), atol=1e-12)
    arm = NominalArm(sockets.robot, sockets.tools[0].centre)
    after = real_steps.shifted(sockets, row, by).measurements.readings
    before, after = (arm.tool_poses(arm.frames(q)) for q in (sockets.measurements.readings, after))
    np.testing.assert_allclose(after[:row], before[:row])
    np.testing.assert_allclose(after[row:, :3, 3], before[row:, :3, 3] - by, atol=2e-8)
    np.testing.assert_allclose(after[row:, :3, :3], before[row:, :3, :3], atol=2e-6)


def test_a_step_is_within_the_rows_of_a_target(sockets):
    """Sixteen rows of each, of which twelve are fitted."""
    rows = Scene(sockets).rows("calibrate")
    target = sockets.measurements.target
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        row = real_steps.seen_at(sockets, rows, share)
        assert 3 <= np.sum(rows[target[rows] == target[row]] < row) <= 9
    row = real_steps.seen_at(sockets, rows, 0.5)
    assert np.linalg.norm(real_steps.direction(sockets, row, 0.5)) == pytest.approx(1.0)


def test_detectability_of_a_step(waved):
    """Of a small shift it is quadratic in its size; the geometry absorbs a part of it."""
    plain = calibrated(Scene(waved), ("geometry",))
    by = np.array([0.0, 0.0, 2e-5])
    once, twice = (real_steps.detectability(plain, real_steps.shifted(waved, 40, k * by)) for k in (1, 2))
    assert twice == pytest.approx(4.0 * once, rel=0.02)
    whole = 40 * (by[2] / (plain.weights.scale["point"] * 1e-5)) ** 2
    assert 0.1 * whole < once < 0.5 * whole  # no more than one half: the mean is the instrument's
