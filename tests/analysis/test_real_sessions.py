"""The page of real sessions in small: sockets at three places, each of them kept back in turn."""

import json
from dataclasses import replace
from pathlib import Path

import foreign
import numpy as np
import pytest
from kind_sessions import CONTACT, cone, of_pieces
from sessions import misread, plain, wavy, with_columns, with_rows

from analysis import (
    knock_out,
    knock_out_page,
    real_card,
    real_halves,
    real_names,
    real_sessions,
    real_sessions_page,
    real_steps,
)
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
    given = ["--real", folder / "real", "--runs", folder / "runs", "--out", folder / "page.md"]
    return [*map(str, given)]


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


# --- The knock-outs in small: what is taken out of a simulated session is found, and a miss has its reason.

README = """# A session

| held out, mm | mean | rms | max |
| --- | --- | --- | --- |
| nominal | 1.5 | 1.75 | 3 |
| **geometric** | 0.2 | 0.25 | 0.5 |
"""


@pytest.fixture(scope="module")
def knock_out_run(tmp_path_factory, renewed):
    """One simulated session through the command, and the page that it writes."""
    folder = tmp_path_factory.mktemp("knock-out")
    options = Options(contacts=80, later=30, repeats=0, spheres=2, placements=2, seed=4)
    write_dataset(plain(simulate(options).dataset), folder / "real" / "session")
    (folder / "real" / "session" / "README.md").write_text(README, encoding="utf-8")
    renewed(knock_out_page.MARKS, lambda _: knock_out.main(knock_out_arguments(folder)), folder)
    return folder


def knock_out_arguments(folder):
    return [*arguments(folder), "--joints", "4", "--workers", "1"]


def test_what_is_taken_out_is_found(knock_out_run):
    found = records(knock_out_run)
    assert list(found) == ["session | whole", "session | compliance", "session | geometry at joint 4"]
    whole, compliance, joint = found.values()
    assert whole["verdict"] == "null"
    assert whole["joints"] == [1, 2, 3, 4, 5]
    assert [step["adds"] for step in whole["levels"]] == ["nominal", "geometry", "compliance"]
    assert whole["yardsticks"][1] == {"model": "geometric", "mean": 0.2, "rms": 0.25, "max": 0.5}
    for r in (compliance, joint):
        assert knock_out_page.right(r)
        assert r["probability"] > 0.99
        held = r["validation"]["planes"]
        assert held["after_um"] < 1.1 * held["whole_um"] < 0.2 * held["before_um"]
        assert held["before_um"] == pytest.approx(held["predicted_before_um"], rel=0.15)
        assert r["lambda"] > 1000


def test_the_page_has_what_was_found(knock_out_run):
    text = (knock_out_run / "page.md").read_text(encoding="utf-8")
    assert "all parts: 2 of 2 named" in text
    assert "| geometry at joint 4 | " in text
    assert "| session, 30 planes | nominal |" in text


def test_an_interrupted_run_goes_on(knock_out_run, monkeypatch):
    given = knock_out_arguments(knock_out_run)
    check_continued(knock_out_run, knock_out, given, "session | geometry at joint 4", monkeypatch)


def missed(**more):
    """A record of something that was not named, made up."""
    held = {"before_um": 90.0, "after_um": 80.0, "whole_um": 60.0}
    return {
        "without": "geometry at joint 4", "named": [], "verdict": "unknown", "missing": "", "footnotes": [],
        "lambda": 500.0, "claimed_nats": 0.0, "possible_nats": 100.0, "leading": ["unknown"],
        "validation": {"points": held},
    } | more  # fmt: skip


