"""What has misled identifications from joint logs before, each as a small log: nothing false follows."""

import gzip
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml
from cases import refused
from motion import made
from motion.made import of_rows, write
from scipy.ndimage import minimum_filter1d
from scipy.signal import butter, lfilter, sosfiltfilt
from scipy.special import logsumexp

from bayescal.logs import read_log
from bayescal.logs.types import CALIBRATE
from bayescal.motion.calibrate import _withheld
from bayescal.motion.diagnose import diagnose
from bayescal.motion.effects import EFFECTS
from bayescal.motion.estimate import estimated
from bayescal.motion.linear import gains, normal
from bayescal.motion.noise import noise_of, white_noise
from bayescal.motion.pool import Pool
from bayescal.motion.settings import BASELINE, SEARCH, SIGNALS
from bayescal.motion.signals import Bands, all_signals, derivative, signals_of
from bayescal.preparing.joint_log import check_log


def slow_noise(q, dq, ddq, tau, t, load):
    """Noise that half a second keeps."""
    white = np.random.default_rng(int(1e3 * t[0]) + 1).standard_normal(q.shape)
    return lfilter([np.sqrt(1.0 - 0.97**2)], [1.0, -0.97], white, axis=0) * made.SIGMA


def other_transition(q, dq, ddq, tau, t, load):
    """Friction reverses over 0.042 rad/s, where the nominal arm says 0.03."""
    return made.nominal().coulomb * (np.tanh(dq / 0.042) - np.tanh(dq / 0.03))


def linear_reversal(q, dq, ddq, tau, t, load):
    """Friction that grows in proportion to the speed up to 0.04 rad/s, where the model has a tangent."""
    return made.nominal().coulomb * (np.clip(dq / 0.04, -1.0, 1.0) - np.tanh(dq / 0.03))


def estimate_of(folder, extra=None):
    """The baseline of a made log."""
    return estimated(all_signals(read_log(write(folder, extra))))


def best_gain(estimate, noise=None):
    """Nats that the best cause gains beside the baseline, its size averaged as in a diagnosis."""
    pool, noise = Pool.of(estimate), noise or estimate.noise
    search = pool.search(normal(pool.table.of_role(CALIBRATE), noise))
    index, scales = search.normal.index, np.array(SEARCH.scales)
    sets = [np.array([index[name] for name in names]) for _, names in search.forms]
    table, _ = gains(search.fit(), sets, scales)
    weight = np.exp(-0.5 * (np.log(scales) / np.log(SEARCH.spread)) ** 2)
    return float(np.max(logsumexp(table, axis=1, b=weight / weight.sum())))


def test_slow_noise_is_no_effect_unless_it_is_taken_for_white(tmp_path):
    estimate = estimate_of(tmp_path / "log", slow_noise)
    assert estimate.noise.lag1.min() > 0.7
    assert best_gain(estimate, white_noise(estimate.noise.sd)) > 12.0
    assert best_gain(estimate) < 5.0


def test_noise_of_an_empty_band_is_not_amplified():
    # a logger low-passed at a third of the band of its rows
    rng = np.random.default_rng(0)
    sos = butter(6, 0.3, output="sos")
    parts = [sosfiltfilt(sos, rng.standard_normal((2000, 1)), axis=0) for _ in range(3)]
    noise = noise_of(parts)
    # a disturbance in the empty band of 3 % of the noise does not become chi2 / row of 24
    other = parts[0] + 0.03 * noise.sd * rng.standard_normal((2000, 1))
    assert np.mean(noise.whitened(other[:, 0], 0) ** 2) < 1.5


@pytest.mark.parametrize("step", [0.01, 0.04])
def test_derivatives_keep_five_hertz(step):
    """At a hundred rows a second by central differences it was 0.967, at 25 by five points 0.87."""
    t = np.arange(0.0, 200 * step, step)
    w = 2.0 * np.pi * 5.0
    ddq = derivative(derivative(np.sin(w * t)[:, None], step), step)[10:-10, 0]
    share = -ddq @ np.sin(w * t)[10:-10] / (w**2 * np.sum(np.sin(w * t)[10:-10] ** 2))
    assert share == pytest.approx(1.0, abs=0.02 if step > 0.01 else 0.005)


def test_another_transition_speed_of_friction_is_estimated(tmp_path):
    estimate = estimate_of(tmp_path / "log", other_transition)
    assert estimate.model.transition == pytest.approx(0.042, rel=0.12)
    assert best_gain(estimate) < 5.0


