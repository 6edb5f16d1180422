"""The knock-outs in small: what is taken out of a simulated session is found, and a miss has its reason."""

import json

import foreign
import pytest

from analysis import knock_out, knock_out_page
from bayescal.dataset import read_dataset, write_dataset
from bayescal.simulation import Options, simulate

README = """# A session

| held out, mm | mean | rms | max |
| --- | --- | --- | --- |
| nominal | 1.5 | 1.75 | 3 |
| **geometric** | 0.2 | 0.25 | 0.5 |
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One simulated session through the command, and the page that it writes."""
    folder = tmp_path_factory.mktemp("knock-out")
    options = Options(contacts=120, later=40, repeats=0, spheres=2, placements=2, seed=4)
    write_dataset(simulate(options).dataset, folder / "real" / "session")
    (folder / "real" / "session" / "README.md").write_text(README, encoding="utf-8")
    marks = knock_out_page.BEGIN, knock_out_page.END
    (folder / "page.md").write_text("before\n{}\nold\n{}\nafter\n".format(*marks), encoding="utf-8")
    knock_out.main(arguments(folder))
    return folder


def arguments(folder):
    given = ["--real", folder / "real", "--runs", folder / "runs", "--out", folder / "page.md"]
    return [*map(str, given), "--joints", "4", "--workers", "1"]


def test_what_is_taken_out_is_found(run):
    records = json.loads((run / "runs" / "records.json").read_text(encoding="utf-8"))
    assert list(records) == ["session | whole", "session | compliance", "session | geometry at joint 4"]
    whole, compliance, joint = records.values()
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


def test_page_keeps_what_is_around(run):
    text = (run / "page.md").read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "\nold\n" not in text
    assert "all parts: 2 of 2 named" in text
    assert "| geometry at joint 4 | " in text
    assert "| session, 40 planes | nominal |" in text


def test_an_interrupted_run_goes_on(run, monkeypatch):
    before = (run / "page.md").read_text(encoding="utf-8")
    path = run / "runs" / "records.json"
    records = json.loads(path.read_text(encoding="utf-8"))
    last = records.popitem()[1]
    path.write_text(json.dumps(records), encoding="utf-8")
    made = []
    monkeypatch.setattr(knock_out, "made", lambda task: made.append(task.key) or last)
    knock_out.main(arguments(run))
    assert made == ["session | geometry at joint 4"]
    assert (run / "page.md").read_text(encoding="utf-8") == before


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
    found = knock_out.knocked(read_dataset(foreign.REAL / "panda-ball-socket-3"), "geometry at joint 4")
    assert found["named"][0].items() >= {"effect": "geometry", "site": "joint 4"}.items()
    held = found["validation"]["points"]
    assert held["before_um"] > 4 * held["whole_um"]
    assert held["after_um"] == pytest.approx(held["predicted_after_um"], rel=0.05)
    assert held["before_um"] == pytest.approx(held["predicted_before_um"], rel=0.05)
