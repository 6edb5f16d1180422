"""The study of sessions of our own in small: what they state wrongly, and what counts as a false name."""

from dataclasses import fields

import pytest

from analysis import own_sessions as own
from bayescal.dataset import Dataset
from bayescal.simulation import Options, simulate

CASE = "masses +-15 %, 2 kg on half the contacts"


def test_what_is_stated_is_wrong_and_nothing_else():
    seed = 1010000
    dataset = simulate(Options(seed=seed, contacts=60, repeats=0, placements=0)).dataset
    changed = own.wrongly_stated(dataset, seed, stated=0.75, masses=0.15)
    assert changed.noise.contact == pytest.approx(0.75 * dataset.noise.contact)
    off = changed.robot.masses / dataset.robot.masses - 1
    assert 0.02 < abs(off).max() <= 0.15
    same = own.wrongly_stated(dataset, seed)
    assert all(getattr(same, f.name) is getattr(dataset, f.name) for f in fields(Dataset))


def test_false_names_are_counted_and_told(tmp_path, monkeypatch):
    def diagnosed(seed):
        return [{"case": CASE, "seed": seed, "verdict": "named", "named": ["step"] if seed == 110003 else []}]

    monkeypatch.setattr(own, "diagnosed", diagnosed)
    begin, end = own.MARKS
    (tmp_path / "page.md").write_text(f"before\n{begin}\n{end}\nafter\n", encoding="utf-8")
    arguments = ["--seeds", "40", "--workers", "1", "--page", str(tmp_path / "page.md")]
    own.main([*arguments, "--runs", str(tmp_path / "runs")])
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert f"| {CASE} | 1 of 40, 2 % (0 to 13) | 110003: step | 0 | at most 5 % |" in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert (tmp_path / "runs" / "records.json").is_file()