def test_another_form_of_the_reversal_of_friction_is_no_effect(tmp_path, monkeypatch):
    parts = all_signals(read_log(write(tmp_path / "log", linear_reversal)))
    assert best_gain(estimated(parts)) < 10.0
    for name in ("reversal", "reversals"):
        monkeypatch.setitem(vars(BASELINE), name, 1e-6)
    assert best_gain(estimated(parts)) > 100.0


def test_stamps_count_and_not_row_numbers(null_log):
    log = read_log(null_log)
    motion = log.motions[0]
    rng = np.random.default_rng(0)
    steps = rng.choice([0.010, 0.012], len(motion.time)) * 60.0 / 66.0 / 0.6
    time = motion.time[0] + np.cumsum(steps) - steps[0]
    wave = np.sin(2.0 * time)[:, None] * np.ones(3)
    uneven = replace(motion, time=time, position=wave, velocity=None, torque=np.zeros_like(wave))
    s = signals_of(log, uneven, float(time[0]), 0.0, Bands.of(log))
    inner = slice(20, -20)
    true = 2.0 * np.cos(2.0 * (s.time + time[0]))
    assert np.abs(s.dq[inner, 0] - true[inner]).max() < 0.02
    by_index = np.gradient(wave[:, 0], 1.0 / 60.0)
    assert np.abs(by_index - 2.0 * np.cos(2.0 * time)).max() > 0.1


def test_friction_of_a_joint_at_rest_stays_at_its_prior(tmp_path, monkeypatch):
    whole = made.path

    def resting(seed):
        t, q, dq, ddq = whole(seed)
        for x in (q, dq, ddq):
            x[:, 2] = 0.0
        return t, q, dq, ddq

    monkeypatch.setattr(made, "path", resting)
    folder = write(tmp_path / "log")
    fit = estimated(all_signals(read_log(folder))).fit()
    sd = {t.name: t.sd for t in fit.normal.terms}
    for name in ("coulomb 3", "viscous 3"):
        assert fit.u[name] > 0.9 * sd[name]
    assert fit.u["coulomb 1"] < 0.1 * sd["coulomb 1"]
    assert "resting" in {f.code for f in check_log(folder).findings}


