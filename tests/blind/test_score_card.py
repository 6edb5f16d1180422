"""The score card: a screen, a page, a folder that is whole, and pictures whatever was judged."""

import csv
import json

import pytest
from made_up_worlds import answer, many, null, perfect, shrunk, silent, strange, tracked, truth
from rich.console import Console

from analysis.blind.card import BEGIN, END, between, page, tables, terminal
from analysis.blind.files import MISSES, SCORE, write_score
from analysis.blind.pictures import PICTURES, said_of
from analysis.blind.score import figures
from bayescal.errors import BayescalError

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


def printed(found):
    console = Console(width=100, highlight=False, force_terminal=False)
    with console.capture() as capture:
        console.print(terminal(found))
    return capture.get()


def test_terminal_is_one_screen():
    text = printed(figures(many(*SOME)))
    lines = text.splitlines()
    assert len(lines) <= 65
    assert max(map(len, lines)) <= 100
    for words in (
        "12 simulated sessions", "2 noise only", "1 of 2, 50 % (9 to 91)", "at most 2 %", "by detectability",
        "probability stated", "log score", "misses (3)", "false name 1", "over 100",
    ):  # fmt: skip
        assert words in text


def test_sessions_with_a_tracker_have_a_row_of_their_own():
    assert "tracker" not in printed(figures(many(*SOME)))
    text = " ".join(printed(figures(many(*CASES["with a tracker"]))).split())
    assert "tracker, lambda 0 or from 30: correct 1 of 2, 50 % (9 to 91) at least 90 %" in text
    assert "points: RMS after refit / true model 1.10" in text
    assert "points: achieved / predicted reduction 1.00" in text


def test_no_world_is_no_score_and_no_crash():
    text = printed(figures([]))
    assert text.startswith("0 simulated sessions")
    assert "no cases" in text


def test_page_holds_figures_misses_and_where_they_are_from():
    text = tables(figures(many(*SOME)), ABOUT, ["blind-lambda.png"])
    assert "Frozen: at commit 0123abc." in text
    assert "truth `a1a1a1a1a1a1a1a1`" in text
    assert "12 simulated sessions of seed 2026" in text
    assert "(pictures/blind-lambda.png)" in text
    assert "| noise only: an effect was named | 1 of 2, 50 % (9 to 91) | at most 2 % | no |" in text
    assert "- 009: step at joint 4, joint angle (lambda 200): named, lobing" in text
    assert "009 (20.0 to 30.0 µm)" in text
    assert "date of freezing the thresholds not recorded" in tables(figures(many(*SOME)), {})


@pytest.mark.parametrize("case", CASES)
def test_folder_is_whole_and_its_pictures_drawn(case, tmp_path):
    rs = many(*CASES[case])
    found = figures(rs)
    assert printed(found)
    names = write_score(rs, found, ABOUT, tmp_path / "score")
    assert {p.name for p in (tmp_path / "score").glob("[!.]*")} == set(names) == {SCORE, MISSES, *PICTURES}
    for name in PICTURES:
        picture = (tmp_path / "score" / name).read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) > 10_000
    kept = json.loads((tmp_path / "score" / SCORE).read_text(), parse_constant=pytest.fail)
    assert kept["about"] == ABOUT
    assert len(kept["records"]) == kept["worlds"] == len(rs)
    with (tmp_path / "score" / MISSES).open() as stream:
        assert [line["world"] for line in csv.DictReader(stream)] == [m["world"] for m in found["misses"]]


def test_an_earlier_score_is_replaced_and_another_folder_left_alone(tmp_path):
    rs = many(*SOME)
    found = figures(rs)
    for _ in range(2):
        assert write_score(rs, found, ABOUT, tmp_path / "score", pictures=False) == (SCORE, MISSES)
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "mine.txt").write_text("mine")
    with pytest.raises(BayescalError, match=r"did not write: mine\.txt"):
        write_score(rs, found, ABOUT, tmp_path / "thesis", pictures=False)
    with pytest.raises(ValueError, match="JSON"):
        write_score(rs, found | {"worlds": float("nan")}, ABOUT, tmp_path / "bad", pictures=False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["score", "thesis"]


def test_page_keeps_what_is_around_and_takes_the_pictures(tmp_path):
    folder, text = tmp_path / "score", tmp_path / "page.md"
    folder.mkdir()
    (folder / "blind-lambda.png").write_bytes(b"picture")
    text.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    found = figures(many(*SOME))
    page(text, found, ABOUT, folder)
    new = text.read_text(encoding="utf-8")
    assert new.startswith(f"before\n{BEGIN}\n")
    assert new.endswith(f"\n{END}\nafter\n")
    assert "\nold\n" not in new
    assert "blind-confusion.png" not in new
    assert (tmp_path / "pictures" / "blind-lambda.png").read_bytes() == b"picture"
    page(text, found, ABOUT, folder)
    assert text.read_text(encoding="utf-8") == new
    text.write_text("no marks\n", encoding="utf-8")
    with pytest.raises(BayescalError, match="the page has no marks for the tables"):
        page(text, found, ABOUT, folder)
    assert text.read_text(encoding="utf-8") == "no marks\n"
    with pytest.raises(BayescalError, match="No such file"):
        between(tmp_path / "none.md", (BEGIN, END), "")


def test_what_was_said_of_what():
    said = [pair for r in many(*SOME) for pair in said_of(r)]
    assert said.count(("step", "step")) == 7
    assert ("step", "lobing") in said
    assert ("noise only", "step") in said
    assert said.count(("unmodelled", "noise only")) == 1
    assert ("unmodelled", "unmodelled") in said
