"""The check of joint logs: each mistake of a recording is a finding, what is missing has a remedy."""

import json
import warnings
from dataclasses import replace
from types import SimpleNamespace

import foreign
import numpy as np
import pytest
from cases import refused
from click.testing import CliRunner
from joint_logs import KINDS, made, sines, written
from scipy.signal import butter, lfilter, sosfiltfilt
from typer.main import get_command

import bayescal as bc
from bayescal.cli import app
from bayescal.errors import BayescalError
from bayescal.logs import read_log
from bayescal.motion.effects import EFFECTS
from bayescal.preparing import joint_facts, joint_findings
from bayescal.preparing.joint_delays import mean as weighted_mean
from bayescal.preparing.joint_delays import uniform
from bayescal.preparing.joint_facts import gravity_torques
from bayescal.preparing.joint_log import mistaken


def checked(folder):
    return bc.check(folder).data


def codes(check):
    return [f.code for f in check.findings]


def of(check, code):
    found = [f for f in check.findings if f.code == code]
    assert len(found) == 1, codes(check)
    assert f"{found[0].what}{found[0].remedy}".count("\n") == 0
    return found[0]


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return written(made(), tmp_path_factory.mktemp("log") / "good")


def test_a_good_log_has_no_findings(good):
    check = checked(good)
    assert codes(check) == []
    assert check.log.limits == check.log.notes
    assert set(check.not_assessed) == {"servo-stiffness", "elasticity", "backlash"}
    assert set(check.assessed) == EFFECTS.keys() - check.not_assessed.keys()
    for joint in check.joints:
        assert abs(joint.torque_delay[0]) < 2 * joint.torque_delay[1] < 2.2e-3
        assert abs(joint.velocity_delay[0]) < 2e-4
        assert joint.velocity_gain == pytest.approx(1, abs=0.02)
        assert joint.velocity_cutoff == np.inf


def test_gravity_of_a_pose_by_hand(good):
    q = np.array([[0.3, 0.4]])
    second = 2.0 * 9.80665 * 0.15 * np.cos(0.7)
    first = second + 9.80665 * np.cos(0.3) * (5.0 * 0.2 + 2.0 * 0.4)
    np.testing.assert_allclose(gravity_torques(read_log(good), q), [[first, second]], rtol=1e-12)


@pytest.mark.parametrize("delay", [0.006, -0.004])
def test_a_delay_of_torque_is_found_and_stated(tmp_path, delay):
    check = checked(written(made(delay=(delay, delay)), tmp_path / "log"))
    finding = of(check, "delay")
    assert f"{'later' if delay > 0 else 'earlier'} than positions" in finding.what
    for joint in check.joints:
        assert joint.torque_delay[0] == pytest.approx(delay, abs=2 * joint.torque_delay[1])
    advised = float(finding.remedy.split("`alignment_ms: ")[1].split("`")[0])  # following it ends it
    assert advised == pytest.approx(1e3 * delay, abs=0.5)
    stated = written(made(delay=(delay, delay)), tmp_path / "stated", clock={"alignment_ms": advised})
    assert "delay" not in codes(checked(stated))


@pytest.mark.parametrize("delay", [0.0, 0.01])
def test_friction_that_reverses_over_a_way_is_no_delay(tmp_path, delay):
    """From all rows torques seem 10 ms later: friction follows a reversal over a way."""
    check = checked(written(made(delay=(delay, delay), bristles=5e-3), tmp_path / "log"))
    assert codes(check) == ["delay"] * bool(delay)
    for joint in check.joints:
        assert joint.torque_delay[0] == pytest.approx(delay, abs=2.5 * joint.torque_delay[1])
        assert joint.torque_delay[1] < 1e-3


def test_a_joint_of_another_delay_is_named_and_the_others_are_not(tmp_path):
    finding = of(checked(written(made(delay=(0.0, 0.015)), tmp_path / "log")), "joint_delay")
    assert "differs by joint: J" in finding.what
    log = SimpleNamespace(alignment=0.0, u_alignment=3e-4, motions=[SimpleNamespace(time=np.zeros(2))])
    delays = [8e-3, 1e-4, -1e-4, 0.0]
    usual = {"velocity_delay": (0.0, 1.0), "torque_delays": np.empty((3, 0))}
    joints = [SimpleNamespace(name=f"J{k}", torque_delay=(d, 5e-4), **usual) for k, d in enumerate(delays, 1)]
    found = list(joint_findings._clocks(log, joints, "motions.csv"))
    assert [f.code for f in found] == ["joint_delay"]
    assert found[0].what == "the delay of torque differs by joint: J1 8 ms; the others 0 ms"


