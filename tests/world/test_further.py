"""A further round of a simulated session: the same machine, other contacts."""

import csv
import io
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from analysis.world.build import make
from analysis.world.further import Wanted, further
from analysis.world.mix import recipe, stage
from analysis.world.scene import NAMES

SEED = 101


def number_of(effects: set[str], what: str = "cube") -> int:
    """The first session with one of these effects alone."""
    return next(
        k
        for k in range(400)
        if (drawn := recipe(SEED, k))[0] in ("single", "outside")
        and drawn[1][0].__name__ in effects
        and stage(SEED, k, 4, drawn[1]) == what
    )


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def wanted(made, count: int, payload: float = 0.0) -> list[Wanted]:
    """Contacts of the first round once more, from a little off the surface."""
    s = made.world.session
    at = np.flatnonzero((s.phase == 0) & (s.payload == payload))[:count]
    return [Wanted(NAMES[s.target[k]], s.start[k] - 1e-3 * s.way[k], s.velocity[k], payload) for k in at]


@pytest.mark.parametrize(
    "effects", [{"hysteresis", "hardening"}, {"latency"}, {"step"}, {"payload"}], ids=lambda e: min(e)
)
def test_the_first_round_stays_and_further_rows_are_measured(effects) -> None:
    made = make(SEED, number_of(effects))
    old, count = rows_of(made.texts["measurements.csv"]), 10
    rows = rows_of(further(made, wanted(made, count, 0.0), np.random.default_rng(0)))
    assert rows[: len(old)] == old
    new = rows[len(old) :]
    assert [r["role"] for r in new] == ["calibrate"] * count
    assert len({r["id"] for r in rows}) == len(rows)
    assert all(float(a["time_s"]) < float(b["time_s"]) for a, b in pairwise(rows))


def test_the_same_contacts_are_read_again_but_for_noise() -> None:
    """Without effects that depend on time, the readings of a repeated contact differ by the noise."""
    made = make(SEED, number_of({"encoder_scale", "bending", "base_compliance", "coupling"}))
    rows = rows_of(further(made, wanted(made, 12), np.random.default_rng(0)))
    joints = [f"j{k}_deg" for k in range(1, 7)]
    q = np.radians([[float(r[j]) for j in joints] for r in rows])
    s = made.world.session
    at = np.flatnonzero((s.phase == 0) & (s.payload == 0))[:12]
    gap = made.world.gap(np.concatenate([q[: len(s.time)]]), made.acts)
    assert np.max(np.abs(gap - made.noise)) < 1e-7
    again = np.array(q[: len(s.time)])
    again[at] = q[len(s.time) :]
    off = made.world.gap(again, made.acts)[at]
    assert 0 < np.max(np.abs(off)) < 6 * made.sigma


def test_a_payload_hangs_on_the_arm() -> None:
    made = make(SEED, number_of({"bending"}))
    bare = wanted(made, 8)
    loaded = [replace(w, payload=2.0) for w in bare]
    q = [
        np.array([float(r["j2_deg"]) for r in rows_of(further(made, w, np.random.default_rng(0)))[-8:]])
        for w in (bare, loaded)
    ]
    assert np.max(np.abs(q[1] - q[0])) > 1e-4


def test_a_session_that_a_further_round_would_change_is_refused() -> None:
    made = make(SEED, number_of({"shoved_target"}))
    with pytest.raises(RuntimeError, match="would change what shoved-target did"):
        further(made, wanted(made, 5), np.random.default_rng(0))