OTHER = [{"effect": "eccentricity", "site": "joint 4", "probability": 0.9}]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"lambda": 20.0}, "not detectable"),
        ({"missing": "no contact would show it"}, "not detectable"),
        ({"footnotes": ["geometry explains the fitted contacts but spoils"]}, "increased validation errors"),
        ({"footnotes": ["geometry: 3 um, 2 % of what was found"]}, "footnote"),
        ({"footnotes": ["step: 3 um, 2 % of what was found"]}, "unmodelled effect"),
        (
            {"claimed_nats": 101.0, "validation": {"points": {"before_um": 130.0, "whole_um": 60.0}}},
            "more evidence than possible",
        ),
        ({"validation": {"points": {"before_um": 61.0, "whole_um": 60.0}}}, "no effect on validation"),
        (
            {
                "named": OTHER,
                "validation": {"points": {"before_um": 90.0, "after_um": 61.0, "whole_um": 60.0}},
            },
            "other effects explain it",
        ),
        ({"named": OTHER}, "are preferred"),
        ({"leading": [*"abcdef", "unknown"]}, "the maximum of a set"),
        ({"verdict": "ambiguous"}, "not decided"),
    ],
)
def test_a_miss_has_its_reason(more, words):
    assert words in knock_out_page.why(missed(**more))


def test_only_the_right_name_at_the_right_place_counts():
    here = {"effect": "geometry", "site": "joint 4", "probability": 1.0}
    assert knock_out_page.right(missed(named=[*OTHER, here]))
    assert not knock_out_page.right(missed(named=[here | {"site": "joint 5"}]))
    assert knock_out_page.right(
        missed(without="compliance", named=[here | {"effect": "compliance", "site": ""}])
    )
    assert knock_out_page.why(missed(named=[here])) == ""


@foreign.needs()
def test_a_joint_of_a_real_arm():
    """Of every third row, and without a scan of gear ratios."""
    session = read_dataset(foreign.REAL / "panda-ball-socket-3")
    every_third = with_rows(session, np.arange(0, len(session.measurements.ids), 3))
    found = knock_out.knocked(plain(every_third), "geometry at joint 4")
    assert found["named"][0].items() >= {"effect": "geometry", "site": "joint 4"}.items()
    held = found["validation"]["points"]
    assert held["before_um"] > 4 * held["whole_um"]
    assert held["after_um"] == pytest.approx(held["predicted_after_um"], rel=0.05)
    assert held["before_um"] == pytest.approx(held["predicted_before_um"], rel=0.05)


# --- The card of real sessions in small: two sessions with made-up records, and one half that is diagnosed.


def split(kind, chi2, inside=0.95):
    return {"kind": kind, "chi2": (9.0, chi2), "inside": (0.5, inside)}


def half(session, which, *names, after=90.0):
    """Names as (effect, probability, RMS of the other half without it)."""
    keys = ("effect", "probability", "without_um")
    told = [dict(zip(keys, n, strict=True)) | {"name": f"{n[0]} x2"} for n in names]
    found = {"verdict": "named", "before_um": 120.0, "after_um": after, "names": told}
    return {"session": session, "split": 0, "half": which} | found


SESSIONS = [
    {"session": "one", "splits": [split("random", 1.0), split("time", 1.0), split("workspace", 2.3)]},
    {"session": "two", "splits": [split("random", 0.5), split("time", 1.0), split("workspace", 1.2, 0.8)]},
]
HALVES = [
    half("one", 0, ("backlash", 0.99, 100.0), ("step", 0.6, 80.0)),
    half("one", 1, ("backlash", 0.97, 95.0)),
    half("two", 0, ("bending", 0.99, 85.0)),
    half("two", 1),
]
WORKSPACE = half("two", -1) | {"kind": "workspace", "inside": [0.85, 0.9]}


def test_the_card_compares_each_session_with_what_is_wanted():
    halves = [*HALVES, WORKSPACE]
    random, _, far, within, _, inside, named, beyond, better, again = (
        [cell.strip() for cell in line.split("|")[2:-1]]
        for line in real_card.card(SESSIONS, halves).splitlines()[2:]
    )
    assert random[1:] == ["1.000 (1.00 to 1.00)", "**0.500 (0.50 to 0.50)**", "0.750 (0.50 to 1.00)"]
    assert far[1:] == ["**2.300 (2.30 to 2.30)**", "1.200 (1.20 to 1.20)", "**1.750 (1.20 to 2.30)**"]
    assert within[1:] == ["95.0 %"] * 3
    assert inside[1:] == ["95.0 %", "**80.0 %**", "**87.5 %**"]
    assert named[1:] == ["-"] * 3
    assert beyond[1:] == ["-", "**90.0 %**", "**90.0 %**"]
    assert better[1:] == ["2 of 2", "**0 of 1**", "**2 of 3**"]
    assert again[1:] == ["2 of 2", "0 of 1", "2 of 3"]