def test_two_clocks_of_different_rates(tmp_path):
    log = made(motions=7)
    for j in (1, 2):
        torque, time = log.columns[f"torque{j}_Nm"], log.columns["t_s"]
        log.columns[f"torque{j}_Nm"] = np.interp(time - 1e-4 * (time - 40), time, torque)
    finding = of(checked(written(log, tmp_path / "log")), "clock_drift")
    assert "changes by" in finding.what
    slope = float(finding.what.partition("by ")[2].partition(" ")[0])
    assert slope == pytest.approx(100, abs=15)  # µs/s


DEV = foreign.DATA / "motion-dev"


@foreign.needs(DEV)
@pytest.mark.parametrize(
    ("name", "expected"), [("001", ["clock_drift"]), ("013", [])]
)  # their truths: clock-drift of 2.8 µs/s, an effect that is no mistake of the recording
def test_logs_of_another_author(name, expected):
    assert [f.code for f in checked(DEV / name).findings if f.kind == "odd"] == expected


def first_order(cutoff):
    """Velocities behind a low-pass of first order."""

    def filtered(time, v):
        share = np.exp(-2 * np.pi * cutoff * (time[1] - time[0]))
        return lfilter([1 - share], [1, -share], v, axis=0, zi=share * v[:1])[0]

    return filtered


@pytest.mark.parametrize("cutoff", [0.5, 0.8, 2.0])
def test_filtered_velocities(tmp_path, cutoff):
    """A filter that begins below the lowest frequencies of the motions is no wrong unit."""
    check = checked(written(made(velocity=first_order(cutoff)), tmp_path / "log"))
    assert "J1" in of(check, "velocity_delay").what
    assert "velocity" not in codes(check)
    for joint in check.joints:
        assert joint.velocity_delay[0] == pytest.approx(1 / (2 * np.pi * cutoff), rel=0.35)
        assert joint.velocity_gain == pytest.approx(1, abs=0.35)
        assert joint.velocity_cutoff == pytest.approx(cutoff, rel=1.1)


def test_late_velocities_do_not_make_torques_early(tmp_path):
    check = checked(written(made(velocity=first_order(17.0)), tmp_path / "log"))
    assert "velocity_delay" in codes(check)
    assert "delay" not in codes(check)
    for joint in check.joints:
        assert 4e-3 < joint.velocity_delay[0] < 11e-3
        assert abs(joint.torque_delay[0]) < 1.5e-3


def test_an_encoder_that_rests_has_no_filter():
    noise = np.random.default_rng(0).standard_normal(500)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(joint_facts.cutoff(np.zeros(500), noise, 0.008)).all()


def test_velocities_in_another_unit(tmp_path):
    check = checked(written(made(velocity=lambda time, v: v / 2), tmp_path / "log"))
    assert codes(check).count("velocity") == 2
    assert check.joints[0].velocity_gain == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("factor", [1000.0, 0.01, -1.0])
def test_torques_in_another_unit_of_another_sign_or_before_the_gear(tmp_path, factor):
    log = made()
    log.columns["torque1_Nm"] *= factor
    check = checked(written(log, tmp_path / "log"))
    gain = joint_facts.torque_gains(check.log, [uniform(m) for m in check.log.motions])[0]
    assert 0.5 < gain / factor < 2.0  # the rotors are no part of the masses
    assert of(check, "torque_scale" if factor > 0 else "torque_sign").what in (
        f"torques over those of the nominal masses: J1 {gain:.3g} (1 expected)",
        "by the torques of J1 friction drives the motion",
    )


@pytest.mark.parametrize(("names", "what"), [
    (("q", "dq", "torque"), "columns"), (("q", "dq"), "positions"), (("torque",), "torques"),
])  # fmt: skip
def test_joints_that_are_interchanged(tmp_path, names, what):
    log = made()
    for key in [k for k in log.columns if k.startswith(tuple(f"{name}1_" for name in names))]:
        other = key.replace("1_", "2_", 1)
        log.columns[key], log.columns[other] = log.columns[other], log.columns[key]
    finding = of(checked(written(log, tmp_path / "log")), "order")
    assert finding.what.startswith(f"the {what} of J1 and J2")


