"""The card of real sessions in small: two sessions with made-up records, and one half that is diagnosed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis import real_card, real_halves, real_names
from bayescal.model.scene import Scene


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


def test_the_card_compares_each_session_with_what_is_wanted():
    random, late, inside, better, again = (
        [cell.strip() for cell in line.split("|")[2:-1]]
        for line in real_card.card(SESSIONS, HALVES).splitlines()[2:]
    )
    assert random[1:] == ["1.000 (1.00 to 1.00)", "**0.500 (0.50 to 0.50)**", "0.750 (0.50 to 1.00)"]
    assert late[1] == "**1.650 (1.00 to 2.30)**"
    assert late[2] == "1.100 (1.00 to 1.20)"
    assert inside[1:] == ["95.0 %", "**80.0 %**", "**87.5 %**"]
    assert better[1:] == ["2 of 2", "**0 of 1**", "**2 of 3**"]
    assert again[1:] == ["2 of 2", "0 of 1", "2 of 3"]


def test_the_page_of_names_counts_sure_names_and_others():
    counts = real_names.table(HALVES).splitlines()
    assert counts[2] == "| probability above 0.95 | 3 | 2 (0.67) | 2 (0.67) |"
    assert counts[3] == "| all others | 1 | 0 (0.00) | 0 (0.00) |"
    assert "| two 1b | named | | | | |" in counts
    assert "| | backlash x2 | 0.99 | 100.0 | 90.0 | backlash |" in counts
    assert "| | step x2 | 0.60 | 80.0 | 90.0 | no |" in counts


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
def wavy(tracker):
    """A session of points with a wave of joint 5 that no geometry absorbs."""
    d = tracker(seed=3, count=80).dataset
    readings = d.measurements.readings.copy()
    readings[:, 4] += 1e-3 * np.sin(2 * readings[:, 4])
    return replace(d, measurements=replace(d.measurements, readings=readings, command=None))


def test_a_half_is_diagnosed_alone_and_predicts_the_other(wavy, monkeypatch):
    monkeypatch.setattr(real_names, "read_dataset", lambda folder: wavy)
    found = real_names.made(real_names.Task(Path("arm"), 0, 0))
    (name,) = found["names"]
    assert (found["session"], name["effect"]) == ("arm", "second-harmonic")
    assert name["without_um"] == pytest.approx(found["before_um"])
    assert found["after_um"] < 0.3 * found["before_um"]


def test_the_stated_uncertainty_of_a_half_holds_for_the_other(wavy):
    (one, other) = next(real_halves.splits(wavy)).halves
    functions = real_halves.families(Scene(wavy).circumstances(np.concatenate([one, other])))
    found = real_halves.half(wavy, one, other, functions)
    assert 0.9 <= found.inside[1] <= 1.0
