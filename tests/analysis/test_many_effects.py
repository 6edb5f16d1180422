"""Arms with many effects: which names count as true."""

import pytest

from analysis.many_effects import OF_ARM, card, names

TRUTH = {
    "where": [
        {"effect": "backlash", "site": "joint 2", "also": []},
        {"effect": "thermal-drift", "site": "time", "also": ["arm"]},
        {"effect": "eccentricity", "site": "joint 5"},
    ],
    "lambda": {"each": {"backlash": 40.0, "thermal-drift": 8.0, "eccentricity": 31.0}},
}


def record(**named):
    """A record in which effects are named: probability and site of each."""
    return {
        "named": [{"effect": e.replace("_", "-"), "sites": [site]} for e, (_, site) in named.items()],
        "probability": {"null": 0.0, "unknown": 0.95}
        | {e.replace("_", "-"): p for e, (p, _) in named.items()},
    }


@pytest.mark.parametrize(
    ("named", "expected"),
    [
        ({"backlash": (0.95, "joint 2")}, [(True, True)]),
        ({"backlash": (0.95, "joint 3")}, [(True, False)]),
        ({"thermal_drift": (0.9, "arm")}, [(True, True)]),
        ({"artefact": (0.99, "cube")}, [(False, False)]),
        ({"backlash": (0.89, "joint 3")}, []),
    ],
)
def test_a_sure_name_is_there_and_at_its_site(named, expected):
    assert [(n.there, n.at_site) for n in names(TRUTH, record(**named))] == expected


def test_the_card_counts_names_and_effects():
    said = record(backlash=(0.95, "joint 2"), thermal_drift=(0.92, "base"), artefact=(0.99, "cube"))
    lines = list(card([(TRUTH, said), (TRUTH, record())]))
    assert lines[1] == "names with P from 0.9: 3, there: 2, and at their site: 1"
    assert lines[2] == "effects with lambda from 0 to 30: 2, with P from 0.9: 1"
    assert lines[3] == "effects with lambda from 30 to inf: 4, with P from 0.9: 1"


def test_effects_of_the_arm_do_not_begin_in_a_session():
    assert {m.__name__ for m in OF_ARM}.isdisjoint({"step", "payload", "compliance", "lobing", "artefact"})