def test_a_torque_of_the_opposite_sense_at_one_joint(tmp_path, monkeypatch):
    """The check says so, and what `fit` and `gap` compute from has it among its notes."""
    log = made()
    log.columns["torque2_Nm"] *= -1.0
    folder, words = written(log, tmp_path / "log"), "by the torques of J2 friction drives the motion"
    assert of(checked(folder), "torque_sign").what == words
    assert "torque_sign" not in {f.code for f in mistaken(replace(read_log(folder), signed=False))}
    notes = []

    def taken(log, *_):
        notes.append(log.limits)
        raise BayescalError("enough", "", "")

    for module, name, command in (("calibrate", "calibrate", bc.fit), ("diagnose", "diagnose", bc.diagnose)):
        monkeypatch.setattr(f"bayescal.motion.{module}.{name}", taken)
        with pytest.raises(BayescalError, match="enough"):
            command(folder)
    assert [sum(text.startswith(words) for text in of) for of in notes] == [1, 1]


def test_a_log_of_few_rows_has_no_delays(tmp_path):
    log = made()
    log.columns["t_s"] = 1e3 * log.columns["t_s"]
    assert not np.isfinite(checked(written(log, tmp_path / "log")).joints[0].torque_delay).any()


def test_positions_behind_commands(tmp_path):
    servo = {"kind": "position", "kp_Nm_per_rad": [100, 100]}
    check = checked(written(made(lag=0.05), tmp_path / "log", controller=servo))
    for joint in check.joints:
        assert joint.command_delay[0] == pytest.approx(0.05, abs=2e-3)
    assert "servo-stiffness" in check.assessed


def test_jitter_of_stamps_is_stated_and_does_no_harm(tmp_path):
    rng = np.random.default_rng(0)

    def jitter(time):
        return time + 1.6e-3 * rng.uniform(-1, 1, len(time))

    check = checked(written(made(stamps=jitter), tmp_path / "log"))
    assert codes(check) == ["jitter"]
    assert "stamps count" in of(check, "jitter").what
    assert abs(check.joints[0].velocity_delay[0]) < 5e-4  # by index it would be some per cent wrong
    by_index = made(stamps=jitter)
    by_index.columns["t_s"] = 0.008 * np.arange(len(by_index.motion)) + 2.0 * by_index.motion
    assert checked(written(by_index, tmp_path / "index")).stamps.jitter < 1e-6


def test_gaps(tmp_path):
    log = made()
    keep = np.ones(len(log.motion), bool)
    keep[log.of(2)[300:360]] = False
    log.columns = {k: v[keep] for k, v in log.columns.items()}
    finding = of(checked(written(log, tmp_path / "log")), "gaps")
    assert "1 gap in the stamps, the longest 0.488 s" in finding.what
    assert finding.where == f"motion.csv:{log.of(2)[300] + 2} (motion 2)"


def test_stamps_that_go_back_or_repeat_are_refused_with_their_line(tmp_path):
    for k, change in enumerate((-0.1, -0.008)):
        log = made()
        row = log.of(2)[50]
        log.columns["t_s"][row] += change
        with pytest.raises(BayescalError, match=rf"motion.csv:{row + 2}: `t_s` does not increase"):
            bc.check(written(log, tmp_path / f"log{k}"))


def test_a_corrupt_value_beyond_any_arm_is_refused_and_a_spike_is_found(tmp_path):
    log = made()
    row = log.of(3)[70]
    log.columns["torque2_Nm"][row] = 300.0
    finding = of(checked(written(log, tmp_path / "spike")), "spikes")
    assert "motion 3 with a torque far from their neighbours" in finding.what
    assert abs(int(finding.where.partition(":")[2]) - (row + 2)) <= 2
    log.columns["torque2_Nm"][row] = 1e111
    with pytest.raises(BayescalError, match=rf"motion.csv:{row + 2}: `torque2_Nm` is beyond"):
        bc.check(written(log, tmp_path / "corrupt"))


def test_steps_are_no_spikes():
    rng = np.random.default_rng(0)
    step = (np.arange(1000) > 700)[:, None] + 1e-3 * rng.standard_normal((1000, 1))
    assert len(joint_facts.spikes(step, np.ptp(step, axis=0))) == 0
    step[500] += 0.5
    assert joint_facts.spikes(step, np.ptp(step, axis=0)).tolist() == [500]
    # a step of the encoder while the joint rests, which moves in other motions
    rest = np.where(np.arange(1000) == 500, 1e-5, 0.0)[:, None]
    assert joint_facts.spikes(rest, np.ptp(rest, axis=0)).tolist() == [500]
    assert len(joint_facts.spikes(rest, np.array([1.0]))) == 0


