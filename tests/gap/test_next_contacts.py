"""Contacts that are advised can be sent: target, readings, motion, payload; repeats say what they repeat."""

import csv
import io
import json
from types import SimpleNamespace

import numpy as np
import pytest

import bayescal as bc
from bayescal.gap.design.advise import next_contacts
from bayescal.gap.design.candidate_contacts import AGAIN
from bayescal.gap.result import Advice
from bayescal.reporting.gap.contacts import first_contacts, records, table_of_contacts


def advised(dataset, what, velocity=None, payload=None):
    """Advice of three contacts at the rows 7, 2 and 30 of a session."""
    rows = np.array([2, 7, 11, 30])
    chosen = SimpleNamespace(what=what, pose=rows, velocity=velocity, payload=payload, measured=False)
    contacts = next_contacts(dataset, chosen, [1, 0, 3])
    own = Advice(("bending", "coupling"), what, (), 1.0, 9.0, contacts)
    return SimpleNamespace(dataset=dataset, advice=(own,)), rows[[1, 0, 3]]


@pytest.fixture(scope="module")
def dataset(cube):
    return cube(seed=1).dataset


def test_a_repeat_is_the_contact_of_the_session(dataset):
    m = dataset.measurements
    gap, rows = advised(dataset, AGAIN, m.velocity[[2, 7, 11, 30]])
    table = list(csv.DictReader(io.StringIO(table_of_contacts(gap))))
    assert [t["id"] for t in table] == ["next-1-001", "next-1-002", "next-1-003"]
    assert [t["repeat_of"] for t in table] == [m.ids[r] for r in rows]
    assert [t["target"] for t in table] == [dataset.targets[m.target[r]].name for r in rows]
    joints = range(1, dataset.robot.n + 1)
    read = [[float(t[f"j{k}_deg"]) for k in joints] for t in table]
    np.testing.assert_allclose(read, np.degrees(m.readings[rows]), atol=1e-6)
    moved = [[float(t[f"j{k}_degps"]) for k in joints] for t in table]
    np.testing.assert_allclose(moved, np.degrees(m.velocity[rows]), atol=1e-6)
    assert "payload_kg" not in table[0]


def test_a_changed_condition_is_no_repeat(dataset):
    gap, _ = advised(dataset, "more payload", -dataset.measurements.velocity[[2, 7, 11, 30]], np.full(4, 2.0))
    table = list(csv.DictReader(io.StringIO(table_of_contacts(gap))))
    assert {t["repeat_of"] for t in table} == {""}
    assert {t["payload_kg"] for t in table} == {"2"}
    (first, *_) = records(gap, gap.advice[0])
    assert json.loads(json.dumps(first))["payload_kg"] == 2.0
    assert len(first_contacts(gap).rows) == 3


def test_the_file_is_written_where_contacts_are_advised(tmp_path):
    gap = bc.diagnose(
        bc.simulate(effects="geometry", contacts=60, later=8, repeats=5, spheres=0, seed=1), "geometry"
    )
    names = gap.save(tmp_path / "run", pictures=False)
    listed = [c["id"] for a in gap.record["next"] for c in a["contacts"]]
    assert ("next.csv" in names) == bool(listed)
    if listed:
        text = (tmp_path / "run" / "next.csv").read_text(encoding="utf-8")
        assert [row["id"] for row in csv.DictReader(io.StringIO(text))] == listed