def pausing(seed):
    """The sums of sines of `made.path`, which rest for a second twice."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, made.SECONDS, 1.0 / made.RATE)
    slope = np.full_like(t, 1.0)
    for rest in (2.5, 5.5):
        u = np.clip((np.abs(t - rest) - 0.5) / 0.5, 0.0, 1.0)
        slope *= u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    rate = np.gradient(slope, t)
    s = np.cumsum(slope) / made.RATE
    q, dq, ddq = np.zeros((3, len(t), 3))
    for j in range(3):
        for w in rng.uniform(0.6, 5.0, 4):
            a, phase = rng.uniform(0.1, 0.5) / w**0.7, rng.uniform(0, 6.28)
            q[:, j] += a * np.sin(w * s + phase)
            dq[:, j] += a * w * np.cos(w * s + phase) * slope
            ddq[:, j] += a * w * (np.cos(w * s + phase) * rate - w * np.sin(w * s + phase) * slope**2)
    return t, q, dq, ddq


def stiction(q, dq, ddq, tau, t, load):
    """Each rest holds each joint with a torque of its own, up to the friction."""
    still = np.all(np.abs(dq) < 1e-9, axis=1)
    number = np.cumsum(np.diff(still.astype(int), prepend=0) == 1)
    own = np.random.default_rng(int(1e3 * t[0])).uniform(-1.0, 1.0, (number[-1] + 1, 3))
    return np.where(still[:, None], own[number] * [3.0, 3.0, 1.5], 0.0)


def test_a_joint_that_rests_on_its_way_has_no_speed(tmp_path, monkeypatch):
    """The noise of its position was a direction: in logs without an effect it explained its own error."""
    monkeypatch.setattr(made, "path", pausing)
    s = all_signals(read_log(write(tmp_path / "log")))[0]
    dq = pausing(0)[2]
    rests = minimum_filter1d((np.abs(dq) < 1e-9).astype(int), 19, axis=0) == 1  # and 0.15 s before and after
    assert np.mean(rests) > 0.05
    assert np.mean(s.dq[rests] == 0.0) > 0.95
    assert np.all(s.dq[np.abs(dq) > 0.1] != 0.0)


def test_torques_of_stiction_are_no_effect(tmp_path, monkeypatch):
    """Rows at rest are left out where torques are far from the model there, and count where they are not."""
    monkeypatch.setattr(made, "path", pausing)
    free, held = estimate_of(tmp_path / "free"), estimate_of(tmp_path / "held", stiction)
    assert (free.parts[0].stuck, held.parts[0].stuck) == (None, SIGNALS.stuck)
    assert free.limits == free.parts[0].log.limits
    assert held.limits[-1].startswith("stiction holds joints at rest: ")
    assert held.model.coulomb == pytest.approx(free.model.coulomb, rel=0.02)
    assert best_gain(held) < 8.0  # of some hundred forms, before their prior
    every = replace(held, parts=tuple(s.changed(stuck=None) for s in held.parts))
    assert best_gain(every, free.noise) > 50.0


def test_withheld_errors_are_of_rows_that_stiction_does_not_hold(tmp_path, monkeypatch):
    """A fit leaves these out: no parameter explains them, and a cause would be looked for in vain."""

    def also_before_rest(q, dq, ddq, tau, t, load):
        own = 4.0 * stiction(q, 0.0 * dq, ddq, tau, t, load)
        return np.where(np.abs(dq) < 0.05, own, 0.0)

    monkeypatch.setattr(made, "path", pausing)
    held = estimate_of(tmp_path / "held", also_before_rest)
    every = replace(held, parts=tuple(s.changed(stuck=None) for s in held.parts))
    fit = held.fit()
    of_free, of_all = (_withheld(e, fit, e.model, e.model) for e in (held, every))
    assert all(a.fitted > 1.5 * f.fitted for a, f in zip(of_all, of_free, strict=True))
    assert all(w.fitted <= w.interval95[1] for w in of_free)


def test_a_log_in_which_no_joint_moves_has_errors_of_all_rows(tmp_path, monkeypatch):
    """Its torques are those of gravity, and its noise is that of the torques."""
    whole = made.path

    def resting(seed):
        t, q, dq, ddq = whole(seed)
        return t, np.broadcast_to(q[0], q.shape), 0.0 * dq, 0.0 * ddq

    monkeypatch.setattr(made, "path", resting)
    found = diagnose(read_log(write(tmp_path / "log")))
    assert found.verdict.kind == "null"
    assert found.shrinkage.before == pytest.approx(found.shrinkage.expected.rms, rel=0.5)
    assert found.shrinkage.before == pytest.approx(0.8 * made.SIGMA / np.sqrt(1.0 - 0.6**2), rel=0.6)


def test_a_last_row_that_is_cut_off_is_refused_with_its_line(null_log, tmp_path):
    folder = shutil.copytree(null_log, tmp_path / "log")
    lines = gzip.decompress((folder / "motion.csv.gz").read_bytes()).splitlines()
    cut = lines[-1][: len(lines[-1]) // 2].rpartition(b",")[0]
    (folder / "motion.csv.gz").write_bytes(gzip.compress(b"\n".join([*lines[:-1], cut])))
    refused(rf"motion.csv.gz:{len(lines)}: .*not a finite number", lambda: read_log(folder))


def test_a_torque_of_too_few_digits_is_left_out(null_log):
    """It is no torque constant, and no friction: it says nothing of its joint."""
    log = read_log(null_log)
    coarse = 0.9 * max(np.max(np.abs(m.torque[:, 1])) for m in log.motions)

    def rounded(m):
        torque = m.torque.copy()
        torque[:, 1] = coarse * np.round(torque[:, 1] / coarse)
        return replace(m, torque=torque)

    found = diagnose(replace(log, motions=tuple(map(rounded, log.motions))))
    assert found.verdict.kind == "null"
    assert np.isnan(found.estimate.noise.lag1).tolist() == [False, True, False]
    assert ": B " in found.warnings[-1]
    assert "left out" in found.warnings[-1]


@pytest.mark.parametrize(
    ("counts", "said"), [(8192, ["above 2.5 Hz"]), (2048, ["above 2.5 Hz", "noise counts as"])]
)
def test_of_a_coarse_encoder_with_filtered_velocities_nothing_is_named(null_log, counts, said):
    """Noise of accelerations is in drivers and residuals alike; late velocities would make torques early."""
    log, step = read_log(null_log), 2.0 * np.pi / counts

    def coarse(m):
        late = lfilter([0.3], [1.0, -0.7], derivative(m.position, 1.0 / 60.0), axis=0)
        return replace(m, position=np.round(m.position / step) * step, velocity=late)

    found = diagnose(replace(log, motions=tuple(map(coarse, log.motions))))
    assert found.verdict.kind == "null"
    assert "rows about reversals are left out where speeds are noise" in found.warnings[-1]
    assert all(words in found.warnings[-1] for words in said)


def test_rows_about_a_reversal_do_not_count_where_speeds_are_noise(null_parts):
    """Of the joints with such speeds alone; the others have all rows."""
    s, noise = null_parts[0], 0.01
    s = replace(s, stuck=None, unsure=np.array([0.0, noise, 0.5 * SIGNALS.blurred]))
    assert np.all(s.weight[:, [0, 2]] == 1.0)
    slow = np.abs(s.dq[:, 1]) < SIGNALS.still[0] * noise
    near = minimum_filter1d(np.abs(s.dq[:, 1]), 2 * round(0.5 / s.band / s.step) + 1)
    assert slow.any()
    assert np.all(s.weight[slow, 1] == 0.0)
    assert np.all(s.weight[near < SIGNALS.still[0] * noise, 1] == 0.0)
    assert np.all(s.weight[near > SIGNALS.still[1] * noise, 1] == 1.0)


def test_rows_that_are_left_out_are_said_and_counted_by_their_reason(null_estimate):
    """Those about reversals in any band; a joint whose torque tells nothing is not held by stiction."""
    assert null_estimate.limits == null_estimate.parts[0].log.limits

    def said(**of_parts):
        parts = tuple(s.changed(**of_parts) for s in null_estimate.parts)
        return replace(null_estimate, parts=parts).limits[-1]

    noisy = np.full(3, 2.0 * SIGNALS.blurred)
    assert said(unsure=noisy).startswith("rows about reversals are left out where speeds are noise")
    held = said(stuck=0.05)
    assert "stiction holds joints at rest" in held
    assert said(stuck=0.05, unsure=noisy, telling=np.array([True, False, True])) == held


def test_what_is_beyond_the_band_of_the_drives_is_not_made_a_name(null_parts):
    # a ripple of 20 Hz is in no row that is fitted; elasticity and backlash need a second encoder
    s = null_parts[0]
    t = s.time[:, None]
    inside, beyond = (np.std(s.kept(np.sin(2.0 * np.pi * hertz * t))) for hertz in (4.0, 20.0))
    assert inside == pytest.approx(np.sqrt(0.5), rel=0.05)
    assert beyond < 0.02
    for name in ("elasticity", "backlash"):
        assert "second encoders" in EFFECTS[name].needs(s.log)


def test_nothing_is_interpolated_where_rows_are_missing(null_log, null_estimate):
    log = read_log(null_log)
    kept = np.abs(log.motions[2].time - log.motions[2].time.mean()) > 0.5
    lossy = of_rows(log.motions[2], kept)
    log = replace(log, motions=(*log.motions[:2], lossy, *log.motions[3:]))
    estimate = estimated(all_signals(log))
    assert [s.name for s in estimate.parts] == ["1", "2", "3 (1)", "3 (2)", "4", "5", "6", "7", "8"]
    assert estimate.parts[3].log.motions[3].line == lossy.line + int(np.argmax(np.diff(lossy.time))) + 1
    assert estimate.noise.sd == pytest.approx(null_estimate.noise.sd, rel=0.1)
    assert any("rows are missing in motion 3" in said for said in estimate.limits)
    # of a role of which no part is long enough nothing can be said
    short = of_rows(replace(lossy, role="validate"), slice(None, None, 40))
    short = replace(short, time=short.time + np.arange(len(short.time)) // 2)
    log = replace(log, motions=(*log.motions[:6], short))
    refused("rows are missing in all motions of role validate", lambda: all_signals(log))


def test_the_arm_may_be_written_out_in_a_file_of_its_own(null_log, tmp_path):
    folder = shutil.copytree(null_log, tmp_path / "log")
    within = yaml.safe_load((folder / "dataset.yaml").read_text())
    (folder / "robot.yaml").write_text(yaml.safe_dump(within["robot"]))
    (folder / "dataset.yaml").write_text(yaml.safe_dump(within | {"robot": "robot.yaml"}))
    first, second = read_log(null_log), read_log(folder)
    assert np.array_equal(first.mechanism.inertials, second.mechanism.inertials)
    assert first.mechanism.u == second.mechanism.u
    assert folder / "robot.yaml" in second.files
    (folder / "robot.yaml").write_text(yaml.safe_dump(within["robot"] | {"u": {"mass": 0.3}}))
    assert read_log(folder).digest != second.digest
    assert read_log(folder).mechanism.u.mass == 0.3


def test_a_log_in_which_rows_are_missing_everywhere_is_checked_and_refused(null_log, tmp_path):
    folder = shutil.copytree(null_log, tmp_path / "log")
    table = pd.read_csv(folder / "motion.csv.gz")
    table["t_s"] += 0.2 * (np.arange(len(table)) // 50)
    table.to_csv(folder / "motion.csv.gz", index=False)
    assert "gaps" in [f.code for f in check_log(folder).findings]
    no_row = "rows are missing in all motions of role calibrate, validate"
    refused(no_row, lambda: all_signals(read_log(folder)))