def test_bad_ends_of_motions(tmp_path):
    log = made()
    log.columns["dq1_degps"][log.of(4)[-1]] += 60.0
    finding = of(checked(written(log, tmp_path / "log")), "ends")
    assert "motion 4 ends with" in finding.what
    assert finding.where == f"motion.csv:{log.of(4)[-1] + 2}"


def test_unsigned_and_missing_torques(tmp_path):
    log = made()
    for j in (1, 2):
        log.columns[f"torque{j}_Nm"] = np.abs(log.columns[f"torque{j}_Nm"])
    check = checked(written(log, tmp_path / "log", torque={"sign": "none"}))
    assert "torques have no sign: they are not assessed" in of(check, "unsigned").what
    assert of(check, "unsigned").kind == "refused"
    assert check.assessed == ()
    assert "no torques with a sign" in check.not_assessed["payload"]
    for j in (1, 2):
        del log.columns[f"torque{j}_Nm"]
    check = checked(written(log, tmp_path / "none"))
    assert of(check, "no_torque").kind == "refused"
    assert check.assessed == ()
    assert set(check.not_assessed.values()) == {"no torques: log torques or currents"}


def test_limited_torque_and_held_positions(tmp_path):
    log = made()
    log.columns["torque1_Nm"] = np.minimum(log.columns["torque1_Nm"], 20.0)
    for j in (1, 2):
        log.columns[f"q{j}_deg"] = np.repeat(log.columns[f"q{j}_deg"][::4], 4)[: len(log.motion)]
    check = checked(written(log, tmp_path / "log"))
    assert "the torque of J1 is limited at 20 N m" in of(check, "clipped").what
    still = [f.what.partition(" for")[0] for f in check.findings if f.code == "held"]
    assert still == ["positions of J1 are held", "positions of J2 are held"]


def test_a_signal_that_never_changes(tmp_path):
    log = made(motions=2, length=4.0)
    log.columns["torque2_Nm"] = np.zeros(len(log.motion))
    finding = of(checked(written(log, tmp_path / "log")), "constant")
    assert finding.what == "the torque of J2 never changes though the joint moves"


def test_a_filtered_torque(tmp_path):
    log = made()
    rng = np.random.default_rng(0)
    low = butter(4, 12.0, fs=125.0, output="sos")
    noise = rng.standard_normal(len(log.motion))
    log.columns["torque1_Nm"] = sosfiltfilt(low, log.columns["torque1_Nm"] + noise)
    log.columns["torque2_Nm"] = log.columns["torque2_Nm"] + noise
    joints = checked(written(log, tmp_path / "log")).joints
    assert 7.0 < joints[0].torque_band < 20.0
    assert joints[1].torque_band == np.inf


def test_what_a_poor_log_lacks(tmp_path):
    def poor(seed, time):
        return sines(seed, time, 0.05) * np.array([1.0, 0.0])

    log = made(trajectory=poor, length=4.0, motions=3)
    for entry in log.settings["motions"]:
        entry |= {"payload_kg": 0.0, "same_as": entry["id"], "kind": "x", "role": "calibrate"}
    log.settings["motions"][2]["role"] = "validate"
    for key in ("temperature_degC", "command1_deg", "command2_deg"):
        del log.columns[key]
    check = checked(written(log, tmp_path / "log"))
    assert codes(check) == [
        "same_kind", "no_repeat", "few_motions", "resting", "no_fast", "one_pose", "no_loads",
        "no_temperature", "no_command",
    ]  # fmt: skip
    assert of(check, "resting").what == "J2 not moved: friction undetermined"
    assert of(check, "few_motions").what == "3 motions, 3 of them shorter than 10 s"
    assert of(check, "one_pose").what.startswith("J1, J2: gravity loads them in one pose")
    assert "no motion carries a payload" in check.not_assessed["payload-offset"]
    assert "torque-constant" in check.not_assessed


def test_loads_in_a_block_few_kelvin_and_no_slow_crossing(tmp_path):
    def fast(seed, time):  # reverses with large acceleration
        return 2.0 * np.sin(2 * np.pi * 0.8 * time[:, None] + np.array([0.0, 1.0])) + 0 * sines(seed, time)

    log = made(trajectory=fast)
    for k, entry in enumerate(log.settings["motions"]):
        entry["payload_kg"] = float(k > 3)
        entry["kind"] = KINDS[k]
    log.columns["temperature_degC"] = 25 + 0.5 * np.sin(log.columns["t_s"] / 60)
    check = checked(written(log, tmp_path / "log"))
    assert "loaded motions come in one block" in of(check, "load_order").what
    assert "the temperature varies by" in of(check, "no_warm_up").what
    assert "J1, J2: less than 2 s slower than 0.05 rad/s" in of(check, "no_slow").what
    assert "reverse slowly" in check.not_assessed["stribeck"]
    assert "log 10 K of warm-up" in check.not_assessed["viscous-temperature"]


