"""Contacts that were never made: found whatever their share, and no measured contact is taken for one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_up_plans import made_up_plan
from probing_cell import on_planes

import bayescal as bc
from bayescal.dataset.consistency import CHANCE, planned
from bayescal.dataset.write import write_dataset

ROWS = 110


@pytest.fixture(scope="module")
def measured(cube):
    """A session, and the same with the readings of a plan, in the digits of plan.csv."""
    dataset = cube(seed=2, count=130).dataset
    at = on_planes(made_up_plan(dataset, count=ROWS, validation=0)).session.measurements.readings
    session = made_up_plan(dataset, count=ROWS, validation=20).session
    at = np.radians(np.round(np.degrees(at), 7))
    return session, np.concatenate([at, session.measurements.readings[ROWS:]])


def mixed(measured, rows):
    session, plan = measured
    readings = session.measurements.readings.copy()
    readings[rows] = plan[rows]
    return replace(session, measurements=replace(session.measurements, readings=readings))


def test_a_single_contact_is_found(measured):
    for row in range(0, ROWS, 10):
        found = planned(mixed(measured, [row]))
        assert found is not None
        assert found.rows.tolist() == [row]
        assert found.chance < CHANCE


@pytest.mark.parametrize("count", [4, 40, ROWS])
def test_and_so_are_many(measured, count):
    rows = np.sort(np.random.default_rng(0).choice(ROWS, count, replace=False))
    found = planned(mixed(measured, rows))
    assert found.rows.tolist() == rows.tolist()


def test_fewer_digits_need_more_contacts(measured):
    """As a controller logs the poses of a program, in 1e-5 deg: one can be chance, six cannot."""
    session, plan = measured
    coarse = (session, np.radians(np.round(np.degrees(plan), 5)))
    assert set(planned(mixed(coarse, np.arange(6))).rows) == set(range(6))


@pytest.mark.parametrize("spread", [1e-3, 1e-5])
def test_measured_contacts_are_not(measured, spread):
    """Contacts that are off by chance: of an arm with errors of 0.5 mm, of one as good as its noise."""
    session, plan = measured
    rng = np.random.default_rng(3)
    false = 0
    for _ in range(300):
        m = replace(session.measurements, readings=plan + spread * rng.standard_normal(plan.shape))
        false += planned(replace(session, measurements=m)) is not None
    assert false <= 3  # 0.3 expected


def test_check_and_fit_say_it(measured, tmp_path, command):
    dataset = mixed(measured, [17])
    write_dataset(dataset, tmp_path / "cell")
    code, said, _ = command("check", tmp_path / "cell", "--json")
    assert code == 0
    (found,) = [f for f in json.loads(said)["findings"] if f["code"] == "planned_pose"]
    name = dataset.measurements.ids[17]
    assert f"1 contact has the readings of a plan ({name})" in found["what"]
    assert found["where"].startswith("measurements.csv:19")
    result = bc.fit(tmp_path / "cell", model="geometry", samples=0)
    verdict = result.record["verdict"]
    assert verdict["words"].startswith("no calibration")
    assert not verdict["explains"]
    assert verdict["reasons"][0]["test"] == "planned_poses"
    assert name in str(result)
    assert "not valid" in str(result)


def test_a_plan_as_measurements_is_no_calibration(cube, tmp_path):
    """All contacts: residuals are nearly zero, and no other test of the fit fails."""
    dataset = on_planes(made_up_plan(cube(seed=2, count=90).dataset, count=70, validation=20)).session
    verdict = bc.fit(dataset, model="geometry", samples=0).record["verdict"]
    assert verdict["words"].startswith("no calibration")
    assert [r["test"] for r in verdict["reasons"]] == ["planned_poses"]
