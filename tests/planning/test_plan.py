"""A whole plan, of few candidates."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bayescal.dataset.types import Box
from bayescal.errors import BayescalError
from bayescal.planning.plan import plan
from bayescal.planning.pool import Setup
from bayescal.planning.result import BOTH, DISTANCES, GAP, REPEAT, VALIDATE, Plan
from bayescal.planning.setup import continued, read_setup

EXAMPLE = Path(__file__).parents[2] / "data" / "lrmate200ic-cube"


@cache
def example() -> Setup:
    """The set-up of the example, with the first placement of its spheres, and a mass of 2 kg."""
    dataset = read_setup(EXAMPLE).dataset
    targets = tuple(t for t in dataset.targets if t.name.partition("@")[2] in ("", "1"))
    names = {t.name for t in targets}
    certificates = tuple(c for c in dataset.certificates if names.issuperset(c.targets))
    setup = continued(replace(dataset, targets=targets, certificates=certificates))
    return replace(setup, payloads=(2.0,))


@pytest.fixture(scope="module")
def planned() -> Plan:
    """100 contacts for distances and for the gap, of 300 candidates."""
    return plan(example(), 100, count=300)


def test_rows(planned: Plan) -> None:
    """Half of the contacts are for distances; both of a repeat share name and pose, apart in time."""
    m, purpose = planned.session.measurements, np.array(planned.purpose)
    assert {p: int(np.sum(purpose == p)) for p in (DISTANCES, GAP, REPEAT)} == {
        DISTANCES: 45,
        GAP: 45,
        REPEAT: 10,
    }
    assert np.all((m.role == "validate") == (purpose == VALIDATE))
    assert len(set(m.ids)) == len(m.ids)
    assert m.repeat is not None
    for name in set(m.repeat.tolist()) - {""}:
        a, b = np.flatnonzero(m.repeat == name)
        np.testing.assert_array_equal(m.readings[a], m.readings[b])
        assert b - a > 1
    assert np.all(np.diff(m.time) >= 0)  # type: ignore[arg-type]


def test_ways_between_contacts(planned: Plan) -> None:
    """Every row has a collision-free path, of which some pass further points."""
    numbers = [-1 if way is None else len(way) for way in planned.via]
    assert len(numbers) == len(planned.purpose)
    assert min(numbers) >= 0
    assert 0 < sum(n > 0 for n in numbers) < 0.6 * len(numbers)


def test_better_than_random(planned: Plan) -> None:
    """Distances and the detectability of effects are better than those of random selections."""
    assert all(e.u < e.u_random for e in planned.expected)
    assert planned.equals_random > 150
    smaller = [np.log(d.smallest / d.smallest_random) for d in planned.detectable if np.isfinite(d.smallest)]
    assert np.exp(np.nanmean(smaller)) < 0.75
    for e in planned.expected:
        assert sum(e.shares.values()) == pytest.approx(1.0)


def test_for_distances_is_more_accurate(planned: Plan) -> None:
    """A plan for distances alone is more accurate than one for both, which shows effects better."""
    alone = plan(example(), 100, DISTANCES, count=300)
    assert planned.aim == BOTH
    assert set(alone.purpose) == {DISTANCES, VALIDATE}
    assert alone.expected[0].u < planned.expected[0].u
    own = {(d.effect, d.site): d.smallest for d in alone.detectable}
    ratio = [
        np.log(d.smallest / own[d.effect, d.site]) for d in planned.detectable if np.isfinite(d.smallest)
    ]
    assert np.nanmean(ratio) < 0


def test_levers() -> None:
    """Without its lever no contact has a payload; a volume that is partly out of reach is noted."""
    setup = replace(example(), volume=Box(np.array([0.9, 0.0, 0.4]), np.full(3, 0.5)))
    one = plan(setup, 60, GAP, levers=("approach",), effects=("geometry",), count=300)
    assert one.expected[1].over == "volume of interest"
    assert any("of the volume of interest" in w for w in one.warnings)
    payload = one.session.measurements.payload
    assert payload is None or not np.any(payload)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"aim": "gaps"}, "--for"),
        ({"levers": ("speed",)}, "--levers"),
        ({"order": "faces"}, "--order"),
        ({"contacts": 0}, "--contacts"),
        ({"contacts": 20}, "unknowns"),
    ],
)
def test_refusals(options: dict[str, object], words: str) -> None:
    """Options that are not possible, and fewer contacts than unknowns, are refused."""
    with pytest.raises(BayescalError, match=words):
        plan(example(), **{"count": 100, **options})  # type: ignore[arg-type]