def test_second_encoders_and_sensors(tmp_path):
    log = made()
    for j in (1, 2):
        log.columns[f"link{j}_deg"] = log.columns[f"q{j}_deg"]
    check = checked(written(log, tmp_path / "log", torque={"kind": "sensor"}))
    assert {"backlash", "elasticity"} <= set(check.assessed)
    assert "it has no torque constant" in check.not_assessed["torque-constant"]


def test_two_motions_are_needed(tmp_path):
    refused("fewer than two motions", lambda: bc.check(written(made(motions=1), tmp_path / "log")))


def test_the_command_prints_both_forms(good):
    table = CliRunner().invoke(get_command(app), ["check", str(good)], env={"COLUMNS": "160"})
    assert table.exit_code == 0
    assert "assessable" in table.output
    assert f"bayescal fit {good}" in table.output.replace("\n", "")
    assert "J2" in table.output
    record = json.loads(CliRunner().invoke(get_command(app), ["check", str(good), "--to", "json"]).output)
    assert record["schema"] == "bayescal-motion-check/1"
    assert record["joints"][0]["delay_ms"]["velocity"]["value"] == pytest.approx(0.0, abs=0.2)
    assert record["columns"] == ["position", "velocity", "command", "torque", "temperature"]
    result = bc.check(good)
    assert repr(result) == "<check of two joints: no findings>"
    assert list(result.joints.index) == ["J1", "J2"]
    assert list(result.findings.columns) == ["code", "kind", "what", "where", "remedy"]


@pytest.mark.parametrize("count", [8, 60])
def test_the_u_of_a_median_and_of_a_weighted_mean_is_its_scatter(count):
    rng = np.random.default_rng(count)
    found = np.array([joint_facts.middle(rng.normal(3.0, 0.2, count)) for _ in range(300)])
    pulls = (found[:, 0] - 3.0) / found[:, 1]
    assert np.sqrt(np.median(pulls**2)) / 0.6745 == pytest.approx(1.0, abs=0.3)
    # the u of a weighted mean is its scatter
    rng = np.random.default_rng(count)
    weight = rng.uniform(0.5, 2.0, count)
    found = np.array([weighted_mean(3.0 + rng.normal(0, weight**-0.5), weight) for _ in range(300)])
    pulls = (found[:, 0] - 3.0) / found[:, 1]
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("loose", [1e-4, 2e-2])
def test_a_delay_of_all_joints_is_as_sure_as_that_of_the_surest(monkeypatch, loose):
    """A joint that tells little of it makes it neither less sure nor another one."""
    monkeypatch.setattr(joint_findings, "clock_drift", lambda *_: (0.0, 1.0))
    log = SimpleNamespace(alignment=0.0, u_alignment=1e-4, motions=[SimpleNamespace(time=np.zeros(2))])
    delays = enumerate([(5e-3, 1e-4), (5e-3 + loose, loose)])
    joints = [SimpleNamespace(name=f"J{k}", torque_delay=d, velocity_delay=(0.0, 1.0)) for k, d in delays]
    found = {f.code: f.what for f in joint_findings._clocks(log, joints, "motions.csv")}
    weights = np.array([1e-4, loose]) ** -2
    mean = (weights @ [5e-3, 5e-3 + loose]) / weights.sum()
    assert f"{1e3 * mean:.2f} ms (u 0.10) later" in found["delay"]
    assert "joint_delay" not in found


def test_a_torque_of_too_few_digits(tmp_path):
    """Currents of small drives are zero in most rows: what follows from them is wrong, and is said to be."""
    log = made()
    coarse = 2.5 * np.max(np.abs(log.columns["torque2_Nm"]))
    log.columns["torque2_Nm"] = coarse * np.round(log.columns["torque2_Nm"] / coarse)
    log.columns["torque2_Nm"][::50] = coarse
    finding = of(checked(written(log, tmp_path / "log")), "coarse")
    assert "J2" in finding.what
    assert "J1" not in finding.what
    read = read_log(tmp_path / "log")
    assert list(read.coarse) == ["J2"]
    assert "one and the same torque" in read.limits[-1]
    assert "J2" in read.limits[-1]