def test_the_page_of_names_counts_sure_names_and_others():
    counts = real_names.table([*HALVES, WORKSPACE]).splitlines()
    assert counts[2] == "| probability above 0.95 | 3 | 2 (0.67) | 2 (0.67) |"
    assert counts[3] == "| all others | 1 | 0 (0.00) | 0 (0.00) |"
    assert "| workspace | two | 85 % | 90 % |" in counts
    assert "| two 1b | named |  |  |  |  |" in counts
    assert "|  | backlash x2 | 0.99 | 100.0 | 90.0 | backlash |" in counts
    assert "|  | step x2 | 0.60 | 80.0 | 90.0 | no |" in counts


def test_records_that_are_there_are_used(tmp_path, capsys):
    for module, keys, records in (
        (real_halves, ("one", "two"), SESSIONS),
        (real_names, ("one | 0 | 0", "one | 0 | 1", "two | 0 | 0", "two | 0 | 1"), HALVES),
    ):
        folder = tmp_path / "runs" / module.RUNS.name
        folder.mkdir(parents=True)
        (folder / "records.json").write_text(json.dumps(dict(zip(keys, records, strict=True))))
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "dataset.yaml").touch()
    page = tmp_path / "card.md"
    real_card.main(["--real", str(tmp_path), "--runs", str(tmp_path / "runs"), "--out", str(page)])
    text = real_card.card(SESSIONS, HALVES)
    assert capsys.readouterr().out.strip() == text
    assert text in page.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def waved(tracker):
    return wavy(tracker(seed=3, count=80).dataset)


def test_a_half_is_diagnosed_alone_and_predicts_the_other(waved, monkeypatch):
    monkeypatch.setattr(real_names, "read_dataset", lambda _: waved)
    found = real_names.made(real_names.Task(Path("arm"), 0, 0))
    (name,) = found["names"]
    assert (found["session"], name["effect"]) == ("arm", "second-harmonic")
    assert name["without_um"] == pytest.approx(found["before_um"])
    assert found["after_um"] < 0.3 * found["before_um"]
    assert 0.9 <= found["inside"][1] <= 1.0


def test_the_stated_uncertainty_of_a_half_holds_for_the_other(waved):
    (one, other) = next(real_halves.splits(waved)).halves
    functions = real_halves.families(Scene(waved).circumstances(np.concatenate([one, other])))
    found = real_halves.half(waved, one, other, functions)
    assert 0.9 <= found.inside[1] <= 1.0


# --- Steps added to sessions.


def test_a_shifted_base_is_seen_by_an_instrument_and_in_the_readings(waved, sockets):
    """Both are the same displacement of the arm's points in its frame."""
    by = np.array([3e-4, -2e-4, 5e-4])
    (t,), row = waved.targets, 40
    moved = real_steps.shifted(waved, row, by).measurements.xyz - waved.measurements.xyz
    np.testing.assert_allclose(moved[:row], 0.0)
    np.testing.assert_allclose(
        moved[row:] @ rpy_matrix(t.values["rpy"]).T, by + np.zeros((40, 3)), atol=1e-12
    )
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
        mine = rows[target[rows] == target[row]]
        assert 3 <= np.sum(mine < row) <= 9
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


def test_the_page_counts_steps_within_their_intervals():
    def record(name, noncentrality, *events):
        return {
            "session": name, "lambda": noncentrality, "row": 50, "events": events, "widths": [3] * len(events)
        }  # fmt: skip

    found = [
        record("one", 5.0), record("one", 50.0, (52, [49, 53])), record("one", 500.0, (90, [89, 91])),
        record("two", 500.0, (20, [19, 21]), (50, [48, 51])),
    ]  # fmt: skip
    lines = real_steps.table(found).splitlines()
    assert lines[2] == "| one | 0 of 1 | - | 1 of 1 | 0 of 1 | 4 |"
    assert lines[3] == "| two | - | - | - | 1 of 1 | 4 |"
    assert lines[4] == "| **all** | 0 of 1 | - | 1 of 1 | 1 of 2 | 4 |"
