"""The check of logs of servos: jumps, zeros that differ between motions and calibrations, and sag."""

import json
import re
from functools import partial

import numpy as np
import pytest
from cases import refused
from joint_logs import made as whole
from joint_logs import written

import bayescal as bc

made = partial(whole, length=5.0)


def found(folder, code, **options):
    return [f for f in bc.check(folder, **options).data.findings if f.code == code]


def moved(log, rows, joint, degrees):
    for column in (f"q{joint}_deg", f"command{joint}_deg"):
        if column in log.columns:
            log.columns[column] = log.columns[column].copy()
            log.columns[column][rows] += degrees
    return log


@pytest.mark.parametrize(("degrees", "words"), [(25.0, "divide the motion"), (-360.0, "wraps at 4096 steps")])
def test_a_jump_within_a_motion(tmp_path, degrees, words):
    log = made()
    rows = log.of(3)[400:]
    (finding,) = found(written(moved(log, rows, 2, degrees), tmp_path / "log"), "jump")
    size = float(finding.what.removeprefix("J2 jumps by ").partition(" deg in one row of motion")[0])
    assert size == pytest.approx(degrees, abs=1.0)  # with the motion in this row
    assert words in finding.remedy
    assert finding.where.endswith(f":{rows[0] + 2}")


def test_a_single_wrong_value_is_a_spike_and_no_jump(tmp_path):
    folder = written(moved(made(), [made().of(2)[300]], 1, 40.0), tmp_path / "log")
    assert found(folder, "jump") == []
    assert len(found(folder, "spikes")) == 1


@pytest.mark.parametrize(("degrees", "words"), [(180.0, "half a turn"), (-360.0, "a whole turn")])
def test_a_motion_of_another_zero(tmp_path, degrees, words):
    def small(seed, time):
        return 0.3 * np.sin(time)[:, None] * [1.0, 0.8]

    log = made(trajectory=small)
    (finding,) = found(written(moved(log, log.of(4), 1, degrees), tmp_path / "log"), "turned")
    assert f"J1 is {words} from its other motions in" in finding.what
    assert found(written(moved(log, log.of(4), 1, -degrees), tmp_path / "again"), "turned") == []


def resting(seed, time):
    """Three poses with rests."""
    pose = np.array([[0.0, 0.2], [0.5, -0.3], [-0.4, 0.4]])[np.minimum((time / 1.7).astype(int), 2)]
    kernel = np.ones(101) / 101
    return np.column_stack([np.convolve(np.pad(p, 50, mode="edge"), kernel, "valid") for p in pose.T])


@pytest.mark.parametrize(("degrees", "count"), [(-1.5, 1), (0.2, 0)])
def test_sag(tmp_path, degrees, count):
    log = made(trajectory=resting)
    log.columns["command1_deg"] = log.columns["q1_deg"] - degrees
    log.columns["command2_deg"] = log.columns["q2_deg"].copy()
    findings = found(written(log, tmp_path / "log"), "sag")
    assert len(findings) == count
    if findings:
        assert f"J1 rests {degrees:.2f} deg from its command" in findings[0].what
        assert "it sags, gravity loads it with" in findings[0].what


WRONG = {
    "": lambda one, two: (np.roll(one, 125), np.roll(two, 125)),  # late by a second, which a fit finds
    "positions move 57 times as far as commands (J1)": lambda one, two: (np.radians(one), two),
    "positions move against commands (J2)": lambda one, two: (one, -two),
    "positions follow the command of another joint (J1 that of J2, J2 that of J1)": lambda *both: both[::-1],
    "positions do not follow commands (J1)": lambda one, two: (np.sort(one), two),
}


@pytest.mark.parametrize("words", WRONG)
def test_positions_that_do_not_follow_their_commands(tmp_path, words):
    """Servos are refused; of a log with torques the check says so. One motion is shorter than the delay."""
    log, names = whole(lag=0.04), ("command1_deg", "command2_deg")
    log.columns |= dict(zip(names, WRONG[words](*(log.columns[name] for name in names)), strict=True))
    rows = np.setdiff1d(np.arange(len(log.motion)), log.of(7)[60:])
    log.columns = {name: x[rows] for name, x in log.columns.items()}
    each = found(written(log, tmp_path / "log"), "command")
    assert [(f.kind, f.what) for f in each] == [("odd", words)] * bool(words)
    log.columns = {name: x for name, x in log.columns.items() if not name.startswith("torque")}
    log.settings["controller"] = {"kind": "position", "kp_Nm_per_rad": [900.0, 900.0]}
    folder = written(log, tmp_path / "servo")
    assert [f.kind for f in found(folder, "command")] == ["refused"] * bool(words)
    if words:
        assert not found(folder, "sag")
        refused(re.escape(words), lambda: bc.fit(folder, samples=0))


def calibration(path, **changes):
    usual = {"drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
    entries = {name: {"id": k, **usual, **changes.get(name, {})} for k, name in ((1, "J1"), (2, "J2"))}
    path.write_text(json.dumps(entries))
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return written(made(), tmp_path_factory.mktemp("servo") / "log")


def test_zeros_of_two_calibrations(log, tmp_path):
    one = calibration(tmp_path / "a.json")
    changes = {"J1": {"homing_offset": 100}, "J2": {"homing_offset": 2047, "range_max": 4096}}
    first, second = found(log, "zero", calibration=[one, calibration(tmp_path / "b.json", **changes)])
    assert "J1 reads -8.79 deg (-100 steps) more by b.json than by a.json" in first.what
    assert second.what.endswith("half a turn")
    assert found(log, "zero", calibration=[one, one]) == found(log, "zero", calibration=[one]) == []


def test_readings_beyond_the_range(log, tmp_path):
    narrow = calibration(tmp_path / "a.json", J2={"range_min": 2000, "range_max": 2100})
    (finding,) = found(log, "range", calibration=[narrow])
    assert "J2 is up to" in finding.what
    refused("option of joint logs", lambda: bc.check(tmp_path, calibration=[narrow]))
