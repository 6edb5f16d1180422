"""The headline, its footnotes, `effects` and the table of probabilities follow from one rule.

Every effect that is as likely as not is in the headline or in a footnote, and no other; a verdict `named` or
`named+unexplained` has a name, and none of `effects` is less likely than not.
"""

import re
from dataclasses import replace

import pytest
from gap_diagnoses import diagnosis
from hypothesis import given, settings
from hypothesis import strategies as st

from bayescal.effects import EFFECTS
from bayescal.gap.explain import settled
from bayescal.gap.result import VERDICTS, Named, Verdict
from bayescal.reporting.gap.record import gap_record

NAMES = tuple(EFFECTS)
LABEL = {"unmodelled effect": "unknown"}


def stated(record):
    """Effects that the headline or a footnote states; the latter begin with their effect."""
    found = set()
    for line in record["words"]:
        found |= set(re.findall(r"\(([a-z-]+), probability", line))
        found |= set(re.findall(r"found: ([a-z-]+) in .*; probability", line))
        found |= {LABEL.get(n, n) for n in re.findall(r"not named: (.+?) \(probability", line)}
        if line.startswith(("Ambiguous", "Also: ", "No effect")):
            assert not any(re.search(rf"\b{name}\b", line) for name in NAMES), line
    found |= {note.partition(" ")[0].rstrip(":") for note in record["footnotes"]} & set(NAMES)
    return found


def check(record):
    """The rule, for a record of any diagnosis."""
    p, kind = record["probability"], record["verdict"]
    likely = {n for n in p if p[n] >= 0.5 and n not in ("null", "unknown")}
    assert stated(record) - {"unknown"} == likely
    assert set(record["effects"]) <= {n for n in p if p[n] >= 0.5}
    assert bool(record["named"]) or not kind.startswith("named")
    assert record["effects"] == (["unknown"] if kind == "unknown" else [n["effect"] for n in record["named"]])
    if p["unknown"] >= 0.5:
        said = any("nmodelled effect" in line or "further effect" in line for line in record["words"])
        assert said
    for n in record["named"]:
        assert n["probability"] == pytest.approx(p[n["effect"]])


@pytest.fixture(scope="module")
def session(cube):
    return cube(seed=1, count=40).dataset


probabilities = st.dictionaries(st.sampled_from(NAMES), st.floats(0.001, 0.999), min_size=1, max_size=6)


@settings(deadline=None, max_examples=80)
@given(probabilities, st.floats(0.001, 0.999), st.sampled_from(VERDICTS), st.data())
def test_headline_effects_and_probabilities_are_of_one_rule(session, p, unknown, kind, data):
    likely = sorted(n for n in p if p[n] >= 0.5)
    some = data.draw(st.lists(st.sampled_from(likely), unique=True)) if likely else []
    names = [] if kind in ("null", "unknown") else some
    small = [] if kind == "null" else [n for n in likely if n not in some][:1]
    p = {"null": 0.2, "unknown": unknown, **p}
    kind = settled(kind, bool(names), p)
    verdict = Verdict(
        kind, tuple(Named(n, n, (), "", p[n], 9.0) for n in names), p, (*p,), (),
        tuple(f"{n}: RMS 1.0 µm, 2 % of the explained variance" for n in small), {}, (),
    )  # fmt: skip
    check(gap_record(replace(diagnosis(session, kind), verdict=verdict)))


@pytest.mark.parametrize(
    ("kind", "named", "unknown", "expected"),
    [
        ("named", False, 0.6, "unknown"),
        ("named", False, 0.4, "ambiguous"),
        ("named+unexplained", False, 0.5, "unknown"),
        ("named+unexplained", True, 0.1, "named+unexplained"),
        ("unknown", False, 0.499, "ambiguous"),
        ("unknown", False, 0.5, "unknown"),
        ("ambiguous", True, 0.9, "ambiguous"),
        ("null", False, 0.7, "null"),
    ],
)
def test_a_verdict_is_one_that_its_probabilities_support(kind, named, unknown, expected):
    assert settled(kind, named, {"unknown": unknown}) == expected
